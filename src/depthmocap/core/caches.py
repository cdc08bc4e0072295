"""Where libraries keep what takes long to make: a folder until this process ends, where theirs cannot be written."""

from __future__ import annotations

import atexit
import functools
import logging
import os
import shutil
import tempfile
from pathlib import Path

from depthmocap.errors import InputError


def temporary_cache(variable: str, why: str) -> Path:
    """Have a library use a folder of this process for its cache, by its environment variable, which processes started
    from now on inherit; one line on stderr tells it.

    Args:
        why: what of it cannot be written, for the message.

    Raises:
        InputError: when there is no temporary folder either.
    """
    try:
        folder = _folder() / variable.lower()
        folder.mkdir(exist_ok=True)
    except OSError:
        raise InputError(f"{why}, nor a temporary folder: set {variable} to a folder that can be written") from None
    os.environ[variable] = str(folder)
    logging.getLogger("depthmocap").warning(
        "%s: what takes a minute to make is kept until the end only; set %s to a folder that lasts", why, variable
    )
    return folder


def see_to_home() -> None:
    """Have a folder for HOME where the system knows none (a container's user without a name): libraries would take
    ``~`` for the name of a folder, or fail."""
    try:
        Path.home()
    except RuntimeError:
        temporary_cache("HOME", "this user has no home folder")


@functools.cache
def _folder() -> Path:
    """Made for this user alone, because what is compiled is run: one of a known name could be prepared by others."""
    folder, process = tempfile.mkdtemp(prefix="depthmocap-"), os.getpid()

    def remove() -> None:
        if os.getpid() == process:
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    return Path(folder)
