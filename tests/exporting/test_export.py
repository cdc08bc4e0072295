"""Poses written to CSV, TRC and BVH and read back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS, PARENTS
from depthmocap.datasets.bvh_joints import read_bvh_joints
from depthmocap.errors import InputError
from depthmocap.exporting import CsvWriter, read_bvh, read_csv, read_trc, write_bvh, write_csv, write_trc
from depthmocap.exporting.bone_rotations import REST, euler_zxy_deg
from depthmocap.frames import Pose
from depthmocap.geometry import z_up_from
from depthmocap.recordings.pose_table import read_table

START_NS = 1_700_000_000_123_456_789
FRAME_NS = 33_333_333
#: Axes of the hinges of a right arm and of legs.
HINGES = {"Elbow": (0.0, 1.0, 0.0), "Knee": (1.0, 0.0, 0.0)}


def moving_skeleton(frames: int, rng: np.random.Generator, bend_rad: float = 0.8) -> np.ndarray:
    """Joints (t, 18, 3), Z up, of a skeleton with constant bones, whose joints turn smoothly and at random as people's
    do: knees and elbows are hinges."""
    time = np.linspace(0, 2 * np.pi, frames)
    offsets = {joint: np.array(direction) * length for joint, (direction, length) in REST.items()}
    # A real body: hip joints below the pelvis, shoulders above the chest, and not symmetric.
    offsets |= {"RHip": np.array([-0.1, -0.07, 0.01]), "LHip": np.array([0.11, -0.08, 0.0])}
    offsets |= {"RShoulder": np.array([-0.17, 0.12, -0.03]), "LShoulder": np.array([0.18, 0.13, -0.02])}
    world: dict[str, Rotation] = {}
    joints = np.zeros((frames, len(JOINTS), 3))
    for joint, parent in PARENTS.items():
        phase, size = rng.uniform(0, 2 * np.pi, (1, 3)), rng.uniform(-bend_rad, bend_rad, 3)
        turn = Rotation.from_rotvec(size * np.sin(time[:, None] + phase))
        if joint.startswith("Spine"):
            turn = Rotation.from_rotvec(0.45 * turn.as_rotvec())
        if joint[1:] in HINGES:
            axis = np.array(HINGES[joint[1:]]) * (-1 if joint == "LElbow" else 1)
            turn = Rotation.from_rotvec(bend_rad * (1.1 + np.sin(time[:, None] + phase[0, 0])) * axis)
        if parent is None:
            world[joint] = Rotation.from_euler("Y", time[:, None] * 1.5) * turn  # past half a turn
            joints[:, JOINT_INDEX[joint]] = np.stack([np.sin(time), 0.95 + 0.1 * np.cos(time), time / 3], -1)
        else:
            world[joint] = world[parent] * turn
            joints[:, JOINT_INDEX[joint]] = joints[:, JOINT_INDEX[parent]] + world[parent].apply(offsets[joint])
    return joints @ z_up_from("y").T


def as_poses(joints: np.ndarray, timestamps_ns: np.ndarray | None = None) -> list[Pose]:
    if timestamps_ns is None:
        timestamps_ns = START_NS + FRAME_NS * np.arange(len(joints))
    return [
        Pose(int(time), frame, np.where(np.isnan(frame).any(-1), 0.0, 0.75))
        for time, frame in zip(timestamps_ns, joints, strict=True)
    ]


@pytest.fixture
def joints() -> np.ndarray:
    return moving_skeleton(40, np.random.default_rng(0))


def test_csv_round_trip(tmp_path: Path, joints: np.ndarray) -> None:
    joints[3, 5] = np.nan
    joints[7] = np.nan
    write_csv(tmp_path / "pose.csv", as_poses(joints))
    header, first = (tmp_path / "pose.csv").read_text().splitlines()[:2]
    assert header.startswith("time_s,Head_x,Head_y,Head_z,Head_confidence,Neck_x,")
    assert first.startswith("0.000000000,") and first.endswith(f",{START_NS}")
    times_s, read, confidence = read_csv(tmp_path / "pose.csv")
    np.testing.assert_allclose(read, joints, atol=6e-7)
    np.testing.assert_allclose(times_s, np.arange(40) * FRAME_NS * 1e-9, atol=1e-9)
    assert confidence[3, 5] == 0 and confidence[3, 6] == 0.75


def test_csv_keeps_what_was_written_before_an_interruption(tmp_path: Path, joints: np.ndarray) -> None:
    path = tmp_path / "pose.csv"
    with pytest.raises(KeyboardInterrupt), CsvWriter(path) as writer:
        for pose in as_poses(joints[:2]):
            writer.write(pose)
            assert path.read_text().endswith("\n")
        raise KeyboardInterrupt
    assert len(read_csv(path)[0]) == 2
    with pytest.raises(ValueError, match="with CsvWriter"):
        writer.write(as_poses(joints[:1])[0])


def test_csv_counts_from_an_origin_and_tells_timestamps(tmp_path: Path, joints: np.ndarray) -> None:
    with CsvWriter(tmp_path / "pose.csv", START_NS - 5 * 10**8) as writer:
        for pose in as_poses(joints[:3]):
            writer.write(pose)
    table = read_table(tmp_path / "pose.csv")
    np.testing.assert_allclose(table.times_s, 0.5 + np.arange(3) * FRAME_NS * 1e-9, atol=1e-9)
    assert table.on_clock and table.stamps_ns.tolist() == [START_NS + i * FRAME_NS for i in range(3)]
    # Older files have time_s alone.
    older = [line.rpartition(",")[0] for line in (tmp_path / "pose.csv").read_text().splitlines()]
    (tmp_path / "older.csv").write_text("\n".join(older))
    table = read_table(tmp_path / "older.csv")
    assert not table.on_clock and table.stamps_ns.tolist() == [5 * 10**8 + i * FRAME_NS for i in range(3)]


def test_csv_without_confidence_in_any_column_order(tmp_path: Path) -> None:
    columns = [f"{joint}_{axis}" for joint in JOINTS for axis in "xyz"]
    values = [str(i) for i in range(54)]
    values[3:6] = ["", "", ""]
    path = tmp_path / "truth.csv"
    path.write_text("﻿" + ",".join(["note", *columns[::-1], "time_s"]) + "\r\n" + ",".join(["-", *values[::-1], "0.5"]))
    times_s, joints, confidence = read_csv(path)
    assert times_s.tolist() == [0.5]
    assert joints[0, 0].tolist() == [0, 1, 2]
    assert np.isnan(joints[0, 1]).all()
    assert confidence[0, :3].tolist() == [1, 0, 1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: "", "holds no rows"),
        (lambda text: text.splitlines()[0], "holds no rows"),
        (lambda text: text.replace("Head_x", "Kopf_x", 1), "lacks the columns Head_x"),
        (lambda text: text.replace("Head_confidence", "c", 1), "all or none"),
        (lambda text: text.replace("0.75", "much", 1), "row 2: could not convert"),
        (lambda text: text + "1,2,3\n", "row 4: 3 cells"),
        (lambda text: text.replace("\n0.0000", "\n9.0000", 1), "must not go back"),
        (lambda text: text.replace("\n0.000000000", "\nnan", 1), "row 2: time_s must be a number"),
        (lambda text: text.replace(str(START_NS), "1e400", 1), "row 2: timestamp_ns must be a number"),
        (lambda text: text.replace(str(START_NS), str(2**63 - 1), 1), "timestamp_ns must not go back"),
        (lambda text: text.replace("0.75", "inf", 1), "infinite"),
    ],
)
def test_csv_errors(tmp_path: Path, joints: np.ndarray, change, message: str) -> None:
    path = tmp_path / "pose.csv"
    write_csv(path, as_poses(joints[:2]))
    path.write_text(change(path.read_text().replace("0.7500", "0.75")))
    with pytest.raises(InputError, match=message):
        read_csv(path)


@pytest.mark.parametrize("read", [read_csv, read_trc, read_bvh])
def test_reading_what_is_not_there_or_something_else(tmp_path: Path, read) -> None:
    with pytest.raises(InputError, match="not found"):
        read(tmp_path / "none")
    (tmp_path / "other").write_text("HIERARCHY\nROOT Pelvis\n{\nMOTION\nFrames: 1\n")
    with pytest.raises(InputError, match="other"):
        read(tmp_path / "other")
    (tmp_path / "binary").write_bytes(bytes(range(128, 256)))
    with pytest.raises(InputError, match="binary"):
        read(tmp_path / "binary")


@pytest.mark.parametrize("write", [write_trc, write_bvh])
def test_nothing_to_write(tmp_path: Path, joints: np.ndarray, write) -> None:
    path = tmp_path / "file"
    with pytest.raises(InputError, match="no poses"):
        write(path, [], "z")
    with pytest.raises(InputError, match="no person was found in any frame"):
        write(path, as_poses(np.full((3, 18, 3), np.nan)), "z")
    with pytest.raises(InputError, match="pose 2 is not later than pose 1"):
        write(path, as_poses(joints[:3], np.array([0, 10, 10])), "z")
    (tmp_path / "no folder").touch()
    with pytest.raises(InputError, match="cannot write"):
        write(tmp_path / "no folder" / "file", as_poses(joints), "z")
    assert not path.exists()


def in_world(joints: np.ndarray, up: str) -> np.ndarray:
    """Z-up joints in a world with another up axis."""
    return joints @ z_up_from(up)


@pytest.mark.parametrize("up", ["z", "y", "-y"])
def test_trc_round_trip(tmp_path: Path, joints: np.ndarray, up: str) -> None:
    joints[3, 5] = np.nan
    joints[4, -1] = np.nan  # the last cells of a row
    joints[7] = np.nan
    write_trc(tmp_path / "walk.trc", as_poses(in_world(joints, up)), up)
    times_s, read = read_trc(tmp_path / "walk.trc")
    np.testing.assert_allclose(read, joints, atol=1e-6)
    np.testing.assert_allclose(times_s, np.arange(40) * FRAME_NS * 1e-9, atol=1e-6)


def test_trc_layout(tmp_path: Path, joints: np.ndarray) -> None:
    joints[1, -1] = np.nan
    write_trc(tmp_path / "walk.trc", as_poses(joints[:2]), "z")
    lines = (tmp_path / "walk.trc").read_text().split("\n")
    assert lines[0] == "PathFileType\t4\t(X/Y/Z)\twalk.trc"
    assert lines[2].split("\t") == ["30", "30", "2", "18", "mm", "30", "1", "2"]
    assert lines[3].startswith("Frame#\tTime\tHead\t\t\tNeck\t\t\tSpine2")
    assert lines[4].startswith("\t\tX1\tY1\tZ1\tX2")
    assert lines[5] == "" and lines[8] == ""
    assert [len(line.split("\t")) for line in lines[6:8]] == [2 + 54 + 1] * 2  # and the tab at the end
    assert lines[7].endswith("\t\t\t\t")
    height_mm = float(lines[6].split("\t")[3])
    assert height_mm == pytest.approx(joints[0, 0, 2] * 1000, abs=1e-3)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("up", ["z", "-y"])
def test_bvh_round_trip_of_constant_bones(tmp_path: Path, seed: int, up: str) -> None:
    joints = moving_skeleton(60, np.random.default_rng(seed))
    held = write_bvh(tmp_path / "a.bvh", as_poses(in_world(joints, up)), up)
    times_s, read = read_bvh(tmp_path / "a.bvh")
    assert not held.any()
    np.testing.assert_allclose(times_s, np.arange(60) * FRAME_NS * 1e-9, atol=1e-6)
    np.testing.assert_allclose(read, joints, atol=1e-4)


def test_bvh_angles_do_not_jump(tmp_path: Path) -> None:
    joints = moving_skeleton(300, np.random.default_rng(1), bend_rad=0.3)
    write_bvh(tmp_path / "a.bvh", as_poses(joints), "z")
    rows = np.array([line.split() for line in (tmp_path / "a.bvh").read_text().splitlines()[-300:]], dtype=float)
    assert np.abs(np.diff(rows[:, 3:], axis=0)).max() < 20


def test_bvh_rest_skeleton(tmp_path: Path) -> None:
    joints = moving_skeleton(60, np.random.default_rng(0))
    write_bvh(tmp_path / "a.bvh", as_poses(joints), "z")
    text = (tmp_path / "a.bvh").read_text()
    lines = text[: text.index("MOTION")].splitlines()
    offsets = {}
    for i, line in enumerate(lines):
        if line.split()[0] in ("ROOT", "JOINT"):
            offsets[line.split()[1]] = np.array(lines[i + 2].split()[1:], dtype=float)
    assert text.count("End Site") == 5 and text.startswith("HIERARCHY\nROOT Hip\n{")
    # The subject's left at +X, legs down, arms sideways, centimetres.
    np.testing.assert_allclose(offsets["LElbow"], [27, 0, 0], atol=0.01)
    np.testing.assert_allclose(offsets["RKnee"], [0, -42, 0], atol=0.01)
    np.testing.assert_allclose(
        np.linalg.norm(offsets["RShoulder"]), 100 * np.linalg.norm([0.17, 0.12, 0.03]), atol=0.01
    )
    assert offsets["LHip"][0] > 9 and offsets["RHip"][0] < -9 and offsets["LHip"][1] < 0
    assert offsets["LShoulder"][0] > 15 and offsets["LShoulder"][1] > 5


def test_bvh_joints_are_moved_little(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    joints = moving_skeleton(60, rng)
    noise_m = 0.01
    noisy = joints + rng.uniform(-noise_m, noise_m, joints.shape)
    write_bvh(tmp_path / "a.bvh", as_poses(noisy), "z")
    read = read_bvh(tmp_path / "a.bvh")[1]
    assert np.linalg.norm(read - noisy, axis=-1).mean() < noise_m
    # What constant lengths take away is error.
    assert np.linalg.norm(read - joints, axis=-1).mean() < np.linalg.norm(noisy - joints, axis=-1).mean()


def test_bvh_holds_gaps(tmp_path: Path) -> None:
    joints = moving_skeleton(30, np.random.default_rng(2))
    gappy = joints.copy()
    gappy[:3] = np.nan
    gappy[10:13] = np.nan
    gappy[20, JOINT_INDEX["RHand"]] = np.nan
    gappy[22, JOINT_INDEX["RHand"], 1] = np.nan  # one coordinate is enough
    held = write_bvh(tmp_path / "a.bvh", as_poses(gappy), "z")
    _, read = read_bvh(tmp_path / "a.bvh")
    hand = JOINT_INDEX["RHand"]
    assert np.flatnonzero(held.all(1)).tolist() == [0, 1, 2, 10, 11, 12]
    assert np.argwhere(held[~held.all(1)]).tolist() == [[20 - 6, hand], [22 - 6, hand]]
    # Nothing was seen before: the rest pose, where the person is first.
    np.testing.assert_allclose(read[:3, JOINT_INDEX["Hip"]], joints[[3, 3, 3], JOINT_INDEX["Hip"]], atol=1e-3)
    forearms = read[:3, hand] - read[:3, JOINT_INDEX["RElbow"]]
    np.testing.assert_allclose(forearms, [[-REST["RHand"][1], 0, 0]] * 3, atol=1e-3)
    np.testing.assert_allclose(read[10:13], joints[[9, 9, 9]], atol=1e-3)
    others = [name for name in JOINTS if name != "RHand"]
    index = [JOINT_INDEX[name] for name in others]
    np.testing.assert_allclose(read[[20, 22]][:, index], joints[[20, 22]][:, index], atol=1e-3)
    forearm = read[20, JOINT_INDEX["RHand"]] - read[20, JOINT_INDEX["RElbow"]]
    assert np.linalg.norm(forearm) == pytest.approx(REST["RHand"][1], abs=1e-3)
    # The hidden hand keeps the bend of the elbow that it had before, and so stays near where it is.
    assert np.linalg.norm(read[20, JOINT_INDEX["RHand"]] - joints[20, JOINT_INDEX["RHand"]]) < 0.15
    np.testing.assert_allclose(read[23:], joints[23:], atol=1e-3)


def test_bvh_of_one_pose_and_of_a_joint_never_seen(tmp_path: Path) -> None:
    joints = moving_skeleton(5, np.random.default_rng(3))
    joints[:, [JOINT_INDEX["LHand"], JOINT_INDEX["Spine"]]] = np.nan
    joints[:, JOINT_INDEX["RFoot"]] = joints[:, JOINT_INDEX["RKnee"]]  # a bone without length has no direction
    (held,) = write_bvh(tmp_path / "a.bvh", as_poses(joints[:1]), "z")
    # With the spine's first joint nobody knows where the second is, seen from the hips.
    assert {JOINTS[i] for i in np.flatnonzero(held)} == {"LHand", "Spine", "Spine1", "RFoot"}
    _, read = read_bvh(tmp_path / "a.bvh")
    forearms = (
        read[0, [JOINT_INDEX["LHand"], JOINT_INDEX["RHand"]]] - read[0, [JOINT_INDEX["LElbow"], JOINT_INDEX["RElbow"]]]
    )
    np.testing.assert_allclose(np.linalg.norm(forearms, axis=-1), REST["RHand"][1], atol=1e-4)
    assert np.isfinite(read).all()
    np.testing.assert_allclose(read[0, JOINT_INDEX["RHip"]], joints[0, JOINT_INDEX["RHip"]], atol=0.02)


def test_bvh_of_irregular_timestamps(tmp_path: Path) -> None:
    joints = moving_skeleton(12, np.random.default_rng(0))
    steps = np.array([0, 1, 2, 3, 6, 7, 8, 9, 10, 11, 12, 13])  # two frames lost
    jitter_ns = np.random.default_rng(0).integers(-6_000_000, 6_000_000, 12)
    jitter_ns[[0, -1]] = 0
    held = write_bvh(tmp_path / "a.bvh", as_poses(joints, START_NS + steps * FRAME_NS + jitter_ns), "z")
    times_s, read = read_bvh(tmp_path / "a.bvh")
    assert np.flatnonzero(held.any(1)).tolist() == np.flatnonzero(held.all(1)).tolist() == [4, 5]
    np.testing.assert_allclose(times_s[-1], 13 * FRAME_NS * 1e-9, atol=1e-6)
    np.testing.assert_allclose(read, joints[[0, 1, 2, 3, 3, 3, 4, 5, 6, 7, 8, 9, 10, 11]], atol=1e-3)
    with pytest.raises(InputError, match=r"pauses for 36\d\d s after frame 2"):
        write_bvh(tmp_path / "b.bvh", as_poses(joints[:4], np.array([0, 1, 2, 3602]) * 10**9 // 30 * 30), "z")


def test_bvh_of_rounded_timestamps_takes_each_pose_once(tmp_path: Path) -> None:
    joints = np.repeat(moving_skeleton(10, np.random.default_rng(0)), 60, axis=0)
    milliseconds = np.rint(np.arange(600) * 1000 / 30).astype(np.int64)
    assert not write_bvh(tmp_path / "a.bvh", as_poses(joints, milliseconds * 10**6), "z").any()
    times_s, _ = read_bvh(tmp_path / "a.bvh")
    assert len(times_s) == 600
    assert times_s[1] == pytest.approx(1 / 30, rel=1e-4)


def test_euler_angles_at_gimbal_lock() -> None:
    angles = np.array([[[30.0, 90, 20]], [[30, -90, 20]], [[170, 45, -170]]])
    rotations = Rotation.from_euler("ZXY", angles.reshape(-1, 3), degrees=True).as_matrix().reshape(3, 1, 3, 3)
    again = Rotation.from_euler("ZXY", euler_zxy_deg(rotations).reshape(-1, 3), degrees=True).as_matrix()
    np.testing.assert_allclose(again[:, None], rotations, atol=1e-7)


@pytest.mark.parametrize(
    ("name", "read"), [("pose.trc", read_trc), ("pose.bvh", read_bvh), ("pose.bvh", read_bvh_joints)]
)
def test_a_number_that_no_length_can_be_is_refused(tmp_path: Path, joints: np.ndarray, name: str, read: Any) -> None:
    path = tmp_path / name
    (write_trc if name == "pose.trc" else write_bvh)(path, as_poses(joints), "z")
    lines = path.read_text().splitlines()
    words = lines[-1].split("\t" if name == "pose.trc" else " ")
    lines[-1] = lines[-1].replace(words[5], "1e300", 1)
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match="a number that no length"):
        read(path)
