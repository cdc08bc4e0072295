"""How long somebody takes to stand up and to sit down."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.analysis.steady_joints import SteadyJoints

#: Least inclination of the thighs of somebody who sits from the vertical (degrees).
_SEATED = 55.0
#: Largest one of somebody who stands (degrees).
_UPRIGHT = 30.0
#: The hips' way is followed for so long before and after the thighs turn (s).
_AROUND_S = 1.5
#: A transfer is from this share of the hips' rise
_FROM = 0.1
#: to this one.
_TO = 0.9
#: Least rise of the hips (m).
_LEAST_RISE_M = 0.12
#: Longest turn of the thighs (s).
_LONGEST_S = 5.0

Kind = Literal["sit_to_stand", "stand_to_sit"]


@dataclasses.dataclass(frozen=True)
class Transfer:
    """Somebody stands up or sits down: from a tenth to nine tenths of the hips' way up or down."""

    kind: Kind
    start_s: float
    end_s: float

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return self.end_s - self.start_s


def transfers(steady: SteadyJoints) -> list[Transfer]:
    """Every transfer that was seen as a whole. A squat is one as well: a seat is not seen."""
    thighs = [steady.of(f"{side}Hip") - steady.of(f"{side}Knee") for side in "LR"]
    inclinations = np.stack([np.degrees(np.arctan2(np.hypot(v[:, 0], v[:, 2]), v[:, 1])) for v in thighs])
    hips = np.stack([steady.of(f"{side}Hip")[:, 1] for side in "LR"])
    inclination, height = inclinations.mean(0), hips.mean(0)
    states = np.where(inclination > _SEATED, -1, np.where(inclination < _UPRIGHT, 1, 0))
    states[np.isnan(inclination)] = 2  # a gap parts what is before it from what is after it
    held = np.flatnonzero(states)
    whole = []
    for last, first in itertools.pairwise(held.tolist()):
        if int(states[last]) * int(states[first]) != -1 or (first - last) * steady.frame_s > _LONGEST_S:
            continue
        kind: Kind = "sit_to_stand" if states[first] == 1 else "stand_to_sit"
        around = round(_AROUND_S / steady.frame_s)
        begin, end = max(last - around, 0), min(first + around + 1, len(height))
        transfer = _transfer(kind, steady.times_s[begin:end], height[begin:end], int(last - begin), int(first - begin))
        if transfer is not None:
            whole.append(transfer)
    return whole


def _transfer(
    kind: Kind, times_s: Float[ndarray, " t"], height: Float[ndarray, " t"], last: int, first: int
) -> Transfer | None:
    """The transfer around the frames ``last`` and ``first`` in which the thighs turn; None where it is not seen."""
    if kind == "stand_to_sit":
        back = _transfer("sit_to_stand", -times_s[::-1], height[::-1], len(height) - 1 - first, len(height) - 1 - last)
        return back and Transfer(kind, -back.end_s, -back.start_s)
    low, high = np.nanmin(height[: first + 1]), np.nanmax(height[last:])
    if high - low < _LEAST_RISE_M:
        return None
    share = (height - low) / (high - low)
    middle = last + int(np.argmin(np.abs(np.nan_to_num(share[last : first + 1], nan=9.0) - 0.5)))
    start_s, end_s = _reached(times_s, share, middle, -1, _FROM), _reached(times_s, share, middle, 1, _TO)
    return None if start_s is None or end_s is None else Transfer(kind, start_s, end_s)


def _reached(
    times_s: Float[ndarray, " t"], share: Float[ndarray, " t"], start: int, step: int, level: float
) -> float | None:
    """When a level is first passed from a frame on, forwards or backwards; None where it is not, or a gap is before."""
    i = start
    while 0 <= i + step < len(share):
        here, there = share[i], share[i + step]
        if np.isnan(there):
            return None
        if (here - level) * (there - level) <= 0 and here != there:
            return float(times_s[i] + (times_s[i + step] - times_s[i]) * (level - here) / (there - here))
        i += step
    return None
