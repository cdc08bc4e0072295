"""Timing of two functions in turns, and the rows of the table."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy import ndarray

#: Rest before each timed run, seconds: thread pools spin after their work, which slows the next function on the same
#: cores. A camera at 20 frames per second leaves as much time.
PAUSE_S = 0.05


@dataclasses.dataclass(frozen=True)
class Timing:
    """Wall-clock milliseconds of an item (a view, a body, a frame set)."""

    median_ms: float
    p95_ms: float
    least_ms: float
    runs: int

    @classmethod
    def of(cls, milliseconds: ndarray) -> Timing:
        """The summary of at least one measurement."""
        p50, p95 = np.quantile(milliseconds, [0.5, 0.95])
        return cls(float(p50), float(p95), float(milliseconds.min()), len(milliseconds))


@dataclasses.dataclass(frozen=True)
class Row:
    """One line of the table. ``agrees``: whether ours and the reference gave the same result, None if not compared."""

    what: str
    ours: Timing
    reference_name: str = ""
    reference: Timing | None = None
    goal_ms: float | None = None
    agrees: bool | None = None
    note: str = ""

    @property
    def ratio(self) -> float | None:
        """The reference's median time divided by ours."""
        return None if self.reference is None else self.reference.median_ms / self.ours.median_ms

    @property
    def goal_met(self) -> bool | None:
        """Whether our median is within the goal."""
        return None if self.goal_ms is None else self.ours.median_ms <= self.goal_ms


@dataclasses.dataclass(frozen=True)
class Reference:
    """The function that ours is compared with; one call makes ``items``."""

    name: str
    call: Callable[[], object]
    items: int = 1


@dataclasses.dataclass(frozen=True)
class Bench:
    """Settings of the measurement, and its rows. ``threads`` are those of the networks of both sides."""

    runs: int
    warm_up: int
    threads: int
    folder: Path
    rows: list[Row] = dataclasses.field(default_factory=list)
    notes: list[str] = dataclasses.field(default_factory=list)

    def measure(
        self,
        what: str,
        ours: Callable[[], object],
        reference: Reference | None = None,
        *,
        items: int = 1,
        goal_ms: float | None = None,
        agrees: bool | None = None,
        note: str = "",
    ) -> None:
        """Time ours and the reference in turns and add the row. One call of ours makes ``items``."""
        calls = [ours] if reference is None else [ours, reference.call]
        times = interleave(calls, self.runs, self.warm_up)
        self.rows.append(
            Row(
                what,
                Timing.of(times[0] / items),
                "" if reference is None else reference.name,
                None if reference is None else Timing.of(times[1] / reference.items),
                goal_ms,
                agrees,
                note,
            )
        )


def interleave(calls: Sequence[Callable[[], object]], runs: int, warm_up: int) -> list[ndarray]:
    """Milliseconds (runs,) of each call, run in turns A/B/A/B, so that a machine that slows down slows all of them."""
    milliseconds = np.empty((len(calls), warm_up + runs))
    for run in range(warm_up + runs):
        for i, call in enumerate(calls):
            time.sleep(PAUSE_S)
            start = time.perf_counter()
            call()
            milliseconds[i, run] = (time.perf_counter() - start) * 1e3
    return list(milliseconds[:, warm_up:])
