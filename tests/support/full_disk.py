"""A disk that is full, for tests."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator

import pytest

resource = pytest.importorskip("resource", reason="limits of POSIX")


@contextlib.contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """Stands for a full disk: the system writes what fits, then refuses."""
    old, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, old[1]))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
        signal.signal(signal.SIGXFSZ, handler)
