"""The contract of a stream: where the results of a running capture go, set by set."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable, Collection

from depthmocap.frames import FrameSet, Pose
from depthmocap.geometry import Rig
from depthmocap.offline.pipeline import Result


def _say_nothing(line: str) -> None:
    """Tell nobody."""


@dataclasses.dataclass(frozen=True, eq=False)
class StreamSetup:
    """What is known when a stream starts.

    Attributes:
        rig: the cameras that were opened, and the world's up axis; others may come later, and a sample's views tell.
        people: so many are followed at most.
        tell: shows a line to the user, such as the address at which a server waits.
        note: puts a line into the capture's summary.
    """

    rig: Rig
    people: int = 1
    tell: Callable[[str], None] = _say_nothing
    note: Callable[[str], None] = _say_nothing


@dataclasses.dataclass(frozen=True, eq=False)
class Sample:
    """One set's result on its way out. Nothing in it changes afterwards.

    Attributes:
        result: the whole result; joints in the rig's world, metres.
        people: the poses of everybody by their numbers, the one who is followed first; empty where nobody is in view.
        frames: the set: depth pictures and their cameras. Where a filter waits, the pose is of an earlier set.
        unix_ns: when the pose was exposed: nanoseconds since 1970, or a recording's own time where one is replayed.
        monotonic_ns: the same on this machine's clock (``time.monotonic_ns``); where a recording is replayed, when it
            was due.
    """

    result: Result
    people: dict[int, Pose]
    frames: FrameSet
    unix_ns: int
    monotonic_ns: int


@dataclasses.dataclass(frozen=True)
class Marker:
    """An event in the take, such as "trial 3", and its time as in :class:`Sample`."""

    text: str
    unix_ns: int
    monotonic_ns: int


class Places:
    """Places for people in a stream that has so many: somebody keeps a place while in view.

    Attributes:
        numbers: who has each place; 0 where nobody does.
    """

    def __init__(self, count: int) -> None:
        self.numbers = [0] * count

    def take(self, present: Collection[int]) -> list[int]:
        """Give free places to those who are new in view; returns who has each."""
        self.numbers = [number if number in present else 0 for number in self.numbers]
        for number in present:
            if number not in self.numbers and 0 in self.numbers:
                self.numbers[self.numbers.index(0)] = number
        return self.numbers


class Stream(abc.ABC):
    """A receiver of results. All its methods are called from one thread of its own, which may wait as long as it needs:
    the capture never waits for it, and a sample that it does not take in time is replaced by the next one.

    What a method raises is told to the user in one line, once, and the capture goes on: a start is tried again, and a
    sample that could not be sent is left out.

    Attributes:
        name: in messages.
    """

    name: str = "stream"

    def start(self, setup: StreamSetup) -> None:  # noqa: B027 - need not be
        """Prepare before the first sample. What it raises leaves nothing open."""

    @abc.abstractmethod
    def send(self, sample: Sample) -> None:
        """Take one sample."""

    def mark(self, marker: Marker) -> None:  # noqa: B027 - need not be
        """Take a marker; by default it is ignored."""

    def close(self) -> None:  # noqa: B027 - need not be
        """End; called once after each successful start."""
