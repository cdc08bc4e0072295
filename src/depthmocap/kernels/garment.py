"""Clothes and hair: shells over the skin, and hanging sheets."""

import numba
import numpy as np


@numba.njit(cache=True, fastmath=True, nogil=True)
def edge_compression(points, starts, neighbours, rest_lengths, out):
    """``out[v]``: mean shortening of the edges at a vertex, from 0 (none, or stretched) to 1; edges in CSR form."""
    for v in range(points.shape[0]):
        first, last = starts[v], starts[v + 1]
        total = np.float32(0)
        for e in range(first, last):
            n = neighbours[e]
            x = points[n, 0] - points[v, 0]
            y = points[n, 1] - points[v, 1]
            z = points[n, 2] - points[v, 2]
            total += max(1 - np.sqrt(x * x + y * y + z * z) / rest_lengths[e], np.float32(-0.3))
        out[v] = max(total / max(last - first, 1), np.float32(0))


@numba.njit(cache=True, fastmath=True, nogil=True)
def edge_lengths(points, starts, neighbours):
    """Length of every edge of a mesh in CSR form."""
    out = np.empty(neighbours.shape[0], np.float32)
    for v in range(points.shape[0]):
        for e in range(starts[v], starts[v + 1]):
            n = neighbours[e]
            x, y, z = points[n, 0] - points[v, 0], points[n, 1] - points[v, 1], points[n, 2] - points[v, 2]
            out[e] = np.sqrt(x * x + y * y + z * z) + np.float32(1e-6)
    return out


@numba.njit(cache=True, fastmath=True, nogil=True)
def smooth_cloth(points, starts, neighbours, count, rounds):
    """A taut cloth over the first ``count`` points of a mesh: above hollows and below bumps. The other points stay.

    In each round every point moves to the mean of its neighbours (Laplacian smoothing).
    """
    previous, new = points.copy(), points.copy()
    for _ in range(rounds):
        for v in range(count):
            x = y = z = np.float32(0)
            first, last = starts[v], starts[v + 1]
            for e in range(first, last):
                n = neighbours[e]
                x += previous[n, 0]
                y += previous[n, 1]
                z += previous[n, 2]
            share = np.float32(1) / max(last - first, 1)
            new[v, 0], new[v, 1], new[v, 2] = x * share, y * share, z * share
        previous, new = new, previous
    return previous


@numba.njit(cache=True, fastmath=True, nogil=True)
def cut_mesh(level, hidden, faces, starts, neighbours):
    """The part of a mesh where ``level`` is above 0, without faces whose corners are all ``hidden``.

    Returns:
        The vertices; the faces, as indices of these; for each vertex outside (``level`` ≤ 0) its neighbour with the
        highest level, for the others the vertex itself; and how far towards that neighbour (0–1) the level is 0.
    """
    number = np.full(level.shape[0], -1, np.int32)
    kept_faces = np.empty_like(faces)
    count = 0
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        inside = level[i] > 0 or level[j] > 0 or level[k] > 0
        if inside and not (hidden[i] and hidden[j] and hidden[k]):
            kept_faces[count, 0], kept_faces[count, 1], kept_faces[count, 2] = i, j, k
            number[i] = number[j] = number[k] = 0
            count += 1
    vertices = np.flatnonzero(number == 0).astype(np.int32)
    partner = vertices.copy()
    mix = np.zeros(vertices.shape[0], np.float32)
    for i in range(vertices.shape[0]):
        v = vertices[i]
        number[v] = i
        if level[v] > 0:
            continue
        best = np.float32(0)
        for e in range(starts[v], starts[v + 1]):
            if level[neighbours[e]] > best:
                best = level[neighbours[e]]
                partner[i] = neighbours[e]
        if best > 0:
            mix[i] = min(-level[v] / (best - level[v]), np.float32(0.95))
    local = kept_faces[:count].copy()
    for f in range(count):
        for k in range(3):
            local[f, k] = number[local[f, k]]
    return vertices, local, partner, mix


@numba.njit(cache=True, fastmath=True, nogil=True)
def interpolate_cut(field, vertices, partner, mix):
    """A field of the vertices, interpolated at the points between vertices and their partners."""
    out = np.empty(vertices.shape[0], np.float32)
    for i in range(vertices.shape[0]):
        out[i] = (1 - mix[i]) * field[vertices[i]] + mix[i] * field[partner[i]]
    return out


@numba.njit(cache=True, fastmath=True, nogil=True)
def add_folds(level, metres, azimuth, slant, wander, patches, trunk, waves, out):
    """Write the height of folds around limbs and trunk, where ``level`` is not far outside.

    The first ``trunk`` vertices are the trunk's. A row of ``waves`` holds the wave number on limbs and on the trunk
    (radians per metre), the turns around a limb (twice as many around the trunk), and the phase. Ridges are narrower
    than the valleys between them. Where ``patches`` is low, the cloth is smooth.
    """
    for v in range(level.shape[0]):
        if level[v] < np.float32(-0.1):
            continue
        total = np.float32(0)
        for i in range(waves.shape[0]):
            share = min(max(np.float32(0.3) + np.float32(0.8) * patches[i, v], np.float32(0)), np.float32(1))
            number, turns = (waves[i, 1], 2 * waves[i, 2]) if v < trunk else (waves[i, 0], waves[i, 2])
            phase = number * metres[v] + turns * slant[v] * azimuth[v] + wander[v] + waves[i, 3]
            total += share * share * (3 - 2 * share) * (1 - np.float32(1.6) * abs(np.sin(np.float32(0.5) * phase)))
        out[v] = total


@numba.njit(cache=True, fastmath=True, nogil=True)
def offset_shell(points, directions, compressed, vertices, partner, mix, thickness, slack, fold, crease, out):
    """Offset a shell's vertices from the posed skin.

    The offset is ``thickness`` (metres), plus ``slack``, which is small where the normal points up, as cloth rests
    there, and large where it points down, as cloth hangs there, plus ``fold`` (metres, signed), which grows by
    ``crease`` where the skin is compressed, as in a bent elbow.
    """
    for i in range(vertices.shape[0]):
        v, n, m = vertices[i], partner[i], mix[i]
        up = (1 - m) * directions[v, 2] + m * directions[n, 2]
        squeezed = min((1 - m) * compressed[v] + m * compressed[n], np.float32(0.5))
        away = slack[i] * (1 - np.float32(0.85) * up) + fold[i] * (1 + crease * squeezed)
        away = thickness[i] + max(away, np.float32(0))
        for k in range(3):
            out[i, k] = ((1 - m) * points[v, k] + m * points[n, k]) + away * (
                (1 - m) * directions[v, k] + m * directions[n, k]
            )


@numba.njit(cache=True, fastmath=True, nogil=True)
def hanging_offsets(height, azimuth, radius, step, decay, columns):
    """Distance (metres) between the skin and cloth that hangs from above, at each vertex.

    The largest radius at each azimuth (``columns`` around the circle) continues downwards and shrinks by ``decay`` per
    metre. Cloth spans the hollows between neighbouring columns.
    """
    top, bottom = height.max(), height.min()
    rows = int((top - bottom) / step) + 2
    widest = np.zeros((rows, columns), np.float32)
    turn = columns / (2 * np.pi)
    half_turn = np.float32(0.5 * np.cos(2 * np.pi / columns))
    for v in range(height.shape[0]):
        row = int((top - height[v]) / step)
        column = int((azimuth[v] + np.pi) * turn) % columns
        widest[row, column] = max(widest[row, column], radius[v])
    for row in range(1, rows):
        for column in range(columns):
            widest[row, column] = max(widest[row, column], widest[row - 1, column] - decay * step)
        for _ in range(3):
            for column in range(columns):
                chord = half_turn * (widest[row, (column + 1) % columns] + widest[row, column - 1])
                widest[row, column] = max(widest[row, column], chord)
    out = np.empty_like(radius)
    for v in range(height.shape[0]):
        # Interpolated between the centres of two rows and two columns.
        down = max((top - height[v]) / step - np.float32(0.5), np.float32(0))
        row = int(down)
        lower, below = down - row, min(row + 1, rows - 1)
        position = (azimuth[v] + np.pi) * turn - np.float32(0.5)
        column = int(np.floor(position))
        share = position - column
        column, next_column = column % columns, (column + 1) % columns
        high = (1 - share) * widest[row, column] + share * widest[row, next_column]
        low = (1 - share) * widest[below, column] + share * widest[below, next_column]
        # The largest radius of a cell is slightly larger than the skin's in its centre.
        out[v] = max((1 - lower) * high + lower * low - radius[v] - np.float32(0.003), np.float32(0))
    return out


@numba.njit(cache=True, fastmath=True, nogil=True)
def _push_out(x, y, z, starts, ends, start_radii, end_radii):
    """The point moved out of capsules whose radius changes linearly between their ends."""
    for i in range(starts.shape[0]):
        ax, ay, az = starts[i, 0], starts[i, 1], starts[i, 2]
        bx, by, bz = ends[i, 0] - ax, ends[i, 1] - ay, ends[i, 2] - az
        t = ((x - ax) * bx + (y - ay) * by + (z - az) * bz) / (bx * bx + by * by + bz * bz + 1e-9)
        t = min(max(t, 0.0), 1.0)
        dx, dy, dz = x - ax - t * bx, y - ay - t * by, z - az - t * bz
        radius = start_radii[i] + t * (end_radii[i] - start_radii[i])
        square = dx * dx + dy * dy + dz * dz
        if 1e-10 < square < radius * radius:
            grow = radius / np.sqrt(square) - 1
            x, y, z = x + grow * dx, y + grow * dy, z + grow * dz
    return x, y, z


@numba.njit(cache=True, fastmath=True, nogil=True)
def relax_sheet(sheet, along, across, closed, starts, ends, start_radii, end_radii, fall, floor, rounds):
    """Let a sheet of ``(rows, columns, 3)`` points hang from its first row, in place.

    In each round points fall by ``fall`` metres, are pulled to within ``along`` of the point above and ``across`` of
    the next point in their row, and are moved out of the capsules and the floor. Lengths only have upper limits,
    because cloth folds. A point that a capsule supports does not fall any more: cloth on a lap does not slide off. This
    is position-based dynamics (Müller et al. 2007) without velocities: the result depends only on the posture.
    """
    rows, columns = sheet.shape[0], sheet.shape[1]
    resting = np.zeros((rows, columns), np.bool_)
    for _ in range(rounds):
        for r in range(1, rows):
            for c in range(columns):
                x, y, z = sheet[r, c, 0], sheet[r, c, 1], sheet[r, c, 2]
                if not resting[r, c]:
                    z -= fall
                dx, dy, dz = x - sheet[r - 1, c, 0], y - sheet[r - 1, c, 1], z - sheet[r - 1, c, 2]
                length = np.sqrt(dx * dx + dy * dy + dz * dz)
                if length > along[r - 1, c]:
                    shrink = 1 - along[r - 1, c] / length
                    x, y, z = x - shrink * dx, y - shrink * dy, z - shrink * dz
                sheet[r, c, 0], sheet[r, c, 1], sheet[r, c, 2] = x, y, z
            for c in range(columns if closed else columns - 1):
                n = (c + 1) % columns
                dx = sheet[r, n, 0] - sheet[r, c, 0]
                dy = sheet[r, n, 1] - sheet[r, c, 1]
                dz = sheet[r, n, 2] - sheet[r, c, 2]
                length = np.sqrt(dx * dx + dy * dy + dz * dz)
                if length > across[r, c]:
                    half = 0.5 * (1 - across[r, c] / length)
                    for k, d in enumerate((dx, dy, dz)):
                        sheet[r, c, k] += half * d
                        sheet[r, n, k] -= half * d
            for c in range(columns):
                old_x, old_y, old_z = sheet[r, c, 0], sheet[r, c, 1], sheet[r, c, 2]
                x, y, z = _push_out(old_x, old_y, old_z, starts, ends, start_radii, end_radii)
                if z - old_z > abs(x - old_x) + abs(y - old_y):
                    resting[r, c] = True
                sheet[r, c, 0], sheet[r, c, 1], sheet[r, c, 2] = x, y, max(z, floor)
