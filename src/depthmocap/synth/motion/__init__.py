"""Postures: motion capture files, pools and the prior, and the demo's motion."""
