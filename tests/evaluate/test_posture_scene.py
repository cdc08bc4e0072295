"""Scenes of ``evaluate people --scenario postures`` that need more than a room."""

import itertools

import numpy as np
import pytest

from depthmocap.evaluate.people_protocol import visible_surface_m2
from depthmocap.evaluate.posture_scenarios import ONE_CAMERA, PostureScenario

pytest.importorskip("torch")


@pytest.mark.parametrize("act", ["wheelchair", "in bed", *ONE_CAMERA])
def test_scenes_with_furniture_and_with_one_camera(act):
    from depthmocap.evaluate.posture_scene import PostureScene

    scene = PostureScene(np.random.default_rng(1), PostureScenario(act), cameras=2, rate_hz=0.5)
    first, second = itertools.islice(scene.frames(), 2)
    assert len(first.frames.views) == (1 if act in ONE_CAMERA else 2)
    for frame in (first, second):
        assert visible_surface_m2(frame.frames, frame.masks[0]) > 0.15
        (joints,) = frame.joints
        if act in ONE_CAMERA:  # the camera is the origin of the world that it tells of
            assert (frame.frames.views[0].camera.world_from_camera == np.eye(4)).all()
            assert 0.5 < joints[0, 2] < 3
    if act != "carried":  # what is known of the empty scene
        empty_m = scene.backgrounds_m["cam0"]
        view, others = first.frames.views[0], ~first.masks[0][0]
        known = others & (empty_m > 0) & (view.depth_m > 0)
        assert np.median(np.abs(empty_m - view.depth_m)[known]) < 0.02
        assert np.median((empty_m - view.depth_m)[first.masks[0][0] & (empty_m > 0)]) > 0.1
    moved = np.abs(first.frames.views[0].depth_m - second.frames.views[0].depth_m)[~first.masks[0][0]]
    assert (np.median(moved) > 0.01) == (act == "carried")
