"""Temporal smoothing (paper, section "Pose Estimation"): a weighted mean of the current and the K previous estimates.

    Ỹᵢ = Σⱼ λⱼ Yᵢ₋ⱼ,  j = 0…K,  with Σⱼ λⱼ = 1

Missing estimates (NaN) are left out, joint by joint, and the other weights are rescaled to sum to one. A joint that is
missing now stays missing: gaps are not filled. The weights are for one frame rate.
"""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float64
from numpy import ndarray

from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.pose.ridge import grouped_folds
from depthmocap.smooth.pose_filter import PoseFilter

#: Weights of the current and the previous estimates: a mean delay of 0.7 frames (23 ms at 30 Hz), and 0.62 of the
#: noise.
DEFAULT_WEIGHTS = np.array([0.5, 0.3, 0.2])
#: If less than this share of the weights is present, rescaling would amplify noise: the current estimate is kept.
_LEAST_SHARE = 0.05
#: Number of estimates in an average by time: at 60 Hz the last has 8 % of the first's weight.
_LONGEST = 7


def smooth(
    joints: Float[ndarray, "t 18 3"], weights: Float[ndarray, "k"] = DEFAULT_WEIGHTS
) -> Float64[ndarray, "t 18 3"]:
    """Smoothed joints of a sequence: each frame is averaged with the frames before it; ``weights[0]`` is its own
    weight.

    Raises:
        InputError: when the weights are not finite or do not sum to one.
    """
    _check(weights)
    current = joints.astype(np.float64)
    observed = np.expand_dims(np.isfinite(current).all(-1), -1)
    total, share = np.zeros(current.shape), np.zeros(observed.shape)
    for lag, weight in enumerate(weights[: len(joints)]):
        earlier = slice(0, len(joints) - lag)
        total[lag:] += np.where(observed[earlier], weight * current[earlier], 0)
        share[lag:] += weight * observed[earlier]
    usable = share > _LEAST_SHARE
    smoothed = np.where(usable, total / np.where(usable, share, 1), current)
    return np.where(observed, smoothed, np.nan)


@dataclasses.dataclass(frozen=True)
class AverageSettings:
    """The average's weights.

    Attributes:
        time_constant_s: an estimate has the weight exp(−age / this): the same lag (seconds) at any frame rate, also
            where frames are lost.
        weights: if given, the weights of the current and the previous estimates, as in the paper, for one frame rate.
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
        self._poses: collections.deque[Pose] = collections.deque(maxlen=len(settings.weights or range(_LONGEST)))

    @property
    def settings(self) -> AverageSettings:
        """The weights."""
        return self._settings

    @property
    def latency_s(self) -> float:
        """The mean age of the averaged estimates (seconds) at the rate of the last frames; at 30 Hz before two
        frames."""
        timestamps_ns = [pose.timestamp_ns for pose in self._poses]
        period_s = float(np.median(np.diff(timestamps_ns))) / 1e9 if len(timestamps_ns) > 1 else 1 / 30
        ages = np.arange(len(self._settings.weights or range(_LONGEST))) * period_s
        return float(self._weights(ages) @ ages)

    def __call__(self, pose: Pose) -> Pose:
        """See :class:`PoseFilter`."""
        if self._poses and pose.timestamp_ns < self._poses[-1].timestamp_ns:
            self.reset()
        self._poses.append(pose)
        timestamps_ns = np.array([past.timestamp_ns for past in self._poses])
        weights = self._weights((pose.timestamp_ns - timestamps_ns[::-1]) / 1e9)
        joints = smooth(np.stack([past.joints for past in self._poses]), weights)[-1]
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
    """Fit smoothing weights λ₀…λ_K, the current frame's first, to estimated sequences and their ground truth.

    For each K, λ minimises the squared error of the smoothed joints subject to Σ λ = 1, and to λ ≥ 0 unless
    ``nonnegative`` is False: negative weights extrapolate the motion, and overshoot. Because of the sum, that error is
    λᵀ G λ, where G holds the products of the lagged estimates' errors. K up to ``max_previous`` is chosen by
    cross-validation over sequences, on the same frames for all K.

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
            lags = slice(0, previous + 1)
            weights = _solve_weights((total - held_out)[lags, lags], nonnegative)
            errors[previous] += weights @ held_out[lags, lags] @ weights
    lags = slice(0, int(errors.argmin()) + 1)
    return _solve_weights(total[lags, lags], nonnegative)


def _check(weights: ndarray) -> None:
    if not len(weights) or not np.isfinite(weights).all() or abs(weights.sum() - 1) > 1e-6:
        raise InputError(f"smoothing weights must be finite and sum to one, got {weights.tolist()}")


def _lagged_errors(estimate: ndarray, truth: ndarray, max_previous: int) -> ndarray:
    """(coordinates, K+1): errors of the estimates 0…K frames ago against the present truth, where all are known."""
    if len(estimate) <= max_previous:
        return np.zeros((0, max_previous + 1))
    windows = np.lib.stride_tricks.sliding_window_view(estimate, max_previous + 1, axis=0)[..., ::-1]
    errors = (windows - truth[max_previous:, ..., None]).reshape(-1, max_previous + 1)
    return errors[np.isfinite(errors).all(1)]


def _solve_weights(gram: ndarray, nonnegative: bool) -> ndarray:
    """The λ with Σ λ = 1 that minimises λᵀ G λ."""
    size = len(gram)
    # The small diagonal keeps the system solvable for estimates that agree exactly, and gives them equal weights.
    gram = gram / max(np.trace(gram), 1e-30) + 1e-12 * np.eye(size)
    if nonnegative:
        # Minimising μᵀ G μ + (Σ μ − 1)² gives the same direction: at the best length it is f / (1 + f), increasing in
        # f = λᵀ G λ of the normalised λ.
        root = np.linalg.cholesky(gram).T
        from scipy.optimize import nnls  # slow to import

        solution, _ = nnls(np.vstack([root, np.ones(size)]), np.append(np.zeros(size), 1.0))
    else:
        solution = np.linalg.solve(gram, np.ones(size))
    return solution / solution.sum()
