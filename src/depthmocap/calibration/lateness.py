"""A coarse, bounded search for how much later one camera exposes than another, by how the person moves.

For every time offset of a grid, the skeletons of two cameras are aligned anew, because a wrong offset also looks like a
turn of the world where the person walks in a circle. The offset at which they fit best is refined elsewhere
(``camera_placement``), by velocities, which work only near the truth.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.calibration.joint_tracks import JointTrack, common_times, resample
from depthmocap.calibration.pairs import SharedJoints, geman_mcclure

#: Offsets up to this (seconds) are searched,
LONGEST_S = 2.0
#: in steps of this (seconds).
_STEP_S = 0.1
#: Up to here (seconds) velocities alone find the offset.
NEAR_S = 0.1
#: Another offset must be at least so far from the best one (seconds) to count as another.
_APART_S = 0.4
#: One offset fits better than another if it does by so many standard errors.
_SIGMAS = 3.0
#: Fits at an offset are scored over blocks of this length (seconds), whose errors are taken as independent.
_BLOCK_S = 2.0
#: Most moments at which two cameras are compared.
_MOMENTS = 60
#: An offset counts if the cameras then share this share of the most moments that any offset gives,
_LEAST_SHARE = 0.5
#: and at least so many.
_LEAST_MOMENTS = 12
#: Random fits for each offset.
_FITS = 8
#: Iterations of reweighted least squares for each offset.
_ITERATIONS = 6


@dataclasses.dataclass(frozen=True)
class Lateness:
    """How much later than camera a camera b exposes.

    Attributes:
        seconds: from where the fine search starts; 0 where that finds it alone, or nothing is known.
        told: False if another offset fits better than a small one, but which cannot be told.
    """

    seconds: float = 0.0
    told: bool = True


def search_lateness(a: JointTrack, b: JointTrack, rng: np.random.Generator) -> Lateness:
    """The time offset of two cameras as their skeletons tell it, to about half a step."""
    if min(len(a.times_s), len(b.times_s)) < 2:
        return Lateness()
    times_s = common_times([a, b])
    times_s = times_s[:: max(round(len(times_s) / _MOMENTS), 1)]
    steps = round(LONGEST_S / _STEP_S)
    offsets_s = _STEP_S * np.arange(-steps, steps + 1)
    scores = np.stack([agreement(a, b, times_s, late_s, rng) for late_s in offsets_s])
    moments = np.isfinite(scores).sum(1)
    usable = moments >= max(_LEAST_SHARE * moments.max(), _LEAST_MOMENTS)
    if not usable.any():
        return Lateness()
    with np.errstate(invalid="ignore"):
        means = np.where(usable, np.nansum(scores, 1) / np.maximum(moments, 1), -np.inf)
    best = int(means.argmax())
    near = np.where(np.abs(offsets_s) <= NEAR_S + 1e-9, means, -np.inf)
    if abs(offsets_s[best]) <= NEAR_S + 1e-9:
        return Lateness()
    blocks = ((times_s - times_s[0]) / _BLOCK_S).astype(np.int64)
    if np.isfinite(near.max()) and not _is_better(scores[best], scores[int(near.argmax())], blocks):
        return Lateness()
    others = np.where(np.abs(offsets_s - offsets_s[best]) >= _APART_S, means, -np.inf)
    at_the_end = best in (0, len(means) - 1) or not (usable[best - 1] and usable[best + 1])
    if at_the_end or not _is_better(scores[best], scores[int(others.argmax())], blocks):
        return Lateness(told=False)
    before, here, after = means[best - 1 : best + 2]
    return Lateness(float(offsets_s[best] + _STEP_S * (after - before) / (2 * (2 * here - before - after) or 1.0)))


def agreement(
    a: JointTrack, b: JointTrack, times_s: Float[ndarray, " n"], late_s: float, rng: np.random.Generator
) -> Float[ndarray, " n"]:
    """How well the skeletons fit at each moment if b exposes ``late_s`` later than a: 0 to 1, NaN where one lacks."""
    skeletons = resample([a, b], times_s, np.array([0.0, late_s]))
    one, other = skeletons.joints
    shared = SharedJoints.of((one, other), (skeletons.sigma_m[0], skeletons.sigma_m[1]))
    scores = np.full(len(times_s), np.nan)
    if not len(shared.frame_of):
        return scores
    weights = geman_mcclure(shared.ratios(shared.fit(rng, _FITS, _ITERATIONS)))
    counts = np.bincount(shared.frame_of, minlength=len(times_s))
    sums = np.bincount(shared.frame_of, weights, len(times_s))
    seen = counts > 0
    scores[seen] = sums[seen] / counts[seen]
    return scores


def _is_better(one: Float[ndarray, " n"], other: Float[ndarray, " n"], blocks: ndarray) -> bool:
    """Whether the first offset fits better at the moments that both have, beyond chance."""
    both = np.isfinite(one) & np.isfinite(other)
    if not both.any():
        return True
    counts = np.bincount(blocks[both])
    sums = np.bincount(blocks[both], (one - other)[both])
    mean = sums.sum() / counts.sum()
    error = np.sqrt(((sums - mean * counts) ** 2).sum()) / counts.sum()
    return bool((counts > 0).sum() > 2 and mean > _SIGMAS * error)
