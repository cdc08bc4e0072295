"""Messages for the user from a run with several threads."""

from __future__ import annotations

import collections
import threading
from collections.abc import Iterable, Mapping


class Problems:
    """Lines for the user, and how often each occurred. Any thread may add to them."""

    def __init__(self, problems: Iterable[str] = ()) -> None:
        self._lock = threading.Lock()
        self._times = collections.Counter(problems)

    def add(self, problem: str) -> None:
        """Add one occurrence of a problem."""
        with self._lock:
            self._times[problem] += 1

    def update(self, problems: Iterable[str] | Mapping[str, int]) -> None:
        """Add one occurrence of each problem, or as many as the mapping says."""
        with self._lock:
            self._times.update(problems)

    def counts(self) -> dict[str, int]:
        """A copy of all problems so far and their counts, in the order of their first occurrence."""
        with self._lock:
            return dict(self._times)
