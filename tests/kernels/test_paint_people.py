"""Labels at full resolution, from those of samples."""

import numpy as np
import pytest

from depthmocap.kernels.people_votes import paint_people

STEP_M = 0.1


def painted_slowly(depth_m, limit_m, starts, samples_m, labels, beyond):
    """Of every pixel: the label of the sample among the nearest nine whose depth it continues."""
    out = np.zeros(depth_m.shape, np.uint8)
    of_pixel = [np.searchsorted(each, np.arange(each[-1]), "right") - 1 for each in starts]
    for v, i in enumerate(of_pixel[0]):
        for u, j in enumerate(of_pixel[1]):
            nine = [
                (abs(samples_m[y, x] - depth_m[v, u]), abs(y - i) + abs(x - j), y, x)
                for y in range(max(i - 1, 0), min(i + 2, labels.shape[0]))
                for x in range(max(j - 1, 0), min(j + 2, labels.shape[1]))
            ]
            if len({labels[y, x] for _, _, y, x in nine}) == 1:
                nine = [one for one in nine if one[1] == 0]
            near = [one for one in nine if one[0] < STEP_M and (samples_m[one[2:]] > 0 or len(nine) == 1)]
            if depth_m[v, u] > 0 and near:
                _, _, y, x = min(near, key=lambda one: one[0] + np.float32(0.01) * one[1])
                if depth_m[v, u] < limit_m[v, u] or beyond[y, x]:
                    out[v, u] = labels[y, x]
    return out


@pytest.mark.parametrize("seed", range(4))
def test_a_pixel_has_the_label_of_the_sample_that_it_continues(seed):
    rng = np.random.default_rng(seed)
    starts = [np.floor(np.arange(count + 1) * 2.9).astype(np.int64) for count in (12, 16)]
    labels = np.kron(rng.choice([0, 0, 1, 2], (4, 4)), np.ones((3, 4))).astype(np.uint8)
    samples_m = (2 + 0.5 * labels + rng.normal(0, 0.04, labels.shape)).astype(np.float32)
    samples_m[rng.uniform(size=labels.shape) < 0.1] = 0
    of_pixel = np.ix_(*(np.searchsorted(each, np.arange(each[-1]), "right") - 1 for each in starts))
    depth_m = (samples_m[of_pixel] + rng.normal(0, 0.05, samples_m[of_pixel].shape)).astype(np.float32)
    depth_m[rng.uniform(size=depth_m.shape) < 0.1] = 0
    limit_m = rng.choice(np.array([2.4, 2.7, 9.0], np.float32), depth_m.shape)
    beyond = (rng.uniform(size=labels.shape) < 0.2).astype(np.uint8)
    out = np.zeros(depth_m.shape, np.uint8)
    paint_people(depth_m, limit_m, starts[0], starts[1], samples_m, labels, beyond, STEP_M, out)
    np.testing.assert_array_equal(out, painted_slowly(depth_m, limit_m, starts, samples_m, labels, beyond))
    assert {0, 1, 2} >= set(np.unique(out)) > {0}
