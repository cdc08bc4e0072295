"""Opens files that users name, only if they are regular files, and reads them up to a size limit."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO

from depthmocap.errors import InputError

#: Largest size of a text (bytes); an hour of joints at 30 frames a second is half of it.
LARGEST_TEXT = 1 << 28

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def check_file(path: Path, missing: str = "") -> os.stat_result:
    """Check that a path is a regular file before a library opens it, because reading other kinds may never return.

    Args:
        missing: what to do if it does not exist, for the message.

    Raises:
        InputError: when it is missing, a folder, a pipe or a device, or cannot be accessed.
    """
    try:
        status = path.stat()
    except FileNotFoundError:
        raise InputError(f"{path} not found" + (f": {missing}" if missing else "")) from None
    except OSError as error:
        raise _unreadable(path, error) from None
    except ValueError:  # a zero byte
        raise InputError(f"{str(path)!r} cannot be a file's name") from None
    _check_regular(path, status)
    return status


def open_file(path: Path, missing: str = "") -> BinaryIO:
    """Open a regular file for reading bytes.

    Raises:
        InputError: like :func:`check_file`, or when it cannot be read.
    """
    check_file(path, missing)
    # Without blocking, because the file may have been replaced by a pipe since the check.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)
    try:
        descriptor = os.open(path, flags)
    except OSError as error:
        raise _unreadable(path, error) from None
    try:
        _check_regular(path, os.fstat(descriptor))
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_bytes(path: Path, most: int, missing: str = "") -> bytes:
    """Read all bytes of a regular file, at most ``most``.

    Raises:
        InputError: like :func:`open_file`, or when it is larger.
    """
    with open_file(path, missing) as file:
        try:
            data = file.read(most + 1)
        except OSError as error:
            raise _unreadable(path, error) from None
    if len(data) > most:
        raise InputError(f"{path} is larger than the {most / 1e6:,.0f} MB that such a file may have")
    return data


def read_text(path: Path, most: int = LARGEST_TEXT, missing: str = "") -> str:
    """Read a text in UTF-8, with or without a byte-order mark; line ends become ``\\n``.

    Raises:
        InputError: like :func:`read_bytes`, or when it is not UTF-8.
    """
    try:
        text = read_bytes(path, most, missing).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not text in UTF-8 (byte {error.start}): save it as UTF-8") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _check_regular(path: Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        kind = next((words for test, words in _KINDS if test(status.st_mode)), "no regular file")
        raise InputError(f"{path} cannot be read: it is {kind}, not a file")


def _unreadable(path: Path, error: OSError) -> InputError:
    return InputError(f"{path} cannot be read: {error.strerror or error}")
