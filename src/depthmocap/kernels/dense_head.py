"""Labels and their probabilities from the scores of all pixels, at masked pixels only."""

import numba
import numpy as np


@numba.njit(cache=True, fastmath=True, nogil=True)
def label_dense_pixels(scores, mask, labels, confidence):
    """Argmax and softmax of one view's scores ``(c, h, w)`` into ``(h, w)`` arrays, zero outside the mask.

    Each row is read class by class between its first and last masked pixels, in the order of the memory.
    """
    classes, height, width = scores.shape
    best = np.empty(width, np.float32)
    total = np.empty(width, np.float32)
    index = np.empty(width, np.uint8)
    for y in range(height):
        columns = np.flatnonzero(mask[y])
        if not len(columns):
            continue
        first, last = columns[0], columns[-1] + 1
        for x in range(first, last):
            best[x] = scores[0, y, x]
            index[x] = 0
            total[x] = 0
        for i in range(1, classes):
            for x in range(first, last):
                if scores[i, y, x] > best[x]:
                    best[x] = scores[i, y, x]
                    index[x] = i
        for i in range(classes):
            for x in range(first, last):
                total[x] += np.exp(scores[i, y, x] - best[x])
        for x in columns:
            labels[y, x] = index[x]
            confidence[y, x] = 1 / total[x]
