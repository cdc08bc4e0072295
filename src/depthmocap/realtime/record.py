"""``depthmocap record``: any cameras into one MCAP file, each with a thread of its own."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.live import Live
from rich.table import Table

from depthmocap.cameras.playback_clock import PlaybackClock
from depthmocap.cameras.registry import make_sources
from depthmocap.cameras.source import DepthFrame
from depthmocap.core.console import Terminal
from depthmocap.core.interrupts import finishing
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig, load_rig
from depthmocap.realtime.mcap_recorder import McapRecorder, not_recorded
from depthmocap.realtime.multi_camera_reader import ENDED, LOOK_S, OPENING, RUNNING, SILENT, Readers, SourceState
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
class _Count:
    """What came from one camera. Only its own thread writes to it."""

    frames: int = 0
    lost: int = 0
    last: int | None = None

    def add(self, number: int | None) -> None:
        """Count a frame, and those that its number says were lost before it."""
        self.frames += 1
        if number is not None and self.last is not None:
            self.lost += max(number - self.last - 1, 0)
        self.last = number


class _Writing:
    """Takes what the reading threads bring.

    Attributes:
        recorder: writes the frames; set it before any comes.
        fault: why the file cannot be written any further; None while it can.
    """

    def __init__(self, names: list[str]) -> None:
        self.problems, self.counts = Problems(), {name: _Count() for name in names}
        self.recorder: McapRecorder | None = None
        self.fault: InputError | None = None

    def opened(self, camera: DepthCamera) -> None:
        """The recorder asks for cameras itself."""

    def note(self, problem: str) -> None:
        self.problems.add(problem)

    def deliver(self, frame: DepthFrame) -> None:
        if self.fault is not None:
            return
        assert self.recorder is not None
        count = self.counts[frame.camera]
        try:
            self.recorder.write(frame)
        except UnfitFrameError:
            count.lost += 1
            self.note(not_recorded(frame))
        except InputError as error:
            self.fault = error
        else:
            count.add(frame.number)


def record(settings: RecordSettings, console: Console | None = None) -> dict[str, Any]:
    """Record; returns frames, losses and states by camera, and how often there was which problem.

    A camera that fails is told, and opened again until it is there; the others go on.

    Raises:
        InputError: when no source can be opened as the rig says, no frame came, or the file cannot be written any
            further (every frame before is in it).
    """
    console = console or Terminal(stderr=True)

    def tell(line: str) -> None:
        console.print(f"• {line}")

    if not settings.sources:
        raise InputError("name at least one camera: depthmocap cameras lists them")
    if settings.seconds is not None and not settings.seconds > 0:
        raise InputError(f"--seconds must be positive, got {settings.seconds}")
    check_name("--out", settings.out)
    rig = load_rig(settings.rig) if settings.rig else None
    sources = make_sources(settings.sources, PlaybackClock(1.0 if settings.realtime else 0.0), tell)
    writing = _Writing([source.name for source in sources])
    readers = Readers(sources, rig, writing, held=True)
    with contextlib.ExitStack() as stack:
        stack.callback(readers.stop)
        readers.start(tell)
        cameras = readers.cameras
        opened = [source for source in sources if source.name in cameras]
        backgrounds = {source.name: raw for source in opened if (raw := source.raw_background) is not None}
        seen = Rig(tuple(cameras.values()), rig.up if rig else opened[0].up)
        writer = stack.enter_context(McapWriter(settings.out, seen, backgrounds, settings.coding))
        stack.callback(readers.stop)  # before the file is closed, into which they write
        writing.recorder = McapRecorder(writer, readers.camera)
        seconds = _follow(readers, writing, settings.seconds, console)
    states = {name: known.state for name, known in readers.known.items()}
    problems = writing.problems.told()
    if writing.fault is not None:
        raise writing.fault
    if not any(writer.frames.values()):
        raise InputError(
            f"no frame came in {seconds:.1f} s: {_why_none(states, writing.counts)}; {writer.path} holds no frame"
        )
    for problem, times in problems.items():
        if times > 1:
            tell(f"{problem} ({times} times)")
    console.print(f"{sum(writer.frames.values())} frames are in {writer.path}")
    return {
        "seconds": seconds,
        "frames": dict(writer.frames),
        "lost": {name: writing.counts[name].lost for name in writer.frames},
        "states": states,
        "problems": problems,
    }


def _follow(readers: Readers, writing: _Writing, seconds: float | None, console: Console) -> float:
    """Let the cameras deliver until the end, and show how they do; returns how long that was."""
    told: set[str] = set()
    begun_s = time.monotonic()

    def show() -> float:
        passed_s = time.monotonic() - begun_s
        live.update(_table(readers.known, writing.counts, passed_s))
        for problem in writing.problems.told():
            if problem not in told:  # as soon as it is known, above the table
                told.add(problem)
                console.print(f"• {problem}")
        return passed_s

    with Live(console=console, refresh_per_second=4) as live:
        try:
            readers.go()
            while not readers.over and writing.fault is None:
                passed_s = show()
                if seconds is not None and passed_s >= seconds:
                    break
                time.sleep(min(LOOK_S, seconds or LOOK_S))
        except KeyboardInterrupt:
            pass
        finally:
            with finishing():
                readers.stop()
            passed_s = show()
    return passed_s


def _why_none(states: Mapping[str, str], counts: Mapping[str, _Count]) -> str:
    """What is known of cameras that gave no frame for the file."""
    told = [state for state in states.values() if state not in (RUNNING, SILENT, OPENING, ENDED)]
    told += [f"{count.lost} of {name!r} did not fit and were left out" for name, count in counts.items() if count.lost]
    return joined(told, 3) or "are the cameras running?"


def _table(known: Mapping[str, SourceState], counts: Mapping[str, _Count], seconds: float) -> Table:
    table = Table(title=f"{seconds:.0f} s", title_justify="left")
    for column in ("camera", "frames", "a second", "lost", "state"):
        table.add_column(column)
    for name, count in counts.items():
        rate = count.frames / max(seconds, 1e-9)
        table.add_row(name, str(count.frames), f"{rate:.1f}", str(count.lost), known[name].state)
    return table
