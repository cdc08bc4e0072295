"""``depthmocap replay``: plays a recording at its own speed, and what was found in it, for other programs."""

from __future__ import annotations

import collections
import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import tyro
from rich.console import Console
from rich.progress import Progress

from depthmocap.body.skeleton import JOINTS
from depthmocap.cameras.playback_clock import PlaybackClock
from depthmocap.core.console import Terminal
from depthmocap.core.settings import check_above_0
from depthmocap.errors import InputError
from depthmocap.exporting.stored_result import StoredResult, read_result
from depthmocap.frames import FrameSet, Pose
from depthmocap.offline.pipeline import PersonResult, Result
from depthmocap.pose.cloud import merge_views
from depthmocap.recordings.convert import timeline
from depthmocap.recordings.mcap_writer import Topics
from depthmocap.recordings.open_recording import open_recording
from depthmocap.recordings.recording import Recording
from depthmocap.streaming.addresses import open_stream
from depthmocap.streaming.foxglove_stream import DESCRIBE_NS, FoxgloveStream
from depthmocap.streaming.outlets import Outlets
from depthmocap.streaming.stream_protocol import Marker, StreamSetup

#: Where a recording is shown if nothing else is said.
FOXGLOVE = "foxglove://127.0.0.1:8765"


@dataclasses.dataclass(frozen=True)
class ReplaySettings:
    """Play a recording, and the joints that were found in it, for other programs: by default for Foxglove, where you
    open the connection ws://localhost:8765.

    Attributes:
        recording: a recording folder or an MCAP file.
        result: a folder that run has written: its joints are played, with their corrections and markers.
        stream: where to: foxglove://HOST:PORT shows the recording and the joints; osc://HOST:PORT, vmc://HOST:PORT,
            ws://HOST:PORT and lsl://NAME take the joints, as those of live do. A server is for this machine;
            0.0.0.0 lets others connect. May be given several times.
        speed: times its own speed.
        loop: play it again and again, until Ctrl-C.
    """

    recording: tyro.conf.Positional[Path]
    result: Path | None = None
    stream: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    speed: float = 1.0
    loop: bool = False


#: What is due at a time of the recording (ns).
_Event = tuple[int, Callable[[], None]]


def play(
    recording: Recording,
    topics: Sequence[Topics],
    playback_clock: PlaybackClock,
    advance: Callable[[], None] = lambda: None,
    others: Sequence[_Event] = (),
) -> int:
    """Publish every frame and the true joints when they are due; returns the number of readable frames.

    Args:
        advance: is called with every frame.
        others: what else is due, each before the frames of its time.
    """
    frames = 0

    def describe(stamp: int) -> int:
        for topic in topics:
            topic.describe(stamp)
        return stamp + DESCRIBE_NS

    def tell_truth(stamp: int, joints: np.ndarray) -> None:
        for topic in topics:
            topic.truth(stamp, joints)

    truth = [(stamp, lambda row=(stamp, joints): tell_truth(*row)) for stamp, joints in recording.truth_rows()]
    waiting = collections.deque(sorted([*truth, *others], key=lambda event: event[0]))
    due_ns: int | None = None
    for stamp, name in timeline(recording):
        due_ns = describe(stamp) if due_ns is None or stamp >= due_ns else due_ns
        while waiting and waiting[0][0] <= stamp:
            _when_due(playback_clock, *waiting.popleft())
        while not playback_clock.wait(stamp, 1.0):
            pass
        advance()
        try:
            raw = recording.raw(name, stamp)
        except InputError:
            continue
        for topic in topics:
            topic.depth(name, topic.image(name, stamp, raw), stamp)
        frames += 1
    for event in waiting:
        _when_due(playback_clock, *event)
    return frames


def _when_due(playback_clock: PlaybackClock, stamp: int, act: Callable[[], None]) -> None:
    while not playback_clock.wait(stamp, 1.0):
        pass
    act()


def replay(settings: ReplaySettings, console: Console | None = None) -> int:
    """Play the recording; returns the number of frames of the last round.

    Raises:
        InputError: when the path is no recording, the result is none or of another recording, the speed is not
            positive, or a stream cannot start.
    """
    console = console or Terminal(stderr=True)
    check_above_0({"--speed": settings.speed})
    recording = open_recording(settings.recording)
    result = None if settings.result is None else read_result(settings.result)
    shift_ns = 0 if result is None else _shift_ns(recording, result)
    streams = [open_stream(address) for address in settings.stream or (FOXGLOVE,)]
    shows = [stream for stream in streams if isinstance(stream, FoxgloveStream)]
    if result is None and len(shows) < len(streams):
        other = next(stream.name for stream in streams if stream not in shows)
        raise InputError(f"{other} takes joints: tell with --result which run's")
    rig = recording.rig if result is None else dataclasses.replace(recording.rig, up=result.up)
    outlets = Outlets(streams, lambda line: console.print(f"• {line}"))
    people = 1 if result is None else max(len(result.people), 1)
    outlets.start(StreamSetup(rig, people, console.print), at_once=True)
    try:
        console.print("Ctrl-C ends")
        with Progress(console=console) as progress:
            task = progress.add_task("playing", total=len(timeline(recording)))
            while True:
                others = [] if result is None else _events(result, outlets, settings.speed, shift_ns)
                frames = play(
                    recording, [stream.topics for stream in shows], PlaybackClock(settings.speed),
                    lambda: progress.advance(task), others,
                )  # fmt: skip
                progress.reset(task)
                if not settings.loop:
                    return frames
    finally:
        outlets.close()


def _shift_ns(recording: Recording, result: StoredResult) -> int:
    """What is added to the times of the result for those of the recording: of a live capture, which has the times of
    this machine's clock, what its summary says.

    Raises:
        InputError: unless poses of the result are within the times of the recording.
    """
    stamps = [stamp for stamp, _ in timeline(recording)]
    live_ns = result.summary["recorded_minus_timestamp_ns"] if result.summary else None
    for shift_ns in (0, live_ns or 0):
        times_ns = [person.table.stamps_ns + shift_ns for person in result.people]
        if any(((times >= stamps[0]) & (times <= stamps[-1])).any() for times in times_ns):
            return shift_ns
    raise InputError(f"none of the times in {result.folder} are within the recording: it is of another one")


def _events(result: StoredResult, outlets: Outlets, speed: float, shift_ns: int) -> list[_Event]:
    """What of a result is due when, in the recording's times."""
    poses_by_stamp: dict[int, dict[int, Pose]] = {}
    for person in result.people:
        for pose in person.table.poses():
            poses_by_stamp.setdefault(pose.timestamp_ns + shift_ns, {})[person.number] = pose
    stamps = sorted(poses_by_stamp)
    begun: list[int] = []

    def due_ns(stamp: int) -> int:
        """On this machine's clock."""
        if not begun:
            begun.append(time.monotonic_ns() - round((stamp - stamps[0]) / speed))
        return begun[0] + round((stamp - stamps[0]) / speed)

    def send(stamp: int) -> None:
        outlets.send(_result(stamp, poses_by_stamp[stamp]), FrameSet(stamp, ()), stamp, due_ns(stamp))

    def mark(text: str, stamp: int) -> None:
        outlets.mark(Marker(text, stamp, due_ns(stamp)))

    poses: list[_Event] = [(stamp, lambda stamp=stamp: send(stamp)) for stamp in stamps]
    marked = [(marker.timestamp_ns + shift_ns, marker.text) for marker in result.markers]
    return poses + [(stamp, lambda stamp=stamp, text=text: mark(text, stamp)) for stamp, text in marked]


def _result(stamp: int, poses: dict[int, Pose]) -> Result:
    """What is left of a result: joints alone, of those who are there."""
    cloud = merge_views([])
    there = {number: pose for number, pose in poses.items() if np.isfinite(pose.joints).any()}
    people = tuple(PersonResult(number, pose, (), (), cloud) for number, pose in sorted(there.items()))
    nobody = Pose(stamp, np.full((len(JOINTS), 3), np.nan), np.zeros(len(JOINTS)))
    return Result(people[0].pose if people else nobody, (), (), cloud, {}, people)
