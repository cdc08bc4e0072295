"""Resampling between a depth image and the network's window, in both directions, by the nearest pixel."""

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def mark_supported(depth, mask, tolerance_m, tolerance_per_m, fewest, out):
    """Set ``out`` (False before) at masked pixels of which at least ``fewest`` of the 8 masked neighbours are near in
    depth."""
    height, width = depth.shape
    for y in range(height):
        for x in range(width):
            if not mask[y, x]:
                continue
            z = depth[y, x]
            tolerance = tolerance_m + tolerance_per_m * z
            count = 0
            for v in range(max(y - 1, 0), min(y + 2, height)):
                for u in range(max(x - 1, 0), min(x + 2, width)):
                    if mask[v, u] and abs(depth[v, u] - z) < tolerance:
                        count += 1
                if count > fewest:  # the pixel counts itself
                    out[y, x] = True
                    break


@numba.njit(cache=True, nogil=True)
def gather_depth(depth, mask, corner, left, top, step, centre_m, scale_m, out):
    """Fill ``out[0]`` with scaled relative depth and ``out[1]`` with the mask; both must be zero before.

    ``depth`` and ``mask`` are a part of the image, whose first pixel is at the row and column of ``corner``. Window
    pixel (i, j) reads the image at ``(top + (i + 0.5)·step, left + (j + 0.5)·step)``, rounded down.
    """
    height, width = depth.shape
    columns = np.floor(left + (np.arange(out.shape[2]) + 0.5) * step).astype(np.int64) - corner[1]
    first, last = np.searchsorted(columns, 0), np.searchsorted(columns, width)
    for i in range(out.shape[1]):
        y = int(np.floor(top + (i + 0.5) * step)) - corner[0]
        if y < 0 or y >= height:
            continue
        for j in range(first, last):
            x = columns[j]
            if mask[y, x]:
                value = (depth[y, x] - centre_m) / scale_m
                out[0, i, j] = min(max(value, -2.0), 2.0)
                out[1, i, j] = 1.0


@numba.njit(cache=True, nogil=True)
def gather_labels(labels, left, top, step, out):
    """Labels of the image in the window, by the same rule; ``out`` keeps its values outside the image."""
    height, width = labels.shape
    for i in range(out.shape[0]):
        y = int(np.floor(top + (i + 0.5) * step))
        if y < 0 or y >= height:
            continue
        for j in range(out.shape[1]):
            x = int(np.floor(left + (j + 0.5) * step))
            if 0 <= x < width:
                out[i, j] = labels[y, x]


@numba.njit(cache=True, nogil=True)
def scatter_labels(window_labels, window_confidence, mask, left, top, step, out_labels, out_confidence):
    """Labels and confidences of the window at every masked pixel of the image; both outputs must be zero before."""
    height, width = mask.shape
    rows, columns = window_labels.shape
    first = max(int(np.floor(top)), 0)
    last = min(int(np.ceil(top + rows * step)), height)
    column_of = np.empty(width, np.int64)
    for x in range(width):
        column_of[x] = min(max(int((x + 0.5 - left) / step), 0), columns - 1)
    for y in range(first, last):
        i = min(max(int((y + 0.5 - top) / step), 0), rows - 1)
        for x in range(width):
            if mask[y, x]:
                out_labels[y, x] = window_labels[i, column_of[x]]
                out_confidence[y, x] = window_confidence[i, column_of[x]]
