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
