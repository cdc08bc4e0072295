"""``depthmocap convert`` and ``recover``: copy recordings into other formats, repair them; and what is in them."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from jaxtyping import UInt16
from numpy import ndarray
from rich.console import Console
from rich.progress import Progress

from depthmocap.core.console import Terminal
from depthmocap.core.interrupts import deferred_interrupts
from depthmocap.errors import InputError
from depthmocap.recordings.depth_codec import Coding
from depthmocap.recordings.mcap_file import McapFile
from depthmocap.recordings.mcap_messages import COMPRESSED_IMAGE, RAW_IMAGE
from depthmocap.recordings.mcap_writer import McapSink, McapWriter, check_name
from depthmocap.recordings.open_recording import open_recording
from depthmocap.recordings.recording import Recording
from depthmocap.recordings.recording_writer import RecordingWriter

#: Name endings of camera makers' files: every command takes such a name for a file, so no folder may have it.
FOREIGN = (".mkv", ".oni", ".bag", ".db3")


@dataclasses.dataclass(frozen=True)
class ConvertSettings:
    """Copy a recording into another form; depth, times, rig, backgrounds and true joints stay as they are.

    Attributes:
        source: a recording folder or an MCAP file.
        out: the new recording: an MCAP file if its name ends in .mcap, else a folder.
        coding: of the depth in MCAP. png and raw are larger, but other viewers show them.
    """

    source: tyro.conf.Positional[Path]
    out: tyro.conf.Positional[Path]
    coding: Coding = "delta-zstd"


def timeline(recording: Recording) -> list[tuple[int, str]]:
    """Timestamp (ns, the shared clock) and camera name of all frames, in order of time."""
    return sorted((stamp, name) for name in recording.rig.names for stamp in recording.stamps(name))


def convert(settings: ConvertSettings, console: Console | None = None) -> dict[str, Any]:
    """Convert a recording; returns the numbers of frames copied, frames lost and true poses.

    Raises:
        InputError: when the source is no recording, or when the new recording exists, cannot be written, or has the
            name ending of another kind of file.
    """
    console = console or Terminal(stderr=True)
    if settings.out.suffix.lower() in FOREIGN:
        raise InputError(f"the new recording must be a file that ends in .mcap, or a folder, got {settings.out}")
    source = open_recording(settings.source)
    backgrounds = {name: raw for name in source.rig.names if (raw := source.raw_background(name)) is not None}
    lost: list[str] = []
    frames = 0

    def read(progress: Progress) -> Iterator[tuple[int, str, UInt16[ndarray, "_ _"]]]:
        nonlocal frames
        for stamp, name in progress.track(timeline(source), description="converting"):
            try:
                raw = source.raw(name, stamp)
            except InputError as error:
                lost.append(str(error))
                continue
            yield stamp, name, raw
            frames += 1

    truth = source.truth_rows()
    with Progress(console=console) as progress:
        if settings.out.suffix.lower() == ".mcap":
            start_ns = timeline(source)[0][0]
            writer = McapWriter(settings.out, source.rig, backgrounds, settings.coding, start_ns=start_ns)
            with whole_or_removed(writer):
                for stamp, name, raw in read(progress):
                    timestamp_ns, clock = source.device_time(name, stamp)
                    writer.write(name, timestamp_ns, raw, stamp, clock)
                for stamp, joints in truth:
                    writer.write_truth(stamp, joints)
        else:
            with RecordingWriter(settings.out, source.rig, backgrounds, copy_of=settings.source) as writer:
                for stamp, name, raw in read(progress):
                    writer.write(stamp, {name: raw})
                for stamp, joints in truth:
                    writer.write(stamp, {}, joints)
    for problem in [*source.problems, *lost]:
        console.print(f"• {problem}")
    console.print(f"{frames} frames of {len(source.rig.names)} cameras are in {settings.out}")
    return {"frames": frames, "lost": len(lost), "truth_rows": len(truth)}


@contextlib.contextmanager
def whole_or_removed(new: McapWriter | McapSink) -> Iterator[None]:
    """Close a new file; remove it if it is incomplete, because its source still exists.

    Raises:
        InputError: when it cannot be written.
    """
    try:
        yield
        with deferred_interrupts():
            new.close()
            new.check()
    except BaseException as error:
        new.close()
        new.path.unlink(missing_ok=True)
        if isinstance(error, InputError) and new.fault is not None:
            raise InputError(f"cannot write {new.path}: {new.fault.strerror}") from None
        raise


@dataclasses.dataclass(frozen=True)
class RecoverSettings:
    """Make a whole MCAP file of one that was cut off: by a kill, a full disk, a pulled plug.

    Attributes:
        source: the MCAP file; it is not changed.
        out: the new file (.mcap).
    """

    source: tyro.conf.Positional[Path]
    out: tyro.conf.Positional[Path]


def recover(settings: RecoverSettings, console: Console | None = None) -> dict[str, Any]:
    """Copy everything that can be read into a new file, message by message as it was written.

    Raises:
        InputError: when nothing is in the file, or the new one exists, cannot be written, or is not named as MCAP.
    """
    console = console or Terminal(stderr=True)
    check_name("the new file", settings.out)
    frames = damaged = 0
    with McapFile(settings.source) as file:
        if not file.messages:
            raise InputError(f"{settings.source} holds no message: it was cut off before the first frame")
        sink = McapSink(settings.out)
        with whole_or_removed(sink):
            for name, entries in file.metadata.items():
                sink.metadata(name, entries)
            channels: dict[int, Any] = {}
            for channel in file.channels.values():
                schema = None
                if channel.schema_name or channel.schema_encoding or channel.schema:
                    schema = sink.sdk.Schema(
                        name=channel.schema_name, encoding=channel.schema_encoding, data=channel.schema
                    )
                channels[channel.id] = sink.channel(channel.topic, channel.encoding, channel.metadata, schema)
            for message in file.messages:
                channel = file.channels[message.channel]
                try:
                    payload = file.payload(message)
                except InputError:
                    damaged += 1
                    continue
                channels[message.channel].log(payload, message.log_time_ns, None)
                sink.flush()
                is_image = channel.schema_name in (RAW_IMAGE, COMPRESSED_IMAGE)
                frames += is_image and channel.metadata.get("kind") != "background"
        for problem in file.problems:
            console.print(f"• {problem}")
        lost_bytes = 0 if file.complete else settings.source.stat().st_size - file.sound_end
    state = "was whole already" if lost_bytes == 0 and file.complete else f"ended with {lost_bytes} bytes of no use"
    console.print(
        f"{frames} frames are in {settings.out}; {settings.source} {state}, {damaged} messages were damaged",
    )
    return {"frames": frames, "damaged": damaged, "lost_bytes": lost_bytes}


def recording_info(recording: Recording) -> dict[str, Any]:
    """The summary that ``depthmocap info`` prints. Gaps in a camera's timestamps count as lost frames."""
    path = recording.path
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
    cameras = {}
    for camera in recording.rig.cameras:
        stamps = np.array(recording.stamps(camera.name), np.int64)
        steps = np.diff(stamps)
        period = float(np.median(steps)) if len(steps) else float("nan")
        cameras[camera.name] = {
            "size": [camera.width, camera.height],
            "depth_unit_m": camera.depth_unit_m,
            "time_offset_s": camera.time_offset_s,
            "frames": len(stamps),
            "frames_per_second": 1e9 / period if period > 0 else None,
            "lost": int(np.maximum(np.rint(steps / period) - 1, 0).sum()) if period > 0 else 0,
            "clock": recording.device_time(camera.name, int(stamps[0]))[1] if len(stamps) else None,
            "background": recording.raw_background(camera.name) is not None,
        }
    stored = sum(file.stat().st_size for file in files)
    raw = sum(2 * c["size"][0] * c["size"][1] * c["frames"] for c in cameras.values())
    first, last = timeline(recording)[0][0], timeline(recording)[-1][0]
    return {
        "recording": str(path),
        "complete": recording.complete,
        "up": recording.up,
        "sets": len(recording),
        "seconds": (last - first) / 1e9,
        "megabytes": stored / 1e6,
        "compression": raw / stored,
        "true_joints": len(recording.truth_rows()),
        "cameras": cameras,
        "problems": recording.problems,
    }
