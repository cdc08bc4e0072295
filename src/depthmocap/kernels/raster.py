"""A z-buffer: draws triangles into a depth image and an image of the nearest triangle's values."""

import numba
import numpy as np


# Not all of fastmath: the background's depth is infinite.
@numba.njit(cache=True, fastmath={"contract", "arcp", "nsz", "reassoc"}, nogil=True)
def rasterise(points, faces, face_values, fx, fy, cx, cy, near, two_sided, depth, values):
    """Draw triangles of camera-frame points (x right, y down, z forward) over ``depth``.

    ``depth`` holds metres along z, and ``inf`` where nothing was drawn before. Where a triangle is nearer, ``depth``
    gets its depth and ``values`` its ``face_values``. Depth is exact on the plane of a triangle, because 1/z is linear
    in the image. Triangles that reach nearer than ``near`` are left out, and so are back faces unless ``two_sided``.
    """
    height, width = depth.shape
    n = points.shape[0]
    u = np.empty(n, np.float32)
    v = np.empty(n, np.float32)
    w = np.empty(n, np.float32)
    for i in range(n):
        z = points[i, 2]
        if z > near:
            w[i] = 1 / z
            u[i] = points[i, 0] * w[i] * fx + cx
            v[i] = points[i, 1] * w[i] * fy + cy
        else:
            w[i] = -1
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        if w[i] < 0 or w[j] < 0 or w[k] < 0:
            continue
        u0, v0, u1, v1, u2, v2 = u[i], v[i], u[j], v[j], u[k], v[k]
        area = (u1 - u0) * (v2 - v0) - (u2 - u0) * (v1 - v0)
        # A front face is counter-clockwise from outside. Its area is negative here, because v points down.
        if area == 0 or (area > 0 and not two_sided):
            continue
        left = max(np.int32(np.ceil(min(u0, u1, u2))), 0)
        right = min(np.int32(np.floor(max(u0, u1, u2))), width - 1)
        top = max(np.int32(np.ceil(min(v0, v1, v2))), 0)
        bottom = min(np.int32(np.floor(max(v0, v1, v2))), height - 1)
        if left > right or top > bottom:
            continue
        inverse = 1 / area
        w0, w1, w2 = w[i], w[j], w[k]
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                b0 = ((u1 - x) * (v2 - y) - (u2 - x) * (v1 - y)) * inverse
                b1 = ((u2 - x) * (v0 - y) - (u0 - x) * (v2 - y)) * inverse
                b2 = 1 - b0 - b1
                if b0 >= 0 and b1 >= 0 and b2 >= 0:
                    z = 1 / (b0 * w0 + b1 * w1 + b2 * w2)
                    if z < depth[y, x]:
                        depth[y, x] = z
                        values[y, x] = face_values[f]
