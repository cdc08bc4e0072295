"""Standard output and error that never fail, even if they are closed, full, or lack characters in their encoding."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any, TextIO, cast


class FaultTolerantStream:
    """Wraps a text stream. It drops text that the stream does not take, and escapes characters that its encoding lacks.

    Attributes:
        failure: the first error for which text was dropped; None if there was none.
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
        """Flush the stream, or drop its text."""
        with self._dropping():
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    @contextlib.contextmanager
    def _dropping(self) -> Iterator[None]:
        try:
            yield
        except (OSError, ValueError) as error:  # ValueError: the stream was closed in this process
            self.failure = self.failure or error

    def status(self) -> int:
        """The exit status of a command that printed here: 1 if text was dropped. The reason is printed on
        ``sys.stderr``, unless the reader of a pipe has closed it (``| head``)."""
        self.flush()
        if self.failure is None:
            return 0
        if not isinstance(self.failure, BrokenPipeError):
            reason = getattr(self.failure, "strerror", None) or self.failure
            sys.stderr.write(f"error: cannot write to the standard output: {reason}\n")
        return 1

    def leave(self) -> None:
        """After a failure, replace the stream by the null device, because Python flushes it when it exits, and
        libraries may write to it."""
        if self.failure is None:
            return
        with contextlib.suppress(OSError, ValueError):
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self._stream.fileno())
            os.close(null)


def fault_tolerant(stream: TextIO) -> TextIO:
    """The stream, wrapped so that it never fails."""
    return stream if isinstance(stream, FaultTolerantStream) else cast(TextIO, FaultTolerantStream(stream))


@contextlib.contextmanager
def fault_tolerant_streams() -> Iterator[FaultTolerantStream]:
    """Make ``sys.stdout`` and ``sys.stderr`` fault-tolerant, so that work whose results are files continues without
    them; yields the wrapped ``sys.stdout``."""
    _open_standard_files()
    before = sys.stdout, sys.stderr
    out, errors = FaultTolerantStream(sys.stdout), FaultTolerantStream(sys.stderr)
    sys.stdout, sys.stderr = cast(TextIO, out), cast(TextIO, errors)
    try:
        yield out
    finally:
        sys.stdout, sys.stderr = before
        for stream in (out, errors):
            stream.flush()
            stream.leave()


def _open_standard_files() -> None:
    """Open the null device in place of closed standard files. Otherwise the next opened file would take the number of
    one, and text that a library prints would be written into it."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # child processes need it, too
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115, PTH123 - as long as Python runs
