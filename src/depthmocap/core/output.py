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


#: Names of files that are not written completely.
_UNFINISHED = re.compile(r"\.(.*)\.part-\d+(\..*)?")
#: Number of characters of the file's name in such a name, because the length of names is limited.
_KEPT = 60


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Write a file atomically: yields a temporary path beside ``path`` with the same ending, to be written in the body,
    and then moves it to ``path``. So ``path`` is complete or unchanged, whatever happens, and after an error the
    temporary file is removed. Missing folders are made.

    Raises:
        InputError: when the file cannot be written, and for an ``OSError`` in the body.
    """
    unfinished = path.with_name(f".{path.stem[:_KEPT]}.part-{os.getpid()}{path.suffix}")
    with writing(path):
        _check_replaceable(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        # A file of a killed process with the same number, or a link, which must not be followed.
        unfinished.unlink(missing_ok=True)
        try:
            yield unfinished
            unfinished.replace(path)
        finally:
            with contextlib.suppress(OSError):
                unfinished.unlink(missing_ok=True)


def write_file(path: Path, data: bytes | memoryview | str) -> None:
    """Write a file by :func:`atomic_write`, text as UTF-8 with its own line ends. Bytes of a path that are no UTF-8 are
    escaped as in JSON: ``\\udcff``.

    Raises:
        InputError: when it cannot be written.
    """
    with atomic_write(path) as unfinished:
        unfinished.write_bytes(data.encode(errors="backslashreplace") if isinstance(data, str) else data)


def open_new(path: Path) -> io.BufferedWriter:
    """Open a file that grows and is useful before it is complete. It replaces an existing file; of a link it replaces
    the link itself, not the linked file.

    Raises:
        InputError: when the path is something other than a file.
        OSError: when the file cannot be made.
    """
    while True:
        try:
            return path.open("xb")
        except FileExistsError:
            _check_replaceable(path)
            path.unlink(missing_ok=True)


def make_inner_folder(folder: Path) -> None:
    """Make a folder inside a folder of results, if it does not exist.

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
    """A new text file in UTF-8 to which lines are appended; it replaces an existing file. Each line is handed to the
    system at once and complete, so it survives the end of the process, and a full disk leaves no partial line.

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
            InputError: when it cannot be written; the earlier lines are in the file.
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
        """Close the file; ``add`` opens it again."""
        self._file.close()


def remove_unfinished(folder: Path, of: Path | None = None) -> None:
    """Remove temporary files that a killed process has left behind in :func:`atomic_write`.

    Args:
        folder: a folder that no other process writes.
        of: only the temporary files of this file in it, which no other process writes.

    Raises:
        InputError: when the folder cannot be read.
    """
    with writing(folder):
        paths = list(folder.iterdir())
    for path in paths:
        match = _UNFINISHED.fullmatch(path.name)
        if match and (of is None or (match[1], match[2] or "") == (of.stem[:_KEPT], of.suffix)):
            with contextlib.suppress(OSError):  # a folder is not one of these files
                path.unlink()


def check_outputs(outputs: Mapping[str, Path | None], inputs: Mapping[str, Path | None] | None = None) -> None:
    """Check before long work that the output files of a command can be written, and that they replace neither one
    another nor an input.

    Args:
        outputs: output files by option, such as ``"--out"``.
        inputs: inputs by their words in messages, such as ``"the recording"``. No file in an input folder may be
            replaced.

    Raises:
        InputError: when an output would replace another file of the command, is a folder, or cannot be written.
    """
    input_paths = {words: path.resolve() for words, path in (inputs or {}).items() if path is not None}
    taken = {path: words for words, path in input_paths.items()}
    for option, path in outputs.items():
        if path is None:
            continue
        place = path.resolve()
        if words := taken.get(place):
            raise InputError(f"{option} must not be {words}, got {path}: choose another name")
        if place.is_dir():
            raise InputError(f"{option} must be a file, got the folder {path}")
        for words, folder in input_paths.items():
            if place.is_relative_to(folder) and place.exists():
                raise InputError(f"{option} must not be a file of {words}, got {path}: choose another name")
        taken[place] = f"the file of {option}"
        there = next(parent for parent in place.parents if parent.exists())
        with writing(path):
            tempfile.TemporaryFile(dir=there).close()


def plain_json(value: Any) -> Any:
    """The value with NaN and infinity as null, because JSON has no such numbers."""
    if isinstance(value, Mapping):
        return {key: plain_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_json(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_json(path: Path, value: Any) -> None:
    """Write a value as JSON, with NaN as null, and make the folder.

    Raises:
        InputError: when the file cannot be written.
    """
    write_file(path, json.dumps(plain_json(value), indent=1, ensure_ascii=False) + "\n")
