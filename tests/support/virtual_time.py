"""Time that passes only while every thread waits, so that threads are tested at once and on any machine alike."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import threading
import time
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any

import camera_simulator
import pytest

from depthmocap.cameras import playback_clock, source, time_limit
from depthmocap.realtime import live_capture, live_command, look_ahead, multi_camera_reader, record, synced_reader
from depthmocap.recordings import recorded_camera
from depthmocap.rigging import rig_session, setup_command
from depthmocap.synth import synthetic_camera

MODULES: tuple[ModuleType, ...] = (
    synced_reader, live_capture, live_command, look_ahead, multi_camera_reader, playback_clock, record, recorded_camera,
    camera_simulator, rig_session, setup_command, source, synthetic_camera, time_limit,
)  # fmt: skip


class _OverError(BaseException):
    """The test is over."""


@dataclasses.dataclass(eq=False)
class _Wait:
    on: object
    until_ns: int | None
    told: bool = False


class VirtualTime:
    """Stands for the modules ``time`` and ``threading``. The thread that makes it counts as one of its threads.

    Locks are real: they must not be held while waiting for anything else.
    """

    def __init__(self) -> None:
        self.now_ns = 5_000_000_000
        self._changed = threading.Condition()
        self._threads, self._waits, self._closed, self._stuck = 1, list[_Wait](), False, False
        self.Thread = functools.partial(_Thread, self)
        self.Event = functools.partial(_Event, self)
        self.Condition = functools.partial(_Condition, self)

    def __getattr__(self, name: str) -> Any:
        return getattr(time, name) if hasattr(time, name) else getattr(threading, name)

    def monotonic_ns(self) -> int:
        return self.now_ns

    def monotonic(self) -> float:
        return self.now_ns * 1e-9

    def sleep(self, seconds: float) -> None:
        self.wait(None, seconds + 1e-9)  # never less than asked for

    def Timer(self, interval: float, function: Callable[[], Any]) -> _Thread:  # noqa: N802 - as threading calls it
        cancelled = self.Event()
        timer = self.Thread(target=lambda: cancelled.wait(interval) or function())
        timer.cancel = cancelled.set
        return timer

    def wait(self, on: object, timeout_s: float | None) -> bool:
        """Wait until ``tell(on)``, or for so long; whether it was told."""
        with self._changed:
            wait = _Wait(on, None if timeout_s is None else self.now_ns + round(max(timeout_s, 0) * 1e9))
            self._waits.append(wait)
            self._advance()
            while wait in self._waits:
                if self._closed:
                    raise _OverError
                if self._stuck:
                    raise RuntimeError("every thread waits for ever")
                self._changed.wait()
        return wait.told

    def tell(self, on: object) -> None:
        """Let those go on who wait on it."""
        with self._changed:
            for wait in self._waits:
                wait.told = wait.on is on
            self._release()

    def count(self, more: int) -> None:
        """There are more threads, or fewer."""
        with self._changed:
            self._threads += more
            self._advance()

    def close(self) -> None:
        """End the threads that still wait."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _advance(self) -> None:
        if len(self._waits) < self._threads:
            return
        ends = [wait.until_ns for wait in self._waits if wait.until_ns is not None]
        self._stuck = not ends
        self.now_ns = max(self.now_ns, min(ends, default=0))
        self._release()

    def _release(self) -> None:
        now_ns = self.now_ns
        self._waits = [w for w in self._waits if not w.told and (w.until_ns is None or w.until_ns > now_ns)]
        self._changed.notify_all()


class _Condition:
    """All share one lock, which waiting gives up as a whole."""

    def __init__(self, owner: VirtualTime, lock: object = None) -> None:
        self._time = owner

    def __enter__(self) -> None:
        self._time._changed.acquire()

    def __exit__(self, *error: object) -> None:
        self._time._changed.release()

    def wait(self, timeout: float | None = None) -> bool:
        return self._time.wait(self, timeout)

    def wait_for(self, ready: Callable[[], Any], timeout: float) -> Any:
        end_ns = self._time.now_ns + round(timeout * 1e9)
        while not (outcome := ready()) and self._time.now_ns < end_ns:
            self.wait((end_ns - self._time.now_ns) * 1e-9)
        return outcome

    def notify_all(self) -> None:
        self._time.tell(self)


class _Event:
    def __init__(self, owner: VirtualTime) -> None:
        self._changed, self._set = _Condition(owner), False

    def is_set(self) -> bool:
        return self._set

    def set(self) -> None:
        self._set = True
        self._changed.notify_all()

    def clear(self) -> None:
        self._set = False

    def wait(self, timeout: float = float(2**30)) -> bool:
        with self._changed:
            return self._changed.wait_for(self.is_set, timeout)


class _Thread(threading.Thread):
    def __init__(self, owner: VirtualTime, **arguments: Any) -> None:
        super().__init__(**{**arguments, "daemon": True})
        self._time, self._alive = owner, False
        self.cancel: Callable[[], None] = lambda: None

    def start(self) -> None:
        self._alive = True
        self._time.count(1)
        super().start()

    def run(self) -> None:
        try:
            with contextlib.suppress(_OverError):
                super().run()
        finally:
            self._alive = False
            self._time.tell(self)
            self._time.count(-1)

    def is_alive(self) -> bool:
        return self._alive

    def join(self, timeout: float | None = None) -> None:
        with self._time._changed:
            if self._alive:
                self._time.wait(self, timeout)


@contextlib.contextmanager
def virtual_time() -> Iterator[VirtualTime]:
    """Cameras, their threads and motion capture run in virtual time."""
    made = VirtualTime()
    with pytest.MonkeyPatch.context() as patch:
        for module in MODULES:
            for name in {"time", "threading"} & set(vars(module)):
                patch.setattr(module, name, made)
        yield made
        made.close()
