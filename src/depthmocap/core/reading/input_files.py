"""Files that users name: opened only if they are regular files, and read up to a limit."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO

from depthmocap.errors import InputError

#: Bytes of the longest text that is read; an hour of joints at 30 frames a second is half of it.
LARGEST_TEXT = 1 << 28

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def check_file(path: Path, missing: str = "") -> os.stat_result:
    """See that a path is a regular file, before a library opens it; others can keep a reader waiting for ever.

    Args:
        missing: what to do when it is not there, for the message.

    Raises:
        InputError: when it is missing, a folder, a pipe or a device, or may not be looked at.
    """
    try:
        found = path.stat()
    except FileNotFoundError:
        raise InputError(f"{path} not found" + (f": {missing}" if missing else "")) from None
    except OSError as error:
        raise _unreadable(path, error) from None
    except ValueError:  # a zero byte
        raise InputError(f"{str(path)!r} cannot be a file's name") from None
    _check_regular(path, found)
    return found


def open_file(path: Path, missing: str = "") -> BinaryIO:
    """A regular file, to be read as bytes.

    Raises:
        InputError: as :func:`check_file`, or when it may not be read.
    """
    check_file(path, missing)
    # Without waiting: what was a file a moment ago may be a pipe by now.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)
    try:
        number = os.open(path, flags)
    except OSError as error:
        raise _unreadable(path, error) from None
    try:
        _check_regular(path, os.fstat(number))
        return os.fdopen(number, "rb")
    except BaseException:
        os.close(number)
        raise


def read_bytes(path: Path, most: int, missing: str = "") -> bytes:
    """All of a regular file of at most so many bytes.

    Raises:
        InputError: as :func:`open_file`, or when it is larger.
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
    """A text in UTF-8, with or without a byte-order mark; line ends become ``\\n``.

    Raises:
        InputError: as :func:`read_bytes`, or when it is not UTF-8.
    """
    try:
        text = read_bytes(path, most, missing).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not text in UTF-8 (byte {error.start}): save it as UTF-8") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _check_regular(path: Path, found: os.stat_result) -> None:
    if not stat.S_ISREG(found.st_mode):
        kind = next((words for test, words in _KINDS if test(found.st_mode)), "no regular file")
        raise InputError(f"{path} cannot be read: it is {kind}, not a file")


def _unreadable(path: Path, error: OSError) -> InputError:
    return InputError(f"{path} cannot be read: {error.strerror or error}")
