"""A function over several inputs in several threads, of which the one that asks is one."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from depthmocap.core.cores import usable_cores

T = TypeVar("T")


class SharedWork:
    """Maps functions over inputs in a few threads. Work of a few milliseconds is worth it: the thread that asks begins
    at once, the others take what is left, and with one thread nothing changes hands.
    """

    def __init__(self, threads: int | None = None) -> None:
        """
        Args:
            threads: so many inputs are worked on at a time; by default as many as the cores that this process may use.
        """
        self.threads = threads or usable_cores()
        self._helpers = ThreadPoolExecutor(self.threads - 1) if self.threads > 1 else None

    def map(self, function: Callable[..., T], *inputs: Iterable[Any]) -> list[T]:
        """The results in order, as of ``map``; raises what a call raises. Any thread may ask at any time."""
        calls = list(zip(*inputs, strict=True))
        if self._helpers is None or len(calls) < 2:
            return [function(*call) for call in calls]
        results: dict[int, T] = {}
        places = iter(range(len(calls)))  # shared: each place is given to one thread

        def work() -> None:
            for place in places:
                results[place] = function(*calls[place])

        helpers = [self._helpers.submit(work) for _ in range(min(self.threads, len(calls)) - 1)]
        try:
            work()
        finally:
            # Those that have not begun find nothing to do: nobody waits for them.
            begun = [helper for helper in helpers if not helper.cancel()]
            failures = [failure for helper in begun if (failure := helper.exception()) is not None]
        if failures:
            raise failures[0]
        return [results[place] for place in range(len(calls))]
