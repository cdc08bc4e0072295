"""Labels and their probabilities from what our network tells of groups of pixels."""

import numba
import numpy as np


@numba.njit(cache=True, fastmath=True, nogil=True)
def label_groups(probabilities, mask, labels, confidence):
    """The likeliest class and its probability at the masked pixels of a window; ``labels`` and ``confidence`` zero
    before.

    ``probabilities`` are (m, 4, classes): of the m groups of 2×2 pixels with a masked one, in row-major order, and of
    the pixels of a group, in row-major order too.
    """
    classes = probabilities.shape[2]
    group = 0
    for y in range(0, mask.shape[0], 2):
        for x in range(0, mask.shape[1], 2):
            shown = False
            for k in range(4):
                v, u = y + k // 2, x + k % 2
                if not mask[v, u]:
                    continue
                shown = True
                best = np.float32(-1)
                for i in range(classes):
                    best = max(best, probabilities[group, k, i])
                index = 0
                while probabilities[group, k, index] != best:
                    index += 1
                labels[v, u] = index
                confidence[v, u] = best
            group += shown


@numba.njit(cache=True, fastmath=True, nogil=True)
def label_pixels(logits, mask, labels, confidence):
    """Argmax and softmax of one view's head output ``(4·c, h, w)`` into ``(2h, 2w)`` arrays, zero outside the mask.

    Channel ``c·k + i`` is class i of pixel (row ``k // 2``, column ``k % 2``) of each 2×2 group. Rows are read class by
    class, which follows the memory.
    """
    h, w = logits.shape[1], logits.shape[2]
    classes = logits.shape[0] // 4
    best = np.empty(w, np.float32)
    index = np.empty(w, np.uint8)
    total = np.empty(w, np.float32)
    for y in range(h):
        for k in range(4):
            row = 2 * y + k // 2
            first, last = w, -1
            for x in range(w):
                if mask[row, 2 * x + k % 2]:
                    if first == w:
                        first = x
                    last = x
            if last < 0:
                continue
            for x in range(first, last + 1):
                best[x] = logits[k * classes, y, x]
                index[x] = 0
                total[x] = 0
            for i in range(1, classes):
                for x in range(first, last + 1):
                    value = logits[k * classes + i, y, x]
                    if value > best[x]:
                        best[x] = value
                        index[x] = i
            for i in range(classes):
                for x in range(first, last + 1):
                    total[x] += np.exp(logits[k * classes + i, y, x] - best[x])
            for x in range(first, last + 1):
                if mask[row, 2 * x + k % 2]:
                    labels[row, 2 * x + k % 2] = index[x]
                    confidence[row, 2 * x + k % 2] = 1 / total[x]
