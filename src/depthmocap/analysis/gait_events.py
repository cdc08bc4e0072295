"""Heel strikes and toe-offs, and the steps between them, from where ankles are, and toes where these are told.

Heels and toes are not among the joints. A foot's swing is where its ankle's horizontal speed peaks; heel strike is
where the speed has fallen to a fifth, a share that was chosen on motion capture of walking, against when heel and toe
themselves come to rest (docs/results/analysis.md); toe-off is told by how leg and toe move
(:mod:`.toe_off`).
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.signal import find_peaks

from depthmocap.analysis.joint_angles import SIDES
from depthmocap.analysis.steady_joints import SteadyJoints, stretches
from depthmocap.analysis.toe_off import last_crossing, toe_off_frame

#: Share of the swing's peak speed at heel strike.
_HEEL_STRIKE = 0.22
#: Slowest peak of a swing (m/s).
_SLOWEST_MPS = 0.5
#: Least time from one peak to the next (s).
_APART_S = 0.3
#: Between two swings the ankle slows down to less than this share of the lower peak.
_DIP = 0.5
#: A swing goes at least so far (m),
_SHORTEST_M = 0.12
#: and lasts at most so long (s).
_LONGEST_SWING_S = 1.2
#: The foot stands flat from so long after heel strike (s),
_LANDED_S = 0.1
#: for up to so long (s)
_FLAT_S = 0.35
#: or this share of the stance.
_FLAT_SHARE = 0.6


@dataclasses.dataclass(frozen=True, eq=False)
class Swing:
    """One swing of a foot: seconds, and where the foot stands after it (m, on the floor; NaN where not seen)."""

    side: str
    toe_off_s: float
    heel_strike_s: float
    place: Float[ndarray, "2"]


def swings(steady: SteadyJoints) -> list[Swing]:
    """Swings of both feet in the order of their heel strikes. A swing of which a part was not seen is none."""
    both_feet = [swing for side in SIDES for swing in _of_a_foot(steady, side)]
    return sorted(both_feet, key=lambda swing: swing.heel_strike_s)


def ankle_speed(steady: SteadyJoints, side: str) -> Float[ndarray, " t"]:
    """Horizontal speed of an ankle (m/s), NaN beside gaps."""
    across = steady.of(f"{SIDES[side]}Foot")[:, [0, 2]]
    if len(across) < 2:
        return np.full(len(across), np.nan)
    return np.linalg.norm(np.gradient(across, steady.frame_s, axis=0), axis=1)


def _of_a_foot(steady: SteadyJoints, side: str) -> list[Swing]:
    speed, times_s = ankle_speed(steady, side), steady.times_s
    ankle = steady.of(f"{SIDES[side]}Foot")[:, [0, 2]]
    spans: list[tuple[float, float]] = []
    for first, end in stretches(~np.isnan(speed)):
        for peak in (first + peak for peak in speed_peaks(speed[first:end], steady.frame_s)):
            before = toe_off_frame(steady, SIDES[side], speed, peak)
            after = last_crossing(speed, peak, 1, _HEEL_STRIKE * speed[peak])
            if before is None or after is None or not 0 < (after - before) * steady.frame_s <= _LONGEST_SWING_S:
                continue
            start, stop = max(int(np.floor(before)), first), int(np.ceil(after))
            if np.linalg.norm(ankle[stop] - ankle[start]) >= _SHORTEST_M:
                at = times_s[0] + np.array([before, after]) * steady.frame_s
                spans.append((float(at[0]), float(at[1])))
    result = []
    for i, (toe_off_s, heel_strike_s) in enumerate(spans):
        next_s = spans[i + 1][0] if i + 1 < len(spans) else np.inf
        swing = Swing(side, toe_off_s, heel_strike_s, np.full(2, np.nan))
        result.append(dataclasses.replace(swing, place=place_after(steady, swing, next_s)))
    return result


def speed_peaks(speed: Float[ndarray, " t"], frame_s: float) -> list[int]:
    """Peaks of swings; of two between which the ankle does not slow down, the higher."""
    peaks, _ = find_peaks(speed, height=_SLOWEST_MPS, distance=max(round(_APART_S / frame_s), 1))
    kept: list[int] = []
    for peak in peaks.tolist():
        if kept and speed[kept[-1] : peak + 1].min() > _DIP * min(speed[kept[-1]], speed[peak]):
            if speed[peak] > speed[kept[-1]]:
                kept[-1] = peak
        else:
            kept.append(peak)
    return kept


def place_after(steady: SteadyJoints, swing: Swing, toe_off_s: float) -> Float[ndarray, "2"]:
    """Where a foot stands after a swing: the ankle's mean while the foot is flat, NaN where most of that was not seen.

    Args:
        toe_off_s: the foot's next toe-off; infinite where there is none.
    """
    ankle, times_s = steady.of(f"{SIDES[swing.side]}Foot")[:, [0, 2]], steady.times_s
    flat_s = max(_FLAT_SHARE * (toe_off_s - swing.heel_strike_s), _LANDED_S)
    first_s, last_s = swing.heel_strike_s + _LANDED_S, swing.heel_strike_s + min(_LANDED_S + _FLAT_S, flat_s)
    flat = ankle[(times_s >= first_s - 1e-9) & (times_s <= last_s + 1e-9)]
    seen = flat[~np.isnan(flat).any(1)]
    return seen.mean(0) if len(seen) and 2 * len(seen) > len(flat) else np.full(2, np.nan)
