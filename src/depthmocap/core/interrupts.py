"""Early end of commands: SIGTERM, SIGHUP and, on Windows, SIGBREAK act like Ctrl-C, and all of them wait while results
are being written."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Iterator
from types import FrameType

#: Ctrl-C, and the signals that ask a process to end: from ``kill``, a supervisor, a closed terminal. Windows has no
#: SIGHUP, and processes there cannot send SIGTERM; SIGBREAK replaces both.
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
_SIGNALS = tuple(getattr(signal, name) for name in _NAMES if hasattr(signal, name))
#: A signal within this time after another (s) is a repetition: a closed terminal and its shell both send SIGHUP.
_REPEAT_S = 2.0


class SignalHandler:
    """Handles the signals that end this process.

    Attributes:
        status: the exit status for SIGTERM, SIGHUP or SIGBREAK (128 plus its number); None if none came.
    """

    def __init__(self) -> None:
        self.status: int | None = None
        self._last_s = -_REPEAT_S
        self._writing = 0
        self._deferred = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt; within ``deferred_interrupts``, only for a second signal."""
        now_s = time.monotonic()
        again, self._last_s = now_s - self._last_s < _REPEAT_S, now_s
        if number != signal.SIGINT:
            if self.status is None:
                self.status = 128 + number
            if again:
                return
        if self._writing and not self._deferred:
            self._deferred = True
            return
        raise KeyboardInterrupt

    @contextlib.contextmanager
    def deferred_interrupts(self) -> Iterator[None]:
        """Defer the first signal, as :func:`deferred_interrupts` does."""
        self._writing += 1
        try:
            yield
        finally:
            self._writing -= 1
            waited = self._deferred and not self._writing
            if waited:
                self._deferred = False
        if waited:
            raise KeyboardInterrupt


_handler: SignalHandler | None = None


@contextlib.contextmanager
def handled_signals() -> Iterator[SignalHandler]:
    """Make these signals raise KeyboardInterrupt in the main thread, as Ctrl-C does. Signals that are ignored
    (``nohup``), or that the program handles itself, stay as they are."""
    global _handler
    ending, before = SignalHandler(), {}
    if _handler is None and threading.current_thread() is threading.main_thread():
        for number in _SIGNALS:
            if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                before[number] = signal.signal(number, ending)
        _handler = ending
    try:
        yield ending
    finally:
        if _handler is ending:
            _handler = None
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def deferred_interrupts() -> Iterator[None]:
    """Defer an interruption until the results in the body are written; a second one is raised at once. Outside
    :func:`handled_signals` and other than in the main thread, this has no effect."""
    if _handler is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    with _handler.deferred_interrupts():
        yield


@contextlib.contextmanager
def preserved_handlers() -> Iterator[None]:
    """Restore the handlers of these signals after a library may have changed them."""
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


def ignore_signals() -> None:
    """Ignore the signals in a worker process: they reach whole process groups, and the parent decides what to do."""
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)
