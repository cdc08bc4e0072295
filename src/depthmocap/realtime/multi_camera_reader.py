"""Sources that are each read by a thread of its own, for recording and for motion capture alike.

A camera that fails is told and opened again and again, one that hangs is not waited for, and neither holds up the
others.
"""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType, TracebackType
from typing import Any, Protocol, runtime_checkable

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

#: How long a reading thread waits for a frame before it looks whether it shall stop.
LOOK_S = 0.2
#: A camera that was lost is tried again after so long; one that does not fit the rig after twice as long each time, up
#: to the second, because opening it disturbs others on its bus.
RETRY_S, RETRY_MISFIT_S = 0.25, 8.0
#: Cameras that take longer to open are named.
SLOW_S = 2.0
RUNNING, SILENT, OPENING, ENDED = "running", "silent", "opening", "at its end"


@runtime_checkable
class Listener(Protocol):
    """Who takes what the threads bring; called by any of them at any time."""

    def opened(self, camera: DepthCamera) -> None:
        """A camera is there, or there again."""

    def deliver(self, frame: DepthFrame) -> None:
        """A frame came. What is raised is told as a fault of its camera."""

    def note(self, problem: str) -> None:
        """Something that the user should know."""


@dataclasses.dataclass(frozen=True)
class SourceState:
    """What is known of one source.

    Attributes:
        state: what it does in a word (``RUNNING`` …), or why it does not, in a line.
        camera: as the rig places it; None until it was opened.
        tried: it was opened once, or failed.
        over: it gives nothing more: it is at its end, or was lost and cannot go on.
        misfit: it does not fit the rig.
        failures: how often it was opened in vain.
    """

    state: str = OPENING
    camera: DepthCamera | None = None
    tried: bool = False
    over: bool = False
    misfit: bool = False
    failures: int = 0


class Readers:
    """The threads; a context manager. Sources can be added and removed while it runs, by any thread.

    Who owns what is true: a source belongs to its thread, which alone opens, reads and closes it and says how it is.
    What all of them said last is one immutable mapping, ``known``. It is never changed, but replaced as a whole under a
    lock: whoever takes it has one picture that stays as it is. The thread of a camera that was removed, and may hang in
    its SDK yet, has no say any more.
    """

    def __init__(self, sources: Sequence[DepthSource], rig: Rig | None, listener: Listener, held: bool = False) -> None:
        """
        Args:
            rig: where the cameras stand; by default what the sources know.
            held: open the cameras, and let them wait until ``go``.
        """
        self.rig = rig
        self._listener = listener
        self._lock = threading.Lock()
        self._readers: dict[str, _Reader] = {}
        self._known: Mapping[str, SourceState] = MappingProxyType({})
        self._running = self._stopped = False
        self._changed, self._go = threading.Condition(), threading.Event()
        if not held:
            self._go.set()
        for source in sources:
            self.add(source)
        for problem in missing_source_problems(rig, self._readers) if rig else ():
            listener.note(problem)

    @property
    def known(self) -> Mapping[str, SourceState]:
        """What is known of each source now, by name, in the order they were added."""
        return self._known

    @property
    def cameras(self) -> dict[str, DepthCamera]:
        """Those that were opened so far, as the rig places them."""
        return {name: each.camera for name, each in self._known.items() if each.camera is not None}

    def camera(self, name: str) -> DepthCamera | None:
        """One of them; None where it was not opened yet."""
        state = self._known.get(name)
        return None if state is None else state.camera

    @property
    def over(self) -> bool:
        """Nothing more will come: cameras that do not fit the rig are not waited for."""
        states = self._known.values()
        return any(each.over for each in states) and all(each.over or each.misfit for each in states)

    @property
    def tried(self) -> bool:
        """Every source was opened once, or failed."""
        return all(each.tried for each in self._known.values())

    def add(self, source: DepthSource) -> None:
        """Read one more source from now on.

        Raises:
            InputError: when one of its name is there already, or reading was stopped.
        """
        reader = _Reader(source, self, self._listener)
        with self._lock:
            if source.name in self._readers:
                raise InputError(f"two cameras are called {source.name!r}: give each its own name")
            if self._stopped:
                raise InputError(f"camera {source.name!r} cannot be added any more: reading was stopped")
            self._readers[source.name] = reader
            self._known = MappingProxyType({**self._known, source.name: SourceState()})
            running = self._running
        if running:
            reader.start()

    def remove(self, name: str) -> None:
        """Read a source no more.

        Raises:
            InputError: when there is none of this name.
        """
        with self._lock:
            if name not in self._readers:
                raise InputError(f"there is no camera {name!r}: there are {', '.join(self._readers)}")
            reader = self._readers.pop(name)
            self._known = MappingProxyType({each: known for each, known in self._known.items() if each != name})
        reader.ask_to_stop()
        reader.join(2 * LOOK_S)

    def say(self, reader: _Reader, **changes: Any) -> None:
        """Change what is known of a source; by its thread only."""
        name = reader.source.name
        with self._lock:
            if self._readers.get(name) is not reader:
                return
            now = dataclasses.replace(self._known[name], **changes)
            if now == self._known[name]:
                return
            self._known = MappingProxyType({**self._known, name: now})
        with self._changed:
            self._changed.notify_all()

    def start(self, tell: Callable[[str], None] = lambda line: None) -> None:
        """Open all sources, and wait until each is open, or failed; how long that may take, each knows itself.

        Args:
            tell: takes a line about those that take long.

        Raises:
            InputError: when none could be opened.
        """
        with self._lock:
            self._running = True
            readers = list(self._readers.values())
        for reader in readers:
            reader.start()
        begun_s, slow = time.monotonic(), False
        with self._changed:
            while not self.tried and not self._stopped:
                self._changed.wait(LOOK_S)  # not for ever, so that Ctrl-C is heard on every system
                if not slow and time.monotonic() - begun_s > SLOW_S:
                    slow = True
                    names = ", ".join(name for name, known in self._known.items() if not known.tried)
                    if names:
                        tell(f"still opening: {names}")
        if readers and not self.cameras:
            self.stop()
            by_state: dict[str, list[str]] = {}
            for name, known in self._known.items():
                by_state.setdefault(known.state, []).append(name)
            why = joined((f"{', '.join(names)}: {state}" for state, names in by_state.items()), 3)
            raise InputError(f"no camera could be opened ({why})")

    def go(self) -> None:
        """Let cameras deliver that were held."""
        self._go.set()

    def stop(self) -> None:
        """Stop reading. A call of an SDK that does not return is left behind."""
        with self._lock:
            self._stopped = True
            readers = list(self._readers.values())
        for reader in readers:
            reader.ask_to_stop()
        self._go.set()
        end_s = time.monotonic() + 2 * LOOK_S
        for reader in readers:
            reader.join(max(end_s - time.monotonic(), 0))

    def __enter__(self) -> Readers:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def wait_to_go(self) -> None:
        """Wait until cameras may deliver, or shall stop."""
        self._go.wait()


class _Reader:
    """The thread that reads one source."""

    def __init__(self, source: DepthSource, readers: Readers, listener: Listener) -> None:
        self.source, self._readers, self._listener = source, readers, listener
        self._state, self._failures = OPENING, 0
        self._delivering = self._over = False
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
        misfit_s = RETRY_S
        while not self._stop.is_set():
            wait_s = RETRY_S
            try:
                self._read_on()
            except CameraMismatchError as error:
                self._failed(error, misfit=True)
                misfit_s = wait_s = min(2 * misfit_s, RETRY_MISFIT_S)
            except Exception as error:  # whatever an SDK raises is this camera's trouble alone
                self._failed(error)
            if self._over:
                return
            self._stop.wait(wait_s)

    def _failed(self, error: Exception, **changes: Any) -> None:
        """What happens again each time that the camera is tried is told once."""
        self._failures += not self._delivering
        said = " ".join(str(error).split()) or type(error).__name__
        if said != self._state:
            name = repr(self.source.name)
            what = "was lost" if self._delivering else "cannot be opened"
            named = isinstance(error, CameraMismatchError) or name in said
            self._listener.note(said if named else f"camera {name} {what}: {said}")
        self._over = not self.source.reopens
        self._say(said, tried=True, over=self._over, failures=self._failures, **changes)

    def _say(self, state: str, **changes: Any) -> None:
        if state != self._state or changes:
            self._state = state
            self._readers.say(self, state=state, **changes)

    def _read_on(self) -> None:
        """Open the source and read it until it ends; errors come out."""
        self._delivering = False
        with self.source as source:
            rig = self._readers.rig
            camera = place_in_rig(source.camera, rig) if rig else source.camera
            self._delivering = True
            self._say(RUNNING, camera=camera, tried=True, misfit=False)
            if self._stop.is_set():
                return
            self._listener.opened(camera)
            self._readers.wait_to_go()
            while not self._stop.is_set():
                while source.problems:
                    self._listener.note(source.problems.popleft())
                try:
                    frame = source.read(LOOK_S)
                except FrameTimeoutError:
                    self._say(SILENT)
                    continue
                if frame is None:
                    self._over = True
                    break
                if self._stop.is_set():
                    return
                self._say(RUNNING)
                self._listener.deliver(frame)
            while source.problems:
                self._listener.note(source.problems.popleft())
        if self._over:
            self._say(ENDED, over=True)
