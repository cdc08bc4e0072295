"""``depthmocap replay``: plays a recording at its own speed for Foxglove, or any viewer of its protocol."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import tyro
from rich.console import Console
from rich.progress import Progress

from depthmocap.cameras.playback_clock import PlaybackClock
from depthmocap.core.console import Terminal
from depthmocap.errors import InputError
from depthmocap.recordings.convert import timeline
from depthmocap.recordings.mcap_writer import Topics, load_sdk
from depthmocap.recordings.open_recording import open_recording
from depthmocap.recordings.recording import Recording

#: Rig and calibration are sent again after so much recording time (ns), because viewers may connect at any time.
_DESCRIBE_NS = 1_000_000_000


@dataclasses.dataclass(frozen=True)
class ReplaySettings:
    """Play a recording for viewers: in Foxglove, open the connection ws://localhost:PORT.

    Attributes:
        recording: a recording folder or an MCAP file.
        speed: times its own speed.
        host: address to serve on; 0.0.0.0 lets other machines watch.
        port: of the server; 0 takes any that is free.
        loop: play it again and again, until Ctrl-C.
    """

    recording: tyro.conf.Positional[Path]
    speed: float = 1.0
    host: str = "127.0.0.1"
    port: int = 8765
    loop: bool = False


def play(
    recording: Recording, topics: Topics, playback_clock: PlaybackClock, advance: Callable[[], None] = lambda: None
) -> int:
    """Publish every frame and the true joints when they are due; returns the number of readable frames."""
    frames, described_ns = 0, None
    truth = recording.truth_rows()
    for stamp, name in timeline(recording):
        while not playback_clock.wait(stamp, 1.0):
            pass
        if described_ns is None or stamp - described_ns >= _DESCRIBE_NS:
            topics.describe(stamp)
            described_ns = stamp
        while truth and truth[0][0] <= stamp:
            topics.truth(*truth.pop(0))
        advance()
        try:
            raw = recording.raw(name, stamp)
        except InputError:
            continue
        topics.depth(name, topics.image(name, stamp, raw), stamp)
        frames += 1
    return frames


def replay(settings: ReplaySettings, console: Console | None = None) -> int:
    """Serve the recording; returns the number of frames of the last round.

    Raises:
        InputError: when the path is no recording, the port is taken or impossible, or the speed is not positive.
    """
    console = console or Terminal(stderr=True)
    if not settings.speed > 0:
        raise InputError(f"--speed must be positive, got {settings.speed}")
    if not 0 <= settings.port <= 65535:
        raise InputError(f"--port must be from 0 to 65535, got {settings.port}")
    recording = open_recording(settings.recording)
    sdk = load_sdk()
    context = sdk.Context()
    try:
        server = sdk.start_server(host=settings.host, port=settings.port, name=settings.recording.name, context=context)
    except RuntimeError as error:
        raise InputError(f"cannot serve on {settings.host}:{settings.port} ({error}): choose another --port") from None
    topics = Topics(sdk, context, recording.rig, "raw")
    console.print(f"open ws://{settings.host}:{server.port} in Foxglove; Ctrl-C ends")
    try:
        with Progress(console=console) as progress:
            task = progress.add_task("playing", total=len(timeline(recording)))
            while True:
                frames = play(recording, topics, PlaybackClock(settings.speed), lambda: progress.advance(task))
                progress.reset(task)
                if not settings.loop:
                    return frames
    finally:
        server.stop()
