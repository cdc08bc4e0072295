"""Statistics of each region of a labelled cloud, in one pass over the points sorted by region."""

from __future__ import annotations

import numba
import numpy as np

#: Columns of a row of ``region_statistics``: median, minimum and maximum (3 each), covariance (9).
STATISTICS = 18
#: Bins of a histogram.
_BINS = 512
#: So few candidates are sorted.
_SORTED_DIRECTLY = 64


@numba.njit(cache=True, nogil=True)
def sort_by_region(points, labels, weights, rotation, region_count):
    """Counting sort of rotated points by region.

    Returns the points as (3, n), each axis contiguous; the start of each region 1…``region_count`` in them and the end
    of the last one; the sums of the weights; and the number of points without a valid region or that are not finite. If
    that is not 0, the other results are invalid.
    """
    n = labels.shape[0]
    counts = np.zeros(256, np.int64)
    for i in range(n):
        counts[labels[i]] += 1
    starts = np.zeros(region_count + 1, np.int64)
    for region in range(region_count):
        starts[region + 1] = starts[region] + counts[region + 1]
    by_region = np.empty((3, n), np.float32)
    weight_sums = np.zeros(region_count)
    invalid = n - starts[region_count]
    if invalid:
        return by_region, starts, weight_sums, invalid
    next_free = starts.copy()
    r = rotation
    for i in range(n):
        region = labels[i] - 1
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        invalid += not np.isfinite(x + y + z)
        row = next_free[region]
        next_free[region] = row + 1
        by_region[0, row] = r[0, 0] * x + r[0, 1] * y + r[0, 2] * z
        by_region[1, row] = r[1, 0] * x + r[1, 1] * y + r[1, 2] * z
        by_region[2, row] = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z
        weight_sums[region] += weights[i]
    return by_region, starts, weight_sums, invalid


@numba.njit(cache=True, nogil=True)
def median(values, low, high, bins, scratch):
    """Exact median of finite values between their minimum ``low`` and maximum ``high``.

    Histograms reduce the candidates to few values around the median, and only these are sorted. Hardly any branch
    depends on the data, which makes it several times faster than quickselect.
    """
    n = values.shape[0]
    lower, upper = (n - 1) // 2, n // 2  # ranks of the two middle values, the same one when n is odd
    below = 0  # number of values below all candidates
    candidates = values
    while candidates.shape[0] > _SORTED_DIRECTLY and high > low:
        scale = np.float32(_BINS) / (high - low)
        if not 0 < scale < np.inf:  # a range too small or too large for float32
            break
        bins[:] = 0
        for i in range(candidates.shape[0]):
            bins[min(int((candidates[i] - low) * scale), _BINS - 1)] += 1
        target, cumulative = 0, bins[0]
        while below + cumulative <= lower:
            target += 1
            cumulative += bins[target]
        below += cumulative - bins[target]
        count = 0
        new_low, new_high = high, low
        for i in range(candidates.shape[0]):
            value = candidates[i]
            if min(int((value - low) * scale), _BINS - 1) == target:
                scratch[count] = value  # `candidates` may be `scratch` itself: this never overtakes the reading
                count += 1
                new_low, new_high = min(new_low, value), max(new_high, value)
        candidates, low, high = scratch[:count], new_low, new_high
    candidates = np.sort(candidates) if high > low else candidates
    first = np.float64(candidates[lower - below])
    if upper - below < candidates.shape[0]:
        return 0.5 * (first + np.float64(candidates[upper - below]))
    second = np.float32(np.inf)  # the next value is in another bin
    for i in range(n):
        if values[i] > high and values[i] < second:
            second = values[i]
    return 0.5 * (first + np.float64(second))


@numba.njit(cache=True, nogil=True)
def region_statistics(by_region, starts, min_points):
    """(regions, 18) float64 statistics, NaN for regions under ``min_points`` points, and the median of all points.

    The covariance is divided by n.
    """
    regions = starts.shape[0] - 1
    n = by_region.shape[1]
    out = np.full((regions, STATISTICS), np.nan)
    centre = np.full(3, np.nan)
    if n == 0:
        return out, centre
    bins = np.empty(_BINS, np.int32)
    scratch = np.empty(n, np.float32)
    lowest, highest = by_region[:, 0].copy(), by_region[:, 0].copy()
    low, high = np.empty(3, np.float32), np.empty(3, np.float32)
    for region in range(regions):
        start, end = starts[region], starts[region + 1]
        count = end - start
        if count == 0:
            continue
        # One pass, relative to the region's first point, so that the sums of squares keep their precision.
        x0, y0, z0 = by_region[0, start], by_region[1, start], by_region[2, start]
        x_low, x_high, y_low, y_high, z_low, z_high = x0, x0, y0, y0, z0, z0
        sx, sy, sz, xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(start, end):
            x, y, z = by_region[0, i], by_region[1, i], by_region[2, i]
            x_low, x_high = x if x < x_low else x_low, x if x > x_high else x_high
            y_low, y_high = y if y < y_low else y_low, y if y > y_high else y_high
            z_low, z_high = z if z < z_low else z_low, z if z > z_high else z_high
            dx, dy, dz = np.float64(x) - x0, np.float64(y) - y0, np.float64(z) - z0
            sx += dx
            sy += dy
            sz += dz
            xx += dx * dx
            xy += dx * dy
            xz += dx * dz
            yy += dy * dy
            yz += dy * dz
            zz += dz * dz
        low[0], low[1], low[2] = x_low, y_low, z_low
        high[0], high[1], high[2] = x_high, y_high, z_high
        for axis in range(3):
            lowest[axis], highest[axis] = min(lowest[axis], low[axis]), max(highest[axis], high[axis])
        if count < min_points:
            continue
        for axis in range(3):
            out[region, axis] = median(by_region[axis, start:end], low[axis], high[axis], bins, scratch)
            out[region, 3 + axis], out[region, 6 + axis] = low[axis], high[axis]
        xy = (xy - sx * sy / count) / count
        xz = (xz - sx * sz / count) / count
        yz = (yz - sy * sz / count) / count
        out[region, 9], out[region, 10], out[region, 11] = max((xx - sx * sx / count) / count, 0.0), xy, xz
        out[region, 12], out[region, 13], out[region, 14] = xy, max((yy - sy * sy / count) / count, 0.0), yz
        out[region, 15], out[region, 16], out[region, 17] = xz, yz, max((zz - sz * sz / count) / count, 0.0)
    for axis in range(3):
        centre[axis] = median(by_region[axis], lowest[axis], highest[axis], bins, scratch)
    return out, centre
