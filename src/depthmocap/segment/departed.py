"""Who has left, and whether somebody new is one of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

#: A person who has left keeps their number for this time (seconds).
AWAY_S = 60.0
#: Somebody new gets the number of a person who has left if their statures differ by less than this (metres)
SAME_HEIGHT_M = 0.03
#: and every other person who has left differs by this much more (metres).
CLEARLY_M = 0.03
#: A stature measured for a moment is known to this (metres): people bob as they walk.
MAYBE_HEIGHT_M = 0.08
#: A person who was hidden for no longer than this (seconds) is recognised by the place, too:
HIDDEN_S = 4.0
#: within this distance of where they were last seen (metres),
HIDDEN_M = 0.5
#: and this much more for each second (m/s),
HIDDEN_MPS = 0.8
#: unless both statures are known and differ by more than this (metres).
OTHER_HEIGHT_M = 0.05


@dataclasses.dataclass(frozen=True, eq=False)
class Departed:
    """A person who has left: number, stature (metres, NaN if unknown), least stature, and where and when last seen."""

    number: int
    stature_m: float
    least_m: float
    position_m: Float[ndarray, "3"]
    last_seen_s: float


def match_stature(departed: Sequence[Departed], stature_m: float) -> Departed | None:
    """The one of this stature; None when none clearly matches.

    A person whose stature was never measured is at least as tall as ``least_m``, and matches nobody.
    """
    differences_m = [
        max(away.least_m - stature_m, 0.0) if np.isnan(away.stature_m) else abs(away.stature_m - stature_m)
        for away in departed
    ]
    order = np.argsort(differences_m)
    if not len(order) or np.isnan(stature_m):
        return None
    best = departed[order[0]]
    clearly = len(order) == 1 or differences_m[order[1]] - differences_m[order[0]] >= CLEARLY_M
    if np.isnan(best.stature_m) or differences_m[order[0]] > SAME_HEIGHT_M or not clearly:
        return None
    return best


def may_match(departed: Sequence[Departed], stature_m: float) -> bool:
    """Whether somebody of this stature (metres, so far) may turn out to be one of them, measured longer.

    They may not where two who have left are alike, and either would do.
    """
    if np.isnan(stature_m):
        known = np.array([away.stature_m for away in departed if away.stature_m > 0])
        apart_m = np.abs(known[:, None] - known) + np.diag(np.full(len(known), np.inf))
        return bool((apart_m.min(1, initial=np.inf) >= CLEARLY_M).any())
    near = [away for away in departed if abs(away.stature_m - stature_m) <= MAYBE_HEIGHT_M]
    near.sort(key=lambda away: abs(away.stature_m - stature_m))
    alike = len(near) > 1 and abs(near[0].stature_m - near[1].stature_m) < 2 * CLEARLY_M
    return bool(near) and not alike


def alike(departed: Sequence[Departed], stature_m: float) -> tuple[int, ...]:
    """Numbers of those who are as tall as somebody new (metres), and may be them."""
    return tuple(away.number for away in departed if abs(away.stature_m - stature_m) <= SAME_HEIGHT_M)


def match_place(
    departed: Sequence[Departed], position_m: Float[ndarray, "3"], stature_m: float, now_s: float
) -> Departed | None:
    """The one who was hidden near this place a short time ago; None when there is none, or several."""
    near = []
    for away in departed:
        hidden_s = now_s - away.last_seen_s
        other = abs(away.stature_m - stature_m) > OTHER_HEIGHT_M  # False where one is NaN
        distance_m = float(np.linalg.norm(away.position_m - position_m))
        if hidden_s <= HIDDEN_S and distance_m < HIDDEN_M + HIDDEN_MPS * hidden_s and not other:
            near.append(away)
    return near[0] if len(near) == 1 else None
