"""Compiled inner loops (Numba) on contiguous arrays, without validation.

No file uses kernels of another file: Numba's cache only notices changes in a kernel's own file.
"""

from __future__ import annotations

import functools
import logging
from typing import Any

import numba
from numba.core import config
from numba.core.caching import FunctionCache

from depthmocap.core.caches import ensure_home, temporary_cache

_save = FunctionCache.save_overload


def _save_if_possible(self: FunctionCache, sig: Any, data: Any) -> None:
    """As Numba does, but without failing: a compiled function also runs if it cannot be cached."""
    try:
        _save(self, sig, data)
    except OSError as error:
        _warn_once(str(self.cache_path), error.strerror or str(error))


@functools.cache
def _warn_once(folder: str, reason: str) -> None:
    logging.getLogger("depthmocap").warning(
        "Numba cannot keep what it compiles in %s (%s): free some space, or set NUMBA_CACHE_DIR to another folder",
        folder, reason,
    )  # fmt: skip


FunctionCache.save_overload = _save_if_possible


def _probe() -> None:
    """A function to test whether Numba finds a folder for its cache."""


ensure_home()
try:
    numba.njit(cache=True)(_probe)
except RuntimeError:  # neither beside this file nor in the user's caches
    why = f"Numba can write neither to {__path__[0]} nor to the user's caches"
    setattr(config, "CACHE_DIR", str(temporary_cache("NUMBA_CACHE_DIR", why)))  # noqa: B010 - it is made at import
