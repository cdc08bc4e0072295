"""How commands end early: SIGTERM, SIGHUP and, on Windows, SIGBREAK as Ctrl-C does, and none of them while results are
being written."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Iterator
from types import FrameType

#: Ctrl-C, and what asks a process to end: ``kill``, a supervisor, a terminal that is closed. Windows has no SIGHUP, and
#: no process there can send SIGTERM to another: what stands for both is SIGBREAK.
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
_SIGNALS = tuple(getattr(signal, name) for name in _NAMES if hasattr(signal, name))
#: One that follows another within so long tells the same (s): a closed terminal and its shell both send SIGHUP.
_SAME_S = 2.0


class Ending:
    """What was asked of this process.

    Attributes:
        status: the exit status that SIGTERM, SIGHUP or SIGBREAK asks for (128 and its number), None without.
    """

    def __init__(self) -> None:
        self.status: int | None = None
        self._last_s = -_SAME_S
        self._writing = 0
        self._waits = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """The handler of the signals: raises KeyboardInterrupt, in ``finishing`` only of a second one."""
        now_s = time.monotonic()
        again, self._last_s = now_s - self._last_s < _SAME_S, now_s
        if number != signal.SIGINT:
            if self.status is None:
                self.status = 128 + number
            if again:
                return
        if self._writing and not self._waits:
            self._waits = True
            return
        raise KeyboardInterrupt

    @contextlib.contextmanager
    def finishing(self) -> Iterator[None]:
        """See :func:`finishing`."""
        self._writing += 1
        try:
            yield
        finally:
            self._writing -= 1
            waited = self._waits and not self._writing
            if waited:
                self._waits = False
        if waited:
            raise KeyboardInterrupt


_ending: Ending | None = None


@contextlib.contextmanager
def ended_by_signals() -> Iterator[Ending]:
    """Within, these signals raise KeyboardInterrupt in the main thread, as Ctrl-C does. Signals that are ignored
    (``nohup``) or that a program handles itself stay as they are."""
    global _ending
    ending, before = Ending(), {}
    if _ending is None and threading.current_thread() is threading.main_thread():
        for number in _SIGNALS:
            if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                before[number] = signal.signal(number, ending)
        _ending = ending
    try:
        yield ending
    finally:
        if _ending is ending:
            _ending = None
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def finishing() -> Iterator[None]:
    """Within, results are written that an interruption must not part: one that comes is raised afterwards, a second one
    at once. Where :func:`ended_by_signals` does not see to them, interruptions are as anywhere."""
    if _ending is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    with _ending.finishing():
        yield


@contextlib.contextmanager
def keeping_handlers() -> Iterator[None]:
    """Within, a library may set handlers of these signals; afterwards they are as before."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            if handler is not None:
                signal.signal(number, handler)


def leave_ending_to_parent() -> None:
    """Ignore the signals in a worker: they reach whole groups of processes, and the parent decides."""
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)
