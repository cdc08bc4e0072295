"""The mark of an unfinished recording folder: a file that exists from before the first frame until after the last."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

from depthmocap.core.locks import LOCK_FILE
from depthmocap.core.output import write_file
from depthmocap.core.reading.json_text import read_json
from depthmocap.errors import InputError

UNFINISHED_FILE = "unfinished.json"


def mark_unfinished(folder: Path, copy_of: Path | None) -> None:
    """Mark a folder as being written, and note the recording of which it is a copy, if it is one.

    Raises:
        InputError: when the mark cannot be written.
    """
    source = None if copy_of is None else str(copy_of.resolve())
    write_file(folder / UNFINISHED_FILE, json.dumps({"copy_of": source}) + "\n")


def _copied(folder: Path) -> str | None:
    """The recording of which a marked folder is a copy; None if unknown."""
    with contextlib.suppress(InputError):
        document = read_json(folder / UNFINISHED_FILE)
        source = document.get("copy_of") if isinstance(document, dict) else None
        return source if isinstance(source, str) else None
    return None


def unfinished(folder: Path) -> str | None:
    """A line about a folder that is unfinished; None if it is finished."""
    if not (folder / UNFINISHED_FILE).is_file():
        return None
    source = _copied(folder)
    if source is None:
        return f"{folder} was not finished by who wrote it: what is in it is read"
    return f"{folder} is a copy of {source} that was not finished: run depthmocap convert again, which begins anew"


def remove_unfinished_copy(folder: Path, source: Path) -> bool:
    """Remove the files of an unfinished copy of ``source`` that ``RecordingWriter`` wrote, and no others; returns
    whether the folder is empty now."""
    if _copied(folder) != str(source.resolve()):
        return False
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            for file in path.glob("*.png"):
                if file.stem.isdecimal() or file.name == "background.png" or ".part-" in file.name:
                    file.unlink()
            with contextlib.suppress(OSError):  # the folder holds other files
                path.rmdir()
        elif path.name in ("rig.json", "truth.csv"):
            path.unlink()
    return all(path.name in (UNFINISHED_FILE, LOCK_FILE) for path in folder.iterdir())
