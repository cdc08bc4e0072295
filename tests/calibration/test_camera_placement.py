"""Several cameras placed by their skeletons: chains, clocks, cameras that see nobody, up and the floor."""

import numpy as np
import pytest
from walker import errors, stand, track

from depthmocap.calibration import camera_placement
from depthmocap.calibration.camera_placement import is_reliable, place_cameras, why_unreliable
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.pairs import CameraPair
from depthmocap.calibration.refine import RefinedPlacement
from depthmocap.calibration.upright import find_upright
from depthmocap.calibration.verdict import find_warnings, judge_pairs, late_cameras
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera, rigid_inverse

TIMES_S = np.arange(0, 24, 0.125)
AZIMUTHS = (0.0, 95.0, 190.0, 280.0)


def nobody() -> JointTrack:
    return JointTrack(np.empty(0), np.empty((0, 18, 3)), np.empty((0, 18)))


def relative_errors(placement, poses):
    """Of all placed cameras against the first: metres at the person, radians."""
    first = poses[placement.cameras[0]]
    pose_errors = [
        errors(first @ pose, poses[camera], (0.0, 0.0, 1.0))
        for camera, pose in zip(placement.cameras, placement.poses, strict=True)
    ]
    return np.max(pose_errors, axis=0)


@pytest.mark.slow
def test_cameras_are_placed_whatever_their_clocks_and_rates():
    rng = np.random.default_rng(0)
    poses = [stand(azimuth) for azimuth in AZIMUTHS]
    offset_s = np.array([0.0, 0.04, -0.03, -0.01])
    times = [TIMES_S + shift for shift in (0.0, 0.03, 0.05, 0.02)]
    times[3] = times[3][::2]
    tracks = [track(p, t, rng, offset_s=late) for p, t, late in zip(poses, times, offset_s, strict=True)]
    placement = place_cameras(tracks, rng)
    assert placement.cameras == (0, 1, 2, 3)
    error_m, error_rad = relative_errors(placement, poses)
    assert error_m < 0.006
    assert error_rad < np.deg2rad(0.3)
    np.testing.assert_allclose(placement.offset_s, offset_s - offset_s.mean(), atol=0.006)
    assert (placement.offset_sigma_s < 0.005).all()


@pytest.mark.parametrize("late_s", [-0.5, 1.0])
def test_a_camera_that_is_late_by_more_than_velocities_tell(late_s):
    rng = np.random.default_rng(5)
    poses = [stand(0), stand(95)]
    tracks = [track(pose, TIMES_S, rng, offset_s=late) for pose, late in zip(poses, (0.0, late_s), strict=True)]
    placement = place_cameras(tracks, rng)
    assert not placement.untold
    assert placement.offset_s[1] - placement.offset_s[0] == pytest.approx(late_s, abs=0.015)
    assert relative_errors(placement, poses)[0] < 0.02
    assert set(late_cameras(("a", "b"), placement)) == {"a", "b"}


def test_a_lateness_beyond_the_search_is_never_good():
    rng = np.random.default_rng(6)
    tracks = [track(stand(azimuth), TIMES_S, rng, offset_s=late) for azimuth, late in ((0, 0.0), (95, 3.0))]
    placement = place_cameras(tracks, rng)
    refined = RefinedPlacement(placement.poses, False, {}, {}, np.zeros((2, 2, 6)))
    pairs = judge_pairs(("a", "b"), placement, refined)
    assert [pair.grade for pair in pairs] == ["poor"]
    assert late_cameras(("a", "b"), placement) == {}
    warnings = find_warnings(("a", "b"), placement, pairs)
    assert warnings[-1].startswith("cannot tell the time offset of cameras 'a' and 'b': ")


def test_offsets_that_stray_are_not_believed(monkeypatch):
    # Where time and place cannot be told apart, the fine search may run away, past the ends of the takes.
    monkeypatch.setattr(camera_placement, "estimate_offsets", lambda *_: (np.array([-0.4, 0.4]), np.zeros(2)))
    rng = np.random.default_rng(7)
    placement = place_cameras([track(stand(azimuth), TIMES_S[:96], rng) for azimuth in (0, 95)], rng)
    assert placement.untold == ((0, 1),)
    assert np.isfinite(placement.skeletons.joints).any()


def test_a_chain_of_cameras_and_one_that_sees_nobody():
    rng = np.random.default_rng(1)
    poses = [stand(azimuth) for azimuth in AZIMUTHS]
    tracks = [track(pose, TIMES_S, rng) for pose in poses]
    # The first sees the first two thirds, the third the last two: they share little with each other.
    first = JointTrack(TIMES_S[:110], tracks[0].joints[:110], tracks[0].sigma_m[:110])
    third = JointTrack(TIMES_S[106:], tracks[2].joints[106:], tracks[2].sigma_m[106:])
    placement = place_cameras([first, tracks[1], third, nobody()], rng)
    assert placement.cameras == (0, 1, 2)
    assert relative_errors(placement, poses)[0] < 0.012
    assert set(placement.pairs) == {(0, 1), (0, 2), (1, 2)}


def test_two_groups_give_the_larger_one():
    rng = np.random.default_rng(2)
    tracks = [track(stand(azimuth), TIMES_S, rng) for azimuth in AZIMUTHS]
    alone = JointTrack(tracks[0].times_s + 100, tracks[0].joints, tracks[0].sigma_m)
    assert place_cameras([alone, *tracks[1:]], rng).cameras == (1, 2, 3)


@pytest.mark.parametrize("tilt", [0.0, 0.6])
def test_up_and_floor_by_the_feet_where_no_floor_is_seen(tilt):
    rng = np.random.default_rng(3)
    poses = [stand(azimuth, height) for azimuth, height in ((0.0, 1.0), (120.0, 1.9))]
    roll = np.eye(4)
    roll[:2, :2] = [[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]]
    poses = [pose @ roll for pose in poses]  # cameras may hang askew
    placement = place_cameras([track(pose, TIMES_S, rng) for pose in poses], rng)
    dark = [View(DepthCamera("dark", 32, 24, 30.0, 30.0, 16.0, 12.0), np.zeros((24, 32), np.float32)) for _ in poses]
    upright = find_upright(placement.poses, placement.skeletons, dark)
    assert upright.source == "feet"
    for pose, true in zip(upright.world_from_old @ placement.poses, poses, strict=True):
        assert np.arccos(pose[2, :3] @ true[2, :3]) < np.deg2rad(1.0)
        assert abs(pose[2, 3] - true[2, 3]) < 0.04
    first = upright.world_from_old @ placement.poses[0]
    assert abs(first[0, 2]) < 1e-9  # looks along +Y
    assert first[1, 2] > 0
    assert rigid_inverse(first)[2, 3] > 2  # and stands before the person's place, which is the origin


@pytest.mark.parametrize(
    ("agreed", "shared", "message"),
    [(5, 10, "only 5 poses agree, where 12 or more"), (34, 200, "only 34 of 200 poses agree, where 30% or more")],
)
def test_what_a_pair_lacks_is_what_failed(agreed, shared, message):
    pair = CameraPair(np.eye(4), shared, agreed, 0.03)
    assert not is_reliable(pair)
    assert why_unreliable(pair) == f"{message} are needed"
