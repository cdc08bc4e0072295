"""Reads unsynchronised cameras, each in a thread of its own, and gives the newest synchronised set of frames.

No queue grows: a set that is not taken before the next one is dropped, and so are frames that arrive faster than they
are put into sets.
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
from depthmocap.realtime.ingest import FrameIngest
from depthmocap.realtime.mcap_recorder import not_recorded_problem
from depthmocap.realtime.multi_camera_reader import POLL_S, MultiCameraReader
from depthmocap.realtime.problems import Problems
from depthmocap.realtime.status import CameraStatus, camera_statuses
from depthmocap.realtime.sync import SyncedSet, SyncSettings
from depthmocap.recordings.recording_layout import UnfitFrameError
from depthmocap.recordings.timestamps import frame_period_ns

#: Frames of a camera that may wait for the synchroniser; beyond them the oldest is dropped.
MAX_WAITING = 8
#: Frames that may wait in addition while the rate is measured.
MAX_WAITING_MEASURING = 300
#: Frames of every camera over which the rate is measured.
RATE_FRAMES = 10
#: Longest measurement of the rate (seconds from the first frame on).
RATE_S = 2.0
#: Seconds without any frame after which the nominal rate is used.
NO_RATE_S = 10.0


@runtime_checkable
class Recorder(Protocol):
    """Records every frame as it comes; any thread may call it."""

    def write(self, frame: DepthFrame) -> None: ...


class SyncedReader:
    """Reads sources and gives the newest set; a context manager. Any thread may add and remove sources while it runs.

    Ownership of the data:

    - A source and its state belong to its thread. All states are one immutable mapping (``MultiCameraReader.states``).
    - Health checks, synchroniser and their counts belong to the thread "sets", which holds ``_ingest_lock`` while it
      works on them. ``statuses`` copies them under the same lock.
    - Waiting frames and changes, the newest set, and the counts of dropped frames and sets belong to the holder of the
      lock that the conditions ``_changed`` and ``_published`` share. Of frames the thread "sets" is told by the one, of
      sets who waits for them by the other: each wakes only when there is something for it.
    - Any thread may add to ``problems``.

    ``cameras``, ``statuses`` and ``problems.counts`` give copies that do not change afterwards.

    Attributes:
        problems: messages for the user, one line each, and how often each occurred.
        recorder: writes the frames as they come; set it at any time.
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
            rig: the poses of the cameras; by default the sources' own.
            sync: how frames form sets.
            measure_rate: use the measured rate of the fastest camera in place of the rate in ``sync``.
        """
        self.recorder: Recorder | None = None
        self.problems = Problems()
        self._ingest_lock = threading.Lock()
        self._ingest = FrameIngest(sync or SyncSettings(), self.problems)
        self._dropped = self._overrun = 0
        self._measure = measure_rate
        self._inbox: collections.deque[DepthFrame] = collections.deque()
        #: Cameras that were opened, and names of cameras that were removed, for the thread that owns the ingest.
        self._changes: collections.deque[DepthCamera | str] = collections.deque()
        lock = threading.RLock()
        self._changed, self._published = threading.Condition(lock), threading.Condition(lock)
        self._newest: SyncedSet | None = None
        self._behind = 0
        self._failure: BaseException | None = None
        self._stopping = self._done = False
        self._reader = MultiCameraReader(sources, rig, self)
        self._thread = threading.Thread(target=self._run, name="sets", daemon=True)

    @property
    def cameras(self) -> dict[str, DepthCamera]:
        """The cameras that were opened and not removed, with their poses in the rig."""
        return self._reader.cameras

    def camera(self, name: str) -> DepthCamera | None:
        """The camera of this name; None if it was not opened yet."""
        return self._reader.camera(name)

    def place(self, camera: DepthCamera) -> None:
        """Take a camera's pose for its own from now on, also when it is opened again.

        Raises:
            InputError: when there is none of this name, or it was not opened yet.
        """
        self._reader.place(camera)

    @property
    def rate_hz(self) -> float:
        """Sets a second, as given or as measured."""
        with self._ingest_lock:
            return self._ingest.sync.settings.rate_hz

    @property
    def dropped(self) -> int:
        """Number of sets that were not taken in time."""
        with self._changed:
            return self._dropped

    @property
    def behind(self) -> int:
        """How many of the last sets in a row were there before they were asked for."""
        return self._behind

    @property
    def overrun(self) -> int:
        """Number of frames dropped because they came faster than they could be put into sets."""
        with self._changed:
            return self._overrun

    def reset_dropped(self) -> int:
        """Number of dropped sets; the count restarts at 0."""
        with self._changed:
            dropped, self._dropped = self._dropped, 0
            return dropped

    def add(self, source: DepthSource) -> None:
        """Read one more camera from now on.

        Raises:
            InputError: when there is a camera of its name, or reading was stopped.
        """
        self._reader.add(source)

    def remove(self, name: str) -> None:
        """Stop reading a camera.

        Raises:
            InputError: when there is none of this name.
        """
        self._reader.remove(name)
        with self._changed:
            self._changes.append(name)
            self._changed.notify_all()

    def statuses(self) -> list[CameraStatus]:
        """The current status of every camera."""
        sources = self._reader.states
        states = {name: source.state for name, source in sources.items()}
        failures = {name: source.failures for name, source in sources.items()}
        with self._ingest_lock:
            return camera_statuses(self._ingest, states, time.monotonic_ns(), failures)

    def __enter__(self) -> SyncedReader:
        """Start reading."""
        self.start()
        return self

    def start(self, tell: Callable[[str], None] = lambda line: None) -> None:
        """Start reading, and wait until every camera was opened or has failed.

        Args:
            tell: is called with a line about cameras that take long.

        Raises:
            InputError: when no camera could be opened.
        """
        self._thread.start()
        try:
            self._reader.start(tell)
        except BaseException:
            self.stop()
            raise

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def stop(self) -> None:
        """Stop reading. It does not wait for SDK calls that hang."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        self._reader.stop()
        self._thread.join(2 * POLL_S)

    def sets(self, leaving: Callable[[], bool] = lambda: False) -> Iterator[SyncedSet]:
        """Yield the newest set each time, until all sources are at their end or ``stop`` is called.

        Args:
            leaving: whether no more are wanted; it is asked while none is there.
        """
        while True:
            with self._published:
                self._behind = 0 if self._newest is None else self._behind + 1
                while self._newest is None and not self._done and not leaving():
                    self._published.wait(POLL_S)  # a limit, because some systems notice Ctrl-C only afterwards
                newest, self._newest = self._newest, None
            if newest is None:
                break
            yield newest
        if self._failure is not None:
            raise self._failure

    def deliver(self, frame: DepthFrame) -> None:
        """Take a frame; any thread may call this."""
        most = MAX_WAITING * max(len(self._reader.states), 1)
        with self._changed:
            if len(self._inbox) >= most + (MAX_WAITING_MEASURING if self._measure else 0):
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
            self.note(not_recorded_problem(frame))
        except InputError as error:  # a full disk must not end the motion capture
            self.recorder = None
            self.note(str(error))

    def opened(self, camera: DepthCamera) -> None:
        """Expect frames of a camera that was opened, or opened again."""
        with self._changed:
            self._changes.append(camera)
            self._changed.notify_all()

    def note(self, problem: str) -> None:
        """Add a message for the user."""
        self.problems.add(problem)

    def _run(self) -> None:
        try:
            if self._measure:
                self._measure_rate()
            while not self._stopping and (not self._reader.finished or self._inbox):
                self._step()
            with self._ingest_lock:
                remaining = self._ingest.sync.flush()
            for synced in remaining:
                self._publish(synced)
        except BaseException as error:  # ``sets`` raises it again
            self._failure = error
        with self._published:
            self._done = True
            self._published.notify_all()

    def _measure_rate(self) -> None:
        """Measure the rate of the fastest camera from the first frames, which wait meanwhile."""
        end_s = time.monotonic() + NO_RATE_S
        stamps: dict[str, list[int]] = {}
        with self._changed:
            while not self._stopping and time.monotonic() < end_s and not self._reader.finished:
                self._changed.wait(POLL_S)
                if not self._reader.attempted:
                    end_s = time.monotonic() + NO_RATE_S
                    continue
                stamps = {}
                for frame in self._inbox:
                    stamps.setdefault(frame.camera, []).append(frame.timestamp_ns)
                if stamps and end_s - time.monotonic() > RATE_S:
                    end_s = time.monotonic() + RATE_S
                cameras = self._reader.cameras
                if cameras and all(len(stamps.get(name, ())) >= RATE_FRAMES for name in cameras):
                    break
            stamps = {}
            for frame in self._inbox:
                stamps.setdefault(frame.camera, []).append(frame.timestamp_ns)
            self._measure = False
        with self._ingest_lock:
            settings = dataclasses.replace(self._ingest.sync.settings, rate_hz=1e9 / frame_period_ns(stamps))
            self._ingest = FrameIngest(settings, self.problems)

    def _step(self) -> None:
        with self._changed:
            if not self._inbox and not self._changes and not self._stopping:
                due_ns = self._ingest.sync.next_deadline_ns()
                wait_s = POLL_S if due_ns is None else (due_ns - time.monotonic_ns()) * 1e-9
                self._changed.wait(min(max(wait_s, 0), POLL_S))
            changes, frames = list(self._changes), list(self._inbox)
            self._changes.clear()
            self._inbox.clear()
        with self._ingest_lock:
            for change in changes:
                if isinstance(change, str):
                    self._ingest.remove_camera(change)
                else:
                    self._ingest.add_camera(change)
            for frame in frames:
                self._ingest.add(frame)
            sets = self._ingest.sync.poll(time.monotonic_ns())
        for synced in sets:
            self._publish(synced)

    def _publish(self, synced: SyncedSet) -> None:
        with self._published:
            self._dropped += self._newest is not None
            self._newest = synced
            self._published.notify_all()
