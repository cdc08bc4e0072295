"""UBC3V: the codecs of depth and labels, and the pictures that hold them."""

import numpy as np
import pytest
from PIL import Image
from ubc3v_files import EYES, HALF_STEP_M, SHAPE

from depthmocap.body.regions import UBC3V_COLOURS
from depthmocap.datasets.ubc3v import (
    UNLABELLED,
    decode_depth,
    decode_labels,
    encode_depth,
    encode_labels,
    image_paths,
    kinect2_camera,
)
from depthmocap.datasets.ubc3v_write import write_images
from depthmocap.frames import View
from depthmocap.geometry.transforms import look_at

pytest.importorskip("isal")


def test_depth_round_trip():
    rng = np.random.default_rng(1)
    depth = rng.uniform(0.6, 8.2, SHAPE)
    mask = rng.random(SHAPE) < 0.5
    back, back_mask = decode_depth(encode_depth(depth, mask))
    assert back.dtype == np.float32
    assert (back_mask == mask).all()
    assert (back[~mask] == 0).all()
    assert np.abs(back - depth)[mask].max() <= HALF_STEP_M
    again = encode_depth(back, mask)
    assert (again == encode_depth(depth, mask)).all()


def test_depth_clips_and_drops_invalid():
    depth = np.array([[0.2, 9.0, 0.0, np.nan, 1.0]])
    back, mask = decode_depth(encode_depth(depth, np.array([[True, True, True, True, False]])))
    assert mask.tolist() == [[True, True, False, False, False]]
    np.testing.assert_allclose(back[0, :2], [0.515, 8.24], rtol=1e-6)
    assert decode_depth(encode_depth(depth, mask, 1.0), 1.0)[0][0, 0] == np.float32(0.5)


def test_depth_reads_red_and_full_alpha_only():
    rgba = np.array([[[255, 253, 250, 255], [255, 255, 255, 254]]], np.uint8)
    depth, mask = decode_depth(rgba)
    assert mask.tolist() == [[True, False]]
    np.testing.assert_allclose(depth, [[8.24, 0]], rtol=1e-6)


def test_labels_round_trip():
    labels = np.array([[*range(44), UNLABELLED]], np.uint8)
    rgba = encode_labels(labels)
    assert (rgba[..., 3] == np.where(labels > 0, 255, 0)).all()
    assert (rgba[0, 41] == [0, 0, 0, 255]).all()
    assert (decode_labels(rgba) == labels).all()


def test_labels_within_two_of_their_colour():
    offsets = np.stack(np.meshgrid(*[[-2, 0, 2]] * 3), -1).reshape(-1, 3)
    colours = np.clip(UBC3V_COLOURS[1:, None].astype(int) + offsets, 0, 255).astype(np.uint8)
    rgba = np.concatenate([colours, np.full((*colours.shape[:2], 1), 255, np.uint8)], -1)
    assert (decode_labels(rgba) == np.arange(1, 44)[:, None]).all()


def test_labels_beyond_two_are_unlabelled():
    rgba = np.zeros((1, 3, 4), np.uint8)
    rgba[0, :, :3] = [[255, 109, 0], [3, 0, 0], [255, 255, 255]]  # 1 and 41 missed by one; no region is white
    rgba[0, :, 3] = 255
    assert decode_labels(rgba).tolist() == [[UNLABELLED] * 3]
    rgba[0, :, 3] = 254
    assert decode_labels(rgba).tolist() == [[0] * 3]


def test_labels_reject_unknown():
    with pytest.raises(ValueError, match="0 to 43"):
        encode_labels(np.full((2, 2), 44, np.uint8))


def test_images_are_those_of_the_codecs(tmp_path):
    rng = np.random.default_rng(5)
    for top, bottom in ((0, 424), (0, 200), (100, 424), (200, 201), (0, 0)):
        mask = np.zeros(SHAPE, bool)
        mask[top:bottom, 100:300] = rng.random((bottom - top, 200)) < 0.8
        depth = np.where(rng.random(SHAPE) < 0.9, rng.uniform(0.2, 9.0, SHAPE), 0).astype(np.float32)
        labels = rng.choice([*range(1, 44), UNLABELLED], SHAPE).astype(np.uint8)
        camera = kinect2_camera("Cam1", look_at(np.array(EYES[0]), np.zeros(3)))
        write_images(tmp_path, 0, [View(camera, depth, mask, labels)])
        depth_path, labels_path = image_paths(tmp_path, "Cam1", 0)
        expected = encode_depth(depth, mask), encode_labels(np.where(mask, labels, np.uint8(0)))
        for path, rgba in zip((depth_path, labels_path), expected, strict=True):
            with Image.open(path) as image:
                assert (np.array(image) == rgba).all()
