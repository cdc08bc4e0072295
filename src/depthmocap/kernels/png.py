"""Scanlines of label and depth pictures, filtered as PNG wants them (filter "up": the difference to the row above)."""

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def filter_colours(values, colours, rows):
    """Write the RGBA of ``colours[values]`` (h, w) into ``rows`` (h, 1 + 4 w), byte 0 being the filter's number, 2.

    The row above the first counts as zeros.
    """
    height, width = values.shape
    for i in range(height):
        row = rows[i]
        row[0] = 2
        for j in range(width):
            here = values[i, j]
            above = values[i - 1, j] if i > 0 else 0
            at = 1 + 4 * j
            if here == above and i > 0:
                row[at] = row[at + 1] = row[at + 2] = row[at + 3] = 0
            else:
                for k in range(4):
                    previous = colours[above, k] if i > 0 else np.uint8(0)
                    row[at + k] = colours[here, k] - previous


@numba.njit(cache=True, nogil=True)
def depth_levels(depth_m, mask, scale, near_cm, far_cm, levels):
    """1 + the nearest of 256 levels of depth between ``near_cm`` and ``far_cm`` (times ``scale``); 0 outside the mask
    and where there is no depth."""
    height, width = depth_m.shape
    for i in range(height):
        for j in range(width):
            depth = np.float64(depth_m[i, j])
            if mask[i, j] and depth > 0:
                level = np.rint((depth * 100 / scale - near_cm) / (far_cm - near_cm) * 255)
                levels[i, j] = 1 + min(max(level, 0.0), 255.0)
            else:
                levels[i, j] = 0
