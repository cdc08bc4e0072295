"""A depth image on a coarse grid, as the network that finds people sees it."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def sample_depth(depth_m, rows, columns, out):
    """Copy the pixels at the crossings of ``rows`` and ``columns``; a row or column of -1 gives 0."""
    for i in range(len(rows)):
        for j in range(len(columns)):
            inside = rows[i] >= 0 and columns[j] >= 0
            out[i, j] = depth_m[rows[i], columns[j]] if inside else np.float32(0)


@numba.njit(cache=True, nogil=True)
def describe_cells(samples_m, cell_px, farthest_m, out):
    """The network's inputs: for each cell of 2×2 samples their valid share, the logarithm of their mean depth, how far
    each lies behind it, and the slopes of the surface to the right and downwards.

    Args:
        samples_m: (2h, 2w) depth (metres), 0 where invalid.
        cell_px: focal length in cells.
        farthest_m: depth beyond this counts as invalid.
        out: (8, h, w) float32.
    """
    height, width = out.shape[1:]
    mean_m = np.zeros((height, width), np.float32)
    for i in range(height):
        for j in range(width):
            total, count = np.float32(0), 0
            for k in range(4):
                z = samples_m[2 * i + k // 2, 2 * j + k % 2]
                if 0 < z < farthest_m:
                    total += z
                    count += 1
            mean = total / max(count, 1)
            mean_m[i, j] = mean
            out[0, i, j] = count / 4
            out[1, i, j] = (np.log2(mean) - 1) / 2 if count else 0
            for k in range(4):
                z = samples_m[2 * i + k // 2, 2 * j + k % 2]
                out[2 + k, i, j] = min(max((z - mean) * 6, -1), 1) if 0 < z < farthest_m else 0
    for i in range(height):
        for j in range(width):
            z = mean_m[i, j]
            for axis in range(2):
                slope = np.float32(0)
                a = mean_m[i - axis, j - (1 - axis)] if (i if axis else j) > 0 else np.float32(0)
                b = np.float32(0)
                if (i + 1 < height) if axis else (j + 1 < width):
                    b = mean_m[i + axis, j + (1 - axis)]
                if z > 0 and a > 0 and b > 0:
                    slope = (b - a) * cell_px / (4 * z)
                out[6 + axis, i, j] = min(max(slope, -1), 1)


@numba.njit(cache=True, nogil=True)
def spread_outputs(outputs, logits, offsets):
    """Copy the network's outputs: the logits of each cell's four samples to these, and the offsets of the cells.

    Args:
        outputs: (7, h, w).
        logits: (2h, 2w).
        offsets: (3, h, w).
    """
    height, width = outputs.shape[1:]
    for i in range(height):
        for k in range(2):
            for j in range(width):
                logits[2 * i + k, 2 * j] = outputs[2 * k, i, j]
                logits[2 * i + k, 2 * j + 1] = outputs[2 * k + 1, i, j]
        for axis in range(3):
            for j in range(width):
                offsets[axis, i, j] = outputs[4 + axis, i, j]


@numba.njit(cache=True, nogil=True)
def box_of_full_cells(marked):
    """First row, end of rows, first column and end of columns of the cells of which all four samples are marked; the
    ends are 0 where there is none.

    Args:
        marked: (2h, 2w) bool.
    """
    height, width = marked.shape[0] // 2, marked.shape[1] // 2
    top, bottom, left, right = height, 0, width, 0
    for i in range(height):
        for j in range(width):
            if (
                marked[2 * i, 2 * j]
                and marked[2 * i, 2 * j + 1]
                and marked[2 * i + 1, 2 * j]
                and marked[2 * i + 1, 2 * j + 1]
            ):
                top, bottom, left, right = min(top, i), i + 1, min(left, j), max(right, j + 1)
    return top, bottom, left, right
