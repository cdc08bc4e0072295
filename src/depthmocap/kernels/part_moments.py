"""Robust moments of every region of one view's points."""

from __future__ import annotations

import numba
import numpy as np

#: Columns of a row of ``part_moments``: points, sum of weights, sum of the robust weights, centre (3), and the
#: covariance's xx, xy, xz, yy, yz, zz.
MOMENTS = 12
_ROUNDS = 4
#: Of a region with more points, so many evenly taken ones stand for all.
_MOST = 400


# Sums in any order, and no check for a division by 0, let the loops over points run in vector registers.
@numba.njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def part_moments(points, labels, weights, rotation, region_count, scale_m):
    """(regions, 12) moments of rotated points; only the first column means anything where it is 0.

    Centre and covariance weigh each point by its weight / (1 + d² / scale²)², d its distance from the centre, which is
    found by reweighting from the plain mean (Geman-McClure). A speck far off hardly counts, and turning the points
    turns the result.
    """
    out = np.zeros((region_count, MOMENTS))
    starts = np.zeros(region_count + 1, np.int64)
    for i in range(labels.shape[0]):
        starts[labels[i]] += 1  # of region r in [r], so that the sum up to r is where r + 1 begins
    starts[0] = 0
    for region in range(region_count):
        out[region, 0] = starts[region + 1]
        starts[region + 1] += starts[region]
    order = np.empty(labels.shape[0], np.int64)
    free = starts[:region_count].copy()
    for i in range(labels.shape[0]):
        region = labels[i] - 1
        if region >= 0:
            order[free[region]] = i
            free[region] += 1
    p = np.empty((4, _MOST))
    for region in range(region_count):
        count = starts[region + 1] - starts[region]
        if count == 0:
            continue
        used = min(count, _MOST)
        total = 0.0
        for k in range(used):
            i = order[starts[region] + k * count // used]
            for axis in range(3):
                r = rotation[axis]
                p[axis, k] = r[0] * points[i, 0] + r[1] * points[i, 1] + r[2] * points[i, 2]
            p[3, k] = max(weights[i], 1e-6)
            total += p[3, k]
        x, y, z = np.mean(p[0, :used]), np.mean(p[1, :used]), np.mean(p[2, :used])
        kept = 0.0
        for _ in range(_ROUNDS):
            sx, sy, sz, kept = 0.0, 0.0, 0.0, 0.0
            for k in range(used):
                dx, dy, dz = p[0, k] - x, p[1, k] - y, p[2, k] - z
                f = 1 + (dx * dx + dy * dy + dz * dz) / (scale_m * scale_m)
                w = p[3, k] / (f * f)
                sx, sy, sz, kept = sx + w * dx, sy + w * dy, sz + w * dz, kept + w
            x, y, z = x + sx / kept, y + sy / kept, z + sz / kept
        xx, xy, xz, yy, yz, zz, kept = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(used):
            dx, dy, dz = p[0, k] - x, p[1, k] - y, p[2, k] - z
            f = 1 + (dx * dx + dy * dy + dz * dz) / (scale_m * scale_m)
            w = p[3, k] / (f * f)
            xx, xy, xz = xx + w * dx * dx, xy + w * dx * dy, xz + w * dx * dz
            yy, yz, zz, kept = yy + w * dy * dy, yz + w * dy * dz, zz + w * dz * dz, kept + w
        share = count / used
        row = out[region]
        row[1], row[2], row[3], row[4], row[5] = total * share, kept * share, x, y, z
        row[6], row[7], row[8] = xx / kept, xy / kept, xz / kept
        row[9], row[10], row[11] = yy / kept, yz / kept, zz / kept
    return out
