"""Labels and their probabilities from our network's output for groups of pixels."""

import numba
import numpy as np


@numba.njit(cache=True, fastmath=True, nogil=True)
def label_groups(probabilities, mask, labels, confidence):
    """The most probable class and its probability at the masked pixels of a window; ``labels`` and ``confidence`` must
    be zero before. Gives the number of groups.

    ``probabilities`` are (m, 4, classes): for the m groups of 2×2 pixels that contain a masked one, and for the pixels
    of a group, both in row-major order.
    """
    classes = probabilities.shape[2]
    group = 0
    for y in range(0, mask.shape[0], 2):
        for x in range(0, mask.shape[1], 2):
            has_masked = False
            for k in range(4):
                v, u = y + k // 2, x + k % 2
                if not mask[v, u]:
                    continue
                has_masked = True
                best = np.float32(-1)
                for i in range(classes):
                    best = max(best, probabilities[group, k, i])
                index = 0
                while probabilities[group, k, index] != best:
                    index += 1
                labels[v, u] = index
                confidence[v, u] = best
            group += has_masked
    return group
