"""Calls of SDKs that may never return."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

_Result = TypeVar("_Result")


class HangsError(Exception):
    """A call did not return in time; ``thread`` is the one it is left behind in."""

    def __init__(self, thread: threading.Thread) -> None:
        super().__init__("a call did not return")
        self.thread = thread


def within(limit_s: float, call: Callable[[], _Result], undo: Callable[[], None] | None = None) -> _Result:
    """What ``call`` returns or raises. After ``limit_s`` it is left behind, and undone should it return later.

    Raises:
        HangsError: when it did not return in time.
    """
    outcome: list[tuple[_Result, None] | tuple[None, BaseException]] = []
    left, lock = False, threading.Lock()

    def run() -> None:
        try:
            made = call(), None
        except BaseException as raised:  # raised again where it was called
            made = None, raised
        with lock:
            outcome.append(made)
            if not left:
                return
        if made[1] is None and undo is not None:
            undo()

    # A daemon, because a call that never returns must not keep the process alive.
    thread = threading.Thread(target=run, name="call of an SDK", daemon=True)
    thread.start()
    try:
        thread.join(limit_s)
    finally:  # Ctrl-C as well
        with lock:
            left = not outcome
    if left:
        raise HangsError(thread)
    result, error = outcome[0]
    if error is not None:
        raise error
    return result  # type: ignore[return-value]
