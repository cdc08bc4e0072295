"""Samples that show people, their votes for the centres of people, and masks at full resolution."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def lift_people(
    samples_m, logits, offsets, rays, world_from_camera, limit_m, least, farthest_m, sample_m2,
    indices, points, votes, areas, before,
):  # fmt: skip
    """Write index, world position, vote for the centre and surface (m²) of every sample that shows a person, and
    whether it is before the empty scene; their number.

    Args:
        samples_m, logits: (2h, 2w).
        offsets: (3, h, w) metres, in the camera's axes.
        rays: (2h, 2w, 2) x/z and y/z.
        limit_m: (2h, 2w) depth below which a sample is before the empty scene; 0 where that is unknown.
        least: the logits that a sample must exceed: where the empty scene is unknown, before it, and on it.
        farthest_m: samples from this depth on (metres) are left out.
        sample_m2: surface that a sample shows at a metre (m²).
    """
    rows, columns = samples_m.shape
    r, count = world_from_camera, 0
    for i in range(rows):
        for j in range(columns):
            z, limit = samples_m[i, j], limit_m[i, j]
            place = 0 if not limit > 0 else 1 if z < limit else 2
            if not logits[i, j] > least[place]:
                continue
            x, y = rays[i, j, 0] * z, rays[i, j, 1] * z
            if not 0 < z < farthest_m or np.isnan(x):
                continue
            a = x + offsets[0, i // 2, j // 2]
            b = y + offsets[1, i // 2, j // 2]
            c = z + offsets[2, i // 2, j // 2]
            indices[count] = i * columns + j
            for k in range(3):
                points[count, k] = r[k, 0] * x + r[k, 1] * y + r[k, 2] * z + r[k, 3]
                votes[count, k] = r[k, 0] * a + r[k, 1] * b + r[k, 2] * c + r[k, 3]
            areas[count] = z * z * sample_m2
            before[count] = place == 1
            count += 1
    return count


@numba.njit(cache=True, nogil=True)
def assign_votes(votes, areas, centres, reach_m, owners, sums):
    """Write the nearest centre within ``reach_m`` of each vote (-1 for none), and add to ``sums`` (centre; m², m² · x,
    m² · y, m² · z)."""
    sums[:] = 0
    for i in range(len(votes)):
        best, owner = reach_m * reach_m, -1
        for k in range(len(centres)):
            squared = 0.0
            for axis in range(3):
                squared += (votes[i, axis] - centres[k, axis]) ** 2
            if squared < best:
                best, owner = squared, k
        owners[i] = owner
        if owner >= 0:
            sums[owner, 0] += areas[i]
            for axis in range(3):
                sums[owner, 1 + axis] += areas[i] * votes[i, axis]


@numba.njit(cache=True, nogil=True)
def densest_vote(votes, areas, owners, most, reach_m, centre):
    """The surface (m²) of the votes without owner within ``reach_m`` of where they are densest, and their mean in
    ``centre``. At most ``most`` places are tried before the best one is refined."""
    open_votes = np.flatnonzero(owners < 0)
    count = len(open_votes)
    best = 0.0
    squared_reach = reach_m * reach_m
    step = max(count // most, 1)
    for first in range(0, count, step):
        i = open_votes[first]
        total = 0.0
        for j in open_votes:
            squared = 0.0
            for axis in range(3):
                squared += (votes[j, axis] - votes[i, axis]) ** 2
            if squared < squared_reach:
                total += areas[j]
        if total > best:
            best = total
            centre[:] = votes[i]
    total = best
    for _ in range(3):  # mean shift
        if total <= 0:
            return 0.0
        sums, total = np.zeros(3), 0.0
        for j in open_votes:
            squared = 0.0
            for axis in range(3):
                squared += (votes[j, axis] - centre[axis]) ** 2
            if squared < squared_reach:
                total += areas[j]
                for axis in range(3):
                    sums[axis] += areas[j] * votes[j, axis]
        if total > 0:
            for axis in range(3):
                centre[axis] = sums[axis] / total
    return total


@numba.njit(cache=True, nogil=True)
def grow_people(samples_m, limit_m, logits, least, step_m, reach_m, sample_rad, labels):
    """Give samples without label that of a neighbour whose surface they continue, up to some distance.

    Args:
        samples_m, logits: (2h, 2w).
        limit_m: (2h, 2w) depth below which a sample is before the empty scene; 0 where that is unknown.
        least: logit that a sample needs.
        step_m: largest difference in depth (metres) within a surface.
        reach_m: so far over the surface from samples that have a label at first (metres).
        sample_rad: angle between samples.
        labels: (2h, 2w) uint8, changed in place.
    """
    rows, columns = labels.shape
    queue, gone = np.empty(rows * columns, np.int32), np.zeros(rows * columns, np.float32)
    first, last = 0, 0
    for i in range(rows):
        for j in range(columns):
            if labels[i, j]:
                queue[last] = i * columns + j
                last += 1
    while first < last:
        i, j = queue[first] // columns, queue[first] % columns
        so_far, z = gone[queue[first]], samples_m[i, j]
        first += 1
        if so_far > reach_m:
            continue
        for y, x in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
            if not (0 <= y < rows and 0 <= x < columns) or labels[y, x]:
                continue
            other = samples_m[y, x]
            if 0 < other < limit_m[y, x] and abs(other - z) < step_m and logits[y, x] > least:
                labels[y, x] = labels[i, j]
                gone[y * columns + x] = so_far + other * sample_rad
                queue[last] = y * columns + x
                last += 1


@numba.njit(cache=True, nogil=True)
def paint_people(depth_m, limit_m, row_starts, column_starts, samples_m, labels, beyond_limit, step_m, out):
    """Write the label of every pixel: that of the sample among the nearest nine whose depth it continues.

    Args:
        limit_m: pixels from this depth on are background, except next to samples of ``beyond_limit``.
        row_starts, column_starts: first pixel of each sample, and one after the last.
        samples_m, labels: (2h, 2w) depth (metres) and label of each sample, 0 for no person.
        step_m: largest difference in depth (metres) within a surface.
        out: (h, w) uint8, zeros.
    """
    rows, columns = labels.shape
    first_row, last_row, first_column, last_column = rows, -1, columns, -1
    for i in range(rows):
        for j in range(columns):
            if labels[i, j]:
                first_row, last_row = min(first_row, i), i
                first_column, last_column = min(first_column, j), max(last_column, j)
    low, high = np.zeros(columns, np.uint8), np.zeros(columns, np.uint8)
    # The nine samples of those that have a depth.
    depths, costs, owners, frees = np.empty(9, np.float32), np.empty(9), np.empty(9, np.uint8), np.empty(9, np.bool_)
    for i in range(max(first_row - 1, 0), min(last_row + 2, rows)):
        top, bottom = max(i - 1, 0), min(i + 2, rows)
        for x in range(columns):
            low[x] = high[x] = labels[top, x]
            for y in range(top + 1, bottom):
                low[x], high[x] = min(low[x], labels[y, x]), max(high[x], labels[y, x])
        for j in range(max(first_column - 1, 0), min(last_column + 2, columns)):
            left, right = max(j - 1, 0), min(j + 2, columns)
            least, most = low[left], high[left]
            for x in range(left + 1, right):
                least, most = min(least, low[x]), max(most, high[x])
            if most == 0:
                continue
            if least == most:  # within one person: what is near the middle of nine in depth is theirs
                middle, free = samples_m[i, j], beyond_limit[i, j] > 0
                for v in range(row_starts[i], row_starts[i + 1]):
                    for u in range(column_starts[j], column_starts[j + 1]):
                        z = depth_m[v, u]
                        if z > 0 and abs(z - middle) < step_m and (free or z < limit_m[v, u]):
                            out[v, u] = most
                continue
            count, any_free = 0, False
            for y in range(top, bottom):
                for x in range(left, right):
                    if samples_m[y, x] > 0:
                        depths[count], owners[count] = samples_m[y, x], labels[y, x]
                        costs[count] = np.float32(0.01) * (abs(y - i) + abs(x - j))
                        frees[count] = beyond_limit[y, x] > 0
                        any_free |= frees[count]
                        count += 1
            for v in range(row_starts[i], row_starts[i + 1]):
                for u in range(column_starts[j], column_starts[j + 1]):
                    z = depth_m[v, u]
                    before = z < limit_m[v, u]
                    if not z > 0 or not (before or any_free):
                        continue
                    best, chosen = 1e9, -1
                    for k in range(count):
                        gap = abs(depths[k] - z)
                        cost = gap + costs[k]
                        if cost < best and gap < step_m:
                            best, chosen = cost, k
                    if chosen >= 0 and owners[chosen] and (before or frees[chosen]):
                        out[v, u] = owners[chosen]
