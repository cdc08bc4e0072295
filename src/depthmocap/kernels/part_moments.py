"""Robust moments of the points of each region in one view."""

from __future__ import annotations

import numba
import numpy as np

#: Columns of a row of ``part_moments``: number of points, sum of weights, sum of robust weights, centre (3), and the
#: covariance's xx, xy, xz, yy, yz, zz.
MOMENTS = 12
_ITERATIONS = 4
#: Most points of a region that are used; of more points, as many are chosen evenly.
_MOST_POINTS = 400


# Sums in any order, without checks for division by 0, let the compiler vectorise the loops over points.
@numba.njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def part_moments(points, labels, weights, rotation, region_count, scale_m):
    """(regions, 12) moments of rotated points; in rows whose first column is 0, only that column is valid.

    Centre and covariance give each point its weight / (1 + d² / scale²)², where d is the distance from the centre. The
    centre is found by iterative reweighting from the mean (Geman-McClure). Outliers then hardly count, and the result
    rotates with the points.
    """
    out = np.zeros((region_count, MOMENTS))
    starts = np.zeros(region_count + 1, np.int64)
    for i in range(labels.shape[0]):
        starts[labels[i]] += 1  # of region r in [r], so that the sum up to r is the start of r + 1
    starts[0] = 0
    for region in range(region_count):
        out[region, 0] = starts[region + 1]
        starts[region + 1] += starts[region]
    order = np.empty(labels.shape[0], np.int64)
    next_free = starts[:region_count].copy()
    for i in range(labels.shape[0]):
        region = labels[i] - 1
        if region >= 0:
            order[next_free[region]] = i
            next_free[region] += 1
    p = np.empty((4, _MOST_POINTS))
    for region in range(region_count):
        count = starts[region + 1] - starts[region]
        if count == 0:
            continue
        used = min(count, _MOST_POINTS)
        total = 0.0
        for k in range(used):
            i = order[starts[region] + k * count // used]
            for axis in range(3):
                r = rotation[axis]
                p[axis, k] = r[0] * points[i, 0] + r[1] * points[i, 1] + r[2] * points[i, 2]
            p[3, k] = max(weights[i], 1e-6)
            total += p[3, k]
        x, y, z = np.mean(p[0, :used]), np.mean(p[1, :used]), np.mean(p[2, :used])
        weight_sum = 0.0
        for _ in range(_ITERATIONS):
            sx, sy, sz, weight_sum = 0.0, 0.0, 0.0, 0.0
            for k in range(used):
                dx, dy, dz = p[0, k] - x, p[1, k] - y, p[2, k] - z
                f = 1 + (dx * dx + dy * dy + dz * dz) / (scale_m * scale_m)
                w = p[3, k] / (f * f)
                sx, sy, sz, weight_sum = sx + w * dx, sy + w * dy, sz + w * dz, weight_sum + w
            x, y, z = x + sx / weight_sum, y + sy / weight_sum, z + sz / weight_sum
        xx, xy, xz, yy, yz, zz, weight_sum = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(used):
            dx, dy, dz = p[0, k] - x, p[1, k] - y, p[2, k] - z
            f = 1 + (dx * dx + dy * dy + dz * dz) / (scale_m * scale_m)
            w = p[3, k] / (f * f)
            xx, xy, xz = xx + w * dx * dx, xy + w * dx * dy, xz + w * dx * dz
            yy, yz, zz, weight_sum = yy + w * dy * dy, yz + w * dy * dz, zz + w * dz * dz, weight_sum + w
        share = count / used
        row = out[region]
        row[1], row[2], row[3], row[4], row[5] = total * share, weight_sum * share, x, y, z
        row[6], row[7], row[8] = xx / weight_sum, xy / weight_sum, xz / weight_sum
        row[9], row[10], row[11] = yy / weight_sum, yz / weight_sum, zz / weight_sum
    return out
