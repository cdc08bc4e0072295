"""A camera that was moved is placed anew by a person who walks, while the others stay."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from walker import REST, errors, stand, track, walk

from depthmocap.calibration.camera_replacement import Moment, place_anew
from depthmocap.calibration.rig_watch import KEPT_S, RigWatch
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet
from depthmocap.geometry import DepthCamera, transform_points
from depthmocap.pose.cloud import LabelledCloud

TRUE = {name: stand(azimuth, height) for name, azimuth, height in (("a", 10, 1.4), ("b", 130, 1.9), ("c", 245, 1.6))}
BUMP = np.eye(4)
BUMP[:3, :3] = Rotation.from_euler("yx", (4, 2), degrees=True).as_matrix()
BUMP[:3, 3] = (0.05, 0.0, 0.03)
TIMES_S = np.arange(0, 30, 0.1)


def cameras(names: str = "abc") -> dict[str, DepthCamera]:
    """As the rig says: b was moved since."""
    poses = {**TRUE, "b": TRUE["b"] @ BUMP}
    return {name: DepthCamera(name, 32, 24, 30.0, 30.0, 16.0, 12.0, poses[name]) for name in names}


def moments(names: str = "abc", movement=walk, seed: int = 0) -> list[Moment]:
    rng = np.random.default_rng(seed)
    tracks = {name: track(TRUE[name], TIMES_S, rng, movement=movement) for name in names}
    joints = {name: np.concatenate([each.joints, each.sigma_m[..., None]], -1) for name, each in tracks.items()}
    return [(now_s, {name: each[i] for name, each in joints.items()}) for i, now_s in enumerate(TIMES_S.tolist())]


@pytest.mark.parametrize("names", ["abc", "ab"])
def test_it_is_placed_where_it_stands_now(names: str) -> None:
    found = place_anew("b", cameras(names), moments(names), np.random.default_rng(0))
    metres, turned = errors(found.camera.world_from_camera, TRUE["b"], (0.0, 0.0, 0.9))
    assert metres < 0.01 and np.rad2deg(turned) < 0.3
    assert metres < found.uncertainty_m < 0.05 and np.rad2deg(turned) < found.uncertainty_deg < 2
    at = transform_points(cameras()["b"].world_from_camera @ np.linalg.inv(TRUE["b"]), np.array([0.0, 0.0, 0.9]))
    assert found.moved_m == pytest.approx(np.linalg.norm(at - [0, 0, 0.9]), abs=0.02)
    assert found.moved_deg == pytest.approx(4.5, abs=0.4)
    assert str(found).startswith("camera 'b' is placed anew: it had moved by ")


def standing(times_s: np.ndarray) -> np.ndarray:
    return np.tile(REST, (len(times_s), 1, 1))


def test_what_is_too_little_is_told() -> None:
    rng = np.random.default_rng(0)
    for name, seen, message in (
        ("d", moments(), "there is no camera 'd'"),
        ("b", [], "have not seen a person; one person must walk about"),
        ("b", moments("b"), "have not seen a person"),
        ("b", moments()[:8], "only 8 poses agree"),
        ("b", moments(movement=standing), "the person stays in one place"),
    ):
        with pytest.raises(InputError, match=message):
            place_anew(name, cameras(), seen, rng)
    mixed = [
        (now_s, {**seen, "b": other["b"]}) for (now_s, seen), (_, other) in zip(moments(), moments()[::-1], strict=True)
    ]
    with pytest.raises(InputError, match="cannot be placed anew"):  # the others see somebody else
        place_anew("b", cameras(), mixed, rng)


def test_the_watch_keeps_the_last_minute_in_the_cameras_own_frames() -> None:
    watch, told = RigWatch("z", explain=True), cameras()
    right = tuple(dataclasses.replace(camera, world_from_camera=TRUE[name]) for name, camera in told.items())
    rng, times_s = np.random.default_rng(0), np.arange(0, 68, 0.25)
    seen = [track(camera.world_from_camera, times_s, rng) for camera in right]
    nothing = np.empty(0, np.float32)
    cloud = LabelledCloud(np.empty((0, 3), np.float32), np.empty(0, np.uint8), nothing, (0, 0, 0), right)
    for i, now_s in enumerate(times_s):
        joints = tuple(
            np.concatenate([transform_points(camera.world_from_camera, each.joints[i]), each.sigma_m[i][:, None]], 1)
            for camera, each in zip(right, seen, strict=True)
        )
        assert watch(FrameSet(round(now_s * 1e9), ()), dataclasses.replace(cloud, joints=joints)) == []
    kept = watch.moments("b")
    assert kept[-1][0] - kept[0][0] == pytest.approx(KEPT_S, abs=0.3)
    found = place_anew("b", told, kept, np.random.default_rng(0))
    metres, turned = errors(found.camera.world_from_camera, TRUE["b"], (0.0, 0.0, 0.9))
    assert metres < 0.02 and np.rad2deg(turned) < 1
    assert watch.moved == () and watch.distances_m()
    watch.placed_anew("b")
    assert watch.distances_m() == {}
    assert watch.finish() == []
