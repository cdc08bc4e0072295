"""The command on the packaged recording, and what it says of recordings that cannot be calibrated."""

import importlib.resources
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from walker import errors

from depthmocap.cli import main
from depthmocap.geometry import load_rig, rigid_inverse

DEMO = Path(str(importlib.resources.files("depthmocap") / "demo_recording"))


def unplaced(tmp_path, every: int = 2) -> Path:
    """The packaged recording with all cameras at the origin, and fewer frames."""
    path = shutil.copytree(DEMO, tmp_path / "recording")
    change_rig(path, lambda camera: camera.update(world_from_camera=np.eye(4).tolist()))
    for folder in ("cam0", "cam1", "cam2"):
        frames = sorted(file for file in (path / folder).glob("*.png") if file.stem.isdecimal())
        for i, frame in enumerate(frames):
            if i % every:
                frame.unlink()
    return path


def change_rig(path, change) -> None:
    rig = json.loads((path / "rig.json").read_text())
    for camera in rig["cameras"]:
        change(camera)
    (path / "rig.json").write_text(json.dumps(rig))


@pytest.mark.slow
def test_the_packaged_recording(tmp_path, capsys):
    path, out = unplaced(tmp_path), tmp_path / "found" / "rig.json"
    assert main(["calibrate", str(path), "--out", str(out), "--json", str(tmp_path / "numbers.json")]) == 0
    found, true = load_rig(out), load_rig(DEMO / "rig.json")
    assert found.names == true.names
    first = true.cameras[0].world_from_camera @ rigid_inverse(found.cameras[0].world_from_camera)
    for one, other in zip(found.cameras, true.cameras, strict=True):
        error_m, error_rad = errors(first @ one.world_from_camera, other.world_from_camera, (0.0, 0.0, 1.0))
        assert error_m < 0.02
        assert error_rad < np.deg2rad(0.7)
        assert abs(one.world_from_camera[2, 3] - other.world_from_camera[2, 3]) < 0.02
        assert (one.fx, one.width, one.depth_unit_m) == (other.fx, other.width, other.depth_unit_m)
    numbers = json.loads((tmp_path / "numbers.json").read_text())
    assert [pair["cameras"] for pair in numbers["pairs"]] == [["cam0", "cam1"], ["cam0", "cam2"], ["cam1", "cam2"]]
    assert numbers["floor"] == "floor"
    assert all(20 < pair["agreed_poses"] <= pair["shared_poses"] <= 34 for pair in numbers["pairs"])
    assert numbers["warnings"][0].startswith("cameras 'cam0', 'cam1' and 'cam2' share at most ")  # 34 poses are few
    html = out.with_suffix(".html").read_text()
    assert html.count("<img") == 2
    assert "3 of 3 cameras are placed" in capsys.readouterr().out.replace("\n", " ")


@pytest.mark.slow
def test_a_camera_that_never_sees_the_person_is_named_and_the_others_are_written(tmp_path, capsys):
    path = unplaced(tmp_path, every=4)
    empty = (path / "cam1" / "background.png").read_bytes()
    for frame in (path / "cam1").glob("1*.png"):
        frame.write_bytes(empty)
    assert main(["calibrate", str(path), "--out", str(tmp_path / "rig.json")]) == 0
    assert load_rig(tmp_path / "rig.json").names == ("cam0", "cam2")
    printed = " ".join(capsys.readouterr().out.split())
    assert "2 of 3 cameras are placed" in printed
    assert "Camera 'cam1' is not in the rig: it never sees a person in 17 frames" in printed


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        ("one camera", "has one camera (cam0): a calibration needs two or more"),
        ("nobody", "no person was found in any of"),
        ("one after the other", "no two cameras see the same person often enough"),
    ],
)
def test_what_cannot_be_calibrated_is_one_clear_line(tmp_path, spoil, message, capsys):
    path = unplaced(tmp_path, every=6)
    if spoil == "one camera":
        rig = json.loads((path / "rig.json").read_text())
        (path / "rig.json").write_text(json.dumps({"cameras": rig["cameras"][:1]}))
    if spoil == "nobody":
        shutil.copy(sorted((path / "cam2").glob("1*.png"))[0], path / "cam2" / "background.png")
        for camera in ("cam0", "cam1", "cam2"):
            for frame in (path / camera).glob("1*.png"):
                shutil.copy(path / camera / "background.png", frame)
    if spoil == "one after the other":
        for k, camera in enumerate(("cam0", "cam1", "cam2")):
            frames = sorted((path / camera).glob("1*.png"))
            for i, frame in enumerate(frames):
                if i % 3 != k or camera == "cam2":
                    frame.unlink()
    out = tmp_path / "rig.json"
    status = main(["calibrate", str(path), "--out", str(out)])
    printed = capsys.readouterr().err
    assert status == 2
    assert message in printed
    assert "Traceback" not in printed
    assert not out.exists()


@pytest.mark.parametrize(
    ("out", "options", "message"),
    [
        ("rig.mcap", (), "--out must end in .json"),
        ("rig.html", (), "--out must end in .json"),
        ("rig.json", ("--json", "rig.json"), "--json must not be the file of --out"),
        ("rig.json", ("--report", "rig.json"), "--report must not be the file of --out"),
        ("rig.json", ("--json", "rig.html"), "--json must not be the file of --report"),
        ("recording/rig.json", (), "--out must not be a file of the recording"),
    ],
)
def test_nothing_is_written_over(tmp_path, monkeypatch, capsys, out, options, message):
    shutil.copytree(DEMO, tmp_path / "recording")
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    assert main(["calibrate", "recording", "--out", out, *options]) == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / "recording" / "rig.json").read_bytes() == (DEMO / "rig.json").read_bytes()
