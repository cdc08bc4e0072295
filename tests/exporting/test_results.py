"""Files of a take and its people: one clock, one summary, and no joint that was hardly seen."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from test_export import FRAME_NS, START_NS, moving_skeleton

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.exporting import read_bvh, read_csv, read_trc
from depthmocap.exporting import result_files as files_module
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.result_files import PeopleFiles, PoseFiles
from depthmocap.exporting.run_result import RunResult
from depthmocap.exporting.summary import SCHEMA, Summary, Take, read_summary, unsure_lines
from depthmocap.frames import Pose
from depthmocap.recordings.pose_table import read_table

FRAMES, COMES_AT = 30, 12
ARM = [JOINT_INDEX["LElbow"], JOINT_INDEX["LHand"]]


def poses(count: int, start: int = 0, seed: int = 0) -> list[Pose]:
    """Of somebody who is there from a frame on; the left arm, surely wrong, is hidden in five frames from the third."""
    joints = moving_skeleton(count, np.random.default_rng(seed), bend_rad=0.3)
    confidence = np.full((count, 18), 0.9)
    joints[3:8, ARM], confidence[3:8, ARM] = joints[3:8, ARM] + 0.4, 0.1
    timestamps_ns = START_NS + FRAME_NS * (start + np.arange(count))
    return [Pose(*row) for row in zip(timestamps_ns.tolist(), joints, confidence, strict=True)]


def write(folder: Path, least_confidence: float = 0.2) -> None:
    """A take in which a second person comes later."""
    take = Take("run", ["somewhere"], "z", FileSettings(least_confidence=least_confidence))
    first, second = poses(FRAMES), poses(FRAMES - COMES_AT, COMES_AT, seed=1)
    with PoseFiles(folder, take) as files, PeopleFiles(folder, take) as everybody:
        for i, pose in enumerate(first):
            take.begin(pose.timestamp_ns)
            files.write(pose)
            everybody.write({1: [pose]} | ({2: [second[i - COMES_AT]]} if i >= COMES_AT else {}))


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("take")
    write(folder)
    return folder


def test_all_files_of_a_take_have_one_clock(taken: Path) -> None:
    begin_s = COMES_AT * FRAME_NS * 1e-9
    for folder, frames, start_s in (
        (taken, FRAMES, 0.0), (taken / "person-1", FRAMES, 0.0), (taken / "person-2", FRAMES - COMES_AT, begin_s),
    ):  # fmt: skip
        summary, table = read_summary(folder), read_table(folder / "pose.csv")
        assert summary["first_timestamp_ns"] == START_NS
        assert summary["frames"] == len(table) == frames
        # Whoever takes the column, or the summary's timestamp, has the same time.
        assert (np.rint(table.times_s * 1e9).astype(np.int64) + START_NS).tolist() == table.stamps_ns.tolist()
        assert table.times_s[0] == pytest.approx(start_s, abs=1e-9)
        np.testing.assert_allclose(read_trc(folder / "pose.trc")[0], table.times_s, atol=1e-6)
        assert summary["bvh_start_s"] == pytest.approx(start_s, abs=1e-9)
        np.testing.assert_allclose(read_bvh(folder / "pose.bvh")[0] + start_s, table.times_s, atol=1e-6)
    assert [read_summary(taken / f"person-{i}")["person"] for i in (1, 2)] == [1, 2]


def test_however_many_people_come_and_return_few_files_are_open_and_no_pose_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files_module, "MOST_OPEN", 2)
    monkeypatch.setattr(files_module, "MOST_FOLDERS", 4)
    files, some_poses, before = Path("/dev/fd"), poses(12), 0
    with PeopleFiles(tmp_path, Take("run", ["somewhere"], "z", FileSettings())) as everybody:
        if files.is_dir():
            before = len(list(files.iterdir()))
        for i, pose in enumerate(some_poses):
            everybody.write({1 + i % 5: [pose]})
            assert not files.is_dir() or len(list(files.iterdir())) <= before + 2
    assert everybody.problems == ["more than 4 people were followed: those who came last have no folder"]
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"person-{i}" for i in (1, 2, 3, 4)]
    for i in range(4):
        timestamps_ns = [pose.timestamp_ns for pose in some_poses[i::5]]
        assert read_table(tmp_path / f"person-{1 + i}" / "pose.csv").stamps_ns.tolist() == timestamps_ns
        assert read_summary(tmp_path / f"person-{1 + i}")["frames"] == len(timestamps_ns)


def test_joints_hardly_seen_are_gaps_in_trc_and_held_in_bvh(taken: Path) -> None:
    truth = moving_skeleton(FRAMES, np.random.default_rng(0), bend_rad=0.3)
    _, in_csv, confidence = read_csv(taken / "pose.csv")
    _, in_trc = read_trc(taken / "pose.trc")
    _, in_bvh = read_bvh(taken / "pose.bvh")
    unsure = np.zeros((FRAMES, 18), bool)
    unsure[3:8, ARM] = True
    assert np.isfinite(in_csv).all() and (confidence[unsure] == 0.1).all()  # as it was found
    np.testing.assert_array_equal(np.isnan(in_trc).all(-1), unsure)
    np.testing.assert_array_equal(np.isnan(in_trc).any(-1), unsure)
    # The arm hangs as it did in the last frame that showed it, and nowhere near where nobody saw it.
    assert np.linalg.norm(in_bvh - truth, axis=-1)[unsure].max() < 0.35
    assert np.linalg.norm(in_bvh - in_csv, axis=-1)[unsure].min() > 0.35
    np.testing.assert_allclose(in_bvh[~unsure], truth[~unsure], atol=0.01)
    summary = read_summary(taken)
    assert summary["bvh_held"] == {"LElbow": [[3, 7]], "LHand": [[3, 7]]}
    assert summary["least_confidence"] == 0.2 and summary["unsure_joints"] == {"LElbow": 5, "LHand": 5}
    (line,) = unsure_lines(summary)
    assert "LElbow in 5 frames" in line and "--least-confidence" in line


def test_least_confidence_0_keeps_everything(tmp_path: Path) -> None:
    write(tmp_path, 0.0)
    assert np.isfinite(read_trc(tmp_path / "pose.trc")[1]).all()
    summary = read_summary(tmp_path)
    assert summary["bvh_held"] == summary["unsure_joints"] == {} and unsure_lines(summary) == []


def test_nothing_is_sure_enough(tmp_path: Path) -> None:
    with PoseFiles(tmp_path, Take("run", ["somewhere"], "z", FileSettings(least_confidence=0.95))) as files:
        for pose in poses(FRAMES):
            files.write(pose)
    assert {path.name for path in tmp_path.iterdir()} == {"pose.csv", "summary.json"}
    (problem,) = read_summary(tmp_path)["problems"]
    assert "no joint of 30 frames has a confidence of 0.95" in problem["text"]


def test_hidden_hips_go_with_the_body(tmp_path: Path) -> None:
    with PoseFiles(tmp_path, Take("run", ["somewhere"], "z", FileSettings())) as files:
        for pose in poses(FRAMES):
            pose.confidence[[JOINT_INDEX[name] for name in ("Hip", "RHip", "LHip")]] = 0.1
            files.write(pose)
    truth = moving_skeleton(FRAMES, np.random.default_rng(0), bend_rad=0.3)
    off_m = np.linalg.norm(read_bvh(tmp_path / "pose.bvh")[1] - truth, axis=-1)
    torso = [JOINT_INDEX[name] for name in ("Spine", "Spine1", "Spine2", "Neck", "Head", "RHand")]
    assert off_m[:, torso].max() < 0.02  # though the hips turn and go metres
    held = {joint for joint, ranges in read_summary(tmp_path)["bvh_held"].items() if ranges == [[0, FRAMES - 1]]}
    assert held == {"Hip", "RHip", "LHip", "RKnee", "LKnee", "Spine"}  # the bones to the hips and from them


def test_an_interruption_is_told_and_everything_is_written(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), PoseFiles(tmp_path, Take("live", ["a", "b"], "z", FileSettings())) as files:
        for pose in poses(5):
            files.write(pose)
        raise RuntimeError
    summary = read_summary(tmp_path)
    assert summary["interrupted"] and summary["frames"] == 5 and summary["sources"] == ["a", "b"]
    assert len(read_trc(tmp_path / "pose.trc")[0]) == 5


def test_the_summary_has_its_keys_and_no_other(taken: Path) -> None:
    document = json.loads((taken / "summary.json").read_text())
    assert list(document) == list(Summary.__annotations__) and document["schema"] == SCHEMA
    documented = (Path(__file__).parents[2] / "docs" / "guides" / "export.md").read_text(encoding="utf-8")
    assert [key for key in Summary.__annotations__ if f"`{key}`" not in documented] == []
    files = PoseFiles(taken / "other", Take("run", [], "z", FileSettings()))
    files.numbers["poses"] = 3
    with pytest.raises(ValueError, match="not of a summary: poses"), files:
        pass


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda document: {"frames": 3, "problems": []}, "it has no schema"),
        (lambda document: [document], "it has no schema"),
        (lambda document: document | {"schema": SCHEMA + 1}, f"this version reads {SCHEMA}"),
        (lambda document: {key: value for key, value in document.items() if key != "gaps"}, "lacks gaps"),
    ],
)
def test_what_is_no_summary(taken: Path, tmp_path: Path, change, message: str) -> None:
    document = json.loads((taken / "summary.json").read_text())
    (tmp_path / "summary.json").write_text(json.dumps(change(document)))
    with pytest.raises(InputError, match=message):
        read_summary(tmp_path / "summary.json")
    with pytest.raises(InputError, match="not found"):
        read_summary(tmp_path / "nowhere.json")


@pytest.mark.parametrize("least", [-0.1, 1.5, float("nan")])
def test_least_confidence_out_of_range(least: float) -> None:
    with pytest.raises(InputError, match="--least-confidence must be from 0 to 1"):
        Take("run", ["somewhere"], "z", FileSettings(least_confidence=least))


def test_what_a_run_gives(tmp_path: Path) -> None:
    write(tmp_path)
    result = RunResult(tmp_path, read_summary(tmp_path))
    assert (result.frames, result.gaps, result.problems) == (FRAMES, 0, [])
    assert [pose.timestamp_ns for pose in result.poses()] == [pose.timestamp_ns for pose in poses(FRAMES)]
    with pytest.raises(InputError, match="no poses were written"):
        RunResult(None, result.summary).poses()
