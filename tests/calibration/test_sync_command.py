"""Separate recordings become one take, on the cameras of the packaged recording; and what cannot be put in step."""

from __future__ import annotations

import importlib.resources
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from walker import errors

from depthmocap.cli import main
from depthmocap.geometry import load_rig, rigid_inverse
from depthmocap.recordings.merged_take import ClockMap
from depthmocap.recordings.open_recording import open_recording

DEMO = Path(str(importlib.resources.files("depthmocap") / "demo_recording"))


def alone(folder: Path, camera: str, moved_s: float = 0.0, every: int = 1, keep: slice = slice(None)) -> Path:
    """One camera of the packaged recording as a recording of its own, by a clock of its own."""
    path = folder / f"take_{camera}"
    (path / camera).mkdir(parents=True)
    (entry,) = (entry for entry in json.loads((DEMO / "rig.json").read_text())["cameras"] if entry["name"] == camera)
    del entry["world_from_camera"]
    (path / "rig.json").write_text(json.dumps({"cameras": [entry]}))
    frames = sorted(file for file in (DEMO / camera).glob("*.png") if file.stem.isdecimal())
    for file in frames[keep][::every]:
        shutil.copy(file, path / camera / f"{int(file.stem) + round(moved_s * 1e9)}.png")
    if (DEMO / camera / "background.png").exists():
        shutil.copy(DEMO / camera / "background.png", path / camera / "background.png")
    return path


def test_two_recordings_that_were_started_apart(tmp_path, capsys):
    alone(tmp_path / "in", "cam0")
    alone(tmp_path / "in", "cam2", -311.7, keep=slice(6, None))
    assert main(["sync", str(tmp_path / "in"), "--out", str(tmp_path / "take"), "--rate-hz", "10"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "frames of 2 recordings are in" in printed
    take = open_recording(tmp_path / "take")
    assert take.rig.names == ("cam0", "cam2")
    assert take.complete
    moved_ns = np.array(take.stamps("cam2")) - np.array(open_recording(DEMO).stamps("cam2")[6:])
    assert np.abs(moved_ns).max() < 8e6
    assert take.stamps("cam0") == open_recording(DEMO).stamps("cam0")
    assert take.raw_background("cam0") is not None
    frame = take.stamps("cam2")[3]
    np.testing.assert_array_equal(take.raw("cam2", frame), open_recording(DEMO).raw("cam2", frame - int(moved_ns[3])))


@pytest.mark.slow
def test_from_separate_recordings_to_joints(tmp_path):
    for camera, moved_s in (("cam0", 0.0), ("cam1", 55.5), ("cam2", -311.7)):
        alone(tmp_path / "in", camera, moved_s)
    take, rig, out = tmp_path / "take.mcap", tmp_path / "rig.json", tmp_path / "out"
    assert main(["sync", str(tmp_path / "in"), "--out", str(take)]) == 0
    assert main(["calibrate", str(take), "--out", str(rig)]) == 0
    found, true = load_rig(rig), load_rig(DEMO / "rig.json")
    first = true.cameras[0].world_from_camera @ rigid_inverse(found.cameras[0].world_from_camera)
    for one, other in zip(found.cameras, true.cameras, strict=True):
        error_m, error_rad = errors(first @ one.world_from_camera, other.world_from_camera, (0.0, 0.0, 1.0))
        assert error_m < 0.02
        assert error_rad < np.deg2rad(0.7)
    assert main(["run", str(take), "--rig", str(rig), "--out", str(out)]) == 0
    assert json.loads((out / "summary.json").read_text())["cameras_apart_cm"]["cam1"] < 3


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        ("one", "is one recording: sync takes two or more"),
        ("nothing", "has no recording in it, and is none"),
        ("same name", "have a camera 'cam0': rename one"),
        ("exists", "exists already"),
        ("foreign", "must be a file that ends in .mcap, or a folder"),
        ("nobody", "no person was found in it, by whom it could be put in step"),
        ("statue", "are apart: nobody moves"),
        ("short", "are apart: nobody is seen for long enough"),
    ],
)
def test_what_cannot_be_put_in_step_is_one_clear_line(tmp_path, capsys, spoil, message):
    folder, out = tmp_path / "in", tmp_path / "take.mcap"
    path = alone(folder, "cam0", every=8)
    if spoil == "nothing":
        shutil.rmtree(path)
    elif spoil == "same name":
        shutil.copytree(path, folder / "take_again")
    elif spoil != "one":
        other = alone(folder, "cam1", 9.0, every=8, keep=slice(24) if spoil == "short" else slice(None))
        frames = sorted(file for file in (other / "cam1").glob("*.png") if file.stem.isdecimal())
        still = (other / "cam1" / "background.png" if spoil == "nobody" else frames[0]).read_bytes()
        for file in frames if spoil in ("nobody", "statue") else ():
            file.write_bytes(still)
    if spoil == "exists":
        out.write_bytes(b"something")
    if spoil == "foreign":
        out = tmp_path / "take.mkv"
    assert main(["sync", str(folder), "--out", str(out)]) == 2
    printed = " ".join(capsys.readouterr().err.split())
    assert message in printed
    assert "Traceback" not in printed
    assert out.exists() == (spoil == "exists")


def test_a_clock_on_the_clock_of_a_take():
    clock = ClockMap(10_000, 2_000_000, 1e-3)
    assert clock(10_000) == 2_000_000
    assert clock(1_010_000) == 3_001_000
