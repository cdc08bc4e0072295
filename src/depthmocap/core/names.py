"""Names of cameras: one rule for all that reads or writes them.

A camera's name is a folder's name, a part of MCAP topics and a word in tables, on any system.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from depthmocap.errors import InputError
from depthmocap.text import is_shown

#: Bytes of a name in UTF-8: file systems take 143 at least, and files in the folder have longer paths.
_LONGEST = 128
#: Signs that a file's name cannot have on some system, or that part the names in a path.
_FORBIDDEN = '/\\:*?"<>|'
#: Names of devices on Windows, with any ending, in any case.
_DEVICES = {"con", "prn", "aux", "nul", *(f"{port}{number}" for port in ("com", "lpt") for number in range(1, 10))}
#: What recordings use themselves: files of the folder, and the frame that MCAP's transforms lead to.
_OURS = {"rig.json", "truth.csv", "unfinished.json", "world"}


def _is_reserved(name: str) -> bool:
    return name.casefold() in _OURS or name.casefold().partition(".")[0].rstrip() in _DEVICES


def _fault(name: str) -> str:
    """Why a name cannot be a camera's; nothing if it can."""
    if not name:
        return "is empty"
    if bad := next((letter for letter in name if letter in _FORBIDDEN or not is_shown(letter)), ""):
        return f"has {bad!r} in it"
    if name[0] in " ." or name[-1] in " .":
        return "begins or ends with a dot or a space"
    if _is_reserved(name):
        return "is a reserved name"
    return f"is longer than {_LONGEST} bytes" if len(name.encode()) > _LONGEST else ""


def check_camera_name(name: str) -> None:
    """See that a name can be a camera's.

    Raises:
        InputError: when it is no text, cannot be a folder's name on every system, or means something else there or in
            a recording.
    """
    if not isinstance(name, str):  # as files may have it
        raise InputError(f"a camera's name must be text, got {name!r}")
    if fault := _fault(name):
        raise InputError(f"{name!r} {fault}, so that it cannot be a camera's name: call it {safe_name(name)!r}")


def safe_name(name: str, taken: Iterable[str] = ()) -> str:
    """The name itself if it can be a camera's, otherwise one that is like it; other than those that are taken."""
    kept = name
    if _fault(name):
        letters = (letter if letter not in _FORBIDDEN and is_shown(letter) else "\0" for letter in name)
        kept = re.sub("\0+", "-", "".join(letters)).encode()[: _LONGEST - 16].decode(errors="ignore").strip(" .-")
        if not kept or _is_reserved(kept):
            kept = f"camera-{kept}" if kept else "camera"
    taken, number, unique = set(taken), 1, kept
    while unique in taken:
        number += 1
        unique = f"{kept}-{number}"
    return unique


def safe_names(names: Iterable[str]) -> dict[str, str]:
    """For each name one that can be a camera's: itself where it can, and no two the same."""
    names = list(names)
    found = {name: name for name in names if not _fault(name)}
    for name in names:
        if name not in found:
            found[name] = safe_name(name, found.values())
    return {name: found[name] for name in names}
