"""A clock that jumps during a take: from some moment on, another time offset fits the movement.

Large jumps are seen by the likeness of the signals of each few seconds alone, small ones by what is left of the offset
before and after each moment of the fit of the whole take.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.motion_signals import RATE_HZ, likeness, motion_signals
from depthmocap.calibration.time_fit import TimeFit

#: Signals are compared over this long (seconds),
_WINDOW_S = 8.0
#: again after each such time (seconds).
_HOP_S = 2.0
#: Another offset of such a window must be this far from the take's (seconds),
_APART_S = 0.15
#: so many times more like,
_RATIO = 1.8
#: reach this likeness,
_LEAST_LIKENESS = 60.0
#: and be the same in so many windows in a row,
_WINDOWS = 2
#: to this (seconds).
_SAME_S = 0.15
#: Jumps further than this (seconds) are not looked for.
_FARTHEST_S = 10.0
#: A small jump is at least this long (seconds),
_LEAST_S = 0.03
#: so many standard errors,
_SIGMAS = 6.0
#: with this many blocks on either side.
_LEAST_BLOCKS = 5


@dataclasses.dataclass(frozen=True)
class ClockStep:
    """From ``at_s`` on (by the clock of a), ``by_s`` more than before is to be added to the timestamps of b."""

    at_s: float
    by_s: float


def find_step(a: JointTrack, b: JointTrack, fit: TimeFit) -> ClockStep | None:
    """The clearest jump of one clock against the other; None without any."""
    return find_large_step(a, b, fit.shift_s) or _small_step(fit)


def find_large_step(a: JointTrack, b: JointTrack, shift_s: float) -> ClockStep | None:
    """A jump by more than ``_APART_S``, if ``shift_s`` is right before it or after it."""
    start_a, signals_a, lengths_s = motion_signals(a)
    start_b, signals_b, _ = motion_signals(b)
    size, hop = round(_WINDOW_S * RATE_HZ), round(_HOP_S * RATE_HZ)
    begins_s, asides_s = [], []
    for first in range(0, signals_b.shape[1] - size + 1, hop):
        begin_s = start_b + first / RATE_HZ
        asides = start_a - begin_s - shift_s + np.arange(1 - size, signals_a.shape[1]) / RATE_HZ
        scores = likeness(signals_a, signals_b[:, first : first + size], lengths_s, 0.6 * _WINDOW_S)
        begins_s.append(begin_s + shift_s)
        asides_s.append(_aside_s(scores, asides))
    near = [k for k, aside_s in enumerate(asides_s) if aside_s == 0]
    if not near:
        return None
    for i in range(len(asides_s) - _WINDOWS + 1):
        run = asides_s[i : i + _WINDOWS]
        if abs(run[0]) > _APART_S and np.ptp(run) < _SAME_S:
            end = i + _WINDOWS
            while end < len(asides_s) and abs(asides_s[end] - run[0]) < _SAME_S:
                end += 1
            # A window that the jump divides belongs to the larger part: the jump is at the middle of the next.
            if min(near) > i:
                return ClockStep(begins_s[end - 1] + (_WINDOW_S + _HOP_S) / 2, -float(np.mean(run)))
            return ClockStep(begins_s[i] + (_WINDOW_S - _HOP_S) / 2, float(np.mean(run)))
    return None


def _aside_s(scores: Float[ndarray, " n"], asides_s: Float[ndarray, " n"]) -> float:
    """How far from the take's offset a window fits best: 0 if near, NaN if it cannot be told (seconds)."""
    scores = np.where(np.abs(asides_s) <= _FARTHEST_S, scores, -np.inf)
    best = int(scores.argmax())
    near = scores[np.abs(asides_s) <= _APART_S]
    expected = float(near.max(initial=-np.inf))
    # Where the other camera does not see the person at the take's offset, some other moment is always alike.
    if not np.isfinite(expected) or not scores[best] > _LEAST_LIKENESS:
        return float("nan")
    if abs(asides_s[best]) <= _APART_S:
        return 0.0
    return float(asides_s[best]) if scores[best] > _RATIO * expected else float("nan")


def _small_step(fit: TimeFit) -> ClockStep | None:
    known = np.isfinite(fit.late_s)
    late_s, times_s = fit.late_s[known], fit.block_times_s[known]
    weights = 1 / np.maximum(fit.late_sigma_s[known], 1e-4) ** 2
    best: tuple[float, ClockStep] | None = None
    for split in range(_LEAST_BLOCKS, len(late_s) - _LEAST_BLOCKS + 1):
        before, after = _mean(late_s[:split], weights[:split]), _mean(late_s[split:], weights[split:])
        by_s, sigmas = after[0] - before[0], abs(after[0] - before[0]) / np.hypot(before[1], after[1])
        if abs(by_s) > _LEAST_S and sigmas > _SIGMAS and (best is None or sigmas > best[0]):
            best = sigmas, ClockStep(float(times_s[split]), float(by_s))
    return None if best is None else best[1]


def _mean(values: Float[ndarray, " n"], weights: Float[ndarray, " n"]) -> tuple[float, float]:
    """The weighted mean, and its standard error from the scatter."""
    mean = float((values * weights).sum() / weights.sum())
    variance = float((weights**2 * (values - mean) ** 2).sum() / weights.sum() ** 2)
    return mean, float(np.sqrt(variance * len(values) / max(len(values) - 1, 1))) + 1e-6
