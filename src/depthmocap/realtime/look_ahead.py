"""Work on the next set in a thread of its own, while the set before is finished."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType
from typing import Generic, TypeVar

#: Seconds after which a wait looks about itself, because some systems notice Ctrl-C only then.
_POLL_S = 0.2

T = TypeVar("T")


class LookAhead(Generic[T]):
    """Calls a function again and again in one other thread, each time when asked; a context manager.

    The thread is a daemon: a program that forgets the end of a capture can still end.
    """

    def __init__(self, call: Callable[[], T]) -> None:
        self._call, self._changed = call, threading.Condition()
        self._asked = self._leaving = False
        self._done: list[T] = []
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="look ahead", daemon=True)

    @property
    def leaving(self) -> bool:
        """Whether nobody waits any more for what the function gives."""
        return self._leaving

    def begin(self) -> None:
        """Ask for the next call; :meth:`result` takes what it gives."""
        with self._changed:
            self._asked = True
            self._changed.notify_all()

    def result(self) -> T:
        """What the call gives that was asked for, as soon as it does; raises what the call raises."""
        with self._changed:
            while not self._done and self._failure is None:
                self._changed.wait(_POLL_S)
            if self._failure is not None:
                raise self._failure
            return self._done.pop()

    def __enter__(self) -> LookAhead[T]:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait for a call that runs, and forget what it gives."""
        with self._changed:
            self._leaving = True
            self._changed.notify_all()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._asked and not self._leaving:
                    self._changed.wait(_POLL_S)
                if self._leaving:
                    return
                self._asked = False
            given, failure = list[T](), None
            try:
                given.append(self._call())
            except BaseException as error:  # ``result`` raises it again
                failure = error
            with self._changed:
                self._done, self._failure = given, failure
                self._changed.notify_all()
