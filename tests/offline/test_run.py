"""The whole pipeline on a tiny generated recording, and what it does with bad input."""

import dataclasses
import json
import os
import shutil
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from depthmocap import InputError, RunSettings, load_pipeline, open_source, run
from depthmocap.body.skeleton import JOINTS
from depthmocap.classify.classifier import packaged_weights
from depthmocap.cli import main
from depthmocap.exporting import CsvWriter, read_bvh, read_csv, read_trc, write_trc
from depthmocap.exporting.result_files import PICTURE_FILES, RESULT_FILES
from depthmocap.exporting.summary import read_summary
from depthmocap.geometry import DepthCamera, Rig, load_rig, look_at, save_rig
from depthmocap.offline.run import _way_out
from depthmocap.recordings.recording_writer import RecordingWriter
from depthmocap.smooth.filters import Smoothing
from depthmocap.synth.body.mesh import REST_POSTURE
from depthmocap.synth.render import render_body

#: Cameras of different sizes and makes around a person at the origin.
SIZES = ((320, 288, 252.0), (256, 212, 184.0), (320, 240, 285.0))


def cameras() -> tuple[DepthCamera, ...]:
    made = []
    for i, (width, height, focal) in enumerate(SIZES):
        azimuth = 2 * np.pi * i / 3
        eye = np.array([2.6 * np.sin(azimuth), -2.6 * np.cos(azimuth), 1.2 + 0.3 * i])
        pose = look_at(eye, np.array([0.0, 0.0, 0.9]))
        made.append(DepthCamera(f"cam{i}", width, height, focal, focal, width / 2, height / 2, pose))
    return tuple(made)


@pytest.fixture(scope="session")
def recording(default_body, tmp_path_factory):
    """Six sets of three cameras at 10 Hz: a body in the rest pose that sways a little; no room around it."""
    path = tmp_path_factory.mktemp("recordings") / "sway"
    rig = Rig(cameras())
    with RecordingWriter(path, rig) as writer:
        for i in range(6):
            posture = REST_POSTURE.copy()
            posture[0, 2] = 0.05 * i
            posed = default_body.pose(posture)
            lift = np.array([0.0, 0.0, -float(posed.vertices[:, 2].min())])
            posed = dataclasses.replace(
                posed, vertices=posed.vertices + lift.astype(np.float32), joints=posed.joints + lift
            )
            frames = {c.name: np.round(render_body(posed, c)[0] * 1000).astype(np.uint16) for c in rig.cameras}
            writer.write(1_000_000_000 + i * 100_000_000, frames, posed.joints)
    return path


def copy(recording, tmp_path):
    return shutil.copytree(recording, tmp_path / "copy")


def test_run_writes_everything_and_finds_the_joints(recording, tmp_path):
    summary = run(RunSettings(recording, tmp_path / "out", segment="none", smooth="none")).summary
    for name in ("pose.csv", "pose.bvh", "pose.trc", "summary.json", "report.html", "preview.webp"):
        assert (tmp_path / "out" / name).stat().st_size > 0
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["frames"] == 6
    assert summary["gaps"] == 0
    assert summary["frames_by_camera"] == {"cam0": 6, "cam1": 6, "cam2": 6}
    assert summary["error"] is not None
    # A clean rest pose seen from three sides: well within what the method reaches elsewhere.
    assert summary["error"]["mean_joint_error_cm"] < 8
    assert summary["error"]["within_10cm"] > 0.8
    assert set(summary["ms_per_stage"]) == {"read", "segment", "label", "merge", "joints", "smooth"}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_nobody_can_be_told_and_no_path_is_text(recording, tmp_path, monkeypatch):
    odd = tmp_path / os.fsdecode(b"caf\xe9")
    odd.mkdir()
    source, weights = shutil.copytree(recording, odd / "take"), shutil.copy(packaged_weights(), odd / "net.onnx")
    with open("/dev/full", "w", encoding="utf-8") as full:  # noqa: PTH123 - of the type of the standard streams
        monkeypatch.setattr(sys, "stderr", full)
        options = ["--out", str(odd / "out"), "--segment", "none", "--weights", str(weights), "--no-report"]
        assert main(["run", str(source), *options]) == 0
    assert {each.name for each in (odd / "out").iterdir()} >= set(RESULT_FILES)
    summary = json.loads((odd / "out" / "summary.json").read_text(encoding="utf-8"))
    assert summary["sources"][0] == str(source) and summary["frames"] == 6


def test_files_agree_with_each_other(recording, tmp_path):
    run(RunSettings(recording, tmp_path, segment="none", report=False))
    times, joints, confidence = read_csv(tmp_path / "pose.csv")
    _, from_trc = read_trc(tmp_path / "pose.trc")
    _, from_bvh = read_bvh(tmp_path / "pose.bvh")
    np.testing.assert_allclose(times, np.arange(6) * 0.1, atol=1e-6)
    np.testing.assert_allclose(from_trc, joints, atol=1e-4)
    # The BVH's bones have one length each, so it can only be near.
    assert np.linalg.norm(from_bvh - joints, axis=-1).mean() < 0.05
    assert ((confidence > 0) & (confidence <= 1)).all()


def test_a_camera_may_lack_a_frame_or_all(recording, tmp_path):
    path = copy(recording, tmp_path)
    shutil.rmtree(path / "cam1")
    sorted((path / "cam2").glob("*.png"))[2].unlink()
    summary = run(RunSettings(path, tmp_path / "out", segment="none", report=False)).summary
    assert summary["frames"] == 6
    assert summary["gaps"] == 0
    assert summary["frames_by_camera"] == {"cam0": 6, "cam1": 0, "cam2": 5}


def test_frames_without_a_person_are_gaps(recording, tmp_path):
    path = copy(recording, tmp_path)
    for camera in ("cam0", "cam1", "cam2"):
        sorted((path / camera).glob("*.png"))[3].unlink()
    summary = run(RunSettings(path, tmp_path / "out", segment="none", report=False)).summary
    assert summary["gap_frames"] == [[3, 3]]
    assert summary["bvh_held"] == {joint: [[3, 3]] for joint in JOINTS}
    _, joints, confidence = read_csv(tmp_path / "out" / "pose.csv")
    assert np.isnan(joints[3]).all()
    assert (confidence[3] == 0).all()
    assert np.isfinite(joints[[0, 1, 2, 4, 5]]).all()


def test_nobody_in_any_frame_is_one_error(recording, tmp_path):
    # Without a background frame a person who never moves is background.
    with pytest.raises(InputError, match="no person"):
        run(RunSettings(recording, tmp_path / "out", segment="background", report=False))


def test_a_failed_run_leaves_no_results_of_an_earlier_one(recording, tmp_path):
    """Nor what an earlier one wrote of others, nor a report of other poses; what the user put there stays."""
    out = tmp_path / "out"
    run(RunSettings(recording, out, segment="none", report=False))
    for name in PICTURE_FILES:  # as a report leaves them
        (out / name).touch()
    for name in ("person-1", "person-3"):
        shutil.copytree(out, out / name, ignore=shutil.ignore_patterns("person-*"))
    kept = {out / "notes.txt", out / "person-3" / "notes.txt", out / "person-2" / "report.html", out / "person-x"}
    for path in kept:
        path.parent.mkdir(exist_ok=True)
        path.touch()
    with pytest.raises(InputError, match="no person"):
        run(RunSettings(recording, out, segment="background", report=False))
    left = {path for path in out.rglob("*") if path.is_file()}
    assert left == {out / "pose.csv", out / "summary.json", *(path for path in kept if path.is_file())}
    assert read_summary(out)["gaps"] == 6
    assert np.isnan(read_csv(tmp_path / "out" / "pose.csv")[1]).all()


def test_a_long_pause_costs_the_bvh_alone(recording, tmp_path, capsys):
    path = copy(recording, tmp_path)
    for camera in ("cam0", "cam1", "cam2"):
        last = sorted((path / camera).glob("*.png"))[-1]
        last.rename(last.with_name(f"{int(last.stem) + 3600 * 10**9}.png"))
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--segment", "none", "--no-report"]) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    (problem,) = [each["text"] for each in summary["problems"] if "bvh" in each["text"]]
    assert "3600 s after frame 4" in problem
    assert "pauses" in capsys.readouterr().err
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"pose.csv", "pose.trc"}
    assert not (tmp_path / "out" / "pose.bvh").exists()


def test_gaps_are_not_bridged_without_a_filter(recording):
    with pytest.raises(InputError, match="bridged by the filters"):
        load_pipeline(recording, segment="none", smooth="none", bridge_s=0.1)


@pytest.mark.usefixtures("usual_signals")
@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="signals of POSIX")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_signals_end_a_run_with_everything_written(recording, tmp_path, monkeypatch, name):
    """One while it works, and another while it writes, as of a supervisor that is tired of waiting."""
    out, number = tmp_path / "out", getattr(signal, name)
    write, written = CsvWriter.write, []

    def write_two(self, pose):
        write(self, pose)
        written.append(pose)
        if len(written) == 2:
            signal.raise_signal(number)

    def write_trc_late(*arguments, **options):
        monkeypatch.setattr("depthmocap.core.interrupts._REPEAT_S", 0.0)
        signal.raise_signal(signal.SIGTERM)
        write_trc(*arguments, **options)

    monkeypatch.setattr(CsvWriter, "write", write_two)
    monkeypatch.setattr("depthmocap.exporting.result_files.write_trc", write_trc_late)
    assert main(["run", str(recording), "--out", str(out), "--segment", "none", "--smooth", "none"]) == 128 + number
    assert len(read_csv(out / "pose.csv")[0]) == len(read_trc(out / "pose.trc")[0]) == 2
    assert json.loads((out / "summary.json").read_text(encoding="utf-8"))["interrupted"]
    assert {path.name for path in out.iterdir()} == {*RESULT_FILES, *PICTURE_FILES, "points.csv"}


@pytest.mark.parametrize("factor", [1e-6, 1e-8])
def test_timestamps_in_another_unit_are_refused(recording, tmp_path, factor):
    """Milliseconds, or counts of frames."""
    path = copy(recording, tmp_path)
    for file in path.glob("cam*/*.png"):
        file.rename(file.with_name(f"{round(int(file.stem) * factor)}.png"))
    with pytest.raises(InputError, match="must be in nanoseconds"):
        open_source(path)


def test_many_problems_are_told_in_few_lines(recording, tmp_path, capsys):
    path = copy(recording, tmp_path)
    for file in sorted((path / "cam0").glob("*.png"))[1:]:
        file.write_bytes(file.read_bytes()[:40])
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--segment", "none", "--no-report"]) == 0
    told = " ".join(capsys.readouterr().err.split())
    assert told.count("is not a complete PNG") == 4
    assert "1 more of this kind" in told
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert len(summary["problems"]) == 5
    assert summary["first_timestamp_ns"] == 1_000_000_000


def test_nobody_is_offered_a_background_that_is_there(tmp_path):
    rig = Rig(cameras()[:2])
    floor = {camera.name: np.full((camera.height, camera.width), 2500, np.uint16) for camera in rig.cameras}
    for known in (["cam0"], ["cam0", "cam1"]):
        path = tmp_path / str(len(known))
        with RecordingWriter(path, rig, {name: floor[name] for name in known}) as writer:
            for i in range(4):
                writer.write(i * 100_000_000, floor)
        source = open_source(path)
        way = _way_out(source, RunSettings(path, tmp_path / "out"))
        assert ("the empty scene of camera 'cam1' (background.png)" in way) == (len(known) == 1)
        assert "cam0" not in way
        assert "area" not in way
        settings = RunSettings(path, tmp_path / "out", segment="none", area=(0.0, 0.0, 1.0, 0.0, 1.0, 1.0))
        way = _way_out(source, settings)
        assert "--segment" not in way and "--area" in way


def test_python_api(recording):
    pipeline = load_pipeline(recording, segment="none", smooth="none")
    source = open_source(recording)
    result = pipeline(next(iter(source)))
    assert result.pose.joints.shape == (len(JOINTS), 3)
    assert len(result.labels) == 3
    assert set(np.unique(result.cloud.labels)) <= set(range(1, 44))


def test_results_are_deterministic(recording, tmp_path):
    for name in ("a", "b"):
        run(RunSettings(recording, tmp_path / name, segment="none", report=False))
    assert (tmp_path / "a" / "pose.csv").read_bytes() == (tmp_path / "b" / "pose.csv").read_bytes()


def test_a_camera_more_or_less_moves_the_joints_little(recording):
    pipeline = load_pipeline(recording, segment="none", smooth="none")
    frames = next(iter(open_source(recording)))
    assert frames.true_joints is not None
    for chosen in ((0,), (0, 1), (0, 1, 2)):
        views = tuple(frames.views[i] for i in chosen)
        joints = pipeline(dataclasses.replace(frames, views=views)).pose.joints
        assert np.linalg.norm(joints - frames.true_joints, axis=-1).mean() < 0.15


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda path: (path / "rig.json").unlink(), "rig.json"),
        (lambda path: (path / "rig.json").write_text("{"), "not valid JSON"),
        (lambda path: [shutil.rmtree(path / f"cam{i}") for i in range(3)], "no camera|no frames|any frame"),
        (lambda path: next((path / "cam0").glob("*.png")).write_bytes(b"no picture"), "cam0"),
        (lambda path: (path / "cam0" / "first.png").write_bytes(b""), "first.png"),
    ],
)
def test_bad_recordings_are_one_clear_line(recording, tmp_path, spoil, message, capsys):
    path = copy(recording, tmp_path)
    for stale in sorted((path / "cam0").glob("*.png"))[1:]:
        stale.unlink()
    spoil(path)
    status = main(["run", str(path), "--out", str(tmp_path / "out"), "--segment", "none", "--no-report"])
    printed = capsys.readouterr().err
    assert status == 2
    assert "Traceback" not in printed
    import re

    assert re.search(message, printed), printed


def test_another_rig_than_the_recordings(recording, tmp_path, capsys):
    path = copy(recording, tmp_path)
    rig = load_rig(path / "rig.json")
    plain = run(RunSettings(path, tmp_path / "plain", segment="none", smooth="none", report=False)).summary
    # Nobody has told where the cameras stand ...
    unplaced = [dataclasses.replace(camera, world_from_camera=np.eye(4)) for camera in rig.cameras]
    save_rig(Rig(tuple(unplaced)), path / "rig.json")
    command = ["run", str(path), "--out", str(tmp_path / "out"), "--segment", "none", "--no-report", "--smooth", "none"]
    assert main(command) == 2
    assert "depthmocap calibrate" in capsys.readouterr().err
    # ... until a file does, of two cameras and of a world that is a metre off.
    shift = np.eye(4)
    shift[0, 3] = 1.0
    moved = [dataclasses.replace(camera, world_from_camera=shift @ camera.world_from_camera) for camera in rig.cameras]
    save_rig(Rig(tuple(moved[:2])), tmp_path / "found.json")
    assert main([*command, "--rig", str(tmp_path / "found.json")]) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["frames_by_camera"] == {"cam0": 6, "cam1": 6}
    assert any("left out: cam2" in problem["text"] for problem in summary["problems"])
    assert plain["error"] is not None and summary["error"] is None  # the truth is in another world
    ours, theirs = (read_csv(tmp_path / name / "pose.csv")[1] for name in ("out", "plain"))
    assert np.abs(np.median(ours - theirs, (0, 1)) - [1, 0, 0]).max() < 0.03
    other = tmp_path / "other.json"
    save_rig(Rig((dataclasses.replace(rig.cameras[0], name="else"),)), other)
    assert main([*command, "--rig", str(other)]) == 2
    assert "none of the rig's cameras" in capsys.readouterr().err


def test_missing_recording(tmp_path, capsys):
    assert main(["run", str(tmp_path / "nowhere"), "--out", str(tmp_path / "out")]) == 2
    assert "nowhere" in capsys.readouterr().err


def test_a_filter_that_waits_loses_no_frame_and_keeps_their_times(recording, tmp_path):
    takes: tuple[tuple[Smoothing, int], ...] = (("kalman", 2), ("fixed-lag", 2), ("fixed-lag", 9))
    for name, frames in takes:  # 9: more than the recording has
        out = tmp_path / f"{name} {frames}"
        settings = RunSettings(recording, out, segment="none", smooth=name, lag_frames=frames, report=False)
        summary = run(settings).summary
        times, joints, confidence = read_csv(out / "pose.csv")
        np.testing.assert_allclose(times, np.arange(6) * 0.1, atol=1e-6)
        assert np.isfinite(joints).all() and (confidence > 0).all()
        assert summary["error"] is not None and summary["smoothing"] is not None
        assert summary["devices"] == dict.fromkeys(("fast", "leaning", "front", "votes"), "cpu")
        assert summary["error"]["joints_observed"] == 6 * len(JOINTS)
        assert summary["error"]["mean_joint_error_cm"] < 8
        assert summary["smoothing"]["delay_frames"] == (frames if name == "fixed-lag" else 0)


def test_time_offsets_of_the_rig_bring_late_frames_into_their_sets(recording, tmp_path, capsys):
    path = copy(recording, tmp_path)
    for frame in sorted((path / "cam1").glob("[0-9]*.png")):  # downwards in time: no name is taken
        frame.rename(frame.with_name(f"{int(frame.stem) - 150_000_000}.png"))
    rig = load_rig(path / "rig.json")
    late = [dataclasses.replace(c, time_offset_s=0.15 if c.name == "cam1" else 0.0) for c in rig.cameras]
    save_rig(Rig(tuple(late)), path / "rig.json")
    command = ["run", str(path), "--out", str(tmp_path / "out"), "--segment", "none", "--no-report"]
    assert main(command) == 0
    summary = read_summary(tmp_path / "out")
    assert summary["time_offsets_s"] == {"cam1": 0.15}
    assert (summary["frames"], summary["frames_by_camera"]) == (6, {"cam0": 6, "cam1": 6, "cam2": 6})
    assert "added to timestamps: 'cam1' +150.0 ms" in " ".join(capsys.readouterr().err.split())
    # A rig that is given instead has its own offsets; time may begin below 0.
    early = [dataclasses.replace(c, time_offset_s=c.time_offset_s - 3) for c in late]
    save_rig(Rig(tuple(early)), tmp_path / "early.json")
    assert main([*command, "--rig", str(tmp_path / "early.json")]) == 0
    assert read_summary(tmp_path / "out")["frames"] == 6
    assert read_summary(tmp_path / "out")["first_timestamp_ns"] == 1_000_000_000 - 3_000_000_000


def test_many_recordings_have_folders_of_their_own_and_are_done_once(recording, tmp_path, capsys):
    first, second = (shutil.copytree(recording, tmp_path / "in" / name / "sway") for name in ("a", "b"))
    out = tmp_path / "out"
    words = ["run", str(first), str(second), "--out", str(out), "--no-report", "--segment", "none", "--formats", "npz"]
    assert main([*words[:3], str(tmp_path / "none"), *words[3:]]) == 2
    assert "1 of 3 recordings could not be processed" in capsys.readouterr().err.replace("\n", " ")
    alone = run(RunSettings(first, tmp_path / "alone", segment="none", report=False, formats=("npz",)))
    assert alone.folder is not None
    for name in ("sway", "sway-2"):
        assert (out / name / "pose.csv").read_bytes() == (alone.folder / "pose.csv").read_bytes()
    stamps = [(out / name / "pose.csv").stat().st_mtime_ns for name in ("sway", "sway-2")]
    os.utime(next(second.rglob("*.png")), ns=(1, 10**18 * 2))
    assert main(words) == 0
    again = [(out / name / "pose.csv").stat().st_mtime_ns for name in ("sway", "sway-2")]
    assert again[0] == stamps[0] and again[1] > stamps[1]
    assert "sway: done before" in capsys.readouterr().err
