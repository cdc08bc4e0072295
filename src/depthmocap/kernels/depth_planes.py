"""Differences of neighbouring depth pixels as planes of bytes, in one pass over the picture."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def split_differences(raw, low, high):
    """Write the low and the high bytes of each pixel's difference from its left neighbour, by zigzag.

    Differences wrap around. The first pixel of a row is its difference from 0.

    Args:
        raw: (h, w) uint16.
        low, high: (h, w) uint8, written.
    """
    for v in range(raw.shape[0]):
        before = np.uint16(0)
        for u in range(raw.shape[1]):
            pixel = raw[v, u]
            signed = np.int16(np.uint16(pixel - before))
            folded = np.uint16((signed << 1) ^ (signed >> 15))
            low[v, u] = np.uint8(folded & 255)
            high[v, u] = np.uint8(folded >> 8)
            before = pixel
