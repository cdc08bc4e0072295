"""A camera whose clock is off: calibrate finds by how much, and run gives joints as good as in step."""

from __future__ import annotations

import importlib.resources
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from walker import REST, stand, track, wander

from depthmocap.calibration.camera_placement import place_cameras
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.lateness_by_motion import find_jumps, jump_lines
from depthmocap.calibration.pairs import align
from depthmocap.cli import main
from depthmocap.geometry import load_rig, transform_points
from depthmocap.offline.pipeline_settings import load_pipeline
from depthmocap.recordings.open_recording import open_recording

DEMO = Path(str(importlib.resources.files("depthmocap") / "demo_recording"))
TIMES_S = np.arange(0, 24, 0.1)


def tracks(late_s: float, jump_s: float = 0.0) -> list[JointTrack]:
    """Three cameras, whose second looks later, and from the middle on by so much more."""
    rng = np.random.default_rng(0)
    late = late_s + np.where(TIMES_S > 12, jump_s, 0.0)
    fine_s = np.arange(-10, 40, 0.05)
    flat = wander(fine_s).reshape(len(fine_s), -1)

    def moving(times_s: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(times_s, fine_s, column) for column in flat.T], 1).reshape(-1, *REST.shape)

    return [
        track(stand(azimuth), TIMES_S, rng, movement=lambda at, late=extra: moving(at + late))
        for azimuth, extra in ((0, 0.0), (100, late), (220, 0.0))
    ]


@pytest.mark.parametrize("late_s", [0.4, -6.0])
def test_a_late_camera_is_placed_however_late(late_s):
    placement = place_cameras(tracks(late_s), np.random.default_rng(0))
    assert not placement.untold
    assert placement.offset_s[1] - placement.offset_s[0] == pytest.approx(late_s, abs=0.01)


@pytest.mark.slow
def test_a_clock_that_jumps_is_named():
    seen = tracks(0.0, 0.3)
    jumps = find_jumps(seen, [0.0, 0.0, 0.0], np.random.default_rng(0))
    assert set(jumps) == {(0, 1), (1, 2)}
    (line,) = jump_lines(("a", "b", "c"), jumps, 0.0)
    assert line.startswith("the clock of camera 'b' jumps by ")
    assert find_jumps(tracks(0.0), [0.0, 0.0, 0.0], np.random.default_rng(0)) == {}
    assert jump_lines(("a", "b"), {(0, 1): jumps[0, 1]}, 0.0)[0].startswith("of cameras 'a' and 'b', the clock of one")


@pytest.mark.slow
def test_joints_are_as_good_from_a_camera_that_was_late(tmp_path):
    errors_cm = {}
    for moved_ms in (0, 400):
        path, rig = shutil.copytree(DEMO, tmp_path / f"take{moved_ms}"), tmp_path / f"rig{moved_ms}.json"
        frames = [file for file in (path / "cam1").glob("*.png") if file.stem.isdecimal()]
        for file in sorted(frames, reverse=True):
            file.rename(file.with_stem(str(int(file.stem) + moved_ms * 1_000_000)))
        assert main(["calibrate", str(path), "--out", str(rig), "--json", str(tmp_path / "numbers.json")]) == 0
        offsets_s = json.loads((tmp_path / "numbers.json").read_text())["time_offset_s"]
        assert offsets_s["cam1"] - offsets_s["cam0"] == pytest.approx(-moved_ms / 1000, abs=0.01)
        errors_cm[moved_ms] = joint_error_cm(path, rig)
    assert errors_cm[400] < errors_cm[0] + 0.15


def joint_error_cm(path: Path, rig: Path) -> float:
    """Mean error of run's joints after one rigid alignment of the whole take, since the found world is its own."""
    recording, truth = open_recording(path, load_rig(rig)), dict(open_recording(DEMO).truth_rows())
    pipeline = load_pipeline(recording)
    stamps = np.array(list(truth))
    found, true = [], []
    for frames in recording:
        recorded_ns = frames.timestamp_ns - recording.rig["cam0"].time_offset_ns
        nearest = int(stamps[np.abs(stamps - recorded_ns).argmin()])
        if abs(nearest - recorded_ns) < 6e7:
            found.append(pipeline(frames).pose.joints)
            true.append(truth[nearest])
    joints, expected = np.concatenate(found), np.concatenate(true)
    known = np.isfinite(joints).all(1)
    moved = transform_points(align(expected[known], joints[known], np.ones(int(known.sum()))), joints[known])
    return 100 * float(np.linalg.norm(moved - expected[known], axis=1).mean())
