import dataclasses

import numpy as np
import pytest

from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera, look_at, transform_points
from depthmocap.pose.cloud import merge_views
from depthmocap.pose.labelled_view import LabelledView

SHAPE = (30, 40)


def make_camera(name="a", distortion=(0.0,) * 5, angle=0.3):
    eye = np.array([2 * np.cos(angle), 2 * np.sin(angle), 1.4])
    pose = look_at(eye, np.array([0.0, 0.0, 1.0]), 0.1)
    return DepthCamera(name, SHAPE[1], SHAPE[0], 35.0, 36.0, 19.0, 15.5, pose, distortion)


def make_part(rng, camera):
    depth_m = rng.uniform(1, 4, SHAPE).astype(np.float32)
    depth_m[rng.uniform(size=SHAPE) < 0.2] = 0
    depth_m[0, :3] = np.nan, np.inf, -1
    labels = rng.integers(0, 46, SHAPE).astype(np.uint8)
    labels[labels >= 44] = 255
    labels[0, :3] = 5
    return View(camera, depth_m), labels, rng.uniform(0, 1, SHAPE).astype(np.float32)


def reference(view, labels, weights):
    keep = (labels >= 1) & (labels <= 43) & np.isfinite(view.depth_m) & (view.depth_m > 0)
    points_camera = view.camera.unproject(view.depth_m, keep)
    return transform_points(view.camera.world_from_camera, points_camera), labels[keep], weights[keep]


def test_merge_equals_unprojection_camera_by_camera():
    rng = np.random.default_rng(0)
    lens = (0.1, -0.05, 0.001, -0.002, 0.01)
    parts = [make_part(rng, make_camera("a")), make_part(rng, make_camera("b", lens, 2.0))]
    cloud = merge_views([LabelledView(*part) for part in parts])
    points, labels, weights = (np.concatenate(x) for x in zip(*(reference(*part) for part in parts), strict=True))
    np.testing.assert_allclose(cloud.points_world, points, atol=2e-6)
    np.testing.assert_array_equal(cloud.labels, labels)
    np.testing.assert_array_equal(cloud.weights, weights)


def test_a_person_in_a_part_of_the_picture():
    view, labels, weights = make_part(np.random.default_rng(4), make_camera())
    labels[:7] = labels[20:] = labels[:, :11] = labels[:, 30:] = 0
    cloud = merge_views([LabelledView(view, labels, weights)])
    points, expected, _ = reference(view, labels, weights)
    np.testing.assert_array_equal(cloud.labels, expected)
    np.testing.assert_allclose(cloud.points_world, points, atol=2e-6)


def test_true_labels_weigh_one_and_float64_depth_is_taken():
    view, labels, _ = make_part(np.random.default_rng(1), make_camera())
    view = dataclasses.replace(view, depth_m=view.depth_m.astype(np.float64))
    cloud = merge_views([LabelledView(view, labels)])
    assert len(cloud) > 0
    assert (cloud.weights == 1).all()


def test_no_views_and_empty_labels_give_an_empty_cloud():
    view, labels, weights = make_part(np.random.default_rng(2), make_camera())
    assert len(merge_views([])) == 0
    assert len(merge_views([LabelledView(view, np.zeros_like(labels), weights)])) == 0


def test_shapes_must_agree():
    view, labels, weights = make_part(np.random.default_rng(3), make_camera())
    with pytest.raises(InputError, match="'a'"):
        merge_views([LabelledView(view, labels[:-1])])
    with pytest.raises(InputError, match="weights"):
        merge_views([LabelledView(view, labels, weights[:, 1:])])
    bent = dataclasses.replace(make_camera(distortion=(0.1, 0.0, 0.0, 0.0, 0.0)), width=SHAPE[1] + 1)
    with pytest.raises(InputError, match="rows, columns"):
        merge_views([LabelledView(dataclasses.replace(view, camera=bent), labels)])
