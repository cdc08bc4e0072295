"""Cameras that deliver when they like, each read by a thread of its own, into the newest set.

No queue grows: a set that nobody took before the next one came is dropped, and so are frames that arrive faster than
they are put into sets.
"""

from __future__ import annotations

import collections
import dataclasses
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from types import TracebackType
from typing import Protocol, runtime_checkable

from depthmocap.cameras.source import DepthFrame, DepthSource
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig
from depthmocap.realtime.ingest import Intake
from depthmocap.realtime.mcap_recorder import not_recorded
from depthmocap.realtime.multi_camera_reader import LOOK_S, Readers
from depthmocap.realtime.problems import Problems
from depthmocap.realtime.status import CameraStatus, camera_statuses
from depthmocap.realtime.sync import SyncedSet, SyncSettings
from depthmocap.recordings.recording_layout import UnfitFrameError
from depthmocap.recordings.timestamps import frame_period_ns

#: Frames that a camera may be ahead of the synchroniser.
AHEAD = 8
#: The rate is measured over so many frames of every camera, or so many seconds from the first frame on; without any
#: frame it is no longer waited for after so many.
RATE_FRAMES, RATE_S, NO_RATE_S = 10, 2.0, 10.0


@runtime_checkable
class Recorder(Protocol):
    """Takes every frame as it came, from any thread."""

    def write(self, frame: DepthFrame) -> None: ...


class Gatherer:
    """Sources in, the newest set out; a context manager. Sources can be added and removed while it runs, by any thread.

    Who owns what is true:

    - a source and its state: its thread. All states are published as one immutable mapping (see ``Readers``).
    - health, synchroniser and the books about both: the thread "sets". It holds a lock while it works on them, under
      which ``statuses`` makes its copy.
    - frames and changes that wait for that thread, the newest set, and the counts of what was dropped: whoever holds
      the condition.
    - problems: any thread adds to them (see ``Problems``).

    What ``cameras``, ``statuses`` and ``problems`` give does not change any more, whatever happens meanwhile.

    Attributes:
        problems: what a user should know, one line each, and how often it was so.
        recorder: what frames are written with as they come; set it at any time.
    """

    def __init__(
        self,
        sources: Sequence[DepthSource],
        rig: Rig | None = None,
        sync: SyncSettings | None = None,
        measure_rate: bool = True,
    ) -> None:
        """
        Args:
            rig: where the cameras stand; by default what the sources know.
            measure_rate: take the rate of the fastest camera instead of the one in ``sync``.
        """
        self.recorder: Recorder | None = None
        self.problems = Problems()
        self._books = threading.Lock()
        self._intake = Intake(sync or SyncSettings(), self.problems)
        self._dropped = self._overrun = 0
        self._measure = measure_rate
        self._inbox: collections.deque[DepthFrame] = collections.deque()
        #: Cameras that were opened, and names of those that were removed, for the thread that owns the intake.
        self._changes: collections.deque[DepthCamera | str] = collections.deque()
        self._changed = threading.Condition()
        self._newest: SyncedSet | None = None
        self._failure: BaseException | None = None
        self._stopping = self._done = False
        self._readers = Readers(sources, rig, self)
        self._thread = threading.Thread(target=self._run, name="sets", daemon=True)

    @property
    def cameras(self) -> dict[str, DepthCamera]:
        """Those that were opened so far and not removed, as the rig places them."""
        return self._readers.cameras

    def camera(self, name: str) -> DepthCamera | None:
        """One of them; None where it was not opened yet."""
        return self._readers.camera(name)

    @property
    def rate_hz(self) -> float:
        """Sets a second: as given, or as measured since."""
        with self._books:
            return self._intake.sync.settings.rate_hz

    @property
    def dropped(self) -> int:
        """Sets that nobody took in time."""
        with self._changed:
            return self._dropped

    @property
    def overrun(self) -> int:
        """Frames that came faster than they could be put into sets."""
        with self._changed:
            return self._overrun

    def forget_dropped(self) -> int:
        """How many sets were dropped; they are counted anew from here on."""
        with self._changed:
            dropped, self._dropped = self._dropped, 0
            return dropped

    def add(self, source: DepthSource) -> None:
        """Read one more camera from now on.

        Raises:
            InputError: when one of its name is there already, or reading was stopped.
        """
        self._readers.add(source)

    def remove(self, name: str) -> None:
        """Read a camera no more.

        Raises:
            InputError: when there is none of this name.
        """
        self._readers.remove(name)
        with self._changed:
            self._changes.append(name)
            self._changed.notify_all()

    def statuses(self) -> list[CameraStatus]:
        """Every camera now."""
        known = self._readers.known
        states = {name: each.state for name, each in known.items()}
        failures = {name: each.failures for name, each in known.items()}
        with self._books:
            return camera_statuses(self._intake, states, time.monotonic_ns(), failures)

    def __enter__(self) -> Gatherer:
        """Start reading, see ``start``."""
        self.start()
        return self

    def start(self, tell: Callable[[str], None] = lambda line: None) -> None:
        """Start reading, and wait until every camera was opened once, or failed.

        Args:
            tell: takes a line about cameras that take long.

        Raises:
            InputError: when none could be opened.
        """
        self._thread.start()
        try:
            self._readers.start(tell)
        except BaseException:
            self.stop()
            raise

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def stop(self) -> None:
        """Stop reading. A call of an SDK that does not return is left behind."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        self._readers.stop()
        self._thread.join(2 * LOOK_S)

    def sets(self) -> Iterator[SyncedSet]:
        """The newest set, again and again, until all sources are at their end or ``stop`` is called."""
        while True:
            with self._changed:
                while self._newest is None and not self._done:
                    self._changed.wait(LOOK_S)  # not for ever, so that Ctrl-C is heard on every system
                newest, self._newest = self._newest, None
            if newest is None:
                break
            yield newest
        if self._failure is not None:
            raise self._failure

    def deliver(self, frame: DepthFrame) -> None:
        """Take a frame from any thread."""
        most = AHEAD * max(len(self._readers.known), 1)
        with self._changed:
            if len(self._inbox) >= most + (300 if self._measure else 0):
                self._inbox.popleft()
                self._overrun += 1
            self._inbox.append(frame)
            self._changed.notify_all()
        recorder = self.recorder
        if recorder is None:
            return
        try:
            recorder.write(frame)
        except UnfitFrameError:
            self.note(not_recorded(frame))
        except InputError as error:  # a full disk does not end the motion capture
            self.recorder = None
            self.note(str(error))

    def opened(self, camera: DepthCamera) -> None:
        """A camera is there, or there again."""
        with self._changed:
            self._changes.append(camera)
            self._changed.notify_all()

    def note(self, problem: str) -> None:
        """Remember something that the user should know, and how often it was so."""
        self.problems.add(problem)

    def _run(self) -> None:
        try:
            if self._measure:
                self._measure_rate()
            while not self._stopping and (not self._readers.over or self._inbox):
                self._step()
            with self._books:
                left = self._intake.sync.flush()
            for synced in left:
                self._offer(synced)
        except BaseException as error:  # told where the sets are asked for
            self._failure = error
        with self._changed:
            self._done = True
            self._changed.notify_all()

    def _measure_rate(self) -> None:
        """Let frames come in until they tell the rate of the fastest camera; they wait meanwhile."""
        end_s = time.monotonic() + NO_RATE_S
        stamps: dict[str, list[int]] = {}
        with self._changed:
            while not self._stopping and time.monotonic() < end_s and not self._readers.over:
                self._changed.wait(LOOK_S)
                if not self._readers.tried:
                    end_s = time.monotonic() + NO_RATE_S
                    continue
                stamps = {}
                for frame in self._inbox:
                    stamps.setdefault(frame.camera, []).append(frame.timestamp_ns)
                if stamps and end_s - time.monotonic() > RATE_S:
                    end_s = time.monotonic() + RATE_S
                cameras = self._readers.cameras
                if cameras and all(len(stamps.get(name, ())) >= RATE_FRAMES for name in cameras):
                    break
            stamps = {}
            for frame in self._inbox:
                stamps.setdefault(frame.camera, []).append(frame.timestamp_ns)
            self._measure = False
        with self._books:
            settings = dataclasses.replace(self._intake.sync.settings, rate_hz=1e9 / frame_period_ns(stamps))
            self._intake = Intake(settings, self.problems)

    def _step(self) -> None:
        with self._changed:
            if not self._inbox and not self._changes and not self._stopping:
                due_ns = self._intake.sync.next_deadline_ns()
                wait_s = LOOK_S if due_ns is None else (due_ns - time.monotonic_ns()) * 1e-9
                self._changed.wait(min(max(wait_s, 0), LOOK_S))
            changes, frames = list(self._changes), list(self._inbox)
            self._changes.clear()
            self._inbox.clear()
        with self._books:
            for change in changes:
                if isinstance(change, str):
                    self._intake.remove_camera(change)
                else:
                    self._intake.add_camera(change)
            for frame in frames:
                self._intake.add(frame)
            sets = self._intake.sync.poll(time.monotonic_ns())
        for synced in sets:
            self._offer(synced)

    def _offer(self, synced: SyncedSet) -> None:
        with self._changed:
            self._dropped += self._newest is not None
            self._newest = synced
            self._changed.notify_all()
