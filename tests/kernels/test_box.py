"""The part of a picture in which something is."""

import numpy as np
import pytest

from depthmocap.kernels.box import bounding_box


@pytest.mark.parametrize("dtype", [bool, np.uint8])
def test_box_is_that_of_the_marked_pixels(dtype):
    rng = np.random.default_rng(0)
    for _ in range(20):
        picture = (rng.random((30, 40)) < 0.005).astype(dtype) * dtype(200)
        places = np.nonzero(picture)
        expected = tuple(slice(each.min(), each.max() + 1) for each in places) if len(places[0]) else None
        assert bounding_box(picture) == expected
    assert bounding_box(np.zeros((3, 4), dtype)) is None
