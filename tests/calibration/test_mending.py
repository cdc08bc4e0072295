"""Faults of pictures in the packaged recording: named, the others placed; mended only on demand."""

import importlib.resources
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from depthmocap.cli import main
from depthmocap.geometry import load_rig
from depthmocap.offline.info_command import InfoSettings, info
from depthmocap.recordings.recording import Recording

DEMO = Path(str(importlib.resources.files("depthmocap") / "demo_recording"))
CAMERAS = ("cam0", "cam1", "cam2")


def recording(
    path: Path, every: int = 3, camera: Callable[[dict], None] | None = None, picture=None, names=("cam1",)
) -> Path:
    """A part of the packaged recording, with a fault of some cameras."""
    shutil.copytree(DEMO, path)
    rig = json.loads((path / "rig.json").read_text())
    for entry in rig["cameras"]:
        frames = sorted(file for file in (path / entry["name"]).glob("*.png") if file.stem.isdecimal())
        for i, frame in enumerate(frames):
            if i % every:
                frame.unlink()
        if entry["name"] in names:
            if camera is not None:
                camera(entry)
            if picture is not None:
                for file in (path / entry["name"]).glob("*.png"):
                    cv2.imwrite(str(file), np.ascontiguousarray(picture(cv2.imread(str(file), -1))))
    (path / "rig.json").write_text(json.dumps(rig))
    return path


def mirror(picture: np.ndarray) -> np.ndarray:
    return picture[:, ::-1]


def unit(factor: float) -> Callable[[dict], None]:
    return lambda entry: entry.update(depth_unit_m=entry["depth_unit_m"] * factor)


def said(capsys) -> str:
    captured = capsys.readouterr()
    return " ".join((captured.out + captured.err).split())


@pytest.mark.slow
def test_a_mirrored_camera_is_named_and_left_out_and_placed_where_it_is_to_be_mended(tmp_path, capsys) -> None:
    path, out = recording(tmp_path / "mirrored", picture=mirror), tmp_path / "rig.json"
    assert main(["calibrate", str(path), "--out", str(out)]) == 0
    assert load_rig(out).names == ("cam0", "cam2")
    assert "Camera 'cam1' is not in the rig: the picture of camera 'cam1' is mirrored against" in said(capsys)
    assert main(["calibrate", str(path), "--out", str(out), "--mend"]) == 0
    assert "mended: the picture of camera 'cam1' is mirrored" in said(capsys)
    rig = load_rig(out)
    assert [camera.mirrored for camera in rig.cameras] == [False, True, False]
    mended, true = Recording(path, rig), Recording(DEMO)
    stamp = mended.stamps("cam1")[0]
    depth, true_depth = (source.rig["cam1"].to_metres(source.raw("cam1", stamp)) for source in (mended, true))
    assert np.array_equal(depth, true_depth)


@pytest.mark.slow
def test_a_unit_that_is_wrong_for_all_is_named_with_the_right_one(tmp_path, capsys) -> None:
    path, out = recording(tmp_path / "quarter", 4, unit(0.25), names=CAMERAS), tmp_path / "rig.json"
    assert main(["calibrate", str(path), "--out", str(out)]) == 2
    assert "a depth unit of 0.001 m instead of 0.00025 m would be right" in said(capsys)
    assert not out.exists()
    assert main(["run", str(path), "--out", str(tmp_path / "run"), "--no-report"]) == 2
    assert "multiply their depth by 4 (depth_factor in rig.json)" in said(capsys)  # by the rig's own distances


@pytest.mark.slow
def test_a_camera_in_another_unit_is_named_and_mended_on_demand(tmp_path, capsys) -> None:
    path, out = recording(tmp_path / "half", camera=unit(0.7)), tmp_path / "rig.json"
    assert main(["calibrate", str(path), "--out", str(out), "--mend"]) == 0
    assert [round(camera.depth_factor, 1) for camera in load_rig(out).cameras] == [1, 1.4, 1]
    assert "camera 'cam1' measures 0.7" in said(capsys)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (None, "nothing wrong is found with depth units, pictures and poses"),
        ("inverse", "wrong: world_from_camera of camera 'cam1' is camera_from_world, the inverse: right would be [["),
        ("upside down", "wrong: the picture of camera 'cam1' is turned by 180° against its intrinsics and pose: turn"),
        ("half", "wrong: all cameras measure 0.5 of the lengths between the places that the rig tells"),
    ],
)
def test_info_tells_on_demand_what_is_wrong(tmp_path, capsys, change, message) -> None:
    def inverted(entry: dict) -> None:
        entry["world_from_camera"] = np.linalg.inv(np.array(entry["world_from_camera"])).tolist()

    if change == "upside down":
        path = recording(tmp_path / "r", 4, picture=lambda picture: picture[::-1, ::-1])
    else:
        path = recording(tmp_path / "r", 4, {"inverse": inverted, "half": unit(0.5)}.get(change or ""),
                         names=CAMERAS if change == "half" else ("cam1",))  # fmt: skip
    assert main(["info", str(path), "--check"]) == 0
    printed = said(capsys)
    assert message in printed
    assert printed.count("wrong: ") == (change is not None)


@pytest.mark.slow
def test_a_picture_that_was_turned_is_named_and_left_out_and_placed_as_well_when_it_is_mended(tmp_path, capsys) -> None:
    path, out = recording(tmp_path / "turned", picture=lambda picture: np.rot90(picture, 3)), tmp_path / "rig.json"
    assert main(["calibrate", str(path), "--out", str(out)]) == 2
    assert "width 288, height 320, fx 252.25, fy 252.25, cx 165.8, cy 158.3 would be right if anticlock" in said(capsys)
    assert main(["calibrate", str(path), "--out", str(out), "--mend"]) == 0
    printed = said(capsys)
    assert "mended: the pictures of camera 'cam1' are on their side against the intrinsics" in printed
    assert "mended: the picture of camera 'cam1' is turned by 180° against its intrinsics" in printed  # clockwise
    found, true = load_rig(out), load_rig(DEMO / "rig.json")["cam1"].turned(3)
    camera = found["cam1"]
    assert (camera.width, camera.height, camera.cx, camera.cy) == (true.width, true.height, true.cx, true.cy)
    relative = found["cam0"].camera_from_world @ camera.world_from_camera
    expected = load_rig(DEMO / "rig.json")["cam0"].camera_from_world @ true.world_from_camera
    person = true.camera_from_world @ [0.0, 0.0, 1.0, 1.0]
    assert np.linalg.norm((relative - expected) @ person) < 0.015
    assert main(["run", str(path), "--rig", str(out), "--out", str(tmp_path / "run"), "--no-report"]) == 0


@pytest.mark.slow
def test_a_rig_that_is_checked_is_mended_on_demand_and_the_old_one_stays(tmp_path, capsys) -> None:
    wrong, mended = tmp_path / "wrong.json", tmp_path / "mended.json"
    document = json.loads((DEMO / "rig.json").read_text())
    pose = np.array(document["cameras"][1]["world_from_camera"])
    document["cameras"][1]["world_from_camera"] = (pose @ np.diag([1.0, -1, -1, 1])).tolist()
    wrong.write_text(json.dumps(document))
    before = wrong.read_bytes()
    command = ["calibrate", str(DEMO), "--check", str(wrong), "--rate-hz", "4", "--mend", "--out"]
    assert main([*command, str(wrong)]) == 2
    assert "--out must not be the file of --check" in said(capsys)
    assert main([*command, str(mended)]) == 0
    assert "Mended: world_from_camera of camera 'cam1' is of a camera with y up that looks along -z" in said(capsys)
    assert wrong.read_bytes() == before
    for camera, true in zip(load_rig(mended).cameras, load_rig(DEMO / "rig.json").cameras, strict=True):
        assert np.allclose(camera.world_from_camera, true.world_from_camera, atol=1e-6)


def test_info_without_check_looks_at_no_pictures(tmp_path) -> None:
    summary = info(InfoSettings(DEMO))
    assert "check" not in summary


@pytest.mark.slow
def test_run_names_what_is_wrong_and_not_the_cameras_that_are_right(tmp_path, capsys) -> None:
    def turned(entry: dict) -> None:
        pose = np.array(entry["world_from_camera"])
        pose[:3, :3] = pose[:3, :3] @ cv2.Rodrigues(np.array([0.0, np.deg2rad(15), 0.0]))[0]
        entry["world_from_camera"] = pose.tolist()

    path = recording(tmp_path / "turned", 3, turned)
    assert main(["run", str(path), "--out", str(tmp_path / "run"), "--no-report"]) == 0
    problems = json.loads((tmp_path / "run" / "summary.json").read_text())["problems"]
    assert [problem["text"].split(" stands")[0] for problem in problems] == ["camera 'cam1'"]


@pytest.mark.slow
def test_pictures_on_their_side_give_the_joints_of_upright_ones(tmp_path, capsys) -> None:
    """A whole take: calibrated from pictures of all cameras on their side, and captured with the rig's poses."""

    def hang(entry: dict) -> None:
        camera = load_rig(DEMO / "rig.json")[entry["name"]].turned(1)
        entry.update(width=camera.width, height=camera.height, fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy)
        entry["world_from_camera"] = camera.world_from_camera.tolist()

    upright = recording(tmp_path / "upright", 2)
    hung = recording(tmp_path / "hung", 2, hang, np.rot90, CAMERAS)
    out = tmp_path / "rig.json"
    assert main(["calibrate", str(hung), "--out", str(out)]) == 0
    assert said(capsys).count("is on its side") == 3
    found, true = load_rig(out), load_rig(hung / "rig.json")
    for name in CAMERAS[1:]:
        is_now = found["cam0"].camera_from_world @ found[name].world_from_camera
        told = true["cam0"].camera_from_world @ true[name].world_from_camera
        person = true[name].camera_from_world @ [0.0, 0.0, 1.0, 1.0]
        assert np.linalg.norm((is_now - told) @ person) < 0.015
    errors = []
    for path in (upright, hung):
        assert main(["run", str(path), "--out", str(tmp_path / "run" / path.name), "--no-report"]) == 0
        summary = json.loads((tmp_path / "run" / path.name / "summary.json").read_text())
        errors.append(summary["error"]["mean_joint_error_cm"])
    assert errors[1] < 1.1 * errors[0]
