"""Ray casting of simple solids: boxes, ellipsoids, capsules, cylinders and the inside of a box.

A solid has a kind, a frame in which it has unit size, and for capsules a length:

| kind | in its own frame |
|---|---|
| BOX | the cube −1…1 |
| SHELL | the same cube, seen from inside |
| ELLIPSOID | the unit ball |
| CAPSULE | the points within 1 of the z axis between −half and +half |
| CYLINDER | the unit disc in x and y, z in −1…1 |
"""

import numba
import numpy as np

BOX, SHELL, ELLIPSOID, CAPSULE, CYLINDER = range(5)

_MATH = {"contract", "arcp", "nsz", "reassoc"}  # not all of fastmath: a ray that misses has an infinite depth


@numba.njit(inline="always", fastmath=_MATH, error_model="numpy")
def _nonzero(d):
    """A component of a direction, changed immeasurably if it is 0, so that it can be divided by."""
    return d if abs(d) > 1e-12 else 1e-12


@numba.njit(inline="always", fastmath=_MATH, error_model="numpy")
def _box_span(o0, o1, o2, d0, d1, d2):
    """The t at which a ray o + t d enters and leaves the cube; the second is smaller if the ray misses."""
    i0, i1, i2 = 1 / _nonzero(d0), 1 / _nonzero(d1), 1 / _nonzero(d2)
    m0, m1, m2 = -o0 * i0, -o1 * i1, -o2 * i2
    h0, h1, h2 = abs(i0), abs(i1), abs(i2)
    return max(m0 - h0, m1 - h1, m2 - h2), min(m0 + h0, m1 + h1, m2 + h2)


@numba.njit(inline="always", fastmath=_MATH, error_model="numpy")
def _ball(o0, o1, o2, d0, d1, d2):
    """The t at which a ray enters the unit ball; inf if it misses."""
    a = d0 * d0 + d1 * d1 + d2 * d2
    b = o0 * d0 + o1 * d1 + o2 * d2
    root = b * b - a * (o0 * o0 + o1 * o1 + o2 * o2 - 1)
    return (-b - np.sqrt(root)) / a if root >= 0 else np.inf


@numba.njit(fastmath=_MATH, error_model="numpy")
def _enter(kind, half, o0, o1, o2, d0, d1, d2):
    """The t at which a ray o + t d first meets a solid (for a shell: leaves it); inf if it misses."""
    if kind == BOX:
        enter, leave = _box_span(o0, o1, o2, d0, d1, d2)
        return enter if enter < leave else np.inf
    if kind == SHELL:
        return _box_span(o0, o1, o2, d0, d1, d2)[1]
    if kind == ELLIPSOID:
        return _ball(o0, o1, o2, d0, d1, d2)
    # Cylinder and capsule: first the infinite cylinder around z.
    a = max(d0 * d0 + d1 * d1, 1e-18)
    b = o0 * d0 + o1 * d1
    root = b * b - a * (o0 * o0 + o1 * o1 - 1)
    if root < 0:
        return np.inf
    root = np.sqrt(root)
    enter, leave = (-b - root) / a, (-b + root) / a
    if kind == CYLINDER:
        inverse = 1 / _nonzero(d2)
        enter = max(enter, -o2 * inverse - abs(inverse))
        leave = min(leave, -o2 * inverse + abs(inverse))
        return enter if enter < leave else np.inf
    z = o2 + enter * d2
    if abs(z) <= half:
        return enter
    # Beyond an end, the ray can only meet the ball of that end first.
    return _ball(o0, o1, o2 - np.copysign(half, z), d0, d1, d2)


@numba.njit(fastmath=_MATH, error_model="numpy")
def _cast_box_row(inside, m, x, y, material, depth, values):
    """``cast`` for a box and a part of a row, without branches, so that it is vectorised."""
    o0, o1, o2 = m[0, 3], m[1, 3], m[2, 3]
    x0, x1, x2 = m[0, 0], m[1, 0], m[2, 0]
    y0, y1, y2 = m[0, 1], m[1, 1], m[2, 1]
    z0, z1, z2 = m[0, 2], m[1, 2], m[2, 2]
    for i in range(x.shape[0]):
        a, b = x[i], y[i]
        enter, leave = _box_span(o0, o1, o2, x0 * a + y0 * b + z0, x1 * a + y1 * b + z1, x2 * a + y2 * b + z2)
        t = leave if inside else (enter if enter < leave else np.inf)
        t = np.float32(t) if t > 0 else np.float32(np.inf)
        before = depth[i]
        depth[i] = min(t, before)
        values[i] = material if t < before else values[i]


@numba.njit(cache=True, fastmath=_MATH, error_model="numpy", nogil=True)
def cast(rays_x, rays_y, windows, kinds, halves, frames, materials, depth, values):
    """Draw solids into ``depth`` (metres along z, ``inf`` where it is empty) and ``values``, where they are nearer.

    Args:
        rays_x, rays_y: x/z and y/z of the pixels' rays; one row of x and one column of y are enough without distortion.
        windows: first and last row, first and last column that each solid may cover.
        frames: ``local_from_camera`` of each, 3×4.

    A solid is visible only from outside, and a shell only from inside.
    """
    height, width = depth.shape
    x = np.empty(width)
    y = np.empty(width)
    for row in range(height):
        left, right = width, -1
        for k in range(kinds.shape[0]):
            if row >= windows[k, 0] and row <= windows[k, 1]:
                left, right = min(left, windows[k, 2]), max(right, windows[k, 3])
        for column in range(left, right + 1):
            x[column] = rays_x[min(row, rays_x.shape[0] - 1), column]
            y[column] = rays_y[row, min(column, rays_y.shape[1] - 1)]
        for k in range(kinds.shape[0]):
            if row < windows[k, 0] or row > windows[k, 1]:
                continue
            kind, half, material, m = kinds[k], halves[k], materials[k], frames[k]
            first, last = windows[k, 2], windows[k, 3]
            if kind in (BOX, SHELL):
                _cast_box_row(
                    kind == SHELL, m, x[first : last + 1], y[first : last + 1], material,
                    depth[row, first : last + 1], values[row, first : last + 1],
                )  # fmt: skip
                continue
            for column in range(first, last + 1):
                d0 = m[0, 0] * x[column] + m[0, 1] * y[column] + m[0, 2]
                d1 = m[1, 0] * x[column] + m[1, 1] * y[column] + m[1, 2]
                d2 = m[2, 0] * x[column] + m[2, 1] * y[column] + m[2, 2]
                t = _enter(kind, half, m[0, 3], m[1, 3], m[2, 3], d0, d1, d2)
                if t > 0 and t < depth[row, column]:
                    depth[row, column] = t
                    values[row, column] = material


@numba.njit(inline="always")
def _to_local(m, p):
    """A point in a solid's frame."""
    return (
        m[0, 0] * p[0] + m[0, 1] * p[1] + m[0, 2] * p[2] + m[0, 3],
        m[1, 0] * p[0] + m[1, 1] * p[1] + m[1, 2] * p[2] + m[1, 3],
        m[2, 0] * p[0] + m[2, 1] * p[1] + m[2, 2] * p[2] + m[2, 3],
    )


@numba.njit(cache=True, fastmath=_MATH, error_model="numpy", nogil=True)
def mark_hidden(kinds, halves, frames, eyes, points, hidden):
    """Mark in ``hidden`` (eyes × points) the points that a solid occludes. ``frames``: ``local_from_world``."""
    for k in range(kinds.shape[0]):
        m = frames[k]
        for e in range(eyes.shape[0]):
            o0, o1, o2 = _to_local(m, eyes[e])
            for p in range(points.shape[0]):
                p0, p1, p2 = _to_local(m, points[p])
                t = _enter(kinds[k], halves[k], o0, o1, o2, p0 - o0, p1 - o1, p2 - o2)
                if t > 0 and t < 1:
                    hidden[e, p] = True


@numba.njit(cache=True, nogil=True)
def contains_any(kinds, halves, frames, points):
    """Whether any point lies within any solid; a shell counts as a box. ``frames``: ``local_from_world``."""
    for k in range(kinds.shape[0]):
        kind = kinds[k]
        for p in range(points.shape[0]):
            x, y, z = _to_local(frames[k], points[p])
            if abs(z) > 1 + halves[k]:
                continue
            if kind in (BOX, SHELL):
                inside = abs(x) < 1 and abs(y) < 1
            elif kind == CYLINDER:
                inside = x * x + y * y < 1
            else:
                z = max(abs(z) - halves[k], 0.0)  # half is 0 except for capsules
                inside = x * x + y * y + z * z < 1
            if inside:
                return True
    return False
