"""``depthmocap record``: any cameras into one MCAP file, each with a thread of its own."""

from __future__ import annotations

import contextlib
import dataclasses
import threading
import time
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.live import Live
from rich.table import Table

from depthmocap.capture.cameras import make_sources
from depthmocap.capture.depth_codec import Coding
from depthmocap.capture.mcap_writer import McapWriter, check_name
from depthmocap.capture.recorded import Pace
from depthmocap.capture.recorder import McapRecorder
from depthmocap.capture.recording import UnfitFrameError
from depthmocap.capture.source import CameraError, DepthSource, NoFrame, place, unsourced
from depthmocap.console import Terminal
from depthmocap.ending import finishing
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig, load_rig

_LOOK_S = 0.2
_RECORDING, _ENDED = "recording", "at its end"


@dataclasses.dataclass(frozen=True)
class RecordSettings:
    """Record depth cameras into an MCAP file until Ctrl-C, or until the sources end.

    Attributes:
        sources: cameras such as realsense:SERIAL or left=azure:SERIAL, each with a mode if you like
            ("azure:SERIAL?mode=nfov&fps=15", "realsense:SERIAL?size=848x480"), recordings, or synthetic.
        out: the new MCAP file (.mcap).
        rig: a rig.json that tells where the cameras stand; without it they stand at the origin (recordings know).
        seconds: stop after so long.
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
    state: str = _RECORDING

    def add(self, number: int | None) -> None:
        """Count a frame, and those that its number says were lost before it."""
        self.frames += 1
        if number is not None and self.last is not None:
            self.lost += max(number - self.last - 1, 0)
        self.last = number


def record(settings: RecordSettings, console: Console | None = None) -> dict[str, Any]:
    """Record; returns frames and losses by camera. A camera that fails is told, and the others go on.

    Raises:
        InputError: when no source can be opened as the rig says, no frame came, or the file cannot be written any
            further (every frame before is in it).
    """
    console = console or Terminal(stderr=True)
    if not settings.sources:
        raise InputError("name at least one camera: depthmocap cameras lists them")
    if settings.seconds is not None and not settings.seconds > 0:
        raise InputError(f"--seconds must be positive, got {settings.seconds}")
    check_name("--out", settings.out)
    rig = load_rig(settings.rig) if settings.rig else None
    sources = make_sources(settings.sources, Pace(1.0 if settings.realtime else 0.0))
    with contextlib.ExitStack() as stack:
        cameras, failed = _open(sources, rig, stack)
        problems = [f"{failure}; going on without it" for failure in failed.values()]
        problems += [] if rig is None else unsourced(rig, [source.name for source in sources])
        sources = [source for source in sources if source.name not in failed]
        problems += [source.problems.popleft() for source in sources for _ in range(len(source.problems))]
        for problem in problems:
            console.print(f"• {problem}")
        backgrounds = {s.name: raw for s in sources if (raw := s.raw_background) is not None}
        up = rig.up if rig else sources[0].up
        writer = stack.enter_context(McapWriter(settings.out, Rig(cameras, up), backgrounds, settings.coding))
        told = _record(sources, writer, settings.seconds, console)
        return told | {"states": failed | told["states"], "problems": problems}


def _open(
    sources: list[DepthSource], rig: Rig | None, stack: contextlib.ExitStack
) -> tuple[tuple[DepthCamera, ...], dict[str, str]]:
    """The cameras that could be opened and fit the rig, and why others were not, by name.

    Raises:
        InputError: when there is none.
    """
    cameras: list[DepthCamera] = []
    failed: dict[str, str] = {}
    for source in sources:
        try:
            stack.enter_context(source)
            cameras.append(source.camera if rig is None else place(source.camera, rig))
        except InputError as error:
            failed[source.name] = str(error)
    if not cameras:
        raise InputError(f"no camera could be opened ({'; '.join(failed.values())})")
    return tuple(cameras), failed


def _record(sources: list[DepthSource], writer: McapWriter, seconds: float | None, console: Console) -> dict[str, Any]:
    counts = {source.name: _Count() for source in sources}
    stop, fault = threading.Event(), list[InputError]()
    recorder = McapRecorder(writer, {})

    def run(source: DepthSource, count: _Count) -> None:
        while not stop.is_set():
            try:
                frame = source.read(_LOOK_S)
            except NoFrame:
                continue
            except CameraError as error:
                count.state = str(error)
                return
            if frame is None:
                count.state = _ENDED
                return
            try:
                recorder.write(frame)
            except UnfitFrameError:
                count.lost += 1
                continue
            except InputError as error:
                fault.append(error)
                stop.set()
                return
            count.add(frame.number)

    # Daemons, because a call of an SDK that never returns must not keep the process alive.
    threads = [
        threading.Thread(target=run, args=(source, counts[source.name]), name=source.name, daemon=True)
        for source in sources
    ]
    start = time.monotonic()
    with Live(console=console, refresh_per_second=4) as live:
        try:
            for thread in threads:
                thread.start()
            while any(thread.is_alive() for thread in threads) and not stop.is_set():
                live.update(_table(counts, time.monotonic() - start))
                if seconds is not None and time.monotonic() - start >= seconds:
                    break
                time.sleep(min(_LOOK_S, seconds or _LOOK_S))
        except KeyboardInterrupt:
            pass
        finally:
            with finishing():
                stop.set()
                for thread in threads:
                    thread.join(5 * _LOOK_S)
            live.update(_table(counts, time.monotonic() - start))
    if fault:
        raise fault[0]
    if not any(writer.frames.values()):
        raise InputError(
            f"no frame came in {time.monotonic() - start:.1f} s: {_why_none(counts)}; {writer.path} holds no frame"
        )
    console.print(f"{sum(writer.frames.values())} frames are in {writer.path}")
    return {
        "seconds": time.monotonic() - start,
        "frames": dict(writer.frames),
        "lost": {name: count.lost for name, count in counts.items()},
        "states": {name: count.state for name, count in counts.items()},
    }


def _why_none(counts: dict[str, _Count]) -> str:
    """What is known of cameras that gave no frame for the file."""
    told = [count.state for count in counts.values() if count.state not in (_RECORDING, _ENDED)]
    told += [f"{count.lost} of {name!r} did not fit and were left out" for name, count in counts.items() if count.lost]
    return "; ".join(told) or "are the cameras running?"


def _table(counts: dict[str, _Count], seconds: float) -> Table:
    table = Table(title=f"{seconds:.0f} s", title_justify="left")
    for column in ("camera", "frames", "a second", "lost", "state"):
        table.add_column(column)
    for name, count in counts.items():
        rate = count.frames / max(seconds, 1e-9)
        table.add_row(name, str(count.frames), f"{rate:.1f}", str(count.lost), count.state)
    return table
