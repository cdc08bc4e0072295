"""The clocks of several recordings on the clock of the first, from what was told of pairs of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from depthmocap.calibration.time_fit import DRIFT_SHARED_S

#: Pairs of three recordings contradict each other if they are apart by more than this (seconds),
_CONTRADICTION_S = 0.04
#: and by so many standard errors.
_SIGMAS = 5.0
#: Clocks drift if the drift is so many standard errors,
_DRIFT_SIGMAS = 4.0
#: and moves frames by at least this over their common time (seconds).
_DRIFT_S = 0.004
#: Larger drifts (a ratio) are not to be expected.
_LARGEST_DRIFT = 1e-2
#: What is not known of a pose and of the bias of single views adds to every offset (seconds).
SYSTEMATIC_S = 0.001


@dataclasses.dataclass(frozen=True)
class ClockLink:
    """What two recordings tell: at ``middle_s`` by the clock of ``one``, ``shift_s`` is to be added to the timestamps
    of ``other``, and ``drift`` more in every second. Seconds; errors are standard errors."""

    one: int
    other: int
    shift_s: float
    sigma_s: float
    middle_s: float
    drift: float = 0.0
    drift_sigma: float = float("inf")
    shared_s: float = 0.0

    @property
    def drifts(self) -> bool:
        """Whether the clocks run at rates that differ beyond doubt."""
        return (
            self.shared_s >= DRIFT_SHARED_S
            and abs(self.drift) > _DRIFT_SIGMAS * self.drift_sigma
            and abs(self.drift) * self.shared_s / 2 > _DRIFT_S
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Clocks:
    """Of each recording: a time t of its clock is t (1 + drift) + shift by the clock of the first.

    Attributes:
        shift_s: seconds; 0 of the first.
        sigma_s: standard error of a time in the recording's middle (seconds).
        drift: ratio; 0 where clocks are not seen to differ.
        unlinked: recordings that no link leads to from the first.
        contradictions: links that do not fit the others, with by how much (seconds).
    """

    shift_s: Float[ndarray, " n"]
    sigma_s: Float[ndarray, " n"]
    drift: Float[ndarray, " n"]
    unlinked: tuple[int, ...]
    contradictions: tuple[tuple[ClockLink, float], ...]


def solve_clocks(count: int, links: Sequence[ClockLink], middles_s: Sequence[float]) -> Clocks:
    """The clocks that fit all links best, by least squares.

    Args:
        middles_s: the middle of each recording by its own clock.
    """
    graph = np.zeros((count, count))
    for link in links:
        graph[link.one, link.other] = 1
    _, group = connected_components(csr_array(graph), directed=False)
    unlinked = tuple(int(i) for i in np.flatnonzero(group != group[0]))
    drifting = sorted({i for link in links if link.drifts for i in (link.one, link.other)} - {0})
    free = [("shift", i) for i in range(1, count) if i not in unlinked] + [("drift", i) for i in drifting]
    column = {unknown: k for k, unknown in enumerate(free)}

    def row(entries: dict[tuple[str, int], float]) -> Float[ndarray, " m"]:
        numbers = np.zeros(len(free))
        for unknown, value in entries.items():
            if unknown in column:  # others are 0
                numbers[column[unknown]] = value
        return numbers

    rows = [row({unknown: 1 / _LARGEST_DRIFT}) for unknown in free if unknown[0] == "drift"]
    sides = [0.0] * len(rows)
    for link in links:
        a, b, other_s = link.one, link.other, link.middle_s - link.shift_s
        same_time = row({("shift", b): 1.0, ("shift", a): -1.0, ("drift", b): other_s, ("drift", a): -link.middle_s})
        sigma_s = float(np.hypot(link.sigma_s, SYSTEMATIC_S))
        rows.append(same_time / sigma_s)
        sides.append(link.shift_s / sigma_s)
        if link.shared_s >= DRIFT_SHARED_S and np.isfinite(link.drift_sigma):
            rows.append(row({("drift", b): 1.0, ("drift", a): -1.0}) / link.drift_sigma)
            sides.append(link.drift / link.drift_sigma)
    shift_s, drift, sigma_s = np.zeros(count), np.zeros(count), np.zeros(count)
    if free:
        matrix = np.stack(rows)
        solution = np.linalg.lstsq(matrix, np.array(sides), rcond=None)[0]
        covariance = np.linalg.pinv(matrix.T @ matrix, hermitian=True)
        for (kind, i), value in zip(free, solution, strict=True):
            (shift_s if kind == "shift" else drift)[i] = value
        at_middles = np.stack([row({("shift", i): 1.0, ("drift", i): middles_s[i]}) for i in range(count)])
        sigma_s = np.sqrt(np.einsum("ij,jk,ik->i", at_middles, covariance, at_middles))
    contradictions = []
    for link in links:
        other_s = link.middle_s - link.shift_s
        here = link.middle_s * (1 + drift[link.one]) + shift_s[link.one]
        apart_s = float(other_s * (1 + drift[link.other]) + shift_s[link.other] - here)
        if abs(apart_s) > max(_CONTRADICTION_S, _SIGMAS * link.sigma_s):
            contradictions.append((link, apart_s))
    return Clocks(shift_s, sigma_s, drift, unlinked, tuple(contradictions))
