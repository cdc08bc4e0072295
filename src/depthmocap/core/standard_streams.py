"""Standard output and error that nothing can fail at: closed, full, or of an encoding without our letters."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any, TextIO, cast


class LastingStream:
    """A text stream, used as such. What it cannot take is dropped, and letters that its encoding lacks are escaped.

    Attributes:
        failure: why text was dropped first, None while none was.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.failure: OSError | ValueError | None = None

    def write(self, text: str) -> int:
        """Write, or drop, the text; returns its length."""
        encoding = getattr(self._stream, "encoding", None) or "utf-8"
        shown = text if text.isascii() else text.encode(encoding, "backslashreplace").decode(encoding)
        with self._dropping():
            self._stream.write(shown)
        return len(text)

    def flush(self) -> None:
        """Write what is held back, or drop it."""
        with self._dropping():
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    @contextlib.contextmanager
    def _dropping(self) -> Iterator[None]:
        try:
            yield
        except (OSError, ValueError) as error:  # the second: of a stream that was closed here
            self.failure = self.failure or error

    def status(self) -> int:
        """The exit status of a command that printed here: 1 if something was dropped. The reason is told on
        ``sys.stderr``, unless the reader had left (``| head``)."""
        self.flush()
        if self.failure is None:
            return 0
        if not isinstance(self.failure, BrokenPipeError):
            reason = getattr(self.failure, "strerror", None) or self.failure
            sys.stderr.write(f"error: cannot write to the standard output: {reason}\n")
        return 1

    def leave(self) -> None:
        """After a failure, have the null device in the stream's place: Python flushes once more at its end, and other
        libraries write to it without asking."""
        if self.failure is None:
            return
        with contextlib.suppress(OSError, ValueError):
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self._stream.fileno())
            os.close(null)


def lasting(stream: TextIO) -> TextIO:
    """The stream, so that nothing can fail at it."""
    return stream if isinstance(stream, LastingStream) else cast(TextIO, LastingStream(stream))


@contextlib.contextmanager
def lasting_streams() -> Iterator[LastingStream]:
    """Within, ``sys.stdout`` and ``sys.stderr`` take everything, so that work whose results are files goes on without
    them; yields the first."""
    _open_standard_files()
    before = sys.stdout, sys.stderr
    out, errors = LastingStream(sys.stdout), LastingStream(sys.stderr)
    sys.stdout, sys.stderr = cast(TextIO, out), cast(TextIO, errors)
    try:
        yield out
    finally:
        sys.stdout, sys.stderr = before
        for stream in (out, errors):
            stream.flush()
            stream.leave()


def _open_standard_files() -> None:
    """Have the null device where standard files are closed: the next file that is opened would take the place of one,
    and whatever a library prints would be written into it."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # for the processes of this one, too
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115, PTH123 - as long as Python runs
