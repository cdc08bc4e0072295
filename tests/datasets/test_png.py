"""PNG files: other programs read back what was written."""

import io

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from depthmocap.datasets.png import colour_png, grey_png

pytest.importorskip("isal")


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
        assert back is not None and back.dtype == dtype
        assert (back == image).all()


def test_colours_round_trip():
    rng = np.random.default_rng(1)
    colours = rng.integers(0, 256, (300, 4)).astype(np.uint8)
    colours[0] = 0
    for values in pictures(rng, np.uint16, 300):
        with Image.open(io.BytesIO(colour_png(values, colours))) as image:
            assert image.mode == "RGBA"
            assert (np.array(image) == colours[values]).all()


def test_flat_and_long_runs_round_trip():
    for width in (*range(1, 12), 63, 64, 65, 66, 128, 129, 130, 257, 258, 259, 260, 261, 262, 516, 517, 519, 1031):
        image = np.zeros((6, width), np.uint8)
        image[1] = 7
        image[2, width // 2 :] = 7
        image[4:] = 200
        for data, dtype in ((grey_png(image), np.uint8), (grey_png(image * np.uint16(257)), np.uint16)):
            back = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
            assert (back == image.astype(dtype) * dtype(257 if dtype is np.uint16 else 1)).all()
        colours = np.arange(1024, dtype=np.int64).astype(np.uint8).reshape(256, 4)[:, ::-1].copy()
        with Image.open(io.BytesIO(colour_png(image, colours))) as picture:
            assert (np.array(picture) == colours[image]).all()


def test_flat_pictures_are_small():
    rows, columns = np.mgrid[:424, :512]
    image = np.where(np.hypot(rows - 200, (columns - 250) * 2) < 150, (rows + columns) // 9 + 20, 0).astype(np.uint8)
    assert len(grey_png(image)) < 0.03 * image.size


@given(st.binary(min_size=1, max_size=400), st.integers(1, 20))
def test_any_bytes_round_trip(data, width):
    image = np.resize(np.frombuffer(data, np.uint8), (-(-len(data) // width), width))
    assert (cv2.imdecode(np.frombuffer(grey_png(image), np.uint8), cv2.IMREAD_UNCHANGED) == image).all()


def test_what_cannot_be_written():
    colours = np.zeros((3, 4), np.uint8)
    with pytest.raises(ValueError, match="0 to 2"):
        colour_png(np.array([[3]], np.uint8), colours)
    with pytest.raises(ValueError, match="0 to 2"):
        colour_png(np.array([[-1]]), colours)
    with pytest.raises(ValueError, match="at least one pixel"):
        grey_png(np.zeros((0, 4), np.uint8))
    with pytest.raises(ValueError, match="uint16, got int32"):
        grey_png(np.zeros((2, 2), np.int32))
