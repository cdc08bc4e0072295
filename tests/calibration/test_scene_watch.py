"""A camera that is moved while it runs is told by its room; people, furniture and noise are not taken for it."""

import numpy as np
import pytest

from depthmocap.calibration.rig_watch import RigWatch
from depthmocap.calibration.scene_watch import SceneWatch
from depthmocap.frames import FrameSet, View
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.pose.cloud import LabelledCloud

HALF_M = np.array([3.0, 2.8, 1.3])
WALLS_M = HALF_M, np.array([0.0, 0.0, 1.3])
STEP_NS = 250_000_000


def room_m(camera: DepthCamera) -> np.ndarray:
    """Depth of a box-shaped room from within."""
    rays = np.concatenate([camera.rays, np.ones((*camera.rays.shape[:2], 1))], -1) @ camera.world_from_camera[:3, :3].T
    eye = camera.world_from_camera[:3, 3] - WALLS_M[1]
    with np.errstate(divide="ignore"):
        return ((np.sign(rays) * HALF_M - eye) / rays).min(-1).astype(np.float32)


def camera(shift_m=(0.0, 0.0, 0.0), turn_deg: float = 0.0) -> DepthCamera:
    turn = np.deg2rad(turn_deg)
    aim = np.array([np.sin(turn) * 2.5, 2.5 * (1 - np.cos(turn)), 0.9])
    pose = look_at(np.array([0.2, -2.5, 1.5]) + shift_m, aim + shift_m)
    return DepthCamera("a", 96, 72, 75.0, 75.0, 47.5, 35.5, pose)


def shares(views, noise_m: float = 0.006) -> list[float]:
    """What the watch tells of 20 s of the first camera, and 20 s of what comes next."""
    rng, watch, told = np.random.default_rng(0), SceneWatch(), []
    for i in range(160):
        now = views[0] if i < 80 else views[1]
        depth_m = now + rng.normal(0, noise_m, now.shape).astype(np.float32)
        depth_m[rng.random(now.shape) < 0.05] = 0
        column = (2 * i) % 80
        depth_m[15:70, column : column + 14] = 1.8  # somebody walks to and fro
        share = watch(View(camera(), depth_m), i * STEP_NS)
        told += [] if share is None else [i]
    return told


@pytest.mark.parametrize(
    "bump", [{"shift_m": (0, 0.03, 0)}, {"shift_m": (0, 0, 0.03)}, {"shift_m": (0.02, 0.02, 0.01)}, {"turn_deg": 2.0}]
)
def test_a_bump_is_told_within_ten_seconds_and_once(bump) -> None:
    (told,) = shares([room_m(camera()), room_m(camera(**bump))])
    assert 80 <= told <= 80 + 10 / (STEP_NS * 1e-9)


def test_a_table_that_is_moved_and_sensors_that_drift_are_no_bump() -> None:
    still = room_m(camera())
    table = still.copy()
    table[40:60, 20:60] -= 0.2
    assert shares([still, table]) == []
    assert shares([still, still + 0.004]) == []
    assert shares([still, np.where(np.arange(96) < 60, still, 1.2).astype(np.float32)]) == []  # somebody comes near
    before = np.where(np.arange(96) < 40, 1.2, still).astype(np.float32)
    after = np.where(np.arange(96) > 60, 1.2, still).astype(np.float32)
    assert shares([before, after]) == []  # somebody near goes aside


def test_a_knock_is_told() -> None:
    assert len(shares([room_m(camera()), room_m(camera(turn_deg=20.0))])) == 1


def test_the_watch_names_the_camera() -> None:
    nothing = np.empty(0, np.float32)
    cloud = LabelledCloud(np.empty((0, 3), np.float32), np.empty(0, np.uint8), nothing)
    watch, told = RigWatch("z"), []
    for i in range(120):
        views = tuple(View(each, room_m(each)) for each in (camera(turn_deg=3.0 if i > 60 else 0.0),))
        told += watch(FrameSet(i * STEP_NS, views), None if i % 24 else cloud)
    (line,) = told + watch.finish()
    assert line.startswith("camera 'a' was moved while it ran: ")
