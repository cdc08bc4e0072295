"""``depthmocap record``: records any cameras into one MCAP file, each read in a thread of its own."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.live import Live
from rich.table import Table

from depthmocap.cameras.playback_clock import PlaybackClock
from depthmocap.cameras.registry import make_sources
from depthmocap.cameras.source import DepthFrame, DepthSource
from depthmocap.core.console import Terminal
from depthmocap.core.interrupts import deferred_interrupts
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig, load_rig
from depthmocap.realtime.mcap_recorder import McapRecorder, not_recorded_problem
from depthmocap.realtime.multi_camera_reader import (
    ENDED,
    OPENING,
    POLL_S,
    RUNNING,
    SILENT,
    MultiCameraReader,
    SourceState,
)
from depthmocap.realtime.problems import Problems
from depthmocap.recordings.depth_codec import Coding
from depthmocap.recordings.mcap_writer import McapWriter, check_name
from depthmocap.recordings.recording_layout import UnfitFrameError
from depthmocap.text import joined


@dataclasses.dataclass(frozen=True)
class RecordSettings:
    """Record depth cameras into an MCAP file until Ctrl-C, or until the sources end.

    Attributes:
        sources: cameras such as realsense:SERIAL or left=azure:SERIAL, each with a mode if you like
            ("azure:SERIAL?mode=nfov&fps=15", "realsense:SERIAL?size=848x480"), recordings, or synthetic.
        out: the new MCAP file (.mcap).
        rig: a rig.json that tells where the cameras stand; without it they stand at the origin (recordings know).
        seconds: stop so long after the cameras were opened.
        coding: of the depth; png and raw are larger, but other viewers show them.
        realtime: play recordings at their own speed.
    """

    sources: tyro.conf.Positional[tuple[str, ...]]
    out: Path
    rig: Path | None = None
    seconds: float | None = None
    coding: Coding = "delta-zstd"
    realtime: bool = False


@dataclasses.dataclass
class _FrameCount:
    """Counts the frames of one camera. Only its own thread writes to it."""

    frames: int = 0
    lost: int = 0
    last: int | None = None

    def add(self, number: int | None) -> None:
        """Count a frame, and the lost frames before it, which its number tells."""
        self.frames += 1
        if number is not None and self.last is not None:
            self.lost += max(number - self.last - 1, 0)
        self.last = number


class _RecordingListener:
    """Records the frames that the reading threads deliver.

    Attributes:
        problems: messages for the user.
        counts: frames by camera.
        recorder: writes the frames; set it before the first one.
        error: why the file cannot be written any further; None while it can.
    """

    def __init__(self, names: list[str]) -> None:
        self.problems, self.counts = Problems(), {name: _FrameCount() for name in names}
        self.recorder: McapRecorder | None = None
        self.error: InputError | None = None

    def opened(self, camera: DepthCamera) -> None:
        """Do nothing: the recorder itself asks for cameras."""

    def note(self, problem: str) -> None:
        self.problems.add(problem)

    def deliver(self, frame: DepthFrame) -> None:
        if self.error is not None:
            return
        assert self.recorder is not None
        count = self.counts[frame.camera]
        try:
            self.recorder.write(frame)
        except UnfitFrameError:
            count.lost += 1
            self.note(not_recorded_problem(frame))
        except InputError as error:
            self.error = error
        else:
            count.add(frame.number)


def record(settings: RecordSettings, console: Console | None = None) -> dict[str, Any]:
    """Record; returns frames, losses and states by camera, and how often each problem occurred.

    A camera that fails is reported, and opened again until it runs; the others continue.

    Raises:
        InputError: when no source can be opened as the rig says, no frame came, or the file cannot be written any
            further (every frame before is in it).
    """
    console = console or Terminal(stderr=True)

    def tell(line: str) -> None:
        console.print(f"• {line}")

    _check(settings)
    rig = load_rig(settings.rig) if settings.rig else None
    sources = make_sources(settings.sources, PlaybackClock(1.0 if settings.realtime else 0.0), tell)
    listener = _RecordingListener([source.name for source in sources])
    reader = MultiCameraReader(sources, rig, listener, paused=True)
    with contextlib.ExitStack() as stack:
        stack.callback(reader.stop)
        reader.start(tell)
        writer = stack.enter_context(_open_writer(settings, rig, sources, reader.cameras))
        stack.callback(reader.stop)  # before the file is closed, into which the threads write
        listener.recorder = McapRecorder(writer, reader.camera)
        seconds = _show_until_end(reader, listener, settings.seconds, console)
    states = {name: source.state for name, source in reader.states.items()}
    problems = listener.problems.counts()
    if listener.error is not None:
        raise listener.error
    if not any(writer.frames.values()):
        raise InputError(
            f"no frame came in {seconds:.1f} s: {_reason_without_frames(states, listener.counts)}; "
            f"{writer.path} holds no frame"
        )
    for problem, times in problems.items():
        if times > 1:
            tell(f"{problem} ({times} times)")
    console.print(f"{sum(writer.frames.values())} frames are in {writer.path}")
    return {
        "seconds": seconds,
        "frames": dict(writer.frames),
        "lost": {name: listener.counts[name].lost for name in writer.frames},
        "states": states,
        "problems": problems,
    }


def _check(settings: RecordSettings) -> None:
    if not settings.sources:
        raise InputError("name at least one camera: depthmocap cameras lists them")
    if settings.seconds is not None and not settings.seconds > 0:
        raise InputError(f"--seconds must be positive, got {settings.seconds}")
    check_name("--out", settings.out)


def _open_writer(
    settings: RecordSettings, rig: Rig | None, sources: Sequence[DepthSource], cameras: Mapping[str, DepthCamera]
) -> McapWriter:
    """The new file, with the opened cameras and the backgrounds that their sources know."""
    opened = [source for source in sources if source.name in cameras]
    backgrounds = {source.name: raw for source in opened if (raw := source.raw_background) is not None}
    world = rig or opened[0]
    recorded_rig = Rig(tuple(cameras.values()), world.up, world.area_m)
    return McapWriter(settings.out, recorded_rig, backgrounds, settings.coding)


def _show_until_end(
    reader: MultiCameraReader, listener: _RecordingListener, seconds: float | None, console: Console
) -> float:
    """Let the cameras deliver until the end, and show their states; returns the seconds that this took."""
    shown: set[str] = set()
    start_s = time.monotonic()

    def show() -> float:
        passed_s = time.monotonic() - start_s
        live.update(_table(reader.states, listener.counts, passed_s))
        for problem in listener.problems.counts():
            if problem not in shown:  # at once, above the table
                shown.add(problem)
                console.print(f"• {problem}")
        return passed_s

    with Live(console=console, refresh_per_second=4) as live:
        try:
            reader.resume()
            while not reader.finished and listener.error is None:
                passed_s = show()
                if seconds is not None and passed_s >= seconds:
                    break
                time.sleep(min(POLL_S, seconds or POLL_S))
        except KeyboardInterrupt:
            pass
        finally:
            with deferred_interrupts():
                reader.stop()
            passed_s = show()
    return passed_s


def _reason_without_frames(states: Mapping[str, str], counts: Mapping[str, _FrameCount]) -> str:
    """Why no frame came, as far as the states of the cameras tell."""
    reasons = [state for state in states.values() if state not in (RUNNING, SILENT, OPENING, ENDED)]
    reasons += [
        f"{count.lost} of {name!r} did not fit and were left out" for name, count in counts.items() if count.lost
    ]
    return joined(reasons, 3) or "are the cameras running?"


def _table(source_states: Mapping[str, SourceState], counts: Mapping[str, _FrameCount], seconds: float) -> Table:
    table = Table(title=f"{seconds:.0f} s", title_justify="left")
    for column in ("camera", "frames", "a second", "lost", "state"):
        table.add_column(column)
    for name, count in counts.items():
        rate = count.frames / max(seconds, 1e-9)
        table.add_row(name, str(count.frames), f"{rate:.1f}", str(count.lost), source_states[name].state)
    return table
