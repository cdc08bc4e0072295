"""Cameras that deliver when they like, each read by a thread of its own, into the newest set.

No queue grows: a set that nobody took before the next one came is dropped, and so are frames that arrive faster than
they are put into sets. A camera that fails is opened again and again, one that hangs is not waited for, and neither
holds up the others.
"""

from __future__ import annotations

import collections
import dataclasses
import threading
import time
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Protocol, runtime_checkable

from depthmocap.capture.recording import UnfitFrameError
from depthmocap.capture.source import DepthFrame, DepthSource, MisfitError, NoFrame, place, unsourced
from depthmocap.capture.stamps import frame_period_ns
from depthmocap.capture.sync import SyncedSet, SyncSettings
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig
from depthmocap.online.intake import Intake

#: How long a reading thread waits for a frame before it looks whether it shall stop.
LOOK_S = 0.2
#: A camera that was lost is tried again after so long; one that does not fit the rig after twice as long each time, up
#: to the second, because opening it disturbs others on its bus.
RETRY_S, RETRY_MISFIT_S = 0.25, 8.0
#: Cameras have so long to open at the start, and are then gone on without.
OPENING_S = 10.0
#: Frames that a camera may be ahead of the synchroniser.
AHEAD = 8
#: The rate is measured over so many frames of one camera, or so many seconds.
RATE_FRAMES, RATE_S = 10, 2.0


@runtime_checkable
class Recorder(Protocol):
    """Takes every frame as it came, from any thread."""

    def write(self, frame: DepthFrame) -> None: ...


class Gatherer:
    """Sources in, the newest set out; a context manager. Sources can be added and removed while it runs.

    Attributes:
        intake: checks, synchroniser and books; it belongs to this class's thread, and others only read its numbers.
        dropped: sets that nobody took in time.
        overrun: frames that came faster than they could be put into sets.
        cameras: those that were opened so far, as the rig places them.
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
        self.rig = rig
        self.recorder: Recorder | None = None
        self.cameras: dict[str, DepthCamera] = {}
        self.intake = Intake(sync or SyncSettings())
        self.dropped = self.overrun = 0
        self._measure = measure_rate
        self._readers: dict[str, _Reader] = {}
        self._inbox: collections.deque[DepthFrame] = collections.deque()
        #: Cameras that were opened, and names of those that were removed, for the thread that owns the intake.
        self._changes: collections.deque[DepthCamera | str] = collections.deque()
        self._changed = threading.Condition()
        self._newest: SyncedSet | None = None
        self._failure: BaseException | None = None
        self._stopping = self._done = False
        self._thread = threading.Thread(target=self._run, name="sets", daemon=True)
        for source in sources:
            self.add(source)
        for problem in unsourced(rig, self._readers) if rig else ():
            self.note(problem)

    def add(self, source: DepthSource) -> None:
        """Read one more camera from now on.

        Raises:
            InputError: when one of its name is there already.
        """
        if source.name in self._readers:
            raise InputError(f"two cameras are called {source.name!r}: give each its own name")
        self._readers[source.name] = _Reader(source, self)
        if self._thread.is_alive():
            self._readers[source.name].start()

    def remove(self, name: str) -> None:
        """Read a camera no more.

        Raises:
            InputError: when there is none of this name.
        """
        if name not in self._readers:
            raise InputError(f"there is no camera {name!r}: there are {', '.join(self._readers)}")
        self._readers.pop(name).stop()
        with self._changed:
            self._changes.append(name)

    def states(self) -> dict[str, str]:
        """What each camera does, in a word or a line."""
        return {name: reader.state for name, reader in self._readers.items()}

    def failures(self) -> dict[str, int]:
        """How often each camera was opened in vain."""
        return {name: reader.failures for name, reader in self._readers.items()}

    def note(self, problem: str) -> None:
        """Remember something that the user should know, and how often it was so."""
        self.intake.problems[problem] += 1

    def __enter__(self) -> Gatherer:
        """Start reading, and wait until every camera was opened once, or failed.

        Raises:
            InputError: when none could be opened.
        """
        self._thread.start()
        for reader in self._readers.values():
            reader.start()
        end = time.monotonic() + OPENING_S
        for reader in list(self._readers.values()):
            reader.tried.wait(max(end - time.monotonic(), 0))
        if self._readers and not any(reader.opened for reader in self._readers.values()):
            states = "; ".join(f"{name}: {state}" for name, state in self.states().items())
            self.stop()
            raise InputError(f"no camera could be opened ({states})")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def stop(self) -> None:
        """Stop reading. A call of an SDK that does not return is left behind."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        for reader in self._readers.values():
            reader.stop()
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
        with self._changed:
            if len(self._inbox) >= AHEAD * max(len(self._readers), 1) + (300 if self._measure else 0):
                self._inbox.popleft()
                self.overrun += 1
            self._inbox.append(frame)
            self._changed.notify_all()

    def opened(self, camera: DepthCamera) -> None:
        """A camera is there, or there again."""
        with self._changed:
            self.cameras[camera.name] = camera
            self._changes.append(camera)

    def _run(self) -> None:
        try:
            if self._measure:
                self._measure_rate()
            while not self._stopping and (not self._ended() or self._inbox):
                self._step()
            for synced in self.intake.sync.flush():
                self._offer(synced)
        except BaseException as error:  # told where the sets are asked for
            self._failure = error
        with self._changed:
            self._done = True
            self._changed.notify_all()

    def _ended(self) -> bool:
        """All that can deliver are at their end; a camera that does not fit the rig is not waited for."""
        readers = list(self._readers.values())
        return any(reader.ended for reader in readers) and all(reader.ended or reader.misfit for reader in readers)

    def _measure_rate(self) -> None:
        """Let frames come in until they tell the rate of the fastest camera; they wait meanwhile."""
        end = time.monotonic() + OPENING_S
        stamps: dict[str, list[int]] = {}
        with self._changed:
            while not self._stopping and time.monotonic() < end and not self._ended():
                self._changed.wait(LOOK_S)
                stamps = {}
                for frame in self._inbox:
                    stamps.setdefault(frame.camera, []).append(frame.timestamp_ns)
                if stamps and end - time.monotonic() > RATE_S:
                    end = min(end, time.monotonic() + RATE_S)
                if any(len(own) >= RATE_FRAMES for own in stamps.values()):
                    break
            settings = dataclasses.replace(self.intake.sync.settings, rate_hz=1e9 / frame_period_ns(stamps))
            problems = self.intake.problems
            self.intake = Intake(settings)
            self.intake.problems = problems
            self._measure = False

    def _step(self) -> None:
        sync = self.intake.sync
        with self._changed:
            if not self._inbox and not self._stopping:
                due_ns = sync.next_deadline_ns()
                wait_s = LOOK_S if due_ns is None else (due_ns - time.monotonic_ns()) * 1e-9
                self._changed.wait(min(max(wait_s, 0), LOOK_S))
            while self._changes:
                change = self._changes.popleft()
                if isinstance(change, str):
                    self.intake.remove_camera(change)
                else:
                    self.intake.add_camera(change)
            frames = list(self._inbox)
            self._inbox.clear()
        for frame in frames:
            self.intake.add(frame)
        for synced in sync.poll(time.monotonic_ns()):
            self._offer(synced)

    def _offer(self, synced: SyncedSet) -> None:
        with self._changed:
            self.dropped += self._newest is not None
            self._newest = synced
            self._changed.notify_all()


class _Reader:
    """The thread that reads one source."""

    def __init__(self, source: DepthSource, gatherer: Gatherer) -> None:
        self.source, self.state = source, "opening"
        self.tried, self.opened, self.ended, self.failures = threading.Event(), False, False, 0
        self.misfit = False
        self._gatherer, self._delivering = gatherer, False
        self._stop = threading.Event()
        # A daemon, because a call of an SDK that never returns must not keep the process alive.
        self._thread = threading.Thread(target=self._run, name=f"camera {source.name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(2 * LOOK_S)

    def _run(self) -> None:
        misfit_s = RETRY_S
        while not self._stop.is_set():
            wait_s = RETRY_S
            try:
                self._read_on()
            except MisfitError as error:
                self.misfit = True
                self._failed(str(error), str(error))
                misfit_s = wait_s = min(2 * misfit_s, RETRY_MISFIT_S)
            except Exception as error:  # whatever an SDK raises is this camera's trouble alone
                said = str(error) or type(error).__name__
                self._failed(said, f"camera {self.source.name!r} was lost: {said}")
            self.tried.set()
            if self.ended:
                return
            self._stop.wait(wait_s)

    def _failed(self, state: str, problem: str) -> None:
        """What happens again each time that the camera is tried is told once."""
        self.failures += not self._delivering
        if state != self.state:
            self._gatherer.note(problem)
        self.state = state

    def _read_on(self) -> None:
        """Open the camera and read it until it ends; errors come out."""
        self._delivering = False
        with self.source as source:
            camera = source.camera
            self._gatherer.opened(place(camera, self._gatherer.rig) if self._gatherer.rig else camera)
            self.opened, self.state, self._delivering, self.misfit = True, "running", True, False
            self.tried.set()
            while not self._stop.is_set():
                while source.problems:
                    self._gatherer.note(source.problems.popleft())
                try:
                    frame = source.read(LOOK_S)
                except NoFrame:
                    self.state = "silent"
                    continue
                if frame is None:
                    self.state, self.ended = "at its end", True
                    return
                self.state = "running"
                self._gatherer.deliver(frame)
                self._record(frame)

    def _record(self, frame: DepthFrame) -> None:
        recorder = self._gatherer.recorder
        if recorder is None:
            return
        try:
            recorder.write(frame)
        except UnfitFrameError:
            self._gatherer.note(
                f"camera {frame.camera!r}: a frame of another size, or of an impossible time, is not recorded"
            )
        except InputError as error:  # a full disk does not end the motion capture
            self._gatherer.recorder = None
            self._gatherer.note(str(error))
