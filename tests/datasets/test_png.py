"""PNG files: other programs read back what was written."""

import io

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from depthmocap.datasets.png import colour_png, grey_png


def pictures(rng: np.random.Generator, dtype: type, high: int):
    """Of many sizes, with empty rows above and below, or wholly empty."""
    for height, width in ((1, 1), (1, 40), (37, 1), (60, 33)):
        for top, bottom in ((0, height), (height // 3, height), (0, height - height // 3), (height // 2, height // 2)):
            image = np.zeros((height, width), dtype)
            image[top:bottom] = rng.integers(0, high, (bottom - top, width))
            yield image


@pytest.mark.parametrize(("dtype", "high"), [(np.uint8, 256), (np.uint16, 65536)])
def test_grey_round_trip(dtype, high):
    for image in pictures(np.random.default_rng(0), dtype, high):
        data = grey_png(image)
        with Image.open(io.BytesIO(data)) as opened:
            assert (np.array(opened) == image).all()
        back = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        assert back.dtype == dtype
        assert (back == image).all()


def test_colours_round_trip():
    rng = np.random.default_rng(1)
    colours = rng.integers(0, 256, (300, 4)).astype(np.uint8)
    colours[0] = 0
    for values in pictures(rng, np.uint16, 300):
        with Image.open(io.BytesIO(colour_png(values, colours))) as image:
            assert image.mode == "RGBA"
            assert (np.array(image) == colours[values]).all()


@given(st.binary(min_size=1, max_size=400), st.integers(1, 20))
def test_any_bytes_round_trip(data, width):
    image = np.resize(np.frombuffer(data, np.uint8), (-(-len(data) // width), width))
    assert (cv2.imdecode(np.frombuffer(grey_png(image), np.uint8), cv2.IMREAD_UNCHANGED) == image).all()


def test_what_cannot_be_written():
    colours = np.zeros((3, 4), np.uint8)
    with pytest.raises(ValueError, match="0 to 2"):
        colour_png(np.array([[3]], np.uint8), colours)
    with pytest.raises(ValueError, match="uint16, got int32"):
        grey_png(np.zeros((2, 2), np.int32))
