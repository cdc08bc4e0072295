"""Resampling between a depth image and the network's window, in both directions, by the nearest pixel.

A window may be turned against the image. ``turn`` is the cosine and the sine of the angle; (1, 0) for a window that is
not turned. Its place is told in the turned image, whose point (u', v') is that of the image at
``(cos·u' - sin·v', sin·u' + cos·v')``.
"""

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
def turned_extents(mask, corner, turn):
    """Left, top, right and bottom of the masked pixels in the turned image; ``mask`` is a part of the image, whose
    first pixel is at the row and column of ``corner``."""
    cosine, sine = turn
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    for y in range(mask.shape[0]):
        for x in range(mask.shape[1]):
            if mask[y, x]:
                u, v = corner[1] + x + 0.5, corner[0] + y + 0.5
                turned_u, turned_v = cosine * u + sine * v, cosine * v - sine * u
                left, right = min(left, turned_u - 0.5), max(right, turned_u + 0.5)
                top, bottom = min(top, turned_v - 0.5), max(bottom, turned_v + 0.5)
    return left, top, right, bottom


@numba.njit(cache=True, nogil=True)
def gather_depth(depth, mask, corner, left, top, step, turn, centre_m, scale_m, out):
    """Fill ``out[0]`` with scaled relative depth and ``out[1]`` with the mask; both must be zero before.

    ``depth`` and ``mask`` are a part of the image, whose first pixel is at the row and column of ``corner``. Window
    pixel (i, j) reads the turned image at ``(top + (i + 0.5)·step, left + (j + 0.5)·step)``, rounded down in the image.
    """
    height, width = depth.shape
    cosine, sine = turn
    for i in range(out.shape[1]):
        v = top + (i + 0.5) * step
        for j in range(out.shape[2]):
            u = left + (j + 0.5) * step
            x = int(np.floor(cosine * u - sine * v)) - corner[1]
            y = int(np.floor(sine * u + cosine * v)) - corner[0]
            if 0 <= y < height and 0 <= x < width and mask[y, x]:
                value = (depth[y, x] - centre_m) / scale_m
                out[0, i, j] = min(max(value, -2.0), 2.0)
                out[1, i, j] = 1.0


@numba.njit(cache=True, nogil=True)
def gather_labels(labels, left, top, step, turn, out):
    """Labels of the image in the window, by the same rule; ``out`` keeps its values outside the image."""
    height, width = labels.shape
    cosine, sine = turn
    for i in range(out.shape[0]):
        v = top + (i + 0.5) * step
        for j in range(out.shape[1]):
            u = left + (j + 0.5) * step
            x, y = int(np.floor(cosine * u - sine * v)), int(np.floor(sine * u + cosine * v))
            if 0 <= y < height and 0 <= x < width:
                out[i, j] = labels[y, x]


@numba.njit(cache=True, nogil=True)
def scatter_labels(window_labels, window_confidence, mask, left, top, step, turn, out_labels, out_confidence):
    """Labels and confidences of the window at every masked pixel of the image; both outputs must be zero before."""
    height, width = mask.shape
    rows, columns = window_labels.shape
    cosine, sine = turn
    lowest, highest = np.inf, -np.inf
    for v in (top, top + rows * step):
        for u in (left, left + columns * step):
            lowest, highest = min(lowest, sine * u + cosine * v), max(highest, sine * u + cosine * v)
    for y in range(max(int(np.floor(lowest)), 0), min(int(np.ceil(highest)), height)):
        for x in range(width):
            if mask[y, x]:
                u, v = x + 0.5, y + 0.5
                i = min(max(int((cosine * v - sine * u - top) / step), 0), rows - 1)
                j = min(max(int((cosine * u + sine * v - left) / step), 0), columns - 1)
                out_labels[y, x] = window_labels[i, j]
                out_confidence[y, x] = window_confidence[i, j]
