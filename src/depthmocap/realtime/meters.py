"""Quantiles of a stream of numbers in fixed memory."""

from __future__ import annotations

import collections

import numpy as np

#: Ratio of the upper to the lower limit of each bin: quantiles are exact to 2 %.
_RATIO = 1.04
#: Lower limit of the first bin (milliseconds).
_LEAST_MS = 0.01
#: Number of bins.
_BINS = 400
#: Number of values over which ``recent`` goes.
_RECENT = 300


class Meter:
    """Median and 95th percentile of milliseconds, over all values and over the last ``_RECENT``."""

    def __init__(self) -> None:
        self._counts = np.zeros(_BINS, np.int64)
        self._recent: collections.deque[float] = collections.deque(maxlen=_RECENT)

    def add(self, milliseconds: float) -> None:
        """Add a value."""
        place = int(np.log(max(milliseconds, _LEAST_MS) / _LEAST_MS) / np.log(_RATIO))
        self._counts[min(place, _BINS - 1)] += 1
        self._recent.append(milliseconds)

    def __len__(self) -> int:
        return int(self._counts.sum())

    def overall(self) -> dict[str, float]:
        """p50 and p95 of all values; NaN without values."""
        if not len(self):
            return {"p50": float("nan"), "p95": float("nan")}
        below = np.cumsum(self._counts) / len(self)
        places = [int(np.searchsorted(below, share)) for share in (0.5, 0.95)]
        p50, p95 = (float(_LEAST_MS * _RATIO ** (place + 0.5)) for place in places)
        return {"p50": p50, "p95": p95}

    def recent(self) -> tuple[float, float]:
        """p50 and p95 of the last values; NaN without values."""
        if not self._recent:
            return float("nan"), float("nan")
        p50, p95 = np.quantile(list(self._recent), [0.5, 0.95]).tolist()
        return p50, p95
