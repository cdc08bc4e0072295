"""Locks on results: only one process at a time may write a folder or a file."""

from __future__ import annotations

import contextlib
import errno
import functools
import logging
import os
import socket
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, Concatenate, ParamSpec, TypeVar

from depthmocap.core.output import remove_unfinished, writing
from depthmocap.errors import InputError

_Settings = TypeVar("_Settings")
_More = ParamSpec("_More")
_Result = TypeVar("_Result")

#: The file in a folder that names the process that has locked it.
LOCK_FILE = ".lock"
#: Bytes that are read of another process's lock file.
_MOST_BYTES = 200
#: Errors of file systems without locks, such as some network file systems.
_NO_LOCKS = {getattr(errno, name) for name in ("ENOLCK", "ENOTSUP", "EOPNOTSUPP", "ENOSYS") if hasattr(errno, name)}
_LOG = logging.getLogger(__name__)


def locks_outputs(
    folder: str | None = None, files: tuple[str, ...] = ()
) -> Callable[[Callable[Concatenate[_Settings, _More], _Result]], Callable[Concatenate[_Settings, _More], _Result]]:
    """Decorate the function of a command, so that it locks the outputs that its settings name while it runs.

    Args:
        folder: the setting with the folder of results, locked by :func:`lock_folder`.
        files: the settings with files of results, which may be None, locked by :func:`lock_file`.
    """

    def decorate(
        function: Callable[Concatenate[_Settings, _More], _Result],
    ) -> Callable[Concatenate[_Settings, _More], _Result]:
        @functools.wraps(function)
        def command(settings: _Settings, *more: _More.args, **others: _More.kwargs) -> _Result:
            def named(name: str) -> Any:
                return getattr(settings, name)

            with contextlib.ExitStack() as stack:
                if folder is not None and named(folder) is not None:
                    stack.enter_context(lock_folder(named(folder)))
                # Two options may name one file by mistake; the command itself reports that.
                for path in {path.resolve(): path for path in map(named, files) if path is not None}.values():
                    stack.enter_context(lock_file(path))
                return function(settings, *more, **others)

        return command

    return decorate


@contextlib.contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Make a folder for results, lock it against other processes and threads, and remove files that a killed process
    did not finish (:func:`~depthmocap.core.output.atomic_write`). A new folder that stays empty is removed.

    The file ``.lock`` in it names the process. The operating system's lock on that file counts, not its presence, so a
    file that a killed process has left does not lock.

    Raises:
        InputError: when another process has the folder, it cannot be written, or its ``.lock`` is a link or no file.
    """
    with _made(folder), _locked(folder / LOCK_FILE, folder):
        remove_unfinished(folder)
        yield


@contextlib.contextmanager
def lock_file(path: Path) -> Iterator[None]:
    """Lock a file of results against other processes and threads, with a lock file ``.NAME.lock`` beside it.

    Raises:
        InputError: like :func:`lock_folder`.
    """
    with _made(path.parent), _locked(path.with_name(f".{path.name}{LOCK_FILE}"), path):
        remove_unfinished(path.parent, path)
        yield


@contextlib.contextmanager
def _made(folder: Path) -> Iterator[None]:
    new = not folder.exists()
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        if new:
            with contextlib.suppress(OSError):  # the folder is not empty
                folder.rmdir()


@contextlib.contextmanager
def _locked(path: Path, what: Path) -> Iterator[None]:
    file = _open_locked(path, what)
    try:
        with writing(path):
            file.truncate(0)
            file.write(f"process {os.getpid()} on {socket.gethostname()}".encode())
            file.flush()
        yield
    finally:
        # Removed while it is locked, so that a process that has opened it notices. Windows cannot remove an open file,
        # so there a process that opens it between the two lines keeps it.
        with contextlib.suppress(OSError):
            path.unlink()
        file.close()
        with contextlib.suppress(OSError):
            if os.name == "nt":
                path.unlink()


def _open_locked(path: Path, what: Path) -> BinaryIO:
    """Open and lock the file; try again if its owner has removed it between opening and locking."""
    while True:
        file = _open(path)
        try:
            if not _try_lock(file, what):
                file.seek(0)
                holder = file.read(_MOST_BYTES).decode(errors="replace") or "another process"
                raise InputError(f"{what} is being written by {holder}: wait for it, or choose another folder")
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(path.stat(follow_symlinks=False), os.fstat(file.fileno())):
                    return file
        except BaseException:
            file.close()
            raise
        file.close()


def _open(path: Path) -> BinaryIO:
    """Open or make a lock file, but never a link to another file, symbolic or hard."""
    foreign = InputError(f"{path} is a link or no file, so that {path.parent} cannot be locked: remove it")
    if path.is_symlink():
        raise foreign
    flags = os.O_RDWR | os.O_CREAT
    # Windows lacks these flags, so only the check above protects there.
    for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_BINARY"):
        flags |= getattr(os, name, 0)
    try:
        descriptor = os.open(path, flags, 0o666)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.EISDIR, errno.ENXIO):
            raise foreign from None
        raise InputError(f"cannot write {path}: {error.strerror}") from None
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:
        os.close(descriptor)
        raise foreign
    return os.fdopen(descriptor, "r+b")


def _try_lock(file: BinaryIO, what: Path) -> bool:
    try:
        import fcntl
    except ImportError:  # Windows: the lock is on a byte behind the text, which stays readable
        import msvcrt

        try:
            file.seek(1 << 20)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)  # pyright: ignore[reportAttributeAccessIssue] - of Windows
        except OSError:
            return False
        file.seek(0)
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        _LOG.warning("%s is on a file system without locks: see that no other process writes there", what)
    return True
