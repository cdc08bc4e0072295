"""Compiled inner loops (Numba): plain contiguous arrays in, plain arrays out, no validation.

No file uses kernels of another: Numba's cache knows of changes in a kernel's own file alone.
"""

import numba
from numba.core import config

from depthmocap.caches import see_to_home, temporary_cache


def _probe() -> None:
    """What Numba looks for a cache for."""


see_to_home()
try:
    numba.njit(cache=True)(_probe)
except RuntimeError:  # neither beside this file nor in the user's caches
    why = f"Numba can write neither to {__path__[0]} nor to the user's caches"
    setattr(config, "CACHE_DIR", str(temporary_cache("NUMBA_CACHE_DIR", why)))  # noqa: B010 - it is made at import
