"""Subsets of distinct postures: a cover grown point by point, and greedy farthest-point sampling.

A point is the joints of a posture. The distance of two points is that of the joint that differs most.
"""

from __future__ import annotations

import numba
import numpy as np

#: Coordinates of the cover's hash grid: those of the hands (backwards and up), joints 9 and 16 of 20.
_GRID_JOINTS = np.array([9, 9, 16, 16])
_GRID_AXES = np.array([1, 2, 1, 2])


@numba.njit(cache=True, nogil=True)
def _squared_distance(a, b, limit2):
    """Squared distance of two points; any value above ``limit2`` if it is above that."""
    worst = np.float32(0)
    for j in range(a.shape[0] - 1, -1, -1):  # ends of limbs differ most, and the last are feet and hands
        x, y, z = a[j, 0] - b[j, 0], a[j, 1] - b[j, 1], a[j, 2] - b[j, 2]
        d2 = x * x + y * y + z * z
        if d2 > worst:
            worst = d2
            if worst > limit2:
                break
    return worst


@numba.njit(cache=True, nogil=True)
def _hash_slot(cell, mask):
    hashed = np.int64(0)
    for k in range(cell.shape[0]):
        hashed = hashed * np.int64(1000003) + cell[k]
    hashed ^= hashed >> np.int64(17)
    return hashed & mask


@numba.njit(cache=True, nogil=True)
def grow_cover(points, radius, cover, count, table, next_in_chain, added, limit):
    """Add the points that are farther than ``radius`` from the whole cover, in order, and mark them in ``added``.

    ``table`` (a power of two; −1 where empty) and ``next_in_chain`` are the chains of a hash grid of cells as wide as
    the radius. Returns the cover's new count, and the number of points processed: fewer than all when ``limit`` is
    reached.
    """
    mask = np.int64(table.shape[0] - 1)
    radius2 = np.float32(radius * radius)
    cell = np.empty(4, np.int64)
    neighbour_cell = np.empty(4, np.int64)
    for i in range(points.shape[0]):
        if count >= limit:
            return count, i
        for k in range(4):
            cell[k] = np.int64(np.floor(points[i, _GRID_JOINTS[k], _GRID_AXES[k]] / radius))
        covered = False
        for neighbour in range(81):
            code = (neighbour + 40) % 81  # the cell itself first
            for k in range(4):
                neighbour_cell[k] = cell[k] + code % 3 - 1
                code //= 3
            member = table[_hash_slot(neighbour_cell, mask)]
            while member >= 0:
                if _squared_distance(points[i], cover[member], radius2) <= radius2:
                    covered = True
                    break
                member = next_in_chain[member]
            if covered:
                break
        if not covered:
            slot = _hash_slot(cell, mask)
            cover[count] = points[i]
            next_in_chain[count] = table[slot]
            table[slot] = count
            count += 1
            added[i] = True
    return count, points.shape[0]


@numba.njit(cache=True, nogil=True)
def _box_reaches(point, low, high, reach2):
    """Whether a point in a bounding box can be nearer to a point than the square root of ``reach2``."""
    for j in range(point.shape[0] - 1, -1, -1):
        d2 = np.float32(0)
        for k in range(3):
            distance = max(low[j, k] - point[j, k], point[j, k] - high[j, k])
            if distance > 0:
                d2 += distance * distance
        if d2 >= reach2:
            return False
    return True


@numba.njit(cache=True, nogil=True)
def pick_farthest(points, starts, low, high, allowed, nearest2, picks, count, target):
    """Pick the point farthest from all picks, among those allowed, again and again until there are ``target`` picks.

    Points are in blocks (``starts``, one more than blocks) with bounding boxes, so that a new pick only updates the
    blocks near it. ``nearest2`` is every point's squared distance to its nearest pick (infinity at the start; −1 for
    picks). Returns the number of picks, and the squared distance of the farthest remaining allowed point (−1: none).
    """
    blocks = starts.shape[0] - 1
    reach2 = np.full(blocks, np.float32(-1))
    best2 = np.full(blocks, np.float32(-1))
    for b in range(blocks):
        for i in range(starts[b], starts[b + 1]):
            reach2[b] = max(reach2[b], nearest2[i])
            if allowed[i]:
                best2[b] = max(best2[b], nearest2[i])
    while True:
        block = np.argmax(best2)
        if best2[block] < 0 or count >= target:
            return count, best2[block]
        best = starts[block]
        while not (allowed[best] and nearest2[best] == best2[block]):
            best += 1
        nearest2[best] = np.float32(-1)
        picks[count] = best
        count += 1
        for b in range(blocks):
            if b != block and not _box_reaches(points[best], low[b], high[b], reach2[b]):
                continue
            reach2[b], best2[b] = np.float32(-1), np.float32(-1)
            for i in range(starts[b], starts[b + 1]):
                if nearest2[i] > 0:
                    nearest2[i] = min(nearest2[i], _squared_distance(points[best], points[i], nearest2[i]))
                reach2[b] = max(reach2[b], nearest2[i])
                if allowed[i]:
                    best2[b] = max(best2[b], nearest2[i])


@numba.njit(cache=True, nogil=True)
def nearest_distances(points, others, distance):
    """Distance of every point to the nearest of the others."""
    for i in range(points.shape[0]):
        best2 = np.float32(np.inf)
        for k in range(others.shape[0]):
            d2 = _squared_distance(points[i], others[k], best2)
            if d2 < best2:
                best2 = d2
        distance[i] = np.sqrt(best2)
