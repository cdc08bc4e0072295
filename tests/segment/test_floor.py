import numpy as np
import pytest

from depthmocap.frames import View
from depthmocap.geometry import DepthCamera, look_at, z_up_from
from depthmocap.segment.floor import find_floor
from depthmocap.synth.scenes.room import Box, Room, render_room, table

ROOM = Room(Box((-3.0, -3.0, 0.0), (3.0, 3.0, 2.8)), table((-1.0, 0.5), (1.0, 1.6), 0.74))


def view(x: float, rng: np.random.Generator | None = None, wrong: np.ndarray | None = None) -> View:
    pose = look_at(np.array([x, -2.6, 1.7]), np.array([0.0, 0.0, 0.7]))
    camera = DepthCamera(f"cam{x}", 256, 212, 183.0, 183.0, 127.5, 105.5, pose)
    depth_m = render_room(ROOM, camera)
    if rng is not None:
        depth_m = (depth_m + rng.normal(0, 0.002 * depth_m**2)).astype(np.float32)
    if wrong is not None:
        camera = DepthCamera(f"cam{x}", 256, 212, 183.0, 183.0, 127.5, 105.5, wrong @ pose)
    return View(camera, depth_m)


@pytest.fixture
def rng():
    return np.random.default_rng(4)


def test_a_floor_is_found_below_tables_and_through_noise(rng):
    found = find_floor([view(-1.0, rng), view(1.0, rng)], "z")
    np.testing.assert_allclose(found, np.eye(4), atol=0.015)


@pytest.mark.parametrize("up", ["z", "y", "-y"])
def test_a_rig_whose_floor_is_elsewhere_and_tilted(up, rng):
    tilt = np.deg2rad(2.0)
    wrong = np.eye(4)
    wrong[1:3, 1:3] = [[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]]
    wrong[2, 3] = 0.4
    turn = np.eye(4)
    turn[:3, :3] = z_up_from(up).T
    found = find_floor([view(0.5, rng, turn @ wrong)], up)
    corners = np.array([[x, y, 0.0, 1.0] for x in (-1.5, 1.5) for y in (-1.5, 1.5)])
    heights = (found @ turn @ wrong @ corners.T)[2]
    np.testing.assert_allclose(heights, 0, atol=0.03)


def test_without_a_floor_in_view_the_rigs_is_taken():
    pose = look_at(np.array([0.0, -2.6, 1.7]), np.array([0.0, 2.9, 1.7]))
    camera = DepthCamera("wall", 64, 53, 183.0, 183.0, 31.5, 26.0, pose)
    seen = View(camera, render_room(ROOM, camera))
    np.testing.assert_array_equal(find_floor([seen], "z"), np.eye(4))
    np.testing.assert_array_equal(find_floor([], "z"), np.eye(4))
