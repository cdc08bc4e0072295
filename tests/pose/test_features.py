import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera, look_at, z_up_from
from depthmocap.kernels.stats import median
from depthmocap.pose.cloud import LabelledCloud, merge_views
from depthmocap.pose.features import FEATURES_PER_REGION, MIN_POINTS, cloud_features
from depthmocap.pose.labelled_view import LabelledView
from depthmocap.synth.body.mesh import REST_POSTURE, Phenotype
from depthmocap.synth.render import render_body


def make_cloud(rng, n=3000, regions=43):
    labels = rng.integers(1, regions + 1, n).astype(np.uint8)
    points = labels[:, None] * 0.03 + rng.standard_normal((n, 3)) * [0.05, 0.1, 0.2] + [1, -2, 0.5]
    return LabelledCloud(points.astype(np.float32), labels, rng.uniform(0, 1, n).astype(np.float32))


def reference_region(points):
    covariance = np.cov(points.T, bias=True)
    return np.concatenate(
        [
            np.median(points, axis=0),
            covariance.ravel(),
            np.linalg.eigvalsh(covariance),
            points.std(axis=0),
            points.min(axis=0),
            points.max(axis=0),
        ]
    )


@pytest.mark.parametrize("up", ["z", "y", "-y"])
@pytest.mark.parametrize("frame", ["cloud", "world"])
def test_statistics_match_numpy(up, frame):
    cloud = make_cloud(np.random.default_rng(0))
    features = cloud_features(cloud, up, frame)
    points = cloud.points_world.astype(np.float64) @ z_up_from(up).T
    if frame == "cloud":
        centre = np.median(points, axis=0)
        points = points - centre
        np.testing.assert_allclose(features.origin_world, z_up_from(up).T @ centre, atol=1e-12)
    expected = np.concatenate([reference_region(points[cloud.labels == region]) for region in range(1, 44)])
    np.testing.assert_allclose(features.values, expected, atol=2e-6)
    np.testing.assert_array_equal(features.counts, np.bincount(cloud.labels, minlength=44)[1:])
    mean_weight = [cloud.weights[cloud.labels == region].mean() for region in range(1, 44)]
    np.testing.assert_allclose(features.mean_weights, mean_weight, rtol=1e-5)


def test_frame_round_trip_and_direction():
    rng = np.random.default_rng(1)
    features = cloud_features(make_cloud(rng), "y")
    points = rng.standard_normal((5, 3))
    np.testing.assert_allclose(features.to_world(features.from_world(points)), points, atol=1e-12)
    above = features.from_world(features.origin_world + np.array([0.0, 1.0, 0.0]))
    np.testing.assert_allclose(above, [0, 0, 1], atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(st.tuples(*[st.floats(-5, 5)] * 3), st.integers(0, 2**32 - 1))
def test_relative_features_do_not_change_with_translation(shift, seed):
    cloud = make_cloud(np.random.default_rng(seed), n=400, regions=20)
    moved = LabelledCloud(cloud.points_world + np.float32(shift), cloud.labels, cloud.weights)
    here, there = cloud_features(cloud), cloud_features(moved)
    np.testing.assert_allclose(there.values, here.values, atol=1e-5)
    np.testing.assert_allclose(there.origin_world, here.origin_world + shift, atol=1e-5)


def test_order_of_points_does_not_matter():
    rng = np.random.default_rng(2)
    cloud = make_cloud(rng)
    order = rng.permutation(len(cloud))
    mixed = LabelledCloud(cloud.points_world[order], cloud.labels[order], cloud.weights[order])
    np.testing.assert_allclose(cloud_features(mixed).values, cloud_features(cloud).values, rtol=1e-5, atol=1e-6)


def test_regions_with_few_points_are_nan():
    rng = np.random.default_rng(3)
    labels = np.repeat([3, 7], [MIN_POINTS, MIN_POINTS - 1]).astype(np.uint8)
    cloud = LabelledCloud(rng.standard_normal((len(labels), 3)).astype(np.float32), labels, np.ones_like(labels, "f4"))
    finite = ~np.isnan(cloud_features(cloud).values.reshape(43, FEATURES_PER_REGION))
    assert finite[2].all()
    assert finite.sum() == FEATURES_PER_REGION
    assert np.isfinite(cloud_features(cloud, min_points=1).values).sum() == 2 * FEATURES_PER_REGION


@pytest.mark.parametrize("up", ["z", "-y"])
def test_the_bodys_features_do_not_change_when_person_and_cameras_turn(body_model, up):
    posed = body_model.shape(Phenotype()).pose(REST_POSTURE)
    target = posed.vertices.mean(0)
    world, angle = z_up_from(up).T, 1.1
    turn = world @ Rotation.from_rotvec([0, 0, angle]).as_matrix()
    parts, turned = [], []
    for azimuth in (0.3, 2.0):
        eye = target + 2.5 * np.array([np.sin(azimuth), -np.cos(azimuth), 0.2])
        camera = DepthCamera("camera", 128, 128, 110.0, 110.0, 63.5, 63.5, look_at(eye, target))
        depth, labels = render_body(posed, camera)
        for rotation, views in ((world, parts), (turn, turned)):
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = rotation, [0.5, -0.2, 0.1]
            moved = dataclasses.replace(camera, world_from_camera=pose @ camera.world_from_camera)
            views.append(LabelledView(View(moved, depth), labels))
    here, there = (cloud_features(merge_views(views), up, "body") for views in (parts, turned))
    np.testing.assert_allclose(there.values, here.values, atol=2e-4)
    across = cloud_features(merge_views(turned), up, "cloud").values
    assert np.nanmax(np.abs(across - cloud_features(merge_views(parts), up, "cloud").values)) > 0.1
    # It faces forwards: what is left is at +y, and joints go there and back.
    joints = posed.joints @ world.T + [0.5, -0.2, 0.1]
    result = here.from_world(joints)
    assert result[JOINT_INDEX["LShoulder"], 1] > 0.05 > -0.05 > result[JOINT_INDEX["RShoulder"], 1]
    np.testing.assert_allclose(here.to_world(result), joints, atol=1e-9)


def test_the_bodys_frame_asks_for_cameras():
    with pytest.raises(InputError, match="camera"):
        cloud_features(make_cloud(np.random.default_rng(5)), frame="body")


def test_empty_cloud_is_nan():
    empty = LabelledCloud(np.empty((0, 3), "f4"), np.empty(0, "u1"), np.empty(0, "f4"))
    features = cloud_features(empty)
    assert np.isnan(features.values).all()
    assert np.isnan(features.origin_world).all()
    assert not features.counts.any()


def test_bad_clouds_are_refused():
    cloud = make_cloud(np.random.default_rng(4), 100)
    labels, points = cloud.labels.copy(), cloud.points_world.copy()
    labels[3], points[:2, 1] = 44, np.nan
    with pytest.raises(InputError, match="1 of 100"):
        cloud_features(LabelledCloud(cloud.points_world, labels, cloud.weights))
    with pytest.raises(InputError, match="2 of 100"):
        cloud_features(LabelledCloud(points, cloud.labels, cloud.weights))
    with pytest.raises(InputError, match="up"):
        cloud_features(cloud, "x")
    with pytest.raises(InputError, match="min_points"):
        cloud_features(cloud, min_points=0)


floats32 = st.floats(-1e3, 1e3, width=32)


@settings(max_examples=100, deadline=None)
@given(st.lists(floats32, min_size=1, max_size=8), st.integers(1, 200), st.sampled_from([1.0, 1e-3, 1e30]))
def test_median_is_exact_with_ties_and_outliers(values, repeats, factor):
    spread = np.random.default_rng(repeats).standard_normal(repeats) * 1e-2
    values = np.concatenate([np.repeat(np.float32(values), repeats), spread, [1e4 * factor]]).astype(np.float32)
    result = median(values, values.min(), values.max(), np.empty(512, np.int32), np.empty(len(values), np.float32))
    assert result == np.median(values.astype(np.float64))
