"""Sources read by threads of their own, and ``depthmocap record``, which shows what becomes of them."""

from __future__ import annotations

import io
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from virtual_time import VirtualTime

from depthmocap.cameras.source import CameraError, DepthFrame, DepthSource, FrameTimeoutError
from depthmocap.core.console import Terminal
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig
from depthmocap.realtime import record as record_module
from depthmocap.realtime.multi_camera_reader import ENDED, RUNNING, MultiCameraReader
from depthmocap.realtime.record import RecordSettings, record
from depthmocap.realtime.synced_reader import SyncedReader
from depthmocap.recordings.mcap_recording import McapRecording
from depthmocap.recordings.recording_writer import RecordingWriter


class Camera(DepthSource):
    """Delivers every 20 ms of ``clock``, up to ``count`` frames; ``before`` is called with the number of each read."""

    def __init__(
        self,
        name: str,
        clock: Any,
        count: int = 10**9,
        before: Callable[[int], None] = lambda number: None,
        opening_s: float = 0.0,
    ) -> None:
        super().__init__(name)
        self.clock, self.count, self.before, self.opening_s = clock, count, before, opening_s
        self.number = self.times_opened = 0

    def _open(self) -> DepthCamera:
        self.times_opened += 1
        if self.opening_s:
            self.clock.sleep(self.opening_s)
        return DepthCamera(self.name, 8, 6, 8.0, 8.0, 4.0, 3.0)

    def _read(self, timeout_s: float) -> DepthFrame | None:
        if self.number >= self.count:
            return None
        self.clock.sleep(0.02)
        self.number += 1
        self.before(self.number)
        now_ns = self.clock.monotonic_ns()
        raw = np.full((6, 8), 1000 + self.number % 1000, np.uint16)
        return DepthFrame(self.name, raw, now_ns, f"{self.name} device", now_ns, self.number)

    def _close(self) -> None:
        pass


def fails_at(failing: int, error: Exception) -> Callable[[int], None]:
    def before(number: int) -> None:
        if number == failing:
            raise error

    return before


def recorded(
    monkeypatch: pytest.MonkeyPatch, path: Path, sources: list[DepthSource], seconds: float | None = None
) -> tuple[dict[str, Any], list[str]]:
    """What ``record`` returns of these sources, and the lines that it prints."""
    monkeypatch.setattr(record_module, "make_sources", lambda *arguments: sources)
    printed = io.StringIO()
    told = record(RecordSettings(("x",), path, seconds=seconds), Terminal(file=printed, width=200))
    return told, printed.getvalue().splitlines()


def test_a_camera_whose_sdk_fails_is_told_and_goes_on(
    virtual: VirtualTime, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("foxglove")
    bad = Camera("bad", virtual, before=fails_at(10, RuntimeError("librealsense:\n device disconnected")))
    told, lines = recorded(monkeypatch, tmp_path / "x.mcap", [Camera("good", virtual), bad], 2.0)
    problem = "camera 'bad' was lost: librealsense: device disconnected"
    assert told["problems"] == {problem: 1}
    assert lines.count(f"• {problem}") == 1
    assert told["states"] == {"good": RUNNING, "bad": RUNNING}
    assert (bad.times_opened, told["lost"]) == (2, {"good": 0, "bad": 1})
    assert told["frames"]["good"] == pytest.approx(100, abs=3)
    assert told["frames"]["bad"] == pytest.approx(100 - 0.25 / 0.02, abs=4)  # away for a quarter of a second
    recording = McapRecording(tmp_path / "x.mcap")
    assert recording.complete
    assert {name: len(recording.stamps(name)) for name in ("good", "bad")} == told["frames"]


@pytest.mark.parametrize("error", [CameraError("camera 'file' failed: it is cut off"), RuntimeError("cut off")])
def test_a_file_that_fails_is_not_begun_anew(
    virtual: VirtualTime, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: Exception
) -> None:
    pytest.importorskip("foxglove")
    source = Camera("file", virtual, before=fails_at(10, error))
    source.reopens = False
    told, _ = recorded(monkeypatch, tmp_path / "x.mcap", [source, Camera("other", virtual, 20)])
    assert told["frames"] == {"file": 9, "other": 20}
    assert "cut off" in told["states"]["file"]
    assert told["states"]["other"] == ENDED
    assert ["cut off" in line for line in told["problems"]] == [True]


def test_what_is_found_while_a_recording_is_read_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    rig = Rig((DepthCamera("cam0", 8, 6, 8.0, 8.0, 4.0, 3.0),))
    with RecordingWriter(tmp_path / "rec", rig) as writer:
        for i in range(6):
            writer.write(10**9 + i * 20_000_000, {"cam0": np.full((6, 8), 100 + i, np.uint16)})
    damaged = sorted((tmp_path / "rec" / "cam0").glob("*.png"))[3]
    damaged.write_bytes(damaged.read_bytes()[:40])
    printed = io.StringIO()
    told = record(RecordSettings((str(tmp_path / "rec"),), tmp_path / "x.mcap"), Terminal(file=printed, width=300))
    assert (told["frames"], told["lost"], told["states"]) == ({"cam0": 5}, {"cam0": 1}, {"cam0": ENDED})
    assert [times for line, times in told["problems"].items() if damaged.name in line] == [1], told["problems"]
    assert damaged.name in printed.getvalue()


def test_a_source_that_still_opens_is_not_a_dead_one(
    virtual: VirtualTime, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("foxglove")
    slow = Camera("slow", virtual, opening_s=9.0)
    told, lines = recorded(monkeypatch, tmp_path / "x.mcap", [Camera("quick", virtual), slow], 1.0)
    assert told["seconds"] == pytest.approx(1.0, abs=0.3)
    assert told["frames"]["slow"] == pytest.approx(told["frames"]["quick"], abs=2)
    assert told["frames"]["slow"] > 30
    assert lines[0] == "• still opening: slow"


def test_a_camera_that_comes_later_is_recorded_too(
    virtual: VirtualTime, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("foxglove")

    class Late(Camera):
        def _open(self) -> DepthCamera:
            camera = super()._open()
            if self.times_opened < 4:
                raise CameraError("camera 'late' is not connected")
            return camera

    told, lines = recorded(monkeypatch, tmp_path / "x.mcap", [Late("late", virtual), Camera("there", virtual)], 2.0)
    assert told["frames"]["late"] == pytest.approx(told["frames"]["there"] - 0.75 / 0.02, abs=4)
    assert told["problems"] == {"camera 'late' is not connected": 1}
    assert lines.count("• camera 'late' is not connected") == 1
    assert McapRecording(tmp_path / "x.mcap").rig.names == ("there", "late")


class Heard:
    """Listens."""

    def __init__(self) -> None:
        self.cameras: list[str] = []
        self.frames: list[str] = []
        self.problems: list[str] = []

    def opened(self, camera: DepthCamera) -> None:
        self.cameras.append(camera.name)

    def deliver(self, frame: DepthFrame) -> None:
        self.frames.append(frame.camera)

    def note(self, problem: str) -> None:
        self.problems.append(problem)


def test_what_is_known_stays_as_it_was_when_it_was_taken(virtual: VirtualTime) -> None:
    heard = Heard()
    readers = MultiCameraReader([Camera("a", virtual)], None, heard)
    before = readers.states
    with readers:
        running = readers.states
        readers.add(Camera("b", virtual, 5))
        virtual.sleep(1.0)
        later = readers.states
        readers.remove("a")
        with pytest.raises(InputError, match="no camera 'a': there are b"):
            readers.remove("a")
    assert [(name, each.state) for name, each in before.items()] == [("a", "opening")]
    assert [(name, each.state) for name, each in running.items()] == [("a", RUNNING)]
    assert [(name, each.state, each.finished) for name, each in later.items()] == [
        ("a", RUNNING, False),
        ("b", ENDED, True),
    ]
    assert list(readers.states) == ["b"]
    assert heard.cameras == ["a", "b"]
    assert heard.frames.count("b") == 5
    with pytest.raises(TypeError):
        later["c"] = later["a"]  # pyright: ignore[reportIndexIssue] - what it shall refuse
    with pytest.raises(InputError, match="'c' cannot be added any more: reading was stopped"):
        readers.add(Camera("c", virtual))


def test_a_removed_camera_that_hangs_has_no_say_about_its_successor(virtual: VirtualTime) -> None:
    go_on = virtual.Event()

    def hang(number: int) -> None:
        if number == 3:
            go_on.wait()
            raise CameraError("it was unplugged")

    heard = Heard()
    with MultiCameraReader([Camera("a", virtual, before=hang)], None, heard) as readers:
        virtual.sleep(1.0)
        readers.remove("a")
        readers.add(Camera("a", virtual))
        virtual.sleep(1.0)
        go_on.set()
        virtual.sleep(1.0)
        assert readers.states["a"].state == RUNNING
        assert readers.states["a"].failures == 0


class Flickering(DepthSource):
    """Delivers as fast as it can, is silent now and then, and fails now and then."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.number = 0

    def _open(self) -> DepthCamera:
        return DepthCamera(self.name, 8, 6, 8.0, 8.0, 4.0, 3.0)

    def _read(self, timeout_s: float) -> DepthFrame:
        time.sleep(0.0005)
        self.number += 1
        if self.number % 3 == 0:
            raise FrameTimeoutError("nothing yet")
        if self.number % 50 == 0:
            raise RuntimeError("it was unplugged")
        now_ns = time.monotonic_ns()
        raw = np.full((6, 8), 1000 + self.number % 2, np.uint16)
        return DepthFrame(self.name, raw, now_ns, self.name, now_ns, self.number)

    def _close(self) -> None:
        pass


def test_whoever_looks_while_cameras_come_and_go_sees_one_consistent_picture() -> None:
    """Real threads, that take turns as often as Python can."""
    errors: list[str] = []
    looks = [0, 0]
    stop = threading.Event()
    reader = SyncedReader([Flickering("stays")], measure_rate=False)

    def come_and_go(prefix: str) -> None:
        number = 0
        while not stop.is_set():
            number += 1
            try:
                reader.add(Flickering(f"{prefix}{number % 3}"))
                time.sleep(0.003)
                reader.remove(f"{prefix}{number % 3}")
            except Exception as error:
                errors.append(repr(error))

    def look(index: int) -> None:
        while not stop.is_set():
            try:
                names = [status.name for status in reader.statuses()]
                if names[0] != "stays" or len(set(names)) != len(names):
                    errors.append(f"names {names}")
                if any(camera.name != name for name, camera in reader.cameras.items()):
                    errors.append("another camera's name")
                if any(times < 1 for times in reader.problems.counts().values()):
                    errors.append("a problem that was never so")
            except Exception as error:
                errors.append(repr(error))
            looks[index] += 1

    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with reader:
            threads = [threading.Thread(target=come_and_go, args=(prefix,)) for prefix in "xy"]
            threads += [threading.Thread(target=look, args=(index,)) for index in range(2)]
            for thread in threads:
                thread.start()
            stop.wait(0.8)
            stop.set()
            for thread in threads:
                thread.join(10)
    finally:
        sys.setswitchinterval(interval_s)
    assert errors == []
    assert min(looks) > 5
    assert next(status.name for status in reader.statuses()) == "stays"
