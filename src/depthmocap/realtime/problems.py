"""What a user should know of a run that goes on in several threads."""

from __future__ import annotations

import collections
import threading
from collections.abc import Iterable, Mapping


class Problems:
    """Lines for the user, and how often each was so. Any thread adds to them; what is read is a copy."""

    def __init__(self, problems: Iterable[str] = ()) -> None:
        self._lock = threading.Lock()
        self._times = collections.Counter(problems)

    def add(self, problem: str) -> None:
        """It was so once more."""
        with self._lock:
            self._times[problem] += 1

    def update(self, problems: Iterable[str] | Mapping[str, int]) -> None:
        """Each was so once more, or as often as the mapping says."""
        with self._lock:
            self._times.update(problems)

    def told(self) -> dict[str, int]:
        """All so far, in the order in which each came first."""
        with self._lock:
            return dict(self._times)
