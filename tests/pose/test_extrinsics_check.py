"""Cameras that do not see the person in one place are told of."""

import dataclasses
import importlib.resources
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS, MIRROR
from depthmocap.cli import main
from depthmocap.geometry import DepthCamera, Rig, load_rig, rigid_inverse, save_rig
from depthmocap.pose.cloud import LabelledCloud
from depthmocap.pose.extrinsics_check import FEWEST_SETS, SETS, ExtrinsicsCheck
from depthmocap.recordings.recording import Recording
from depthmocap.recordings.recording_writer import RecordingWriter

NAMES = ("a", "b", "c", "d")


def cloud(joints: Mapping[str, np.ndarray | None]) -> LabelledCloud:
    cameras = tuple(DepthCamera(name, 32, 24, 30.0, 30.0, 16.0, 12.0) for name in joints)
    nothing = np.empty(0, np.float32)
    return LabelledCloud(
        np.empty((0, 3), np.float32),
        np.empty(0, np.uint8),
        nothing,
        (0,) * len(cameras),
        cameras,
        tuple(joints.values()),
    )


def guess(rng: np.random.Generator, offset_m: float = 0.0, noise_m: float = 0.03) -> np.ndarray:
    """The joints by one view: the same body, with an error of some centimetres."""
    body = np.random.default_rng(7).normal(0, 0.4, (len(JOINTS), 3))
    joints = body + rng.normal(0, noise_m, body.shape) + [offset_m, 0, 0]
    return np.concatenate([joints, np.full((len(JOINTS), 1), 0.04)], 1)


def problems_of(count: int, make, sets: int = SETS) -> list[str]:
    rng, extrinsics_check = np.random.default_rng(0), ExtrinsicsCheck()
    problems = []
    for i in range(sets):
        problems += extrinsics_check(cloud({name: make(rng, name, i) for name in NAMES[:count]}))
    return problems + extrinsics_check.finish()


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_cameras_that_agree_are_not_told_of(count: int) -> None:
    def mirrored(rng, name, i):  # one that takes left for right
        return guess(rng)[MIRROR if name == "b" else slice(None)]

    assert problems_of(count, lambda rng, name, i: guess(rng)) == []
    assert problems_of(count, mirrored) == []


@pytest.mark.parametrize(("count", "sets"), [(3, SETS), (4, SETS), (3, FEWEST_SETS)])
def test_a_camera_that_stands_elsewhere_is_named(count: int, sets: int) -> None:
    (problem,) = problems_of(count, lambda rng, name, i: guess(rng, 0.2 if name == "b" else 0), sets)
    assert "camera 'b'" in problem and "more than 10 cm" in problem and "depthmocap calibrate" in problem


def test_of_two_cameras_both_are_named() -> None:
    (problem,) = problems_of(2, lambda rng, name, i: guess(rng, 0.15 if name == "b" else 0))
    assert "cameras 'a' and 'b'" in problem


@pytest.mark.parametrize("sets", [2 * FEWEST_SETS - 2, SETS])
def test_a_pair_is_one_pair_whichever_frame_comes_first(sets: int) -> None:
    rng, extrinsics_check, problems = np.random.default_rng(0), ExtrinsicsCheck(), []
    for i in range(sets):
        joints = {name: guess(rng, 0.15 if name == "b" else 0) for name in ("ab" if i % 2 else "ba")}
        problems += extrinsics_check(cloud(joints))
    (problem,) = problems + extrinsics_check.finish()
    assert "cameras 'a' and 'b'" in problem


def test_a_camera_that_turns_away_is_named_however_long_it_saw() -> None:
    rng, extrinsics_check, in_view = np.random.default_rng(0), ExtrinsicsCheck(), 3 * SETS
    a, b = guess(rng), guess(rng)
    clouds = [cloud({"a": a, "b": b}), cloud({"a": a, "b": np.full((18, 4), np.nan)})]
    reports = [extrinsics_check(clouds[i >= in_view]) for i in range(in_view + 6 * SETS)]
    first = next(i for i, problems in enumerate(reports) if problems)
    assert in_view + 2 * SETS < first  # not while somebody merely stands where it does not look
    assert "camera 'b' sees next to nothing" in reports[first][0]


def test_a_camera_that_sees_nobody_is_named() -> None:
    (problem,) = problems_of(
        3, lambda rng, name, i: np.full((18, 4), np.nan) if name == "c" and i != 20 else guess(rng)
    )
    assert "camera 'c' sees next to nothing" in problem
    assert problems_of(3, lambda rng, name, i: np.full((18, 4), np.nan) if name == "c" and i % 10 else guess(rng)) == []


def test_the_same_of_several_cameras_is_told_in_one_line() -> None:
    def nobody(rng: np.random.Generator, name: str, i: int) -> np.ndarray:
        return guess(rng) if name in "ab" or i == 20 else np.full((18, 4), np.nan)

    (problem,) = problems_of(4, nobody)
    assert problem.startswith("cameras 'c' and 'd' see next to nothing")


def test_what_is_told_is_of_the_last_sets() -> None:
    """A camera that is bumped while it runs."""
    rng, extrinsics_check = np.random.default_rng(0), ExtrinsicsCheck()
    problems = [
        extrinsics_check(cloud({name: guess(rng, 0.3 if name == "a" and i >= SETS else 0) for name in NAMES[:3]}))
        for i in range(3 * SETS)
    ]
    assert [i for i, problems in enumerate(problems) if problems] == [2 * SETS - 1, 3 * SETS - 1]
    assert extrinsics_check.distances_m()["b"] < 0.05 < 0.25 < extrinsics_check.distances_m()["a"] < 0.35


def test_views_that_tell_little_or_nothing_are_left_out() -> None:
    def unsure(rng, name, i):
        joints = guess(rng, 0.5 if name == "b" else 0)
        if name == "b":
            joints[:, 3] = 0.3
            joints[[JOINT_INDEX["Head"], JOINT_INDEX["Neck"]], 3] = 0.01
        return joints

    assert [p for p in problems_of(3, unsure) if "more than" in p] == []
    assert problems_of(3, lambda rng, name, i: None) == []
    assert problems_of(3, lambda rng, name, i: guess(rng, 0.5 if name == "b" else 0), FEWEST_SETS - 1) == []


@pytest.fixture(scope="module")
def short(tmp_path_factory) -> Path:
    """A few sets of the packaged recording."""
    packaged = Recording(Path(str(importlib.resources.files("depthmocap") / "demo_recording")))
    path = tmp_path_factory.mktemp("short") / "rec"
    backgrounds = {name: packaged.raw_background(name) for name in packaged.rig.names}
    with RecordingWriter(path, packaged.rig, {k: v for k, v in backgrounds.items() if v is not None}) as writer:
        for name in packaged.rig.names:
            for stamp in packaged.stamps(name)[: FEWEST_SETS + 8]:
                writer.write(stamp, {name: packaged.raw(name, stamp)})
    return path


def moved(rig: Rig, number: int, pose) -> Rig:
    cameras = list(rig.cameras)
    cameras[number] = dataclasses.replace(cameras[number], world_from_camera=pose(cameras[number].world_from_camera))
    return Rig(tuple(cameras), rig.up)


def shifted(pose: np.ndarray) -> np.ndarray:
    pose = pose.copy()
    pose[0, 3] += 0.15
    return pose


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (None, None),
        (shifted, "stands elsewhere than the rig says, by 0° and 15 cm where the person is, against"),
        (rigid_inverse, "is camera_from_world, the inverse: right would be [["),
    ],
)
def test_run_tells_of_a_rig_that_is_wrong(short, tmp_path, capsys, pose, message) -> None:
    rig = load_rig(short / "rig.json")
    save_rig(rig if pose is None else moved(rig, 1, pose), tmp_path / "rig.json")
    arguments = ["run", str(short), "--rig", str(tmp_path / "rig.json"), "--out", str(tmp_path / "out"), "--no-report"]
    assert main(arguments) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    if message is None:
        assert summary["problems"] == []
        assert max(summary["cameras_apart_cm"].values()) < 4
    else:
        (problem,) = summary["problems"]
        assert message in problem["text"] and repr(rig.names[1]) in problem["text"]
        assert problem["text"][:40] in " ".join(capsys.readouterr().err.split())
