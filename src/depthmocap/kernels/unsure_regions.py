"""Regions of a coarse image that may show a person, and the one of which that is least known."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def number_regions(marked, labels):
    """Number the regions of marked cells that touch by a side, in the order of their first cells, from 1; their count.

    Args:
        labels: (rows, columns) int32, zeros.
    """
    rows, columns = marked.shape
    stack = np.empty(rows * columns, np.int32)
    count = 0
    for i in range(rows):
        for j in range(columns):
            if not marked[i, j] or labels[i, j]:
                continue
            count += 1
            labels[i, j] = count
            stack[0], top = i * columns + j, 1
            while top:
                top -= 1
                y, x = stack[top] // columns, stack[top] % columns
                for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                    b, a = y + dy, x + dx
                    if 0 <= b < rows and 0 <= a < columns and marked[b, a] and not labels[b, a]:
                        labels[b, a] = count
                        stack[top] = b * columns + a
                        top += 1
    return count


@numba.njit(cache=True, nogil=True)
def mark_cells(samples_m, logits, known, least, marked):
    """Mark the cells that have a sample with depth whose logit is above ``least`` and that is not known; whether there
    are any.

    Args:
        samples_m, logits, known: (2 rows, 2 columns).
        marked: (rows, columns) bool, zeros.
    """
    found = False
    for i in range(2 * marked.shape[0]):
        for j in range(2 * marked.shape[1]):
            if logits[i, j] > least and samples_m[i, j] > 0 and not known[i, j]:
                marked[i // 2, j // 2] = found = True
    return found


@numba.njit(cache=True, nogil=True)
def most_doubtful(samples_m, logits, known, labels, count, least, sure, least_m2, sample_rad, depths_m):
    """The label of the region with the largest doubt, 0 without any, and the number of its samples, whose depths are
    written. Doubt is the variance of a sample's probability, times its surface, summed.

    Args:
        samples_m, logits, known: (2 rows, 2 columns).
        labels: (rows, columns) of the regions, of which there are ``count``.
        least: as in :func:`mark_cells`.
        sure: regions whose mean logit is above this are not in doubt,
        least_m2: nor are those of a smaller surface (m²).
        sample_rad: angle between samples.
        depths_m: (samples) float32.
    """
    sums = np.zeros((count + 1, 4))
    for i in range(2 * labels.shape[0]):
        for j in range(2 * labels.shape[1]):
            logit, z = logits[i, j], samples_m[i, j]
            if logit > least and z > 0 and not known[i, j]:
                owner = sums[labels[i // 2, j // 2]]
                probability = 1 / (1 + np.exp(-logit))
                surface_m2 = (z * sample_rad) ** 2
                owner[0] += 1
                owner[1] += logit
                owner[2] += surface_m2
                owner[3] += probability * (1 - probability) * surface_m2
    best, most = 0, 0.0
    for label in range(1, count + 1):
        samples, logit, surface_m2, doubt = sums[label]
        if doubt > most and surface_m2 >= least_m2 and logit <= sure * samples:
            best, most = label, doubt
    written = 0
    for i in range(2 * labels.shape[0] if best else 0):
        for j in range(2 * labels.shape[1]):
            if labels[i // 2, j // 2] == best and logits[i, j] > least and samples_m[i, j] > 0 and not known[i, j]:
                depths_m[written] = samples_m[i, j]
                written += 1
    return best, written


@numba.njit(cache=True, nogil=True)
def mark_around(labels, label, beside):
    """Mark the cells of a label and those that touch one by a side; the first row, the last, and the same of columns.

    Args:
        beside: (rows, columns) bool, zeros.
    """
    rows, columns = labels.shape
    top, bottom, left, right = rows, -1, columns, -1
    for i in range(rows):
        for j in range(columns):
            if labels[i, j] != label:
                continue
            top, bottom, left, right = min(top, i), max(bottom, i), min(left, j), max(right, j)
            beside[i, j] = beside[max(i - 1, 0), j] = beside[min(i + 1, rows - 1), j] = True
            beside[i, max(j - 1, 0)] = beside[i, min(j + 1, columns - 1)] = True
    return top, bottom, left, right
