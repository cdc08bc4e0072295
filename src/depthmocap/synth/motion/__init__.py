"""Postures: motion capture files, pools, the prior, and procedural motion."""
