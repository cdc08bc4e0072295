"""What stands before the background, as columns of a plan of the room; the background itself; and who is who."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def find_candidates(depth_m, limit_m, out):
    """``out`` 1 where there is depth nearer than the limit, else 0; their number."""
    count = 0
    for v in range(depth_m.shape[0]):
        for u in range(depth_m.shape[1]):
            nearer = (depth_m[v, u] > 0) & (depth_m[v, u] < limit_m[v, u])
            out[v, u] = nearer
            count += nearer
    return count


@numba.njit(cache=True, nogil=True)
def place_candidates(
    candidate, depth_m, limit_m, rays, intrinsics, plan_from_camera, plan, fewest, flying_m, far_m, pixels, columns,
    levels, sure,
):  # fmt: skip
    """Candidates that are no noise: their pixels, their columns and levels of the plan, and whether they are surely
    before something; their number.

    A pixel counts with ``fewest`` candidates in its 3×3, unless it hangs ``flying_m`` behind one and before another of
    its neighbours. ``plan`` is (columns in x, columns in y, levels, cell in metres, lowest height, least height of what
    has no background, which is a limit of ``far_m``; where it is not known yet the limit is larger).
    ``plan_from_camera`` has the origin at a corner, z = 0 the floor.
    """
    height, width = depth_m.shape
    fx, fy, cx, cy = intrinsics
    nx, ny, nz, cell_m, lowest_m, clear_m = plan
    r, found = plan_from_camera, 0
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
            # Comparisons with NaN, of rays that the lens model does not give, are false.
            if not (0 <= east < nx and 0 <= north < ny and 0 <= level < nz):
                continue
            pixels[found] = v * width + u
            columns[found] = int(north) * nx + int(east)
            levels[found] = int(level)
            sure[found] = limit_m[v, u] <= far_m
            found += 1
    return found


@numba.njit(cache=True, nogil=True)
def add_area(depth_m, pixels, columns, pixel_m2, out):
    """Add the surface (m²) that pixels show to their columns; ``pixel_m2`` is that of one at a metre."""
    flat = depth_m.ravel()
    for i in range(len(pixels)):
        z = flat[pixels[i]]
        out[columns[i]] += z * z * pixel_m2


@numba.njit(cache=True, nogil=True)
def _measure(owner, area, column, level, nx, areas, profiles):
    """Add the surface of one pixel to what is known of its owner."""
    areas[owner, 0] += area
    areas[owner, 1] += area * (column % nx + 0.5)
    areas[owner, 2] += area * (column // nx + 0.5)
    profiles[owner, level] += area


@numba.njit(cache=True, nogil=True)
def measure_blobs(depth_m, pixels, columns, levels, pixel_m2, blobs, nx, areas, profiles):
    """Add surface to the blob of each column: ``areas`` (blob; m², times x, times y) and ``profiles`` (blob, level)."""
    flat = depth_m.ravel()
    for i in range(len(pixels)):
        column = columns[i]
        blob = blobs[column]
        if blob:
            z = flat[pixels[i]]
            _measure(blob, z * z * pixel_m2, column, levels[i], nx, areas, profiles)


@numba.njit(cache=True, nogil=True)
def mark_voxels(columns, levels, labels, wanted, columns_count, volume, voxels, count):
    """Voxels (level · columns + column) of the points whose label is ``wanted``, each once, into ``voxels`` from
    ``count``; they become 255 in ``volume``, which must be 0 before. Their number."""
    for i in range(len(columns)):
        if labels[columns[i]] == wanted:
            voxel = levels[i] * columns_count + columns[i]
            if volume[voxel] == 0:
                volume[voxel] = 255
                voxels[count] = voxel
                count += 1
    return count


@numba.njit(cache=True, nogil=True)
def divide_voxels(voxels, volume, before, shape, people, core, far, queue):
    """Who each voxel of a blob belongs to, written into ``volume``, where they are 255.

    A person keeps the voxels it had ``before`` (a volume as well), moved by as much as it is expected to have moved,
    and those in its core. What is new goes to whom it hangs together with, by the fewest voxels between; the rest, and
    what is ``far`` from its owner, to the nearest.

    Args:
        shape: columns in x and y, levels.
        people: rows of label, expected middle x, y (in columns), expected movement x, y since before (whole columns).
        core: radius (in columns) of what is a person's own.
        queue: room for all voxels.
    """
    nx, ny, nz = shape
    head = tail = 0
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
            queue[tail] = voxel
            tail += 1
    while head < tail:
        voxel = queue[head]
        head += 1
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
                        queue[tail] = other
                        tail += 1
    for voxel in voxels:
        column = voxel % (nx * ny)
        x, y = column % nx, column // nx
        own, nearest, least = np.inf, 0, np.inf
        for k in range(len(people)):
            distance = np.sqrt((x + 0.5 - people[k, 1]) ** 2 + (y + 0.5 - people[k, 2]) ** 2)
            if distance < least:
                nearest, least = int(people[k, 0]), distance
            if people[k, 0] == volume[voxel]:
                own = distance
        if own > far:  # of nobody, or hardly this person's
            volume[voxel] = nearest


@numba.njit(cache=True, nogil=True)
def measure_divided(depth_m, pixels, columns, levels, pixel_m2, blobs, blob, volume, nx, areas, profiles):
    """As ``measure_blobs``, of the owners that the volume tells in one blob."""
    flat = depth_m.ravel()
    for i in range(len(pixels)):
        column = columns[i]
        if blobs[column] == blob:
            owner = volume[levels[i] * len(blobs) + column]
            z = flat[pixels[i]]
            _measure(owner, z * z * pixel_m2, column, levels[i], nx, areas, profiles)


@numba.njit(cache=True, nogil=True)
def fill_volume(columns, levels, owners, volume):
    """Write the owners of columns into the voxels that have points, but for columns that the volume divides (255)."""
    for i in range(len(columns)):
        owner = owners[columns[i]]
        if owner and owner != 255:
            volume[levels[i] * len(owners) + columns[i]] = owner


@numba.njit(cache=True, nogil=True)
def paint(pixels, columns, levels, owners, volume, out):
    """Each pixel's owner into the flat picture ``out``: of its column, or of its voxel where that says 255."""
    for i in range(len(pixels)):
        owner = owners[columns[i]]
        if owner == 255:
            owner = volume[levels[i] * len(owners) + columns[i]]
        out[pixels[i]] = owner


@numba.njit(cache=True, nogil=True)
def follow_background(depth_m, occupied, background_m, empty, other_m, age, needs, margin_m, margin_per_m, rate):
    """One look at the scene: known backgrounds move towards what is seen near them by the share ``rate``; another depth
    that was seen often enough takes their place.

    ``other_m`` is what is seen instead, ``age`` for how many looks. ``needs`` is how many make a background where none
    is known, where it is farther than the known one, and where it is nearer. ``occupied`` pixels are people's: nothing
    is learnt there. Where nothing is seen for as long as makes a background, there is none: ``empty`` becomes 1.
    """
    new, farther, nearer = needs
    for v in range(depth_m.shape[0]):
        for u in range(depth_m.shape[1]):
            z = depth_m[v, u]
            if occupied[v, u]:
                age[v, u] = 0
                continue
            known = background_m[v, u]
            if not z > 0:
                if not known > 0:
                    age[v, u] = age[v, u] + 1 if other_m[v, u] == 0 else 1
                    other_m[v, u] = 0
                    if age[v, u] >= new:
                        empty[v, u] = 1
                        age[v, u] = 0
                continue
            margin = margin_m + margin_per_m * z * z
            if known > 0 and abs(z - known) <= margin:
                background_m[v, u] = known + rate * (z - known)
                age[v, u] = 0
                continue
            if age[v, u] and abs(z - other_m[v, u]) <= margin:
                age[v, u] = min(age[v, u] + 1, 250)
                other_m[v, u] += (z - other_m[v, u]) / min(age[v, u], 8)
            else:
                other_m[v, u] = z
                age[v, u] = 1
            need = new if not known > 0 else (farther if z > known else nearer)
            if age[v, u] >= need:
                background_m[v, u] = other_m[v, u]
                age[v, u] = 0
