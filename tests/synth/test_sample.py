"""Algorithm 1: bodies, postures and cameras drawn together."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from depthmocap.body.model import BodyModel
from depthmocap.geometry import is_rigid, transform_points
from depthmocap.synth.postures import PosturePrior
from depthmocap.synth.sample import (
    KINECT2,
    CameraRange,
    Sample,
    Sensor,
    Subset,
    draw_sample,
    random_body,
    random_camera,
)
from depthmocap.synth.sensor import SensorNoise

SMALL = Sensor(256, 212, 184.4, 184.0, 126.6, 102.6)


def draw(seed: int, subset: Subset = "open", **options: object) -> Sample:
    return draw_sample(np.random.default_rng(seed), subset, PosturePrior.load(), sensor=SMALL, **options)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def samples(body_model: BodyModel) -> list[Sample]:
    return [draw(seed) for seed in range(12)]


def test_cameras_stand_within_the_range(body_model: BodyModel) -> None:
    rng = np.random.default_rng(0)
    posed = random_body(rng, "easy", body_model).pose(PosturePrior.load().sample(rng)[0])
    low, high = posed.vertices.min(0).astype(float), posed.vertices.max(0).astype(float)
    centre = (low + high) / 2
    places = CameraRange()
    cameras = [random_camera(rng, posed, places, KINECT2, "cam") for _ in range(300)]
    eyes = np.stack([camera.world_from_camera[:3, 3] for camera in cameras])
    distances = np.linalg.norm(eyes - centre, axis=1)
    heights = eyes[:, 2] - low[2]
    assert places.distance_m[0] <= distances.min() < 1.7
    assert 3.8 < distances.max() <= places.distance_m[1]
    assert places.height_m[0] <= heights.min() < 0.6
    assert 2.4 < heights.max() <= places.height_m[1]
    azimuths, _ = np.histogram(np.arctan2(*(eyes - centre)[:, :2].T), 8, (-np.pi, np.pi))
    assert azimuths.min() > 20
    # They look at the body's middle, within 4 deviations of the aim, and stand upright.
    for camera, distance in zip(cameras, distances, strict=True):
        assert is_rigid(camera.world_from_camera, 1e-9)
        x, y, z = transform_points(camera.camera_from_world, centre)
        assert np.hypot(x, y) < 0.5
        assert z > 0.8 * distance
        assert abs(camera.world_from_camera[2, 0]) < 1e-9
    assert (cameras[0].width, cameras[0].fx, cameras[0].cy) == (KINECT2.width, KINECT2.fx, KINECT2.cy)


def test_cameras_may_roll(body_model: BodyModel) -> None:
    rng = np.random.default_rng(1)
    posed = random_body(rng, "easy", body_model).pose(PosturePrior.load().sample(rng)[0])
    rolls = [
        np.arcsin(random_camera(rng, posed, CameraRange(aim_m=0.0, roll_rad=0.1), KINECT2, "c").world_from_camera[2, 0])
        for _ in range(100)
    ]
    assert 0.05 < np.std(rolls) < 0.12


def test_views_of_a_sample(samples: list[Sample]) -> None:
    for sample in samples:
        assert [view.camera.name for view in sample.views] == ["Cam1", "Cam2", "Cam3"]
        assert sample.joints.shape == (18, 3)
        for view in sample.views:
            assert view.mask is not None
            assert view.labels is not None
            np.testing.assert_array_equal(view.labels > 0, view.depth_m > 0)
            np.testing.assert_array_equal(view.mask, view.depth_m > 0)
            assert view.labels.max() <= 43
            assert np.count_nonzero(view.mask) > 500


def test_joints_lie_in_the_picture_of_the_person(samples: list[Sample]) -> None:
    inside = total = 0
    for sample in samples:
        for view in sample.views:
            assert view.mask is not None
            u, v, z = view.camera.project(sample.joints).T
            rows, columns = np.nonzero(view.mask)
            seen = (u > 0) & (u < view.camera.width - 1) & (v > 0) & (v < view.camera.height - 1)
            boxed = (u > columns.min() - 1) & (u < columns.max() + 1) & (v > rows.min() - 1) & (v < rows.max() + 1)
            assert (boxed | ~seen).all()
            hit = view.depth_m[v[seen].round().astype(int), u[seen].round().astype(int)]
            # Where the body is seen, its surface is before the joint or, behind an edge, a limb's width off.
            assert (hit[hit > 0] < z[seen][hit > 0] + 0.1).all()
            inside += np.count_nonzero(hit)
            total += np.count_nonzero(seen)
    assert inside > 0.97 * total > 300


def test_views_agree_on_where_the_person_is(samples: list[Sample]) -> None:
    for sample in samples[:4]:
        clouds = [transform_points(v.camera.world_from_camera, v.camera.unproject(v.depth_m)) for v in sample.views]
        for cloud in clouds:
            reach = np.abs(cloud[:, None] - sample.joints[None].astype(np.float32)).max(2).min(1)
            assert np.quantile(reach, 0.95) < 0.25


def test_samples_depend_on_the_generator_alone(samples: list[Sample]) -> None:
    again = draw(3)
    np.testing.assert_array_equal(again.joints, samples[3].joints)
    assert again.group == samples[3].group
    for view, same in zip(again.views, samples[3].views, strict=True):
        np.testing.assert_array_equal(view.depth_m, same.depth_m)
        np.testing.assert_array_equal(view.camera.world_from_camera, same.camera.world_from_camera)
    assert np.abs(again.joints - samples[4].joints).max() > 0.05


def test_noise_keeps_masks_and_labels_exact(samples: list[Sample]) -> None:
    noisy = draw(3, noise=SensorNoise(), views=1)
    (view,), exact = noisy.views, samples[3].views[0]
    assert view.mask is not None
    assert exact.mask is not None
    np.testing.assert_array_equal(view.mask, view.depth_m > 0)
    np.testing.assert_array_equal(view.labels, exact.labels)
    assert not (view.mask & ~exact.mask).any()
    assert 0.75 < np.count_nonzero(view.mask) / np.count_nonzero(exact.mask) < 1
    difference = np.abs(view.depth_m - exact.depth_m)[view.mask]
    assert 0 < np.median(difference) < 0.01


def test_subsets(body_model: BodyModel) -> None:
    def bodies(subset: Subset) -> set[bytes]:
        return {random_body(np.random.default_rng(i), subset, body_model).rest_vertices.tobytes() for i in range(24)}

    counts = {subset: len(bodies(subset)) for subset in get_args(Subset)}
    assert counts["easy"] == counts["inter"] == 1
    assert 8 <= counts["hard"] <= 16
    assert counts["open"] == 24
    assert bodies("easy") == bodies("inter")
