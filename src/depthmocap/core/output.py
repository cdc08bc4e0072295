"""Files that commands write: seen to before the work is done, errors in the user's words."""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import re
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from depthmocap.errors import InputError


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn an ``OSError`` within into an ``InputError`` that names the file."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error


#: Names under which files are written until they are whole.
_UNFINISHED = re.compile(r"\.(.*)\.part-\d+(\..*)?")
#: Letters of a file's name that such a name has at most: names have an end.
_KEPT = 60


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A file beside ``path``, with its ending, to be written within; afterwards it takes the place of ``path``, so that
    this is there whole or as it was before, whatever happens. After an error nothing of it is left. Folders are made.

    Raises:
        InputError: when it cannot be written; of an ``OSError`` within, too.
    """
    unfinished = path.with_name(f".{path.stem[:_KEPT]}.part-{os.getpid()}{path.suffix}")
    with writing(path):
        _check_replaceable(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        # Of a killed process with this one's number; or a link, which must not be followed.
        unfinished.unlink(missing_ok=True)
        try:
            yield unfinished
            unfinished.replace(path)
        finally:
            with contextlib.suppress(OSError):
                unfinished.unlink(missing_ok=True)


def write_file(path: Path, data: bytes | memoryview | str) -> None:
    """Write a file in one piece (see :func:`replacing`), text as UTF-8 with the line ends it has. Bytes of a path that
    are no UTF-8 are escaped, as JSON escapes them: ``\\udcff``.

    Raises:
        InputError: when it cannot be written.
    """
    with replacing(path) as unfinished:
        unfinished.write_bytes(data.encode(errors="backslashreplace") if isinstance(data, str) else data)


def open_new(path: Path) -> io.BufferedWriter:
    """Open a file that is written as it grows, and is of use before it is whole. It takes the place of a file of its
    name; of a link only the link, so that nothing elsewhere is written over.

    Raises:
        InputError: when something else is in its place.
        OSError: when it cannot be made.
    """
    while True:
        try:
            return path.open("xb")
        except FileExistsError:
            _check_replaceable(path)
            path.unlink(missing_ok=True)


def make_inner_folder(folder: Path) -> None:
    """Make a folder in one of results, if it is not there.

    Raises:
        InputError: when it cannot be made, or is a link to a folder elsewhere.
    """
    if folder.is_symlink():
        raise InputError(f"{folder} is a link, by which files elsewhere would be written over: remove it")
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)


def _check_replaceable(path: Path) -> None:
    if path.exists() and not path.is_file():  # such as /dev/null
        raise InputError(f"cannot write {path}: it is no file")


class LineFile:
    """A new text file in UTF-8, in place of one of its name, to which lines are appended. Each is handed to the system
    at once and whole: a process that is killed afterwards keeps it, and a full disk leaves no half of one.

    Raises:
        InputError: when it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with writing(path):
            self._file = open_new(path).detach()

    def add(self, line: str) -> None:
        """Append a line, without its end.

        Raises:
            InputError: when it cannot be written; the lines before are in the file.
        """
        rest = memoryview(f"{line}\n".encode())
        with writing(self._path):
            if self._file.closed:
                flags = os.O_WRONLY | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
                self._file = os.fdopen(os.open(self._path, flags), "ab", buffering=0)
            before = self._file.tell()
            try:
                while rest:
                    rest = rest[self._file.write(rest) or 0 :]
            except BaseException:
                self._file.truncate(before)
                self._file.seek(before)
                raise

    def close(self) -> None:
        """Close the file; a line that is added opens it again."""
        self._file.close()


def remove_unfinished(folder: Path, of: Path | None = None) -> None:
    """Remove what a killed process left of files that it was :func:`replacing`: in a folder that nobody else writes, or
    ``of`` one file in it that nobody else does.

    Raises:
        InputError: when the folder cannot be read.
    """
    with writing(folder):
        names = list(folder.iterdir())
    for path in names:
        found = _UNFINISHED.fullmatch(path.name)
        if found and (of is None or (found[1], found[2] or "") == (of.stem[:_KEPT], of.suffix)):
            with contextlib.suppress(OSError):  # a folder is not ours
                path.unlink()


def check_outputs(outputs: Mapping[str, Path | None], inputs: Mapping[str, Path | None] | None = None) -> None:
    """See that files which a command shall write do not take the place of one another or of what it reads, and that
    there is room for them to be written, before it works for hours.

    Args:
        outputs: by option, such as ``"--out"``.
        inputs: what is read, by the words for it, such as ``"the recording"``; nothing in a folder that is read is
            written over.

    Raises:
        InputError: when they do.
    """
    given = {words: path.resolve() for words, path in (inputs or {}).items() if path is not None}
    taken = {path: words for words, path in given.items()}
    for option, path in outputs.items():
        if path is None:
            continue
        place = path.resolve()
        if words := taken.get(place):
            raise InputError(f"{option} must not be {words}, got {path}: choose another name")
        if place.is_dir():
            raise InputError(f"{option} must be a file, got the folder {path}")
        for words, folder in given.items():
            if place.is_relative_to(folder) and place.exists():
                raise InputError(f"{option} must not be a file of {words}, got {path}: choose another name")
        taken[place] = f"the file of {option}"
        there = next(parent for parent in place.parents if parent.exists())
        with writing(path):
            tempfile.TemporaryFile(dir=there).close()


def plain_json(value: Any) -> Any:
    """The value with NaN as null, which JSON has no number for."""
    if isinstance(value, Mapping):
        return {key: plain_json(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain_json(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_json(path: Path, value: Any) -> None:
    """Write numbers and texts, NaN as null, and make the folder.

    Raises:
        InputError: when the file cannot be written.
    """
    write_file(path, json.dumps(plain_json(value), indent=1, ensure_ascii=False) + "\n")
