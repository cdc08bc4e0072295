"""Reads several sources, each in a thread of its own, for recording and for motion capture.

A camera that fails is reported and opened again and again. A camera that hangs is not waited for. Neither delays the
others.
"""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType, TracebackType
from typing import Any, Protocol, runtime_checkable

from jaxtyping import Float
from numpy import ndarray

from depthmocap.cameras.source import (
    CameraMismatchError,
    DepthFrame,
    DepthSource,
    FrameTimeoutError,
    missing_source_problems,
    place_in_rig,
)
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig
from depthmocap.text import joined

#: Seconds that a reading thread waits for a frame before it checks whether it shall stop.
POLL_S = 0.2
#: Seconds until a lost camera is opened again.
RETRY_S = 0.25
#: Longest time (seconds) until a camera that does not fit the rig is opened again. The time doubles with each attempt
#: up to this, because opening a camera disturbs others on its bus.
RETRY_MISMATCH_S = 8.0
#: Cameras that take longer to open (seconds) are named in a message.
SLOW_S = 2.0
#: States of a source.
RUNNING, SILENT, OPENING, ENDED = "running", "silent", "opening", "at its end"


@runtime_checkable
class Listener(Protocol):
    """Receives frames and messages of the reading threads, which call it at any time."""

    def opened(self, camera: DepthCamera) -> None:
        """A camera was opened, or opened again."""

    def deliver(self, frame: DepthFrame) -> None:
        """A frame came. An exception is reported as a failure of its camera."""

    def note(self, problem: str) -> None:
        """A message for the user."""


@dataclasses.dataclass(frozen=True)
class SourceState:
    """The state of one source.

    Attributes:
        state: one of ``RUNNING`` …, or a line that says why it does not run.
        camera: the camera with its pose in the rig; None until it was opened.
        attempted: it was opened, or an attempt failed.
        finished: no more frames come, because it is at its end, or was lost and cannot go on.
        mismatched: it does not fit the rig.
        failures: number of failed attempts to open it.
    """

    state: str = OPENING
    camera: DepthCamera | None = None
    attempted: bool = False
    finished: bool = False
    mismatched: bool = False
    failures: int = 0


class MultiCameraReader:
    """Reads sources in threads; a context manager. Any thread may add and remove sources while it runs.

    A source belongs to its thread: only this thread opens, reads and closes it, and reports its state. The latest
    states are one immutable mapping, ``states``, which is replaced as a whole under a lock, so it is always consistent.
    The thread of a removed camera may still hang in its SDK; its reports are ignored.
    """

    def __init__(
        self, sources: Sequence[DepthSource], rig: Rig | None, listener: Listener, paused: bool = False
    ) -> None:
        """
        Args:
            rig: the poses of the cameras; by default the sources' own.
            paused: open the cameras, but let them deliver only after ``resume``.
        """
        self.rig = rig
        self._listener = listener
        self._lock = threading.Lock()
        self._readers: dict[str, _SourceThread] = {}
        self._states: Mapping[str, SourceState] = MappingProxyType({})
        self._poses: dict[str, Float[ndarray, "4 4"]] = {}
        self._running = self._stopped = False
        self._changed, self._resumed = threading.Condition(), threading.Event()
        if not paused:
            self._resumed.set()
        for source in sources:
            self.add(source)
        for problem in missing_source_problems(rig, self._readers) if rig else ():
            listener.note(problem)

    @property
    def states(self) -> Mapping[str, SourceState]:
        """The current state of each source, by name, in the order in which they were added."""
        return self._states

    @property
    def cameras(self) -> dict[str, DepthCamera]:
        """The cameras that were opened so far, with their poses in the rig."""
        return {name: state.camera for name, state in self._states.items() if state.camera is not None}

    def camera(self, name: str) -> DepthCamera | None:
        """The camera of this name; None if it was not opened yet."""
        state = self._states.get(name)
        return None if state is None else state.camera

    def place(self, camera: DepthCamera) -> None:
        """Take a camera's pose for its own from now on, also when it is opened again.

        Raises:
            InputError: when there is none of this name, or it was not opened yet.
        """
        with self._lock:
            state = self._states.get(camera.name)
            if state is None or state.camera is None:
                raise InputError(f"there is no camera {camera.name!r} that was opened")
            self._poses[camera.name] = camera.world_from_camera
            self._states = MappingProxyType({**self._states, camera.name: dataclasses.replace(state, camera=camera)})

    def placed(self, camera: DepthCamera) -> DepthCamera:
        """A camera that was opened, where the rig has it, or where it was placed since.

        Raises:
            CameraMismatchError: when it does not fit the rig.
        """
        camera = place_in_rig(camera, self.rig) if self.rig else camera
        if (pose := self._poses.get(camera.name)) is not None:
            camera = dataclasses.replace(camera, world_from_camera=pose)
        return camera

    @property
    def finished(self) -> bool:
        """Whether no more frames come. Cameras that do not fit the rig are not waited for."""
        states = self._states.values()
        return any(state.finished for state in states) and all(state.finished or state.mismatched for state in states)

    @property
    def attempted(self) -> bool:
        """Whether every source was opened, or failed to open."""
        return all(state.attempted for state in self._states.values())

    def add(self, source: DepthSource) -> None:
        """Read one more source from now on.

        Raises:
            InputError: when there is a source of its name, or reading was stopped.
        """
        reader = _SourceThread(source, self, self._listener)
        with self._lock:
            if source.name in self._readers:
                raise InputError(f"two cameras are called {source.name!r}: give each its own name")
            if self._stopped:
                raise InputError(f"camera {source.name!r} cannot be added any more: reading was stopped")
            self._readers[source.name] = reader
            self._states = MappingProxyType({**self._states, source.name: SourceState()})
            running = self._running
        if running:
            reader.start()

    def remove(self, name: str) -> None:
        """Stop reading a source.

        Raises:
            InputError: when there is none of this name.
        """
        with self._lock:
            if name not in self._readers:
                raise InputError(f"there is no camera {name!r}: there are {', '.join(self._readers)}")
            reader = self._readers.pop(name)
            self._states = MappingProxyType({other: state for other, state in self._states.items() if other != name})
        reader.ask_to_stop()
        reader.join(2 * POLL_S)

    def update_state(self, reader: _SourceThread, **changes: Any) -> None:
        """Update the state of a source; only its thread calls this."""
        name = reader.source.name
        with self._lock:
            if self._readers.get(name) is not reader:
                return
            now = dataclasses.replace(self._states[name], **changes)
            if now == self._states[name]:
                return
            self._states = MappingProxyType({**self._states, name: now})
        with self._changed:
            self._changed.notify_all()

    def start(self, tell: Callable[[str], None] = lambda line: None) -> None:
        """Open all sources, and wait until each is open or has failed. Each source has its own time limit.

        Args:
            tell: is called with a line about sources that take long.

        Raises:
            InputError: when no source could be opened.
        """
        with self._lock:
            self._running = True
            readers = list(self._readers.values())
        for reader in readers:
            reader.start()
        start_s, slow = time.monotonic(), False
        with self._changed:
            while not self.attempted and not self._stopped:
                self._changed.wait(POLL_S)  # a limit, because some systems notice Ctrl-C only afterwards
                if not slow and time.monotonic() - start_s > SLOW_S:
                    slow = True
                    names = ", ".join(name for name, state in self._states.items() if not state.attempted)
                    if names:
                        tell(f"still opening: {names}")
        if readers and not self.cameras:
            self.stop()
            by_state: dict[str, list[str]] = {}
            for name, state in self._states.items():
                by_state.setdefault(state.state, []).append(name)
            why = joined((f"{', '.join(names)}: {state}" for state, names in by_state.items()), 3)
            raise InputError(f"no camera could be opened ({why})")

    def resume(self) -> None:
        """Let paused cameras deliver."""
        self._resumed.set()

    def stop(self) -> None:
        """Stop reading. It does not wait for SDK calls that hang."""
        with self._lock:
            self._stopped = True
            readers = list(self._readers.values())
        for reader in readers:
            reader.ask_to_stop()
        self._resumed.set()
        end_s = time.monotonic() + 2 * POLL_S
        for reader in readers:
            reader.join(max(end_s - time.monotonic(), 0))

    def __enter__(self) -> MultiCameraReader:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def wait_until_resumed(self) -> None:
        """Wait until cameras may deliver, or reading stops."""
        self._resumed.wait()


class _SourceThread:
    """Reads one source in a thread."""

    def __init__(self, source: DepthSource, readers: MultiCameraReader, listener: Listener) -> None:
        self.source, self._readers, self._listener = source, readers, listener
        self._state, self._failures = OPENING, 0
        self._delivering = self._finished = False
        self._stop = threading.Event()
        # A daemon, because a call of an SDK that never returns must not keep the process alive.
        self._thread = threading.Thread(target=self._run, name=f"camera {source.name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def ask_to_stop(self) -> None:
        self._stop.set()

    def join(self, timeout_s: float) -> None:
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    def _run(self) -> None:
        mismatch_wait_s = RETRY_S
        while not self._stop.is_set():
            wait_s = RETRY_S
            try:
                self._read_on()
            except CameraMismatchError as error:
                self._failed(error, mismatched=True)
                mismatch_wait_s = wait_s = min(2 * mismatch_wait_s, RETRY_MISMATCH_S)
            except Exception as error:  # SDKs raise anything, and only this camera fails
                self._failed(error)
            if self._finished:
                return
            self._stop.wait(wait_s)

    def _failed(self, error: Exception, **changes: Any) -> None:
        """Report a failure, but not again if the next attempt fails in the same way."""
        self._failures += not self._delivering
        message = " ".join(str(error).split()) or type(error).__name__
        if message != self._state:
            name = repr(self.source.name)
            what = "was lost" if self._delivering else "cannot be opened"
            named = isinstance(error, CameraMismatchError) or name in message
            self._listener.note(message if named else f"camera {name} {what}: {message}")
        self._finished = not self.source.reopens
        self._update_state(message, attempted=True, finished=self._finished, failures=self._failures, **changes)

    def _update_state(self, state: str, **changes: Any) -> None:
        if state != self._state or changes:
            self._state = state
            self._readers.update_state(self, state=state, **changes)

    def _read_on(self) -> None:
        """Open the source and read it until it ends. Raises what the source raises."""
        self._delivering = False
        with self.source as source:
            camera = self._readers.placed(source.camera)
            self._delivering = True
            self._update_state(RUNNING, camera=camera, attempted=True, mismatched=False)
            if self._stop.is_set():
                return
            self._listener.opened(camera)
            self._readers.wait_until_resumed()
            while not self._stop.is_set():
                while source.problems:
                    self._listener.note(source.problems.popleft())
                try:
                    frame = source.read(POLL_S)
                except FrameTimeoutError:
                    self._update_state(SILENT)
                    continue
                if frame is None:
                    self._finished = True
                    break
                if self._stop.is_set():
                    return
                self._update_state(RUNNING)
                self._listener.deliver(frame)
            while source.problems:
                self._listener.note(source.problems.popleft())
        if self._finished:
            self._update_state(ENDED, finished=True)
