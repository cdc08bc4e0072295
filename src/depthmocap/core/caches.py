"""Temporary caches for libraries whose own cache folder cannot be written."""

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
    """Make a library use a temporary folder for its cache, by setting its environment variable, and log a warning.
    Processes that are started later inherit the variable.

    Args:
        why: what cannot be written, for the message.

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


def ensure_home() -> None:
    """Set HOME to a temporary folder if the system knows none (a container's user without a name). Otherwise libraries
    would create a folder named ``~``, or fail."""
    try:
        Path.home()
    except RuntimeError:
        temporary_cache("HOME", "this user has no home folder")


@functools.cache
def _folder() -> Path:
    """A folder for this user alone. Compiled code in it is run, so others must not be able to prepare it."""
    folder, process = tempfile.mkdtemp(prefix="depthmocap-"), os.getpid()

    def remove() -> None:
        if os.getpid() == process:
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    return Path(folder)
