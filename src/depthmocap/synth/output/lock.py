"""One process at a time in a folder."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from depthmocap.errors import InputError


@contextlib.contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Keep others out of a folder through the file ``.lock`` in it, which tells who holds it.

    The operating system's lock on the file counts, not its presence: what a killed process leaves does not lock.

    Raises:
        InputError: when another process has the folder.
    """
    path = folder / ".lock"
    with _opened(path) as file:
        file.truncate(0)
        file.write(f"process {os.getpid()} on {socket.gethostname()}".encode())
        file.flush()
        try:
            yield
        finally:
            path.unlink(missing_ok=True)


def _opened(path: Path) -> BinaryIO:
    """The file, locked. It may have been removed by who held it between opening and locking: then anew."""
    while True:
        file = path.open("a+b")
        if not _try_lock(file):
            with file:
                file.seek(0)
                holder = file.read().decode(errors="replace") or "another process"
            raise InputError(f"{path.parent} is being written by {holder}: wait for it or choose another --out")
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(path.stat(), os.fstat(file.fileno())):
                return file
        file.close()


def _try_lock(file: BinaryIO) -> bool:
    try:
        import fcntl
    except ImportError:  # Windows, where an open file cannot be removed and the lock is on its first byte
        import msvcrt

        try:
            file.seek(1 << 20)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)  # pyright: ignore[reportAttributeAccessIssue]
        except OSError:
            return False
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
