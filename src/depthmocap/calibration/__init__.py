"""Calibration: the extrinsics of depth cameras, from a person who moves in front of them."""
