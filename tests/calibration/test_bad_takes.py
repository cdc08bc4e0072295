"""Short takes that are bad, as tracks: what is said of them, and that none is called good with a wrong pose."""

from __future__ import annotations

import numpy as np
import pytest
from walker import REST, errors, stand, track, wander

from depthmocap.calibration.calibrate import Calibration, solve_rig
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.observations import Observation
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, rigid_inverse

TIMES_S = np.arange(0, 16, 0.1)
POSES = [stand(10, 1.4), stand(130, 1.9)]


def still(times_s: np.ndarray) -> np.ndarray:
    return np.tile(REST, (len(times_s), 1, 1))


def tracks(movement=wander) -> list[JointTrack]:
    rng = np.random.default_rng(0)
    return [track(pose, TIMES_S, rng, movement=movement) for pose in POSES]


def kept(seen: JointTrack, which: np.ndarray) -> JointTrack:
    return JointTrack(seen.times_s[which], seen.joints[which], seen.sigma_m[which])


def solve(seen: list[JointTrack]) -> Calibration:
    unknown = np.zeros((24, 32), np.float32)
    observations = [
        Observation(DepthCamera(f"cam{i}", 32, 24, 30.0, 30.0, 15.5, 11.5), each, {}, unknown, len(TIMES_S))
        for i, each in enumerate(seen)
    ]
    return solve_rig("the take", observations, [], np.random.default_rng(0))


def within(found: Calibration) -> bool:
    """Whether the pair is within its ±."""
    (pair,) = found.pairs
    a, b = (camera.world_from_camera for camera in found.rig.cameras)
    metres, turned = errors(rigid_inverse(POSES[0]) @ POSES[1], rigid_inverse(a) @ b, (0.0, 0.0, 2.6))
    return 1e3 * metres <= pair.uncertainty_mm and np.rad2deg(turned) <= pair.uncertainty_deg


def test_a_camera_that_stops_half_way_is_placed_by_what_it_saw() -> None:
    first, second = tracks()
    found = solve([first, kept(second, TIMES_S < 8)])
    assert within(found) and found.pairs[0].shared_poses <= 81


def test_somebody_who_stands_is_told() -> None:
    found = solve(tracks(still))
    assert found.grade == "poor"
    assert any("kept near to one place" in warning or "stayed" in warning for warning in found.warnings)


def test_two_people_are_no_good_calibration() -> None:
    first, second = tracks()
    other = track(POSES[1], TIMES_S, np.random.default_rng(1), movement=lambda times_s: wander(times_s, seed=5))
    theirs = (TIMES_S // 2).astype(int) % 3 == 0  # in a third of the time the second camera follows somebody else
    joints = np.where(theirs[:, None, None], other.joints, second.joints)
    found = solve([first, JointTrack(TIMES_S, joints, second.sigma_m)])
    assert within(found) and found.grade != "good"
    with pytest.raises(InputError, match="no two cameras see the same person often enough"):
        solve([first, other])  # all the time


def test_cameras_that_share_no_view_are_told() -> None:
    turns = (TIMES_S // 4).astype(int) % 2
    first, second = tracks()
    with pytest.raises(InputError, match="no two cameras see the same person often enough"):
        solve([kept(first, turns == 0), kept(second, turns == 1)])


def test_a_clock_that_jumps_is_no_good_calibration() -> None:
    first, second = tracks()
    jumped = JointTrack(TIMES_S + np.where(TIMES_S > 8, 0.8, 0), second.joints, second.sigma_m)
    found = solve([first, jumped])
    assert found.grade == "poor"
    assert any("jump" in warning or "cannot be told" in warning for warning in found.warnings)
