"""The rotations nearest to matrices, by Davenport's q-method: the unit quaternion q that makes q·K q largest, where K
is made of the matrix, is K's largest eigenvector, found by Jacobi's rotations."""

from __future__ import annotations

import math

import numba
import numpy as np
from jaxtyping import Float
from numpy import ndarray

#: Sweeps over the six elements above the diagonal; four do.
_MOST_SWEEPS = 12


def nearest_rotations(matrices: Float[ndarray, "*n 3 3"]) -> Float[ndarray, "*n 3 3"]:
    """The rotations nearest to matrices (sum of squares); NaN of a matrix with NaN."""
    flat = np.ascontiguousarray(matrices, np.float64).reshape(-1, 3, 3)
    rotations = np.empty_like(flat)
    _nearest_rotations(flat, rotations)
    return rotations.reshape(matrices.shape)


@numba.njit(cache=True, nogil=True)
def _largest_eigenvector(K, V):
    """The column of V that holds it, once K (symmetric, 4×4) is diagonal; both are overwritten."""
    for i in range(4):
        for j in range(4):
            V[i, j] = 1.0 if i == j else 0.0
    for _ in range(_MOST_SWEEPS):
        beside, whole = 0.0, 0.0
        for i in range(4):
            whole += K[i, i] * K[i, i]
            for j in range(i + 1, 4):
                beside += K[i, j] * K[i, j]
        if beside <= 1e-32 * whole:
            break
        for p in range(3):
            for q in range(p + 1, 4):
                if K[p, q] == 0.0:
                    continue
                ratio = (K[q, q] - K[p, p]) / (2.0 * K[p, q])
                t = math.copysign(1.0, ratio) / (abs(ratio) + math.sqrt(1.0 + ratio * ratio))
                c = 1.0 / math.sqrt(1.0 + t * t)
                s = t * c
                for k in range(4):
                    a, b = K[k, p], K[k, q]
                    K[k, p], K[k, q] = c * a - s * b, s * a + c * b
                for k in range(4):
                    a, b = K[p, k], K[q, k]
                    K[p, k], K[q, k] = c * a - s * b, s * a + c * b
                    a, b = V[k, p], V[k, q]
                    V[k, p], V[k, q] = c * a - s * b, s * a + c * b
    best = 0
    for i in range(1, 4):
        if K[i, i] > K[best, best]:
            best = i
    return best


@numba.njit(cache=True, nogil=True)
def _nearest_rotations(matrices, out):
    K, V = np.empty((4, 4)), np.empty((4, 4))
    for n in range(matrices.shape[0]):
        M = matrices[n]
        K[0, 0] = M[0, 0] + M[1, 1] + M[2, 2]
        K[1, 1] = M[0, 0] - M[1, 1] - M[2, 2]
        K[2, 2] = M[1, 1] - M[0, 0] - M[2, 2]
        K[3, 3] = M[2, 2] - M[0, 0] - M[1, 1]
        K[0, 1] = K[1, 0] = M[2, 1] - M[1, 2]
        K[0, 2] = K[2, 0] = M[0, 2] - M[2, 0]
        K[0, 3] = K[3, 0] = M[1, 0] - M[0, 1]
        K[1, 2] = K[2, 1] = M[0, 1] + M[1, 0]
        K[1, 3] = K[3, 1] = M[0, 2] + M[2, 0]
        K[2, 3] = K[3, 2] = M[1, 2] + M[2, 1]
        known = math.isfinite(K.sum())
        best = _largest_eigenvector(K, V) if known else 0
        w, x, y, z = V[0, best], V[1, best], V[2, best], V[3, best]
        if not known:
            w = np.nan
        R = out[n]
        R[0, 0], R[0, 1], R[0, 2] = w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)
        R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)
        R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z
