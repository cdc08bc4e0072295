"""The rule for names of cameras.

A camera's name must work as a folder name on any system, as a part of MCAP topics, and as a word in tables.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from depthmocap.errors import InputError
from depthmocap.text import is_visible

#: Longest name in bytes of UTF-8. Every file system takes 143; the paths of files in the folder are longer.
_LONGEST = 128
#: Characters that file names cannot have on some system, or that separate the names in a path.
_FORBIDDEN = '/\\:*?"<>|'
#: Device names of Windows, which are reserved with any ending and in any case.
_DEVICES = {"con", "prn", "aux", "nul", *(f"{port}{number}" for port in ("com", "lpt") for number in range(1, 10))}
#: Names that recordings use: files of the folder, and the world frame of MCAP's transforms.
_OURS = {"rig.json", "truth.csv", "unfinished.json", "world"}


def _is_reserved(name: str) -> bool:
    return name.casefold() in _OURS or name.casefold().partition(".")[0].rstrip() in _DEVICES


def _fault(name: str) -> str:
    """The reason why a camera cannot have this name; empty if it can."""
    if not name:
        return "is empty"
    if bad := next((letter for letter in name if letter in _FORBIDDEN or not is_visible(letter)), ""):
        return f"has {bad!r} in it"
    if name[0] in " ." or name[-1] in " .":
        return "begins or ends with a dot or a space"
    if _is_reserved(name):
        return "is a reserved name"
    return f"is longer than {_LONGEST} bytes" if len(name.encode()) > _LONGEST else ""


def check_camera_name(name: object) -> None:
    """Check that a camera can have this name.

    Raises:
        InputError: when it is no text, cannot be a folder name on every system, or is reserved by a system or by
            recordings.
    """
    if not isinstance(name, str):  # files may hold any type
        raise InputError(f"a camera's name must be text, got {name!r}")
    if fault := _fault(name):
        raise InputError(f"{name!r} {fault}, so that it cannot be a camera's name: call it {safe_name(name)!r}")


def safe_name(name: str, taken: Iterable[str] = ()) -> str:
    """The name itself if a camera can have it, otherwise a similar one; never one of those in ``taken``."""
    kept = name
    if _fault(name):
        letters = (letter if letter not in _FORBIDDEN and is_visible(letter) else "\0" for letter in name)
        kept = re.sub("\0+", "-", "".join(letters)).encode()[: _LONGEST - 16].decode(errors="ignore").strip(" .-")
        if not kept or _is_reserved(kept):
            kept = f"camera-{kept}" if kept else "camera"
    taken, number, unique = set(taken), 1, kept
    while unique in taken:
        number += 1
        unique = f"{kept}-{number}"
    return unique


def safe_names(names: Iterable[str]) -> dict[str, str]:
    """A distinct valid camera name for each name: the name itself if it is valid."""
    names = list(names)
    valid = {name: name for name in names if not _fault(name)}
    for name in names:
        if name not in valid:
            valid[name] = safe_name(name, valid.values())
    return {name: valid[name] for name in names}
