"""Foreground as columns of an occupancy map, the labels of people in it, and the update of the background."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def find_candidates(depth_m, limit_m, out):
    """Set ``out`` to 1 where the depth is valid and below the limit, else to 0; the number of ones."""
    count = 0
    for v in range(depth_m.shape[0]):
        for u in range(depth_m.shape[1]):
            nearer = (depth_m[v, u] > 0) & (depth_m[v, u] < limit_m[v, u])
            out[v, u] = nearer
            count += nearer
    return count


@numba.njit(cache=True, nogil=True)
def place_candidates(
    candidate, depth_m, limit_m, rays, intrinsics, map_from_camera, grid, fewest, flying_m, far_m, pixels, columns,
    levels, certain,
):  # fmt: skip
    """Write the pixels, columns and levels of all candidates that are not noise, and whether each is certainly in front
    of something; their number.

    A pixel counts if its 3×3 holds ``fewest`` candidates, unless it is ``flying_m`` behind one of its neighbours and in
    front of another.

    Args:
        limit_m: foreground limit (metres): ``far_m`` where the background is out of range, more where it is unknown.
        map_from_camera: 4×4; the map has its origin at a corner and the floor at z = 0.
        grid: columns in x, columns in y, levels, size of a cell, lowest height, least height of a pixel without a
            background (metres).
    """
    height, width = depth_m.shape
    fx, fy, cx, cy = intrinsics
    nx, ny, nz, cell_m, lowest_m, clear_m = grid
    r, kept = map_from_camera, 0
    for v in range(height):
        for u in range(width):
            if not candidate[v, u]:
                continue
            z = depth_m[v, u]
            crowd, nearest, farthest = 0, z, z
            for y in range(max(v - 1, 0), min(v + 2, height)):
                for x in range(max(u - 1, 0), min(u + 2, width)):
                    crowd += candidate[y, x]
                    other = depth_m[y, x]
                    if other > 0:
                        nearest = min(nearest, other)
                        farthest = max(farthest, other)
            if crowd < fewest or (z - nearest >= flying_m and farthest - z >= flying_m):
                continue
            if rays.size:
                a, b = z * rays[v, u, 0], z * rays[v, u, 1]
            else:
                a, b = z * ((u - cx) / fx), z * ((v - cy) / fy)
            up_m = r[2, 0] * a + r[2, 1] * b + r[2, 2] * z + r[2, 3]
            if limit_m[v, u] >= far_m and up_m < clear_m:
                continue
            east = (r[0, 0] * a + r[0, 1] * b + r[0, 2] * z + r[0, 3]) / cell_m
            north = (r[1, 0] * a + r[1, 1] * b + r[1, 2] * z + r[1, 3]) / cell_m
            level = (up_m - lowest_m) / cell_m
            # NaN, from rays that the lens model does not define, fails these comparisons.
            if not (0 <= east < nx and 0 <= north < ny and 0 <= level < nz):
                continue
            pixels[kept] = v * width + u
            columns[kept] = int(north) * nx + int(east)
            levels[kept] = int(level)
            certain[kept] = limit_m[v, u] <= far_m
            kept += 1
    return kept


@numba.njit(cache=True, nogil=True)
def add_area(depth_m, pixels, columns, pixel_m2, out):
    """Add the surface (m²) of pixels to their columns; ``pixel_m2`` is the surface of a pixel at a metre."""
    flat = depth_m.ravel()
    for i in range(len(pixels)):
        z = flat[pixels[i]]
        out[columns[i]] += z * z * pixel_m2


@numba.njit(cache=True, nogil=True)
def _measure(owner, area, column, level, nx, areas, profiles):
    """Add the surface of one pixel to the sums of its owner."""
    areas[owner, 0] += area
    areas[owner, 1] += area * (column % nx + 0.5)
    areas[owner, 2] += area * (column // nx + 0.5)
    profiles[owner, level] += area


@numba.njit(cache=True, nogil=True)
def measure_blobs(depth_m, pixels, columns, levels, pixel_m2, blobs, nx, areas, profiles):
    """Add the surface of pixels to their blobs: ``areas`` (blob; m², m² · x, m² · y) and ``profiles`` (blob, level)."""
    flat = depth_m.ravel()
    for i in range(len(pixels)):
        column = columns[i]
        blob = blobs[column]
        if blob:
            z = flat[pixels[i]]
            _measure(blob, z * z * pixel_m2, column, levels[i], nx, areas, profiles)


@numba.njit(cache=True, nogil=True)
def mark_voxels(columns, levels, labels, label, columns_count, volume, voxels, count):
    """Append the voxels (level · columns + column) of the points with the label, each once, to the first ``count`` of
    ``voxels``, and set them to 255 in ``volume``, where they must be 0 before; the new count."""
    for i in range(len(columns)):
        if labels[columns[i]] == label:
            voxel = levels[i] * columns_count + columns[i]
            if volume[voxel] == 0:
                volume[voxel] = 255
                voxels[count] = voxel
                count += 1
    return count


@numba.njit(cache=True, nogil=True)
def _claim_voxels(voxels, volume, before, shape, people, core, far, queue):
    """Write the owners of the voxels that people keep into ``volume`` and those voxels into ``queue``; their number."""
    nx, ny, _ = shape
    count = 0
    for voxel in voxels:
        level, column = voxel // (nx * ny), voxel % (nx * ny)
        x, y = column % nx, column // nx
        owner, best, claims = 0, np.inf, 0
        for k in range(len(people)):
            label, px, py = people[k, 0], people[k, 1], people[k, 2]
            distance = np.sqrt((x + 0.5 - px) ** 2 + (y + 0.5 - py) ** 2)
            old_x, old_y = int(x - people[k, 3]), int(y - people[k, 4])
            claim = distance < core
            if not claim and 0 <= old_x < nx and 0 <= old_y < ny and distance < far:
                claim = before[level * nx * ny + old_y * nx + old_x] == label
            if claim:
                claims += 1
                if distance < best:
                    owner, best = int(label), distance
        if claims:
            volume[voxel] = owner
            queue[count] = voxel
            count += 1
    return count


@numba.njit(cache=True, nogil=True)
def _spread_owners(volume, shape, queue, count):
    """Give voxels without an owner (255) that of the nearest voxel they are connected to, from the first ``count`` of
    the queue."""
    nx, ny, nz = shape
    next_index = 0
    while next_index < count:
        voxel = queue[next_index]
        next_index += 1
        level, column = voxel // (nx * ny), voxel % (nx * ny)
        x, y = column % nx, column // nx
        for dz in range(-1, 2):
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    if not (0 <= x + dx < nx and 0 <= y + dy < ny and 0 <= level + dz < nz):
                        continue
                    other = voxel + dz * nx * ny + dy * nx + dx
                    if volume[other] == 255:
                        volume[other] = volume[voxel]
                        queue[count] = other
                        count += 1


@numba.njit(cache=True, nogil=True)
def _assign_nearest(voxels, volume, shape, people, far):
    """Give voxels without an owner, and those ``far`` from theirs, to the nearest person."""
    nx, ny, _ = shape
    for voxel in voxels:
        column = voxel % (nx * ny)
        x, y = column % nx, column // nx
        own_distance, nearest, least = np.inf, 0, np.inf
        for k in range(len(people)):
            distance = np.sqrt((x + 0.5 - people[k, 1]) ** 2 + (y + 0.5 - people[k, 2]) ** 2)
            if distance < least:
                nearest, least = int(people[k, 0]), distance
            if people[k, 0] == volume[voxel]:
                own_distance = distance
        if own_distance > far:  # infinite without an owner
            volume[voxel] = nearest


@numba.njit(cache=True, nogil=True)
def divide_voxels(voxels, volume, before, shape, people, core, far, queue):
    """Write the label of the person whom each voxel of a blob belongs to into ``volume``, where the voxels are 255.

    A person keeps the voxels that they had in the volume ``before``, shifted by their predicted movement, and those in
    their core. A new voxel goes to the person it is connected to by the fewest voxels. The rest, and voxels ``far``
    from their person, go to the nearest person.

    Args:
        shape: columns in x and y, levels.
        people: rows of label, predicted centre x, y (in columns), predicted movement x, y since ``before`` (whole
            columns).
        core, far: radii in columns.
        queue: buffer as long as ``voxels``.
    """
    count = _claim_voxels(voxels, volume, before, shape, people, core, far, queue)
    _spread_owners(volume, shape, queue, count)
    _assign_nearest(voxels, volume, shape, people, far)


@numba.njit(cache=True, nogil=True)
def measure_divided(depth_m, pixels, columns, levels, pixel_m2, blobs, blob, volume, nx, areas, profiles):
    """As ``measure_blobs``, for the people who share one blob: the volume holds their labels."""
    flat = depth_m.ravel()
    for i in range(len(pixels)):
        column = columns[i]
        if blobs[column] == blob:
            owner = volume[levels[i] * len(blobs) + column]
            z = flat[pixels[i]]
            _measure(owner, z * z * pixel_m2, column, levels[i], nx, areas, profiles)


@numba.njit(cache=True, nogil=True)
def fill_volume(columns, levels, owners, volume):
    """Write the owners of columns into the voxels that have points, except in columns that the volume divides (255)."""
    for i in range(len(columns)):
        owner = owners[columns[i]]
        if owner and owner != 255:
            volume[levels[i] * len(owners) + columns[i]] = owner


@numba.njit(cache=True, nogil=True)
def paint_labels(pixels, columns, levels, owners, volume, out):
    """Write each pixel's owner into the flat image ``out``: its column's, or its voxel's where the column says 255."""
    for i in range(len(pixels)):
        owner = owners[columns[i]]
        if owner == 255:
            owner = volume[levels[i] * len(owners) + columns[i]]
        out[pixels[i]] = owner


@numba.njit(cache=True, nogil=True)
def update_background(depth_m, occupied, background_m, empty, candidate_m, age, needed, margin_m, margin_per_m, rate):
    """Update a background model from one frame.

    A background moves towards a depth within its margin by the share ``rate``. Another depth replaces it after enough
    updates that agree.

    Args:
        occupied: pixels of people: not updated.
        empty: set to 1 where no depth was measured for as many updates as make a new background: out of range.
        candidate_m, age: the depth that may replace the background, and the number of updates that agree on it.
        needed: updates that make a background where none is known, where it is farther than the known one, and where it
            is nearer.
    """
    new, farther, nearer = needed
    for v in range(depth_m.shape[0]):
        for u in range(depth_m.shape[1]):
            z = depth_m[v, u]
            if occupied[v, u]:
                age[v, u] = 0
                continue
            known = background_m[v, u]
            if not z > 0:
                if not known > 0:
                    age[v, u] = age[v, u] + 1 if candidate_m[v, u] == 0 else 1
                    candidate_m[v, u] = 0
                    if age[v, u] >= new:
                        empty[v, u] = 1
                        age[v, u] = 0
                continue
            margin = margin_m + margin_per_m * z * z
            if known > 0 and abs(z - known) <= margin:
                background_m[v, u] = known + rate * (z - known)
                age[v, u] = 0
                continue
            if age[v, u] and abs(z - candidate_m[v, u]) <= margin:
                age[v, u] = min(age[v, u] + 1, 250)
                candidate_m[v, u] += (z - candidate_m[v, u]) / min(age[v, u], 8)
            else:
                candidate_m[v, u] = z
                age[v, u] = 1
            required = new if not known > 0 else (farther if z > known else nearer)
            if age[v, u] >= required:
                background_m[v, u] = candidate_m[v, u]
                age[v, u] = 0


@numba.njit(cache=True, nogil=True)
def fill_unknown(background_m, far_m, out):
    """Copy the background (metres), ``far_m`` where it is unknown."""
    for v in range(background_m.shape[0]):
        for u in range(background_m.shape[1]):
            z = background_m[v, u]
            out[v, u] = z if z > 0 else far_m


@numba.njit(cache=True, nogil=True)
def limits_of(filled_m, nearest_m, empty, margin_m, margin_per_m, far_m, out):
    """Write the depth below which a pixel is foreground: nearer than the background by a margin.

    Args:
        filled_m: the background (metres), ``far_m`` where it is unknown: there the nearest around counts,
        nearest_m: which is this.
        empty: pixels that are out of range: ``far_m`` is written for these, twice that where nothing is known yet.
    """
    for v in range(filled_m.shape[0]):
        for u in range(filled_m.shape[1]):
            z = filled_m[v, u] if filled_m[v, u] < far_m else nearest_m[v, u]
            unknown_m = far_m if empty[v, u] else far_m + far_m
            out[v, u] = z - (margin_m + margin_per_m * z * z) if z < far_m else unknown_m
