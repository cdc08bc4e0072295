"""Several recordings as one take, on one clock."""

from __future__ import annotations

import contextlib
import dataclasses
import heapq
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt16
from numpy import ndarray
from rich.console import Console
from rich.progress import Progress

from depthmocap.errors import InputError
from depthmocap.geometry import Rig, z_up_from
from depthmocap.recordings.convert import FOREIGN, timeline, whole_or_removed
from depthmocap.recordings.depth_codec import Coding
from depthmocap.recordings.mcap_writer import McapWriter
from depthmocap.recordings.recording import Recording
from depthmocap.recordings.recording_writer import RecordingWriter


@dataclasses.dataclass(frozen=True)
class ClockMap:
    """The clock of a recording on the take's: ``start_ns`` becomes ``take_ns``, and runs faster by the ratio
    ``drift``."""

    start_ns: int
    take_ns: int
    drift: float = 0.0

    def __call__(self, stamp_ns: int) -> int:
        """A timestamp (ns) on the take's clock."""
        since = stamp_ns - self.start_ns
        return self.take_ns + since + round(since * self.drift)


def check_new_take(out: Path, recordings: Sequence[Recording]) -> None:
    """Check, before any work, that the recordings can be one take of this name.

    Raises:
        InputError: when it exists or has the name of another kind of file, or cameras of two recordings share a name.
    """
    if out.suffix.lower() in FOREIGN:
        raise InputError(f"the take must be a file that ends in .mcap, or a folder, got {out}")
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise InputError(f"{out} exists already: choose a new file or folder for the take")
    owner: dict[str, Path] = {}
    for recording in recordings:
        for name in recording.rig.names:
            if name in owner:
                raise InputError(
                    f"both {owner[name]} and {recording.path} have a camera {name!r}: rename one (an MKV's camera is "
                    "named after the file; in a recording folder, rename the camera's folder and its name in rig.json)"
                )
            owner[name] = recording.path


def write_take(
    out: Path, recordings: Sequence[Recording], clocks: Sequence[ClockMap], coding: Coding, console: Console
) -> tuple[int, list[str]]:
    """Write the frames and backgrounds of all recordings, each with its times on the take's clock: an MCAP file if the
    name ends in .mcap, else a folder. Poses are turned to Z up; true joints are left out.

    Returns:
        The number of frames, and a line for each frame that could not be read.

    Raises:
        InputError: when it cannot be written.
    """
    areas = {recording.area_m if recording.up == "z" else () for recording in recordings}
    cameras = tuple(camera for recording in recordings for camera in _z_up(recording).cameras)
    rig = Rig(cameras, area_m=areas.pop() if len(areas) == 1 else ())
    backgrounds = {
        name: raw
        for recording in recordings
        for name in recording.rig.names
        if (raw := recording.raw_background(name)) is not None
    }
    lost: list[str] = []
    frames = 0
    total = sum(len(timeline(recording)) for recording in recordings)

    def read(progress: Progress) -> Iterator[tuple[int, str, UInt16[ndarray, "_ _"]]]:
        nonlocal frames
        task = progress.add_task("writing", total=total)
        for stamp, name, index, stored_ns in heapq.merge(*map(_stamps, range(len(clocks)), recordings, clocks)):
            progress.advance(task)
            try:
                raw = recordings[index].raw(name, stored_ns)
            except InputError as error:
                lost.append(str(error))
                continue
            yield stamp, name, raw
            frames += 1

    with Progress(console=console, transient=True) as progress, contextlib.ExitStack() as stack:
        if out.suffix.lower() == ".mcap":
            first_ns = min(
                clock(timeline(recording)[0][0]) for clock, recording in zip(clocks, recordings, strict=True)
            )
            mcap = McapWriter(out, rig, backgrounds, coding, start_ns=first_ns)
            stack.enter_context(whole_or_removed(mcap))
            for stamp, name, raw in read(progress):
                mcap.write(name, stamp, raw)
        else:
            folder = stack.enter_context(RecordingWriter(out, rig, backgrounds))
            for stamp, name, raw in read(progress):
                folder.write(stamp, {name: raw})
    return frames, lost


def _stamps(index: int, recording: Recording, clock: ClockMap) -> Iterator[tuple[int, str, int, int]]:
    """Time on the take's clock, camera, recording, and own time of every frame, in order."""
    return ((clock(stamp), name, index, stamp) for stamp, name in timeline(recording))


def _z_up(recording: Recording) -> Rig:
    """The recording's rig in a Z-up world."""
    turn = np.eye(4)
    turn[:3, :3] = z_up_from(recording.up)
    return Rig(
        tuple(
            dataclasses.replace(camera, world_from_camera=turn @ camera.world_from_camera)
            for camera in recording.rig.cameras
        )
    )
