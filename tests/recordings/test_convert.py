"""Recordings from one form to another and back, recorded anew, recovered."""

import json
import time
from pathlib import Path

import numpy as np
import pytest
from depth_scene import bands
from rich.console import Console

pytest.importorskip("foxglove")
pytest.importorskip("zstandard")

from depthmocap.cameras.playback_clock import PlaybackClock
from depthmocap.cameras.source import CameraError, DepthFrame, DepthSource, FrameTimeoutError
from depthmocap.core.console import Terminal
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig, look_at
from depthmocap.offline.info_command import InfoSettings, info
from depthmocap.realtime import record as record_module
from depthmocap.realtime.record import RecordSettings, record
from depthmocap.realtime.replay import ReplaySettings, play, replay
from depthmocap.recordings.convert import ConvertSettings, RecoverSettings, convert, recover
from depthmocap.recordings.depth_codec import CODINGS, Coding
from depthmocap.recordings.mcap_recording import McapRecording
from depthmocap.recordings.mcap_writer import Topics
from depthmocap.recordings.recording import Recording
from depthmocap.recordings.recording_writer import RecordingWriter

START, PERIOD = 1_700_000_000_123_456_789, 33_333_333
QUIET = Console(quiet=True)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    cameras = (
        DepthCamera("a", 24, 16, 20.5, 21.0, 12.1, 8.2, look_at(np.array([0.3, -3, 1.1]), np.array([0.0, 0, 1]))),
        DepthCamera(
            "b", 16, 12, 15.0, 15.0, 8.0, 6.0,
            distortion=(0.1, 0.2, 0.0, 0.0, 0.3), depth_unit_m=0.00025, time_offset_s=-0.01,
            depth_factor=4.0, mirrored=True,
        ),
    )  # fmt: skip

    def frame(camera: DepthCamera) -> np.ndarray:
        return bands((camera.height, camera.width), rng)

    with RecordingWriter(tmp_path / "folder", Rig(cameras, "-y"), {"b": frame(cameras[1])}) as writer:
        for i in range(6):
            for k, camera in enumerate(cameras):
                if (i, k) != (3, 0):  # a lost frame
                    writer.write(START + i * PERIOD + 1000 * k, {camera.name: frame(camera)})
            joints = rng.normal(size=(18, 3))
            joints[i % 18] = np.nan
            writer.write(START + i * PERIOD, {}, joints)
    return tmp_path / "folder"


def contents(path: Path) -> dict[str, bytes]:
    return {str(p.relative_to(path)): p.read_bytes() for p in sorted(path.rglob("*")) if p.is_file()}


@pytest.mark.parametrize("coding", CODINGS)
def test_there_and_back_every_file_is_the_same(folder: Path, tmp_path: Path, coding: Coding) -> None:
    told = convert(ConvertSettings(folder, tmp_path / "x.mcap", coding), QUIET)
    assert told == {"frames": 11, "lost": 0, "truth_rows": 6}
    convert(ConvertSettings(tmp_path / "x.mcap", tmp_path / "y.mcap"), QUIET)
    convert(ConvertSettings(tmp_path / "y.mcap", tmp_path / "back"), QUIET)
    assert contents(tmp_path / "back") == contents(folder)


def test_both_forms_give_the_same_sets(folder: Path, tmp_path: Path) -> None:
    convert(ConvertSettings(folder, tmp_path / "x.mcap"), QUIET)
    one, other = Recording(folder), McapRecording(tmp_path / "x.mcap")
    assert (one.up, one.period_ns, one.problems, len(one)) == (other.up, other.period_ns, other.problems, len(other))
    for a, b in zip(one, other, strict=True):
        assert a.timestamp_ns == b.timestamp_ns
        np.testing.assert_array_equal(a.true_joints, b.true_joints)
        for va, vb in zip(a.views, b.views, strict=True):
            assert va.camera.name == vb.camera.name
            np.testing.assert_array_equal(va.depth_m, vb.depth_m)
    for name in "ab":
        a, b = one.background(name), other.background(name)
        assert (a is None, b is None) == (name == "a", name == "a")
        if a is not None and b is not None:
            np.testing.assert_array_equal(a, b)


def test_recording_a_recording_loses_nothing(folder: Path, tmp_path: Path) -> None:
    told = record(RecordSettings((str(folder),), tmp_path / "x.mcap"), QUIET)
    assert told["frames"] == {"a": 5, "b": 6}
    assert told["lost"] == {"a": 0, "b": 0}
    assert set(told["states"].values()) == {"at its end"}
    convert(ConvertSettings(tmp_path / "x.mcap", tmp_path / "back"), QUIET)
    truth = {"truth.csv"}  # which no camera gives
    assert {k: v for k, v in contents(folder).items() if k not in truth} == contents(tmp_path / "back")


def test_recording_stops_in_time(folder: Path, tmp_path: Path) -> None:
    slow = RecordSettings((f"{folder}#a",), tmp_path / "x.mcap", seconds=0.05, realtime=True)
    assert 1 <= record(slow, QUIET)["frames"]["a"] <= 5
    assert McapRecording(tmp_path / "x.mcap").complete


def test_a_camera_of_the_rig_that_is_not_there_is_told(folder: Path, tmp_path: Path) -> None:
    console = Terminal(record=True, width=150)
    settings = RecordSettings((f"{folder}#a",), tmp_path / "x.mcap", rig=folder / "rig.json")
    assert record(settings, console)["frames"] == {"a": 5}
    assert "the rig has a camera 'b', but no source of that name was given" in console.export_text()


def test_a_camera_that_does_not_fit_is_told_and_the_others_are_recorded(folder: Path, tmp_path: Path) -> None:
    document = json.loads((folder / "rig.json").read_text())
    document["cameras"][0]["width"] = 25
    (tmp_path / "rig.json").write_text(json.dumps(document))
    console = Terminal(record=True, width=200)
    told = record(RecordSettings((str(folder),), tmp_path / "x.mcap", rig=tmp_path / "rig.json"), console)
    assert told["frames"] == {"b": 6}
    assert "calibrated at 25×16" in told["states"]["a"]
    assert told["states"]["b"] == "at its end"
    assert "• camera 'a' delivers" in console.export_text()
    assert McapRecording(tmp_path / "x.mcap").rig.names == ("b",)


def test_what_cannot_be_recorded(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at least one camera"):
        record(RecordSettings((), tmp_path / "x.mcap"), QUIET)
    with pytest.raises(InputError, match="--seconds"):
        record(RecordSettings((str(folder),), tmp_path / "x.mcap", seconds=0.0), QUIET)
    document = json.loads((folder / "rig.json").read_text())
    document["cameras"][0]["width"] = 25
    (tmp_path / "rig.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match="calibrated at 25×16"):
        record(RecordSettings((f"{folder}#a",), tmp_path / "x.mcap", rig=tmp_path / "rig.json"), QUIET)
    assert not (tmp_path / "x.mcap").exists()


@pytest.mark.parametrize("name", ["take.txt", "take", "take.mcap.part"])
def test_a_recording_has_a_name_that_commands_can_read(
    folder: Path, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def opened(*arguments: object) -> list[DepthSource]:
        raise AssertionError("cameras were looked for")

    monkeypatch.setattr(record_module, "make_sources", opened)
    with pytest.raises(InputError, match=rf"--out must end in \.mcap, got .*{name}"):
        record(RecordSettings((str(folder),), tmp_path / name), QUIET)
    convert(ConvertSettings(folder, tmp_path / "x.mcap"), QUIET)
    with pytest.raises(InputError, match=rf"the new file must end in \.mcap, got .*{name}"):
        recover(RecoverSettings(tmp_path / "x.mcap", tmp_path / name), QUIET)
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize("name", ["take.mkv", "take.ONI", "take.bag"])
def test_no_folder_is_named_as_a_file_of_other_makers(folder: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=rf"a file that ends in \.mcap, or a folder, got .*{name}"):
        convert(ConvertSettings(folder, tmp_path / name), QUIET)
    assert not (tmp_path / name).exists()


class Silent(DepthSource):
    """A camera that opens, and then delivers nothing: for ever, or until it is lost."""

    def __init__(self, camera: DepthCamera, lost: str = "") -> None:
        super().__init__(camera.name)
        self._lens, self._lost = camera, lost

    def _open(self) -> DepthCamera:
        return self._lens

    def _read(self, timeout_s: float) -> DepthFrame:
        if self._lost:
            raise CameraError(self._lost)
        time.sleep(0.01)
        raise FrameTimeoutError("nothing yet")

    def _close(self) -> None:
        pass


@pytest.mark.parametrize(
    ("lost", "reason"), [("", "are the cameras running\\?"), ("camera 'a' was unplugged", "camera 'a' was unplugged")]
)
def test_a_recording_without_a_frame_is_an_error(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lost: str, reason: str
) -> None:
    source = Silent(Recording(folder).rig["a"], lost)
    monkeypatch.setattr(record_module, "make_sources", lambda *arguments: [source])
    with pytest.raises(InputError, match=rf"no frame came in \d\.\d s: {reason}; .*x\.mcap holds no frame"):
        record(RecordSettings(("a",), tmp_path / "x.mcap", seconds=0.05), QUIET)


def test_recover_makes_a_whole_file(folder: Path, tmp_path: Path) -> None:
    convert(ConvertSettings(folder, tmp_path / "x.mcap"), QUIET)
    data = (tmp_path / "x.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    told = recover(RecoverSettings(tmp_path / "cut.mcap", tmp_path / "whole.mcap"), QUIET)
    cut, whole = McapRecording(tmp_path / "cut.mcap"), McapRecording(tmp_path / "whole.mcap")
    assert not cut.complete
    assert whole.complete
    assert whole.problems == [] or all("cut off" not in problem for problem in whole.problems)
    assert told["frames"] == sum(len(whole.stamps(name)) for name in "ab") > 0
    for name in "ab":
        assert whole.stamps(name) == cut.stamps(name)
        for stamp in whole.stamps(name):
            np.testing.assert_array_equal(whole.raw(name, stamp), cut.raw(name, stamp))
    reader = pytest.importorskip("mcap.reader")
    with (tmp_path / "whole.mcap").open("rb") as stream:
        summary = reader.make_reader(stream, validate_crcs=True).get_summary()
    assert summary is not None


def test_recover_of_nothing(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(InputError, match="before the first frame"):
        recover(RecoverSettings(tmp_path / "x.mcap", tmp_path / "y.mcap"), QUIET)
    assert not (tmp_path / "y.mcap").exists()


@pytest.mark.parametrize("form", ["folder", "x.mcap"])
def test_info_counts_what_is_lost(folder: Path, tmp_path: Path, form: str) -> None:
    convert(ConvertSettings(folder, tmp_path / "x.mcap"), QUIET)
    found = info(InfoSettings(tmp_path / form), QUIET)
    assert {name: camera["frames"] for name, camera in found["cameras"].items()} == {"a": 5, "b": 6}
    assert {name: camera["lost"] for name, camera in found["cameras"].items()} == {"a": 1, "b": 0}
    assert found["cameras"]["b"]["frames_per_second"] == pytest.approx(30, abs=0.01)
    assert found["seconds"] == pytest.approx(5 / 30, abs=1e-3)
    assert (found["up"], found["complete"], found["true_joints"]) == ("-y", True, 6)


class Heard(Topics):
    """Stands for what viewers are told."""

    def __init__(self) -> None:  # needs no SDK
        self.told: list[tuple[str, int]] = []

    def describe(self, timestamp_ns: int) -> None:
        self.told.append(("rig", timestamp_ns))

    def truth(self, timestamp_ns: int, joints: np.ndarray) -> None:
        self.told.append(("truth", timestamp_ns))

    def image(self, name: str, timestamp_ns: int, raw: np.ndarray) -> np.ndarray:
        return raw

    def depth(self, name: str, image: np.ndarray, log_time_ns: int, clock: str = "") -> None:
        self.told.append((name, log_time_ns))


def test_replay_tells_everything_in_order(folder: Path) -> None:
    heard, recording = Heard(), Recording(folder)
    assert play(recording, [heard], PlaybackClock()) == 11
    kinds = [kind for kind, _ in heard.told]
    assert kinds[0] == "rig"
    assert (kinds.count("a"), kinds.count("b"), kinds.count("truth"), kinds.count("rig")) == (5, 6, 6, 1)
    assert [time for _, time in heard.told] == sorted(time for _, time in heard.told)


def test_replay_serves(folder: Path) -> None:
    assert replay(ReplaySettings(folder, speed=100.0, stream=("foxglove://:0",)), QUIET) == 11
    with pytest.raises(InputError, match="--speed"):
        replay(ReplaySettings(folder, speed=0.0), QUIET)
