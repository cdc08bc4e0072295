"""The space people move in, and the empty scene."""

import numpy as np

from depthmocap.datasets.volume import Volume, scene_background
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.segment.static_scene import PersonSegmenter

CAMERA = DepthCamera(
    "a", 64, 48, 50.0, 50.0, 31.5, 23.5, look_at(np.array([0.0, -3.0, 1.0]), np.array([0.0, 0.0, 1.0]))
)


def test_a_space_stands_on_its_floor_in_every_world():
    places = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [np.nan] * 3])
    assert np.allclose(Volume.around(places, "y", 0.5).low, [-0.5, 0, -0.5])
    assert np.allclose(Volume.around(places, "y", 0.5).high, [1.5, 2.5, 3.5])
    down = Volume.around(places, "-y", 0.5)
    assert np.allclose(down.low, [-0.5, -0.5, -0.5]) and np.allclose(down.high, [1.5, 2.0, 3.5])
    points = np.array([[0.0, 1.99, 0.0], [0.0, 1.8, 0.0], [0.0, 2.1, 0.0]])
    assert down.above_floor(points, 0.1).tolist() == [False, True, False]


def test_rays_leave_the_space_at_its_far_side():
    depth = Volume(np.array([-5.0, -1.0, 0.0]), np.array([5.0, 1.0, 2.2]), "z").exit_depth_m(CAMERA)
    assert abs(depth[23, 31] - 4.0) < 1e-4  # the back, 4 m ahead
    assert abs(depth[47, 31] - 1.0 / (23.5 / 50)) < 1e-4  # the floor, 1 m below
    aside = Volume(np.array([10.0, -1.0, 0.0]), np.array([11.0, 1.0, 2.0]), "z").exit_depth_m(CAMERA)
    assert aside.max() < 0.01  # nothing of it is seen
    nowhere = Volume(np.array([-1e308, -1.0, 0.0]), np.array([1e308, 1.0, 2.2]), "z").exit_depth_m(CAMERA)
    assert np.isfinite(nowhere).all()


def test_somebody_who_never_moves_is_not_scenery():
    wall = np.full((48, 64), 6.0, np.float32)
    person = wall.copy()
    person[10:35, 20:40] = 3.0
    space = Volume(np.array([-2.0, -1.0, 0.0]), np.array([2.0, 1.0, 2.2]), "z")
    background = scene_background([person] * 5, CAMERA, space)
    mask = PersonSegmenter({"a": background})(View(CAMERA, person))
    assert mask[10:35, 20:40].mean() > 0.95
    assert not mask[:, :15].any()
