"""Depth as levels of an 8-bit image."""

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def depth_levels(depth_m, mask, scale, near_cm, far_cm, levels):
    """1 + the nearest of 256 depth levels between ``near_cm`` and ``far_cm`` (times ``scale``); 0 outside the mask and
    without depth."""
    height, width = depth_m.shape
    for i in range(height):
        for j in range(width):
            depth = np.float64(depth_m[i, j])
            if mask[i, j] and depth > 0:
                level = np.rint((depth * 100 / scale - near_cm) / (far_cm - near_cm) * 255)
                levels[i, j] = 1 + min(max(level, 0.0), 255.0)
            else:
                levels[i, j] = 0
