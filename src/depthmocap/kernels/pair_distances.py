"""Points moved as little as possible until pairs of them have given distances: a few Newton steps."""

from __future__ import annotations

import math

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def _solve(A, b, x):
    """Of a symmetric, positive definite matrix, which is overwritten: A x = b, by Cholesky's factors."""
    n = b.shape[0]
    for j in range(n):
        for k in range(j):
            for i in range(j, n):
                A[i, j] -= A[i, k] * A[j, k]
        A[j, j] = math.sqrt(A[j, j])
        for i in range(j + 1, n):
            A[i, j] /= A[j, j]
    for i in range(n):
        x[i] = b[i]
        for k in range(i):
            x[i] -= A[i, k] * x[k]
        x[i] /= A[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= A[k, i] * x[k]
        x[i] /= A[i, i]


@numba.njit(cache=True, nogil=True)
def move_to_distances(frames, pairs, coupling, lengths, damping, shortest, passes, close_m):
    """Move the points of each frame (t, n, 3; NaN where unknown) in place.

    ``pairs`` (p, 2) shall be ``lengths`` apart; ``coupling`` (p, p) is B Bᵀ of their incidence matrix. A pair with an
    unknown point, or nearer than ``shortest`` of its length, binds nothing. Ends after ``passes``, or where all pairs
    are within ``close_m`` of their lengths.
    """
    count = pairs.shape[0]
    bound = np.empty(count, np.bool_)
    direction, stretch, tension = np.empty((count, 3)), np.empty(count), np.empty(count)
    matrix = np.empty((count, count))
    for points in frames:
        for step in range(passes):
            worst = 0.0
            for p in range(count):
                square = 0.0
                for k in range(3):
                    direction[p, k] = points[pairs[p, 1], k] - points[pairs[p, 0], k]
                    square += direction[p, k] * direction[p, k]
                length = math.sqrt(square)
                if step == 0:
                    bound[p] = length > shortest * lengths[p]  # False for NaN
                stretch[p] = length - lengths[p] if bound[p] else 0.0
                for k in range(3):
                    direction[p, k] = direction[p, k] / max(length, 1e-9) if bound[p] else 0.0
                worst = max(worst, abs(stretch[p]))
            if worst < close_m:
                break
            for p in range(count):
                for q in range(p):
                    cosine = 0.0
                    for k in range(3):
                        cosine += direction[p, k] * direction[q, k]
                    matrix[p, q] = coupling[p, q] * cosine
                matrix[p, p] = coupling[p, p] + damping
            _solve(matrix, stretch, tension)
            for p in range(count):
                for k in range(3):
                    points[pairs[p, 0], k] += tension[p] * direction[p, k]
                    points[pairs[p, 1], k] -= tension[p] * direction[p, k]
