"""Refit of the pose stage to a set's own joints (as the paper does for each set, Sec. V): the network stays as it is.

In the frame of the body let x be our 18 joints and the centres of the 43 regions, standardised over the frames that
are fitted on (0 where a region is unseen), b our joint that corresponds to one of the set's (0 where none does) and y
the true one. Minimise over W and c

    Σₙ ‖ bₙ + Wᵀ xₙ + c − yₙ ‖² + strength · ‖W‖²

over the frames in which y is known. A strong penalty leaves our joint and a constant offset; the strength is chosen by
cross-validation over people.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from depthmocap.body.regions import REGION_COUNT
from depthmocap.body.skeleton import JOINTS
from depthmocap.errors import InputError
from depthmocap.evaluate.estimated_frames import EstimatedFrames
from depthmocap.pose.ridge import STRENGTHS, grouped_folds

INPUTS = 3 * (len(JOINTS) + REGION_COUNT)
#: Standardised inputs are clipped to this many deviations, since a region of few mislabelled points may lie anywhere.
_CLIP = 5.0
_FOLDS = 5
#: Neighbouring frames in one fold, where neither people nor actions can be separated.
_BLOCK = 10
#: Least number of frames with a known joint to fit it.
_FEWEST = 10


@dataclasses.dataclass(frozen=True, eq=False)
class JointMap:
    """Map from estimates to a set's joints, by the formula at the top of this file.

    Attributes:
        fitted: joints that were fitted; for the others the map gives our corresponding joint unchanged.
        strengths: penalty of each joint, NaN where not fitted.
    """

    mean: Float[ndarray, "f"]
    scale: Float[ndarray, "f"]
    weights: Float[ndarray, "j f 3"]
    offset: Float[ndarray, "j 3"]
    fitted: Bool[ndarray, "j"]
    strengths: Float[ndarray, "j"]

    def __call__(self, observed: EstimatedFrames) -> Float[ndarray, "n j 3"]:
        """The set's joints in the world turned Z-up. NaN in frames without a detected person, and for joints that are
        neither fitted nor correspond to one of ours."""
        x = _standardised(_inputs(observed), self.mean, self.scale)
        body = _base(observed) + np.einsum("nf,jfc->njc", x, self.weights) + self.offset
        body[:, ~(self.fitted | (observed.corresponding >= 0))] = np.nan
        world = observed.frame.to_world(body)
        world[~observed.detected] = np.nan
        return world


def fit_joints(observed: EstimatedFrames) -> JointMap:
    """Fit the map to frames with known joints.

    Raises:
        InputError: when no joint is known in enough frames with a detected person.
    """
    usable = observed.detected[:, None] & ~np.isnan(observed.truths).any(-1)
    fitted = usable.sum(0) >= _FEWEST
    if not fitted.any():
        raise InputError(
            f"{observed.name}: no joint is known in {_FEWEST} frames to fit to (of {len(observed)} read); pass "
            "--refit none"
        )
    inputs = _inputs(observed)
    mean, scale = _moments(inputs[observed.detected])
    x = _standardised(inputs, mean, scale)
    y = observed.frame.from_world(observed.truths) - _base(observed)
    groups = _groups(observed)
    joints = len(observed.joints)
    weights, offset, strengths = np.zeros((joints, INPUTS, 3)), np.zeros((joints, 3)), np.full(joints, np.nan)
    # Joints that are known in the same frames share the decomposition.
    patterns = {usable[:, j].tobytes(): usable[:, j] for j in np.flatnonzero(fitted)}
    for rows in patterns.values():
        columns = np.flatnonzero(fitted & (usable == rows[:, None]).all(0))
        targets = y[rows][:, columns].reshape(rows.sum(), -1)
        fitted_weights, constant, strength = _ridge(x[rows], targets, groups[rows])
        weights[columns] = fitted_weights.reshape(INPUTS, len(columns), 3).transpose(1, 0, 2)
        offset[columns], strengths[columns] = constant.reshape(-1, 3), strength
    return JointMap(mean, scale, weights, offset, fitted, strengths)


def _inputs(observed: EstimatedFrames) -> Float[ndarray, "n f"]:
    points = np.concatenate([observed.estimates, observed.centres], 1)
    return observed.frame.from_world(points).reshape(len(observed), -1)


def _base(observed: EstimatedFrames) -> Float[ndarray, "n j 3"]:
    """Our corresponding joints in the body's frame, 0 where none does."""
    ours = observed.frame.from_world(observed.estimates)[:, observed.corresponding]
    return np.where((observed.corresponding >= 0)[:, None], ours, 0)


def _moments(inputs: Float[ndarray, "n f"]) -> tuple[Float[ndarray, "f"], Float[ndarray, "f"]]:
    """Mean and deviation of the known inputs. An input that is never known, or constant, gets the deviation 1."""
    known = ~np.isnan(inputs)
    count = np.maximum(known.sum(0), 1)
    mean = np.sum(inputs, axis=0, where=known) / count
    deviation = np.sqrt(np.sum((inputs - mean) ** 2, axis=0, where=known) / count)
    return mean, np.where(deviation > 1e-6, deviation, 1.0)


def _standardised(
    inputs: Float[ndarray, "n f"], mean: Float[ndarray, "f"], scale: Float[ndarray, "f"]
) -> Float[ndarray, "n f"]:
    return np.clip(np.nan_to_num((inputs - mean) / scale), -_CLIP, _CLIP)


def _groups(observed: EstimatedFrames) -> Int[ndarray, "n"]:
    """Groups of the cross-validation: people; with one person only, actions; with one action only, blocks of frames."""
    for names in (observed.subjects, observed.actions):
        different, groups = np.unique(names, return_inverse=True)
        if len(different) > 1:
            return groups
    return np.arange(len(observed)) // _BLOCK


def _ridge(
    x: Float[ndarray, "n f"], y: Float[ndarray, "n d"], groups: Int[ndarray, "n"]
) -> tuple[Float[ndarray, "f d"], Float[ndarray, "d"], float]:
    """Weights, constant, and the strength with the least mean joint error in cross-validation; the strongest where
    there are fewer than two groups."""
    if len(np.unique(groups)) < 2:
        return *_solve(x, y, STRENGTHS[-1:])[0], float(STRENGTHS[-1])
    fold_of = grouped_folds(groups, _FOLDS)
    errors = np.zeros(len(STRENGTHS))
    for fold in range(fold_of.max() + 1):
        out = fold_of == fold
        for i, (weights, constant) in enumerate(_solve(x[~out], y[~out], STRENGTHS)):
            misses = x[out] @ weights + constant - y[out]
            errors[i] += np.linalg.norm(misses.reshape(len(misses), -1, 3), axis=-1).sum()
    strength = STRENGTHS[int(errors.argmin())]
    return *_solve(x, y, np.array([strength]))[0], float(strength)


def _solve(
    x: Float[ndarray, "n f"], y: Float[ndarray, "n d"], strengths: Float[ndarray, "s"]
) -> list[tuple[ndarray, ndarray]]:
    """Weights and constant for each strength, by one eigendecomposition of the centred inputs' products."""
    x_mean, y_mean = x.mean(0), y.mean(0)
    centred = x - x_mean
    values, vectors = scipy.linalg.eigh(centred.T @ centred, check_finite=False)
    rotated = vectors.T @ (centred.T @ (y - y_mean))
    solutions = [vectors @ (rotated / (values.clip(0) + strength)[:, None]) for strength in strengths]
    return [(weights, y_mean - x_mean @ weights) for weights in solutions]
