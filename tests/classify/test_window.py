"""The network's window: what it shows, and labels carried into it and back."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from depthmocap.classify.window import DEPTH_SCALE_M, MIN_PIXELS, PERSON, PIXEL_M, WINDOW, WINDOW_STEP, make_window
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.synth.body.mesh import Body
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.render import render_body


def camera_at(distance_m: float, focal_px: float = 368.0, width: int = 512, height: int = 424) -> DepthCamera:
    pose = look_at(np.array([0.5, -1.0, 0.2]) * distance_m, np.zeros(3))
    return DepthCamera("cam0", width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2, pose)


def picture(body: Body, camera: DepthCamera, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    return render_body(body.pose(PosturePrior.load().sample(np.random.default_rng(seed))[0]), camera)


def full_confidence(labels: np.ndarray) -> np.ndarray:
    return np.ones(labels.shape, dtype=np.float32)


@pytest.mark.parametrize("seed", range(4))
def test_labels_there_and_back(default_body: Body, seed: int) -> None:
    camera = camera_at(2.2)
    depth, labels = picture(default_body, camera, seed)
    window = make_window(depth, labels > 0, camera)
    assert window is not None
    assert 1 < window.step < 1.6  # the picture is larger than the window
    in_window = window.labels_from_image(labels)
    back, confidence = window.labels_to_image(in_window, full_confidence(in_window), labels > 0)
    person = labels > 0
    kept = (back == labels)[person].mean()
    assert kept > 0.945  # all but some of the pixels beside a border between regions
    assert not back[~person].any()
    np.testing.assert_array_equal(confidence, person)
    # The two directions are in register: read a pixel further on, fewer labels return.
    for shift in (-1.0, 1.0):
        beside = dataclasses.replace(window, left=window.left + shift, top=window.top + shift)
        shifted, _ = beside.labels_to_image(in_window, full_confidence(in_window), person)
        assert (shifted == labels)[person].mean() < kept


@pytest.mark.parametrize("seed", range(3))
def test_labels_of_a_small_person_come_back_exactly(default_body: Body, seed: int) -> None:
    camera = camera_at(4.5)
    depth, labels = picture(default_body, camera, seed)
    window = make_window(depth, labels > 0, camera)
    assert window is not None
    assert window.step < 1
    in_window = window.labels_from_image(labels)
    back, _ = window.labels_to_image(in_window, full_confidence(in_window), labels > 0)
    np.testing.assert_array_equal(back, labels)


@pytest.mark.parametrize("distance_m", [1.9, 4.5])
def test_window_shows_the_person(default_body: Body, distance_m: float) -> None:
    camera = camera_at(distance_m)
    depth, labels = picture(default_body, camera)
    window = make_window(depth, labels > 0, camera)
    assert window is not None
    assert window.inputs.dtype == np.float32
    relative, mask, scale = window.inputs
    # As wide and high as the person, in steps.
    assert all(side % WINDOW_STEP == 0 for side in mask.shape)
    assert max(mask.shape) == WINDOW
    assert 10 <= mask.shape[1] - mask.any(0).sum() <= WINDOW_STEP + 14
    # All of the person, but for pixels that stand alone in depth: a finger far away is one pixel wide.
    person = window.labels_from_image(labels) > 0
    assert not (mask > person).any()
    assert (mask < person).sum() <= 0.015 * person.sum()
    # The person's longer side fills PERSON pixels of the window, and lies in its middle.
    rows, columns = np.nonzero(mask)
    sides = (np.ptp(rows) + 1, np.ptp(columns) + 1)
    assert PERSON - 2 <= max(sides) <= PERSON + 2
    for places, side in zip((rows, columns), mask.shape, strict=True):
        assert (places.min() + places.max()) / 2 == pytest.approx((side - 1) / 2, abs=1.5)
    # The depth's origin is the person's median, which an odd pixel moves by less than a millimetre.
    centre_m = np.median(depth[labels > 0])
    assert not relative[mask == 0].any()
    assert np.median(relative[mask > 0]) == pytest.approx(0, abs=0.05)
    # A window pixel shows the picture's pixel under its middle.
    v = np.floor(window.top + (rows + 0.5) * window.step).astype(int)
    u = np.floor(window.left + (columns + 0.5) * window.step).astype(int)
    np.testing.assert_allclose(
        relative[rows, columns], np.clip((depth[v, u] - centre_m) / DEPTH_SCALE_M, -2, 2), atol=2e-3
    )
    np.testing.assert_allclose(scale, np.log2(centre_m * window.step / camera.fx / PIXEL_M), atol=1e-3)


def test_far_things_in_the_mask_are_clipped() -> None:
    depth = np.full((100, 100), 2.0, dtype=np.float32)
    depth[:10], depth[-10:] = 0.5, 8.0
    window = make_window(depth, np.ones(depth.shape, dtype=bool), camera_at(2.0))
    assert window is not None
    assert window.inputs[0].min() == -2
    assert window.inputs[0].max() == 2


def test_nobody() -> None:
    camera = camera_at(2.0)
    depth = np.full((60, 80), 2.0, dtype=np.float32)
    mask = np.zeros(depth.shape, dtype=bool)
    assert make_window(depth, mask, camera) is None
    mask[20 : 20 + MIN_PIXELS // 2 - 1, 30:32] = True
    assert make_window(depth, mask, camera) is None
    mask[20 : 20 + MIN_PIXELS // 2, 30:32] = True
    assert make_window(depth, mask, camera) is not None
    assert make_window(np.zeros_like(depth), np.ones_like(mask), camera) is None


def test_pixels_without_depth_are_not_of_the_person(default_body: Body) -> None:
    camera = camera_at(2.5)
    depth, labels = picture(default_body, camera)
    holes = np.random.default_rng(0).random(depth.shape) < 0.2
    spoilt = np.where(holes, 0, depth).astype(np.float32)
    window, masked = make_window(spoilt, labels > 0, camera), make_window(depth, (labels > 0) & ~holes, camera)
    assert window is not None
    assert masked is not None
    np.testing.assert_array_equal(window.inputs, masked.inputs)
    # Yet the person's pixels without depth get a label.
    ones = np.ones((WINDOW, WINDOW), np.uint8)
    back, _ = window.labels_to_image(ones, full_confidence(ones), labels > 0)
    np.testing.assert_array_equal(back > 0, labels > 0)


def test_where_the_person_stands_does_not_matter(default_body: Body) -> None:
    camera = camera_at(2.2)
    depth, labels = picture(default_body, camera)
    window = make_window(depth, labels > 0, camera)
    moved_depth, moved_labels = (np.roll(image, (17, -23), (0, 1)) for image in (depth, labels))
    moved = make_window(moved_depth, moved_labels > 0, camera)
    assert window is not None
    assert moved is not None
    np.testing.assert_array_equal(moved.inputs, window.inputs)
    assert (moved.top - window.top, moved.left - window.left) == (17, -23)


@pytest.mark.parametrize("change", ["half the pixels", "twice as far"])
def test_scale_does_not_matter(default_body: Body, change: str) -> None:
    near = camera_at(2.4)
    # Half the pixels see the same; from twice as far, a lens of twice the focal length sees nearly the same.
    other = (
        dataclasses.replace(near, width=256, height=212, fx=184.0, fy=184.0, cx=127.5, cy=105.5)
        if change == "half the pixels"
        else camera_at(4.8, 2 * 368.0)
    )
    windows = []
    for camera in (near, other):
        depth, labels = picture(default_body, camera)
        window = make_window(depth, labels > 0, camera)
        assert window is not None
        windows.append((window.inputs, window.labels_from_image(labels)))
    (first, first_labels), (second, second_labels) = windows
    union, both = (first[1] + second[1]) > 0, (first[1] * second[1]) > 0
    assert np.count_nonzero(both) > 0.85 * np.count_nonzero(union)
    assert np.median(np.abs(first[0] - second[0])[both]) < 0.05
    assert (first_labels == second_labels)[both].mean() > 0.8
    assert abs(float(first[2, 0, 0] - second[2, 0, 0])) < 0.1


def test_person_cut_by_the_border(default_body: Body) -> None:
    camera = dataclasses.replace(camera_at(1.0), cx=100.0)
    depth, labels = picture(default_body, camera)
    person = labels > 0
    assert person[:, 0].any() or person[0].any()
    window = make_window(depth, person, camera)
    assert window is not None
    # Beyond the picture the labels are the fill, and the mask is empty.
    in_window = window.labels_from_image(labels, 255)
    assert (in_window == 255).any()
    assert not window.inputs[1][in_window == 255].any()
    known = np.where(in_window == 255, 0, in_window)
    back, _ = window.labels_to_image(known, full_confidence(known), person)
    assert (back == labels)[person].mean() > 0.9


def test_stray_pixels_do_not_change_the_window(default_body: Body) -> None:
    """Flying pixels near the camera or far behind the body would move the depth and the box of the whole person."""
    camera = camera_at(2.5)
    depth, labels = picture(default_body, camera)
    clean = make_window(depth, labels > 0, camera)
    rng = np.random.default_rng(0)
    spoilt, mask = depth.copy(), labels > 0
    v, u = rng.integers(0, depth.shape[0], 60), rng.integers(0, depth.shape[1], 60)
    outside = ~mask[v, u]
    spoilt[v[outside], u[outside]] = rng.uniform(0.4, 5.0, outside.sum())
    mask[v[outside], u[outside]] = True
    window = make_window(spoilt, mask, camera)
    assert clean is not None
    assert window is not None
    assert (window.left, window.top, window.step) == (clean.left, clean.top, clean.step)
    np.testing.assert_allclose(window.inputs, clean.inputs, atol=1e-3)
    # And no more than a few of the body's own pixels are taken for stray.
    assert window.inputs[1].sum() > 0.98 * (window.labels_from_image(labels) > 0).sum()


@pytest.mark.parametrize("turn_rad", [0.6, -2.2, np.pi])
def test_a_turned_window_is_that_of_a_camera_turned_about_its_axis(default_body: Body, turn_rad: float) -> None:
    upright = dataclasses.replace(camera_at(2.2), width=600, height=600, cx=299.5, cy=299.5)
    pose = upright.world_from_camera.copy()
    pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec([0, 0, turn_rad]).as_matrix()
    askew = dataclasses.replace(upright, world_from_camera=pose)
    depth, labels = picture(default_body, upright)
    turned = make_window(depth, labels > 0, upright, turn_rad)
    depth_askew, labels_askew = picture(default_body, askew)
    seen = make_window(depth_askew, labels_askew > 0, askew)
    assert turned is not None and seen is not None
    assert turned.step == pytest.approx(seen.step, rel=0.02)
    assert turned.inputs.shape == seen.inputs.shape
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (50, 3))
    np.testing.assert_allclose(
        turned.positions_from_world(points, upright), seen.positions_from_world(points, askew), atol=0.02
    )
    masks = [window.inputs[1] > 0 for window in (turned, seen)]
    assert (masks[0] & masks[1]).sum() > 0.93 * (masks[0] | masks[1]).sum()
    here, there = turned.labels_from_image(labels), seen.labels_from_image(labels_askew)
    assert (here == there)[masks[0] & masks[1]].mean() > 0.9


@pytest.mark.parametrize("turn_rad", [0.6, -2.2])
def test_labels_come_back_from_a_turned_window(default_body: Body, turn_rad: float) -> None:
    camera = camera_at(4.0)  # so far that window pixels are smaller than the picture's
    depth, labels = picture(default_body, camera)
    window = make_window(depth, labels > 0, camera, turn_rad)
    assert window is not None
    in_window = window.labels_from_image(labels)
    back, confidence = window.labels_to_image(in_window, full_confidence(in_window), labels > 0)
    inside = (labels > 0) & (back > 0)
    assert inside.sum() > 0.98 * (labels > 0).sum()
    assert (back == labels)[inside].mean() > 0.98
    np.testing.assert_array_equal(confidence > 0, labels > 0)


@pytest.mark.parametrize("turn_rad", [0.0, 1.1])
@pytest.mark.parametrize("distortion", [(0.0,) * 5, (0.1, -0.05, 0.001, -0.002, 0.01)])
def test_places_there_and_back(
    default_body: Body, distortion: tuple[float, float, float, float, float], turn_rad: float
) -> None:
    camera = dataclasses.replace(camera_at(2.2), distortion=distortion)
    depth, labels = picture(default_body, camera)
    window = make_window(depth, labels > 0, camera, turn_rad)
    assert window is not None
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.6, 0.6, (50, 3))
    places = window.positions_from_world(points, camera)
    np.testing.assert_allclose(window.positions_to_world(places, camera), points, atol=1e-4)
    # A masked pixel is where its cell of the window says, at its depth.
    row, column = (int(np.median(each)) for each in np.nonzero(labels > 0))
    z = float(depth[row, column])
    ray = camera.rays[row, column]
    point = camera.world_from_camera[:3, :3] @ np.array([*ray * z, z]) + camera.world_from_camera[:3, 3]
    right, down, behind = window.positions_from_world(point[None], camera)[0]
    height, width = window.inputs.shape[1:]
    i, j = int(np.floor(down / window.pixel_m + height / 2)), int(np.floor(right / window.pixel_m + width / 2))
    assert window.inputs[1, i, j] == 1
    assert window.inputs[0, i, j] * DEPTH_SCALE_M == pytest.approx(behind, abs=0.03)
    behind_camera = camera.world_from_camera[:3, 3] - camera.world_from_camera[:3, 2]
    assert np.isnan(window.positions_from_world(behind_camera[None], camera)[0, :2]).all()
