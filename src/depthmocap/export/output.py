"""Errors of writing a file, in the user's words."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from depthmocap.errors import InputError


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn an ``OSError`` within into an ``InputError`` that names the file."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error
