"""Linear blend skinning."""

import numba
import numpy as np


@numba.njit(cache=True, fastmath=True, nogil=True)
def _rotate(rotation, x, y, z):
    """The rotated vector."""
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
    )


@numba.njit(cache=True, fastmath=True, nogil=True)
def skin(rest, indices, weights, rotations, offsets, out):
    """``out[v] = Σ_k weights[v, k] · (rotations[b] @ rest[v] + offsets[b])`` with ``b = indices[v, k]``."""
    for v in range(rest.shape[0]):
        x, y, z = rest[v, 0], rest[v, 1], rest[v, 2]
        a = b = c = np.float32(0)
        for k in range(indices.shape[1]):
            w = weights[v, k]
            if w == 0:
                break  # weights are sorted, largest first
            o = offsets[indices[v, k]]
            rotated_x, rotated_y, rotated_z = _rotate(rotations[indices[v, k]], x, y, z)
            a += w * (rotated_x + o[0])
            b += w * (rotated_y + o[1])
            c += w * (rotated_z + o[2])
        out[v, 0], out[v, 1], out[v, 2] = a, b, c


@numba.njit(cache=True, fastmath=True, nogil=True)
def skin_with_normals(rest, normals, indices, weights, rotations, offsets, out, directions):
    """:func:`skin` of points and of their unit normals."""
    for v in range(rest.shape[0]):
        x, y, z = rest[v, 0], rest[v, 1], rest[v, 2]
        p, q, s = normals[v, 0], normals[v, 1], normals[v, 2]
        a = b = c = d = e = f = np.float32(0)
        for k in range(indices.shape[1]):
            w = weights[v, k]
            if w == 0:
                break
            r, o = rotations[indices[v, k]], offsets[indices[v, k]]
            rotated_x, rotated_y, rotated_z = _rotate(r, x, y, z)
            a += w * (rotated_x + o[0])
            b += w * (rotated_y + o[1])
            c += w * (rotated_z + o[2])
            rotated_x, rotated_y, rotated_z = _rotate(r, p, q, s)
            d += w * rotated_x
            e += w * rotated_y
            f += w * rotated_z
        out[v, 0], out[v, 1], out[v, 2] = a, b, c
        scale = 1 / (np.sqrt(d * d + e * e + f * f) + np.float32(1e-9))
        directions[v, 0], directions[v, 1], directions[v, 2] = d * scale, e * scale, f * scale


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
