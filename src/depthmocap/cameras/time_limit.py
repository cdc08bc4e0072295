"""A time limit for SDK calls that may never return."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

_Result = TypeVar("_Result")


class CallTimeoutError(Exception):
    """A call did not return in time; it still runs in ``thread``."""

    def __init__(self, thread: threading.Thread) -> None:
        super().__init__("a call did not return")
        self.thread = thread


def call_with_timeout(limit_s: float, call: Callable[[], _Result], undo: Callable[[], None] | None = None) -> _Result:
    """Return or raise what ``call`` returns or raises. If it returns only after ``limit_s``, ``undo`` is called then.

    Raises:
        CallTimeoutError: when it did not return in time.
    """
    results: list[_Result] = []
    errors: list[BaseException] = []
    timed_out, lock = False, threading.Lock()

    def run() -> None:
        try:
            result = call()
        except BaseException as raised:  # raised again where it was called
            errors.append(raised)
            return
        with lock:
            results.append(result)
            if not timed_out:
                return
        if undo is not None:
            undo()

    # A daemon, because a call that never returns must not keep the process alive.
    thread = threading.Thread(target=run, name="call of an SDK", daemon=True)
    thread.start()
    try:
        thread.join(limit_s)
    finally:  # Ctrl-C as well
        with lock:
            timed_out = not (results or errors)
    if timed_out:
        raise CallTimeoutError(thread)
    if errors:
        raise errors[0]
    return results[0]
