"""What is wrong with a sequence of poses that single frames do not show: shaking, sliding, lagging, changing sides.

All take estimated and true joints of the same frames (metres; NaN where there is none) at a constant rate. Where there
is nothing to measure, a number is NaN.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.body.skeleton import BONES, JOINT_INDEX, MIRROR
from depthmocap.smooth.swap_guard import LIMBS, limb_joints

#: A joint is at rest, and a foot on the floor, while its true place moves slower than this.
REST_MPS = 0.05
#: Shifts that the lag is sought in, frames.
_SHIFTS = range(-6, 16)
_FEET = [JOINT_INDEX["LFoot"], JOINT_INDEX["RFoot"]]


@dataclasses.dataclass(frozen=True)
class TemporalMetrics:
    """Numbers over sequences.

    Attributes:
        mean_joint_error_cm: as frame by frame.
        acceleration_error_mm: length of the difference between estimated and true acceleration, mm a frame².
        acceleration_error_mps2: the same in m/s².
        rest_jitter_mm: way from frame to frame of joints that are at rest.
        foot_skate_cmps: speed of ankles that stand (cm/s).
        bone_deviation_mm: standard deviation of each bone's length within a sequence, mean over bones.
        flips_per_1000: frames in which the legs or the arms have changed sides since the frame before, per 1,000.
        exchanged: share (0–1) of frames in which the legs or the arms are on the wrong sides.
        lag_ms: shift of the truth that fits the estimate best; positive where the estimate is late.
    """

    mean_joint_error_cm: float
    acceleration_error_mm: float
    acceleration_error_mps2: float
    rest_jitter_mm: float
    foot_skate_cmps: float
    bone_deviation_mm: float
    flips_per_1000: float
    exchanged: float
    lag_ms: float


def temporal_metrics(
    estimates: Sequence[Float[ndarray, "_ 18 3"]], truths: Sequence[Float[ndarray, "_ 18 3"]], period_s: float
) -> TemporalMetrics:
    """All numbers, of sequences one frame period (s) apart; means are over all frames and joints together."""
    pairs = list(zip(estimates, truths, strict=True))
    acceleration = _pooled([acceleration_errors(*pair) for pair in pairs])
    sides = [exchanged_limbs(*pair) for pair in pairs]
    frames = sum(len(limbs) for limbs in sides)
    flips = sum(int(np.diff(limbs, axis=0).any(1).sum()) for limbs in sides)
    return TemporalMetrics(
        mean_joint_error_cm=_pooled([np.linalg.norm(e - t, axis=-1) for e, t in pairs]) * 100,
        acceleration_error_mm=acceleration * 1e3,
        acceleration_error_mps2=acceleration / period_s**2,
        rest_jitter_mm=_pooled([steps_at_rest(*pair, period_s) for pair in pairs]) * 1e3,
        foot_skate_cmps=_pooled([steps_at_rest(*pair, period_s)[:, _FEET] for pair in pairs]) / period_s * 100,
        bone_deviation_mm=_pooled([bone_deviations(e) for e, _ in pairs]) * 1e3,
        flips_per_1000=1e3 * flips / frames if frames else np.nan,
        exchanged=sum(int(limbs.any(1).sum()) for limbs in sides) / frames if frames else np.nan,
        lag_ms=lag_frames(estimates, truths) * period_s * 1e3,
    )


def acceleration_errors(estimate: Float[ndarray, "t 18 3"], truth: Float[ndarray, "t 18 3"]) -> Float[ndarray, "u 18"]:
    """Length of the error's second difference (metres a frame²) for every three frames in a row."""
    return np.linalg.norm(np.diff(estimate - truth, n=2, axis=0), axis=-1)


def steps_at_rest(
    estimate: Float[ndarray, "t 18 3"], truth: Float[ndarray, "t 18 3"], period_s: float
) -> Float[ndarray, "u 18"]:
    """Estimated way (metres) from frame to frame of joints whose true speed is below ``REST_MPS``; others NaN."""
    still = np.linalg.norm(np.diff(truth, axis=0), axis=-1) < REST_MPS * period_s
    return np.where(still, np.linalg.norm(np.diff(estimate, axis=0), axis=-1), np.nan)


def bone_deviations(estimate: Float[ndarray, "t 18 3"]) -> Float[ndarray, " b"]:
    """Standard deviation (metres) of the length of every bone."""
    ends = np.array([[JOINT_INDEX[name] for name in bone] for bone in BONES])
    lengths = np.linalg.norm(estimate[:, ends[:, 0]] - estimate[:, ends[:, 1]], axis=-1)
    known = np.isfinite(lengths)
    count = np.maximum(known.sum(0), 1)
    mean = np.where(known, lengths, 0).sum(0) / count
    deviation = np.sqrt(np.where(known, (lengths - mean) ** 2, 0).sum(0) / count)
    return np.where(known.sum(0) > 1, deviation, np.nan)


def exchanged_limbs(estimate: Float[ndarray, "t 18 3"], truth: Float[ndarray, "t 18 3"]) -> Bool[ndarray, "t 2"]:
    """Frames in which the legs, the arms are nearer to the true ones of the other side, by half."""
    same_side = np.linalg.norm(estimate - truth, axis=-1)
    mirrored = np.linalg.norm(estimate - truth[:, MIRROR], axis=-1)
    flags = []
    for limb in LIMBS:
        limb_columns = limb_joints(limb)
        flags.append(
            mirrored[:, limb_columns].sum(1) < 0.5 * same_side[:, limb_columns].sum(1)
        )  # false where any is NaN
    return np.stack(flags, axis=1)


def lag_frames(estimates: Sequence[Float[ndarray, "_ 18 3"]], truths: Sequence[Float[ndarray, "_ 18 3"]]) -> float:
    """By how many frames estimates are late: the shift of the truth with the least mean squared error, between frames
    by a parabola. Constant errors of a joint do not count. Sequences must be longer than the shifts looked at."""
    first, last = max(-_SHIFTS.start, 0), _SHIFTS.stop - 1
    errors = np.zeros(len(_SHIFTS))
    for estimate, truth in zip(estimates, truths, strict=True):
        length = len(estimate) - first - last
        if length < 2:
            continue
        # The same frames of the estimate for every shift.
        kept = estimate[last : last + length]
        known = np.asarray(np.isfinite(kept).all(-1))
        for i, shift in enumerate(_SHIFTS):
            off = np.where(known[..., None], kept - truth[last - shift : last - shift + length], 0)
            mean = off.sum(0) / np.maximum(known.sum(0), 1)[:, None]
            errors[i] += (np.where(known[..., None], off - mean, 0) ** 2).sum()
    best = int(errors.argmin())
    if errors.max() == errors.min() or best in (0, len(errors) - 1):
        return float("nan")
    before, at, after = errors[best - 1 : best + 2]
    return _SHIFTS[best] + float((before - after) / (2 * (before - 2 * at + after)))


def _pooled(parts: Sequence[Float[ndarray, "..."]]) -> float:
    """Mean of all that is known."""
    values = np.concatenate([part.ravel() for part in parts]) if parts else np.zeros(0)
    values = values[np.isfinite(values)]
    return float(values.mean()) if len(values) else float("nan")
