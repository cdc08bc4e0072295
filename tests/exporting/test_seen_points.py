"""Points of the skin: how they turn head, hands and feet, and how they come through files, filters and corrections."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_kinematic_skeleton import ADULT, FRAME_S, posed

from depthmocap.body.landmarks import POINT_BONES, POINT_JOINTS, POINT_MIRROR, POINTS
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.exporting.body_motion import solve_body
from depthmocap.exporting.edits import Edit, Edits, apply_edits
from depthmocap.exporting.pose_csv import write_csv
from depthmocap.exporting.seen_points import point_places
from depthmocap.exporting.timeline import timeline
from depthmocap.frames import Pose
from depthmocap.recordings.point_table import POINTS_FILE, read_poses
from depthmocap.smooth.filters import load_filter
from depthmocap.streaming.running_skeleton import RunningSkeleton

TURNS = {
    "Head": Rotation.from_euler("yx", [40, 10], degrees=True),
    "RHand": Rotation.from_euler("yz", [25, 30], degrees=True),
    "LFoot": Rotation.from_euler("yx", [20, -20], degrees=True),
}


def turned_pose(ns: int = 0) -> tuple[Pose, np.ndarray]:
    """An adult in a Y-up world whose points of the skin are known, and the rotations of all bones."""
    joints, world = posed(**TURNS)
    points = joints[0, POINT_JOINTS] + (world[0, POINT_BONES] @ point_places(ADULT)[..., None])[..., 0]
    return Pose(ns, joints[0], np.ones(18), points, np.ones(len(POINTS))), world[0]


def without_points(pose: Pose) -> Pose:
    return dataclasses.replace(pose, points=None, points_confidence=None)


def off_deg(found: np.ndarray, truth: np.ndarray, bone: str) -> float:
    turn = found[JOINT_INDEX[bone]].T @ truth[JOINT_INDEX[bone]]
    return float(np.rad2deg(Rotation.from_matrix(turn).magnitude()))


def solved(poses: list[Pose]) -> np.ndarray:
    return solve_body(timeline(poses, "y"), offsets=ADULT).world_rotations()[-1]


@pytest.mark.parametrize("bone", TURNS)
def test_points_turn_bones_that_joints_leave_open(bone: str) -> None:
    pose, truth = turned_pose()
    before = off_deg(solved([without_points(pose)]), truth, bone)
    assert before > 10
    assert off_deg(solved([pose]), truth, bone) < before / 2


def test_live_follows_points_without_their_noise() -> None:
    skeleton, rng = RunningSkeleton("y", ADULT), np.random.default_rng(0)
    off = []
    for i in range(60):
        pose, truth = turned_pose(round(i * FRAME_S * 1e9))
        assert pose.points is not None
        found = skeleton(dataclasses.replace(pose, points=pose.points + rng.normal(0, 0.01, pose.points.shape)))
        assert found is not None
        off.append(off_deg(found.world_rotations(), truth, "Head"))
    assert np.mean(off[20:]) < 12
    assert np.std(off[20:]) < 1.5


def test_unsure_points_tell_nothing() -> None:
    pose, _ = turned_pose()
    unsure = dataclasses.replace(pose, points_confidence=np.full(len(POINTS), 0.3))
    np.testing.assert_allclose(solved([unsure]), solved([without_points(pose)]), atol=1e-9)


def test_times_of_another_unit_are_smoothed_over_no_more_frames() -> None:
    poses = [turned_pose(ns)[0] for ns in (10, 20, 30)]  # a hundred million a second
    in_milliseconds = [dataclasses.replace(pose, timestamp_ns=pose.timestamp_ns * 10**5) for pose in poses]
    np.testing.assert_allclose(solved(poses), solved(in_milliseconds), atol=1e-9)


def test_points_are_written_beside_poses_and_read_back(tmp_path: Path) -> None:
    poses = [turned_pose(ns)[0] for ns in (10, 20, 30)]
    poses[1] = without_points(poses[1])
    write_csv(tmp_path / "pose.csv", poses)
    table = read_poses(tmp_path)
    assert table.points is not None
    for row, pose in enumerate(table.poses()):
        assert pose.points is not None
        if row == 1:
            assert np.isnan(pose.points).all()
            assert pose.points_confidence is not None
            assert not pose.points_confidence.any()
        else:
            written = poses[row].points
            assert written is not None
            np.testing.assert_allclose(pose.points, written, atol=1e-6)
    np.testing.assert_allclose(solved(table.poses()), solved(poses), atol=1e-4)
    write_csv(tmp_path / "pose.csv", [without_points(pose) for pose in poses])
    assert not (tmp_path / POINTS_FILE).exists()
    assert read_poses(tmp_path).points is None


@pytest.mark.parametrize(
    ("change", "message"),
    [(lambda text: "a,b\n", "does not have the columns"), (lambda text: text.replace("1.0000", "one"), "cannot be")],
)
def test_damaged_files_of_points(tmp_path: Path, change, message: str) -> None:
    write_csv(tmp_path / "pose.csv", [turned_pose(10)[0]])
    path = tmp_path / POINTS_FILE
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match=message):
        read_poses(tmp_path)


def test_corrections_take_points_along(tmp_path: Path) -> None:
    write_csv(tmp_path / "pose.csv", [turned_pose(ns)[0] for ns in (10, 20)])
    table = read_poses(tmp_path)
    assert table.points is not None
    edits = Edits("", (Edit("exchange", 1, first_ns=20), Edit("delete", 1, first_ns=10, last_ns=10)))
    after = apply_edits({1: table}, edits).tables[1]
    assert after.points is not None
    assert np.isnan(after.points[0]).all()
    np.testing.assert_array_equal(after.points[1], table.points[1, POINT_MIRROR])
    # Somebody whose estimator tells none, joined.
    other = dataclasses.replace(table, stamps_ns=table.stamps_ns + 100, points=None, points_confidence=None)
    joined = apply_edits({1: table, 2: other}, Edits("", (Edit("join", 1, 2),))).tables[1]
    assert joined.points is not None
    assert len(joined.points) == len(joined) == 4
    assert np.isnan(joined.points[2:]).all()


@pytest.mark.parametrize("name", ["kalman", "fixed-lag", "average", "one-euro"])
def test_filters_keep_points_beside_their_joints(name) -> None:
    filter_ = load_filter(name)
    poses = []
    for i in range(12):
        pose, _ = turned_pose(round(i * FRAME_S * 1e9))
        shift = np.array([0.05 * i, 0, 0])
        assert pose.points is not None
        poses.append(dataclasses.replace(pose, joints=pose.joints + shift, points=pose.points + shift))
    found = [filter_(pose) for pose in poses][filter_.delay_frames :] + filter_.finish()
    for before, after in zip(poses, found, strict=True):
        assert before.points is not None
        assert after.points is not None
        np.testing.assert_allclose(
            after.points - after.joints[POINT_JOINTS], before.points - before.joints[POINT_JOINTS], atol=1e-9
        )
        assert (after.points_confidence == 1).all()
