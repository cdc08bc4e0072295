"""Temporal smoothing (paper, section "Pose Estimation"): a weighted mean of the current and the K previous estimates.

    Ỹᵢ = Σⱼ λⱼ Yᵢ₋ⱼ,  j = 0…K,  with Σⱼ λⱼ = 1

Estimates that are missing (NaN) are left out and the other weights rescaled to sum to one, joint by joint. A joint that
is missing now stays missing: gaps are marked, never filled. Weights belong to one frame rate.
"""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float64
from numpy import ndarray
from scipy.optimize import nnls

from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.pose.ridge import grouped_folds
from depthmocap.smooth.pose_filter import PoseFilter

#: Current estimate first. A mean delay of 0.7 frames, 23 ms at 30 frames a second; white noise falls to 0.62 of itself.
DEFAULT_WEIGHTS = np.array([0.5, 0.3, 0.2])
#: With less than this share of the weights present, rescaling would blow them up; the current estimate is taken as is.
_LEAST_SHARE = 0.05
#: Estimates that an average by time looks back on; at 60 frames a second the last has 8 % of the first's weight.
_MOST = 7


def smooth(
    joints: Float[ndarray, "t 18 3"], weights: Float[ndarray, "k"] = DEFAULT_WEIGHTS
) -> Float64[ndarray, "t 18 3"]:
    """Smoothed joints of a sequence, each frame from itself and the frames before it; ``weights[0]`` is the current's.

    Raises:
        InputError: when the weights are not finite or do not sum to one.
    """
    _check(weights)
    current = joints.astype(np.float64)
    seen = np.expand_dims(np.isfinite(current).all(-1), -1)
    total, share = np.zeros(current.shape), np.zeros(seen.shape)
    for lag, weight in enumerate(weights[: len(joints)]):
        earlier = slice(0, len(joints) - lag)
        total[lag:] += np.where(seen[earlier], weight * current[earlier], 0)
        share[lag:] += weight * seen[earlier]
    usable = share > _LEAST_SHARE
    smoothed = np.where(usable, total / np.where(usable, share, 1), current)
    return np.where(seen, smoothed, np.nan)


@dataclasses.dataclass(frozen=True)
class AverageSettings:
    """The average's weights.

    Attributes:
        time_constant_s: an estimate counts for exp(−age / this): the same lag in time at any frame rate, also where
            frames are lost.
        weights: of the current and the previous estimates instead, as in the paper; they belong to one frame rate.
    """

    time_constant_s: float = 0.04
    weights: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if not self.time_constant_s > 0:
            raise InputError(f"average: the time constant must be above 0, got {self.time_constant_s} s")
        if self.weights is not None:
            _check(np.array(self.weights))


class Average(PoseFilter):
    """The weighted average for a stream."""

    def __init__(self, settings: AverageSettings = AverageSettings()) -> None:
        self._settings = settings
        self._poses: collections.deque[Pose] = collections.deque(maxlen=len(settings.weights or range(_MOST)))

    @property
    def settings(self) -> AverageSettings:
        """The weights."""
        return self._settings

    @property
    def latency_s(self) -> float:
        """The mean age of what is averaged, at the rate of the last frames (30 a second before there are two)."""
        stamps = [pose.timestamp_ns for pose in self._poses]
        period_s = float(np.median(np.diff(stamps))) / 1e9 if len(stamps) > 1 else 1 / 30
        ages = np.arange(len(self._settings.weights or range(_MOST))) * period_s
        return float(self._weights(ages) @ ages)

    def __call__(self, pose: Pose) -> Pose:
        """See :class:`PoseFilter`."""
        if self._poses and pose.timestamp_ns < self._poses[-1].timestamp_ns:
            self.reset()
        self._poses.append(pose)
        stamps = np.array([each.timestamp_ns for each in self._poses])
        weights = self._weights((pose.timestamp_ns - stamps[::-1]) / 1e9)
        joints = smooth(np.stack([each.joints for each in self._poses]), weights)[-1]
        return dataclasses.replace(pose, joints=joints)

    def reset(self) -> None:
        """See :class:`PoseFilter`."""
        self._poses.clear()

    def _weights(self, ages_s: Float64[ndarray, "frames"]) -> Float64[ndarray, "k"]:
        if self._settings.weights is not None:
            return np.array(self._settings.weights)
        weights = np.exp(-ages_s / self._settings.time_constant_s)
        return weights / weights.sum()


def fit_weights(
    estimates: Sequence[Float[ndarray, "_ 18 3"]],
    truths: Sequence[Float[ndarray, "_ 18 3"]],
    max_previous: int = 8,
    *,
    nonnegative: bool = True,
    folds: int = 5,
) -> Float64[ndarray, "k"]:
    """Smoothing weights λ₀…λ_K from estimates of sequences and their truths, current first.

    For each K, λ minimises the squared error of the smoothed joints subject to Σ λ = 1 (and λ ≥ 0 unless
    ``nonnegative`` is False: negative weights extrapolate the motion, and overshoot). Because of the sum, that error is
    λᵀ G λ with G the products of the lagged estimates' errors. K up to ``max_previous`` is chosen by cross-validation
    over sequences, on the same frames for all K.

    Raises:
        InputError: for fewer than two sequences, lengths that differ, or sequences without enough frames in a row.
    """
    if len(estimates) != len(truths) or len(estimates) < 2 or max_previous < 0:
        raise InputError("smoothing weights need at least two sequences of estimates, as many of truths, and K ≥ 0")
    products, samples = [], 0
    for i, (estimate, truth) in enumerate(zip(estimates, truths, strict=True)):
        if len(estimate) != len(truth):
            raise InputError(f"sequence {i}: {len(estimate)} estimates, but {len(truth)} truths")
        errors = _lagged_errors(estimate.astype(np.float64), truth.astype(np.float64), max_previous)
        products.append(errors.T @ errors)
        samples += len(errors)
    products = np.stack(products)
    total = products.sum(0)
    if not samples:
        raise InputError(f"no sequence has {max_previous + 1} frames in a row with estimates and truth")

    fold_of = grouped_folds(np.arange(len(products)), folds)
    errors = np.zeros(max_previous + 1)
    for fold in range(fold_of.max() + 1):
        held_out = products[fold_of == fold].sum(0)
        for previous in range(max_previous + 1):
            own = slice(0, previous + 1)
            weights = _best_weights((total - held_out)[own, own], nonnegative)
            errors[previous] += weights @ held_out[own, own] @ weights
    own = slice(0, int(errors.argmin()) + 1)
    return _best_weights(total[own, own], nonnegative)


def _check(weights: ndarray) -> None:
    if not len(weights) or not np.isfinite(weights).all() or abs(weights.sum() - 1) > 1e-6:
        raise InputError(f"smoothing weights must be finite and sum to one, got {weights.tolist()}")


def _lagged_errors(estimate: ndarray, truth: ndarray, max_previous: int) -> ndarray:
    """(coordinates, K+1): error against the truth of now of the estimates 0…K frames ago, where all are known."""
    if len(estimate) <= max_previous:
        return np.zeros((0, max_previous + 1))
    windows = np.lib.stride_tricks.sliding_window_view(estimate, max_previous + 1, axis=0)[..., ::-1]
    errors = (windows - truth[max_previous:, ..., None]).reshape(-1, max_previous + 1)
    return errors[np.isfinite(errors).all(1)]


def _best_weights(gram: ndarray, nonnegative: bool) -> ndarray:
    """The λ with Σ λ = 1 that minimises λᵀ G λ."""
    size = len(gram)
    # A trace of rounding keeps estimates that agree exactly solvable, and shares the weight between them.
    gram = gram / max(np.trace(gram), 1e-30) + 1e-12 * np.eye(size)
    if nonnegative:
        # Minimising μᵀ G μ + (Σ μ − 1)² gives the same direction: at the best length it is f / (1 + f), increasing in
        # f = λᵀ G λ of the normalised λ.
        root = np.linalg.cholesky(gram).T
        solution, _ = nnls(np.vstack([root, np.ones(size)]), np.append(np.zeros(size), 1.0))
    else:
        solution = np.linalg.solve(gram, np.ones(size))
    return solution / solution.sum()
