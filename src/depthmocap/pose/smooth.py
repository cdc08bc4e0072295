"""Temporal smoothing (paper, section "Pose Estimation"): a weighted mean of the current and the K previous estimates.

    Ỹᵢ = Σⱼ λⱼ Yᵢ₋ⱼ,  j = 0…K,  with Σⱼ λⱼ = 1

Estimates that are missing (NaN) are left out and the other weights rescaled to sum to one, joint by joint. A joint that
is missing now stays missing: gaps are marked, never filled. Weights belong to one frame rate.
"""

from __future__ import annotations

import collections
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float64
from numpy import ndarray
from scipy.optimize import nnls

from depthmocap.errors import InputError
from depthmocap.pose.ridge import grouped_folds

#: Current estimate first. A mean delay of 0.7 frames, 23 ms at 30 frames a second; white noise falls to 0.62 of itself.
DEFAULT_WEIGHTS = np.array([0.5, 0.3, 0.2])
#: Time constant (seconds) of ``weights_for``: about what the default weights have at 30 frames a second.
TIME_CONSTANT_S = 0.04
#: With less than this share of the weights present, rescaling would blow them up; the current estimate is taken as is.
_LEAST_SHARE = 0.05


def weights_for(
    period_s: float, time_constant_s: float = TIME_CONSTANT_S, max_previous: int = 6
) -> Float64[ndarray, "k"]:
    """Weights λⱼ ∝ exp(−j·period/τ) for a frame period in seconds: the same lag in time at any frame rate.

    Weights under 2 % are dropped: at 10 frames a second and slower little but the current estimate is left, because
    the previous one is of another posture.

    Raises:
        InputError: when the period or the time constant is not positive.
    """
    if not (period_s > 0 and time_constant_s > 0):
        raise InputError(f"period and time constant must be positive, got {period_s} and {time_constant_s} s")
    weights = np.exp(-np.arange(max_previous + 1) * period_s / time_constant_s)
    weights /= weights.sum()
    kept = weights[weights >= 0.02]
    return kept / kept.sum()


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


class CausalAverage:
    """``smooth`` for a live stream: give it each pose as it comes, NaN where joints are missing.

    Raises:
        InputError: when the weights are not finite or do not sum to one.
    """

    def __init__(self, weights: Float[ndarray, "k"] = DEFAULT_WEIGHTS) -> None:
        _check(weights)
        self._weights = weights
        self._poses: collections.deque[ndarray] = collections.deque(maxlen=len(weights))

    def __call__(self, pose: Float[ndarray, "18 3"]) -> Float64[ndarray, "18 3"]:
        """The smoothed pose of this instant."""
        self._poses.append(pose.astype(np.float64))
        return smooth(np.stack(self._poses), self._weights)[-1]

    def reset(self) -> None:
        """Forget the past: after a pause, or when another person enters."""
        self._poses.clear()


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
