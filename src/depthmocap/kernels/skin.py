"""Linear blend skinning."""

import numba
import numpy as np


@numba.njit(cache=True, fastmath=True, nogil=True)
def skin(rest, indices, weights, rotations, offsets, out):
    """``out[v] = Σ_k weights[v, k] · (rotations[b] @ rest[v] + offsets[b])`` with ``b = indices[v, k]``."""
    for v in range(rest.shape[0]):
        x, y, z = rest[v, 0], rest[v, 1], rest[v, 2]
        a = np.float32(0)
        b = np.float32(0)
        c = np.float32(0)
        for k in range(indices.shape[1]):
            w = weights[v, k]
            if w == 0:
                break  # weights are sorted, largest first
            r = rotations[indices[v, k]]
            o = offsets[indices[v, k]]
            a += w * (r[0, 0] * x + r[0, 1] * y + r[0, 2] * z + o[0])
            b += w * (r[1, 0] * x + r[1, 1] * y + r[1, 2] * z + o[1])
            c += w * (r[2, 0] * x + r[2, 1] * y + r[2, 2] * z + o[2])
        out[v, 0] = a
        out[v, 1] = b
        out[v, 2] = c


@numba.njit(cache=True, fastmath=True, nogil=True)
def vertex_normals(vertices, faces, out):
    """Area-weighted unit vertex normals."""
    out[:] = 0
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, az = vertices[j, 0] - vertices[i, 0], vertices[j, 1] - vertices[i, 1], vertices[j, 2] - vertices[i, 2]
        bx, by, bz = vertices[k, 0] - vertices[i, 0], vertices[k, 1] - vertices[i, 1], vertices[k, 2] - vertices[i, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        for v in (i, j, k):
            out[v, 0] += nx
            out[v, 1] += ny
            out[v, 2] += nz
    for v in range(out.shape[0]):
        length = np.sqrt(out[v, 0] ** 2 + out[v, 1] ** 2 + out[v, 2] ** 2) + np.float32(1e-12)
        out[v, 0] /= length
        out[v, 1] /= length
        out[v, 2] /= length
