"""How far apart two clocks are that share nothing, by how a person moves before both cameras, if it can be told.

Candidates are the offsets at which the signals of both are most alike (``motion_signals``), over minutes. At each, the
skeletons are brought onto each other: a wrong offset, as one stride aside, may show the same posture, but hardly at the
same place of the room. The product of likeness and squared fit ranks the candidates. It tells an offset only if no
candidate apart from it comes near. Who walks in even circles like clockwork looks the same after every stride, and no
method tells these apart.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.lateness import agreement
from depthmocap.calibration.motion_signals import RATE_HZ, likeness, motion_signals
from depthmocap.calibration.time_fit import DRIFT_SHARED_S, TimeFit, fit_time, shared_times

#: Offsets up to this (seconds) are searched.
LONGEST_SEARCH_S = 600.0
#: Recordings that span more than this (seconds), such as those with a pause of a day, are not searched: moments are
#: as many as fit into it.
_LONGEST_SPAN_S = 6 * 3600.0
#: Both cameras must know a signal for this long (seconds) at an offset.
LEAST_SHARED_S = 4.0
#: Number of candidates,
_CANDIDATES = 8
#: which are so far apart at least (seconds): less than a stride.
APART_S = 0.4
#: Most moments at which skeletons are brought onto each other.
_MOMENTS = 60
#: A rank below this is reached by people who move independently.
LEAST_RANK = 60.0
#: A rival of this share of the best rank makes it ambiguous.
MOST_RIVAL = 0.5
#: A hand, a foot or the trunk moves if it gets further than this (metres) in half a second;
_MOVES_M = 0.12
#: somebody moves who does so for this long (seconds).
_LEAST_MOVING_S = 1.5
#: Clocks are known if the offset's standard error is below this (seconds).
_LARGEST_SIGMA_S = 0.03


@dataclasses.dataclass(frozen=True, eq=False)
class TimeMatch:
    """What could be told of two cameras' clocks.

    Attributes:
        best_s: the likeliest offset (seconds), whether it is told or not; None if there is none.
        fit: from there; None if there is none.
        why: why it cannot be told; empty if it can.
        rank: of the best candidate.
        rival: share of this rank that the next candidate has, apart from it.
        shared_s: how long the recordings overlap at the best (seconds).
        repeats: whether it cannot be told because the movement repeats itself.
    """

    fit: TimeFit | None
    why: str
    best_s: float | None = None
    rank: float = 0.0
    rival: float = 0.0
    shared_s: float = 0.0
    repeats: bool = False

    @property
    def told(self) -> bool:
        """Whether the offset is known."""
        return not self.why


def find_time(
    a: JointTrack,
    b: JointTrack,
    rng: np.random.Generator,
    longest_s: float = LONGEST_SEARCH_S,
) -> TimeMatch:
    """What is to be added to the timestamps of b (seconds), up to ``longest_s`` either way; with drift if they share
    ``DRIFT_SHARED_S``."""
    for track in (a, b):
        if len(track.times_s) < 2 or track.times_s[-1] - track.times_s[0] < LEAST_SHARED_S:
            return TimeMatch(None, "nobody is seen for long enough")
        if (span_s := track.times_s[-1] - track.times_s[0]) > _LONGEST_SPAN_S:
            return TimeMatch(None, f"a recording spans {span_s / 3600:.1f} hours: take out what does not belong to it")
        if moving_s(track) < _LEAST_MOVING_S:
            return TimeMatch(None, "nobody moves")
    start_a, signals_a, lengths_s = motion_signals(a)
    start_b, signals_b, _ = motion_signals(b)
    shifts_s = start_a - start_b + np.arange(1 - signals_b.shape[1], signals_a.shape[1]) / RATE_HZ
    scores = likeness(signals_a, signals_b, lengths_s, LEAST_SHARED_S)
    scores = np.where(np.abs(shifts_s) <= longest_s, scores, -np.inf)
    if not np.isfinite(scores).any():
        return TimeMatch(None, "they do not see somebody at the same time for long enough")
    candidates = _peaks(scores, shifts_s)
    ranks = np.array([score * _fit_share(a, b, shift_s, rng) ** 2 for shift_s, score in candidates])
    best = int(ranks.argmax())
    rank, rival = float(ranks[best]), float(np.delete(ranks, best).max(initial=0.0) / max(ranks[best], 1e-9))
    best_s = candidates[best][0]
    if rank < LEAST_RANK:
        return TimeMatch(None, "they do not see the same movement, or too little of it", best_s, rank, rival)
    long_enough = np.ptp(shared_times(a, b, best_s)) >= DRIFT_SHARED_S
    fit = fit_time(a, b, best_s, rng, with_drift=bool(long_enough))
    if fit is None:
        return TimeMatch(None, "their skeletons do not fit", best_s, rank, rival)
    shared_s = float(np.ptp(shared_times(a, b, fit.shift_s)))
    why = ""
    if rival > MOST_RIVAL:
        other_s = candidates[int(np.argsort(ranks)[-2])][0]
        why = f"the movement repeats itself, and an offset {abs(other_s - fit.shift_s):.1f} s aside fits nearly as well"
    elif fit.sigma_s > _LARGEST_SIGMA_S:
        why = f"it is known to ±{1e3 * fit.sigma_s:.0f} ms only"
    return TimeMatch(fit, why, fit.shift_s, rank, rival, shared_s, rival > MOST_RIVAL)


def moving_s(track: JointTrack) -> float:
    """How long somebody moves (seconds)."""
    period_s = float(np.median(np.diff(track.times_s)))
    grid_s = np.arange(track.times_s[0], track.times_s[-1], 0.25)
    joints, _ = track.interpolate(grid_s, period_s)
    names = ("Hip", "RHand", "LHand", "RFoot", "LFoot")
    moved = np.linalg.norm(joints[2:] - joints[:-2], axis=-1)[:, [JOINT_INDEX[name] for name in names]]
    # Of two joints at least, since one alone may jump by an error.
    return 0.25 * float(((moved > _MOVES_M).sum(1) >= 2).sum())


def _peaks(scores: Float[ndarray, " n"], shifts_s: Float[ndarray, " n"]) -> list[tuple[float, float]]:
    """Offsets (seconds) of the highest scores apart from each other, with these."""
    left, peaks = scores.copy(), []
    while len(peaks) < _CANDIDATES and np.isfinite(left.max()) and left.max() > 0:
        top = int(left.argmax())
        peaks.append((float(shifts_s[top]), float(scores[top])))
        left[np.abs(shifts_s - shifts_s[top]) < APART_S] = -np.inf
    return peaks or [(float(shifts_s[int(scores.argmax())]), 0.0)]


def _fit_share(a: JointTrack, b: JointTrack, shift_s: float, rng: np.random.Generator) -> float:
    """How well the skeletons fit at an offset, 0 to 1."""
    times_s = shared_times(a, b, shift_s)
    seen = _near(times_s, a.times_s) & _near(times_s - shift_s, b.times_s)
    times_s = times_s[seen]
    if len(times_s) < 2:
        return 0.0
    chosen = times_s[np.unique(np.linspace(0, len(times_s) - 1, _MOMENTS).astype(int))]
    scores = agreement(a, b, chosen, shift_s, rng)
    return float(np.nanmean(scores)) if np.isfinite(scores).any() else 0.0


def _near(times_s: Float[ndarray, " n"], frames_s: Float[ndarray, " t"]) -> ndarray:
    """Which of the times have a frame at hand."""
    after = np.clip(np.searchsorted(frames_s, times_s), 1, len(frames_s) - 1)
    period_s = float(np.median(np.diff(frames_s)))
    return np.minimum(np.abs(frames_s[after] - times_s), np.abs(times_s - frames_s[after - 1])) <= period_s
