"""Names of cameras: what is harmless stays, and nothing leads out of a recording's folder."""

import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from depthmocap.cameras.registry import make_sources
from depthmocap.core.camera_names import check_camera_name, safe_name, safe_names
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig, load_rig
from depthmocap.recordings.recording import Recording
from depthmocap.recordings.recording_writer import RecordingWriter

HARMLESS = ("cam0", "Küche links", "Kinect 1", "left.front", "カメラ", "[x]", "$frac{$", "_side", "console")
HOSTILE = (
    "", ".", "..", "../cam0", "a/b", "a\\b", "C:", "a\0b", "a\nb", "\x1b[2J", "a.", " a", "a ", ".lock", "CON",
    "nul.png", "com1", "rig.json", "Truth.csv", "world", "\u202egpj", "\udcff", "x" * 129, "ü" * 65,
)  # fmt: skip


@pytest.mark.parametrize("name", HARMLESS)
def test_a_harmless_name_stays(name: str) -> None:
    check_camera_name(name)
    assert safe_name(name) == name


@pytest.mark.parametrize("name", HOSTILE)
def test_a_name_that_is_no_folder_everywhere_is_refused_in_one_line_with_one_that_is(name: str) -> None:
    with pytest.raises(InputError, match="cannot be a camera's name: call it '") as refused:
        DepthCamera(name, 4, 4, 4.0, 4.0, 2.0, 2.0)
    assert str(refused.value).isprintable()
    assert repr(safe_name(name)) in str(refused.value)
    check_camera_name(safe_name(name))


def test_no_two_cameras_get_the_same_name() -> None:
    named = safe_names(["/left/depth", "left-depth", "left:depth", "..", "", "camera"])
    assert named["left-depth"] == "left-depth"
    assert named["camera"] == "camera"
    assert len(set(named.values())) == 6


def write_folder(path: Path, name: str) -> None:
    camera = DepthCamera(name, 32, 24, 30.0, 30.0, 16.0, 12.0)
    with RecordingWriter(path, Rig((camera,))) as writer:
        for i in range(3):
            raw = 1000 + 100 * np.arange(24, dtype=np.uint16)[:, None] + np.arange(32, dtype=np.uint16) + i
            writer.write(i * 33_333_333, {name: raw})


def test_rig_json_with_such_a_name_is_refused_and_one_with_an_odd_name_is_read(tmp_path: Path) -> None:
    write_folder(tmp_path / "recording", "Küche links")
    assert Recording(tmp_path / "recording").rig.names == ("Küche links",)
    path = tmp_path / "recording" / "rig.json"
    document = json.loads(path.read_text(encoding="utf-8"))
    for name in HOSTILE:
        document["cameras"][0]["name"] = name
        path.write_text(json.dumps(document), encoding="utf-8")
        with pytest.raises(InputError, match=r"rig.json.* (camera's name|half of a surrogate pair)"):
            load_rig(path)
    for name in (None, True, ["a"], {"a": 1}):
        document["cameras"][0]["name"] = name
        path.write_text(json.dumps(document), encoding="utf-8")
        with pytest.raises(InputError, match=r"rig.json: a camera's name must be text, got"):
            load_rig(path)


def test_a_camera_spec_with_such_a_name_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be a camera's name: call it 'left'"):
        make_sources(["../left=realsense:1"])
    write_folder(tmp_path / "recording", "left")
    with pytest.raises(InputError, match="cannot be a camera's name"):
        make_sources([f"{tmp_path / 'recording'}#.."])
    assert make_sources(["openni:/dev/../x"])[0].name == "openni--dev-..-x"


def test_mcap_with_such_names_is_read_under_others_and_converted_into_its_folder(tmp_path: Path, monkeypatch) -> None:
    pytest.importorskip("foxglove")
    from depthmocap.recordings.convert import ConvertSettings, convert
    from depthmocap.recordings.mcap_recording import McapRecording
    from depthmocap.recordings.mcap_writer import McapWriter

    monkeypatch.setattr("depthmocap.geometry.depth_camera.check_camera_name", lambda name: None)
    names = ("..", "/left/depth", "world", "\x1b]0;owned\x07")
    poses = [np.eye(4) for _ in names]
    for i, pose in enumerate(poses):
        pose[0, 3] = i
    cameras = tuple(
        DepthCamera(name, 32, 24, 30.0, 30.0, 16.0, 12.0, pose) for name, pose in zip(names, poses, strict=True)
    )
    raw = (1000 + 100 * np.arange(24)[:, None] + np.arange(32)).astype(np.uint16)
    with McapWriter(tmp_path / "x.mcap", Rig(cameras), {"..": raw}, start_ns=0) as writer:
        for i, name in enumerate(names):
            writer.write(name, 0, raw + i)
    monkeypatch.undo()

    source = McapRecording(tmp_path / "x.mcap")
    assert source.rig.names == ("camera", "left-depth", "camera-world", "]0;owned")
    assert len(source.problems) == 4
    assert "camera '..' is called 'camera' here" in source.problems[0]
    assert source.background("camera") is not None
    (tmp_path / "in").mkdir()
    convert(ConvertSettings(tmp_path / "x.mcap", tmp_path / "in" / "new"), Console(quiet=True))
    assert {each.name for each in tmp_path.iterdir()} == {"x.mcap", "in"}
    assert {each.name for each in (tmp_path / "in").iterdir()} == {"new"}
    back = Recording(tmp_path / "in" / "new")
    for i, name in enumerate(source.rig.names):
        np.testing.assert_array_equal(back.raw(name, 0), raw + i)
        assert back.rig[name].world_from_camera[0, 3] == source.rig[name].world_from_camera[0, 3]
