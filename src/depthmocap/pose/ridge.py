"""Pose estimation by ridge regression (paper, section "Pose Estimation"): features of a cloud to joints.

With standardised features x (an unobserved one is the training mean, 0) and joints y in the feature frame, minimise
over W and b

    Σₙ ‖ Wᵀ xₙ + b − yₙ ‖² + strength · ‖W‖²

whose solution is W = (Xᵀ X + strength · I)⁻¹ Xᵀ Y for centred X and Y. One eigendecomposition Xᵀ X = V diag(s) Vᵀ
gives W = V diag(1 / (s + strength)) Vᵀ Xᵀ Y for every strength.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import cast, get_args

import numpy as np
import scipy.linalg
from jaxtyping import Float, Float32, Int
from numpy import ndarray

from depthmocap.body.skeleton import JOINTS
from depthmocap.core.output import atomic_write
from depthmocap.core.reading.array_files import ArrayType, error_reason, read_npz
from depthmocap.core.reading.input_files import check_file
from depthmocap.errors import InputError
from depthmocap.pose.features import FEATURE_COUNT, FeatureFrame

#: Strengths among which cross-validation chooses.
STRENGTHS = np.logspace(-1, 6, 15)
#: Weights are stored in 16 bits if that changes no joint coordinate of the training data by more (metres).
_ROUNDING_M = 1e-3
_FORMAT = "depthmocap ridge 2"


@dataclasses.dataclass(frozen=True, eq=False)
class RidgePose:
    """A linear map from features to joints, fit for some number of views (0: any) and kind of labels.

    ``mean`` and ``scale`` standardise the features, which must be in ``frame`` (``cloud_features``). ``bias`` holds the
    joints of the mean features, in metres. ``labels`` is "true" or "network". Standardised features are clipped to
    ±``clip``. Then a few mislabelled points far away, which change a region's minimum or maximum by a metre, move the
    joints by centimetres. The paper does not clip.
    """

    mean: Float32[ndarray, "1032"]
    scale: Float32[ndarray, "1032"]
    weights: Float32[ndarray, "1032 54"]
    bias: Float32[ndarray, "54"]
    strength: float
    joints: tuple[str, ...] = JOINTS
    frame: FeatureFrame = "cloud"
    views: int = 0
    labels: str = "true"
    clip: float = np.inf

    def predict(self, features: Float[ndarray, "n f"]) -> Float32[ndarray, "n 18 3"]:
        """Joints in the frame of the features, metres; NaN features count as the training mean.

        Raises:
            InputError: when there are not 1032 features.
        """
        x = standardise(features, self.mean, self.scale, self.clip)
        return (x @ self.weights + self.bias).reshape(-1, len(JOINTS), 3)

    def save(self, path: Path) -> None:
        """Write the model as one .npz file."""
        _save((self,), path)

    @classmethod
    def load(cls, path: Path) -> RidgePose:
        """Read a model.

        Raises:
            InputError: when the file is missing, malformed or holds several models.
        """
        models = _load(path)
        if len(models) != 1:
            raise InputError(f"{path} holds {len(models)} models: load it with RidgeBank.load")
        return models[0]


@dataclasses.dataclass(frozen=True, eq=False)
class RidgeBank:
    """One model per number of views. The model of the most views also serves more views.

    Raises:
        InputError: without models, or when two share a number of views or the models differ in ``frame``.
    """

    models: tuple[RidgePose, ...]

    def __post_init__(self) -> None:
        views = [model.views for model in self.models]
        if not views or len(set(views)) < len(views) or len({model.frame for model in self.models}) > 1:
            raise InputError(f"a bank needs models of different numbers of views and of one frame, got views {views}")

    @property
    def frame(self) -> FeatureFrame:
        """The frame that the features must be in."""
        return self.models[0].frame

    def model_for(self, views: int) -> RidgePose:
        """The model of this many views or, without one, of the next lower number; else that of the fewest views."""
        by_views = sorted(self.models, key=lambda model: model.views)
        return next((model for model in reversed(by_views) if model.views <= views), by_views[0])

    def predict(self, features: Float[ndarray, "n f"], views: int) -> Float32[ndarray, "n 18 3"]:
        """Joints from the features of clouds of ``views`` cameras; see ``RidgePose.predict``."""
        return self.model_for(views).predict(features)

    def save(self, path: Path) -> None:
        """Write all models as one .npz file."""
        _save(self.models, path)

    @classmethod
    def load(cls, path: Path) -> RidgeBank:
        """Read a bank (or a single model as a bank of one).

        Raises:
            InputError: when the file is missing or malformed.
        """
        return cls(_load(path))


def grouped_folds(groups: Int[ndarray, "n"], folds: int) -> Int[ndarray, "n"]:
    """Fold 0…folds−1 of every sample. No group is split, and folds are of similar size; few groups give fewer folds.

    Raises:
        InputError: for fewer than two folds or groups.
    """
    _, inverse, counts = np.unique(groups, return_inverse=True, return_counts=True)
    folds = min(folds, len(counts))
    if folds < 2:
        raise InputError("cross-validation needs at least two folds and two groups (motion clips)")
    sizes, fold_of_group = np.zeros(folds), np.zeros(len(counts), np.int64)
    for group in np.argsort(-counts, kind="stable"):  # largest first, always to the smallest fold
        fold_of_group[group] = sizes.argmin()
        sizes[fold_of_group[group]] += counts[group]
    return fold_of_group[inverse]


def fit_ridge(
    features: Float[ndarray, "n f"],
    joints: Float[ndarray, "n 18 3"],
    groups: Int[ndarray, "n"],
    strengths: Sequence[float] | Float[ndarray, "s"] = STRENGTHS,
    folds: int = 5,
    *,
    frame: FeatureFrame = "cloud",
    views: int = 0,
    labels: str = "true",
    clip: float = np.inf,
) -> RidgePose:
    """Ridge regression whose strength minimises the mean joint error in cross-validation over groups.

    Features and joints are in the feature frame, metres. ``groups`` numbers the motion clip of each sample: clips stay
    whole in one fold, because neighbouring frames of a clip are nearly equal. The standardisation of the features comes
    from all samples. With a single strength there is no cross-validation.

    Args:
        frame: recorded in the model, as are ``views`` (0: any number) and ``labels`` ("true" or "network").
        clip: bound of standardised features, in deviations; see :class:`RidgePose`.

    Raises:
        InputError: when there are not 1032 features, when features, joints or strengths are not usable numbers, or when
            groups are too few.
    """
    candidates = np.asarray(strengths, np.float64)
    if candidates.size == 0 or not (np.isfinite(candidates).all() and (candidates > 0).all()):
        raise InputError(f"strengths must be positive numbers, got {candidates.tolist()}")
    if not len(features) or not np.isfinite(joints).all():
        raise InputError("training needs samples, and their joints must be finite: leave out frames without truth")
    _check_count(features)
    if np.isinf(features).any():
        raise InputError("features must be finite, or NaN for regions that nobody sees")
    mean, scale = feature_moments(features)
    x = standardise(features, mean, scale, clip)
    y = joints.reshape(len(joints), -1).astype(np.float64)

    if len(candidates) == 1:
        products, best = _products(x, y), 0
    else:
        products, best = _cross_validate(x, y, grouped_folds(groups, folds), candidates)
    weights, bias = next(_solve(products, candidates[best : best + 1]))
    weights = weights.astype(np.float32)
    with np.errstate(over="ignore"):
        rounded = weights.astype(np.float16).astype(np.float32)
    if np.isfinite(rounded).all() and np.abs(x @ (rounded - weights)).max() <= _ROUNDING_M:
        weights = rounded
    strength = float(candidates[best])
    return RidgePose(mean, scale, weights, bias.astype(np.float32), strength, JOINTS, frame, views, labels, clip)


def _cross_validate(x: ndarray, y: ndarray, fold_of: Int[ndarray, "n"], strengths: ndarray) -> tuple[ndarray, int]:
    """``_products`` of all samples, and the index of the strength with the least error on the held-out folds."""
    rows_of = [np.flatnonzero(fold_of == fold) for fold in range(fold_of.max() + 1)]
    parts = [_products(x[rows], y[rows]) for rows in rows_of]
    products = np.sum(parts, axis=0)
    errors = np.zeros(len(strengths))
    for rows, part in zip(rows_of, parts, strict=True):
        x_out, y_out = x[rows], y[rows]
        for i, (weights, bias) in enumerate(_solve(products - part, strengths)):
            residuals = x_out @ weights.astype(np.float32) + bias - y_out
            errors[i] += np.linalg.norm(residuals.reshape(-1, 3), axis=1).sum()
    return products, int(errors.argmin())


def _check_count(features: ndarray) -> None:
    if features.shape[1] != FEATURE_COUNT:
        raise InputError(f"expected {FEATURE_COUNT} features (see cloud_features), got {features.shape[1]}")


def feature_moments(features: Float[ndarray, "n f"]) -> tuple[Float32[ndarray, "f"], Float32[ndarray, "f"]]:
    """Mean and deviation of the observed values of each feature. The deviation is 1 for a feature that is constant or
    was never observed."""
    observed = ~np.isnan(features)
    count = np.maximum(observed.sum(0), 1)
    mean = np.sum(features, axis=0, where=observed, dtype=np.float64) / count
    deviation = np.sqrt(np.sum((features - mean) ** 2, axis=0, where=observed) / count)
    constant = deviation <= 1e-6 * np.abs(mean) + 1e-12  # only rounding: dividing by it would amplify noise
    return mean.astype(np.float32), np.where(constant, 1.0, deviation).astype(np.float32)


def standardise(
    features: Float[ndarray, "n _"], mean: Float32[ndarray, "f"], scale: Float32[ndarray, "f"], clip: float
) -> Float32[ndarray, "n _"]:
    """Features in deviations from their mean, clipped to ±``clip``; an unobserved one is the mean, 0."""
    _check_count(features)
    x = (features.astype(np.float32, copy=False) - mean) / scale
    x[np.isnan(x)] = 0
    return np.clip(x, -clip, clip, out=x)


def _products(x: ndarray, y: ndarray) -> ndarray:
    """[1 X]ᵀ [1 X Y]: all that the solution needs of the samples. The products of folds add up."""
    ones = np.ones((len(x), 1))
    left = np.concatenate([ones, x.astype(np.float64)], axis=1)
    return np.concatenate([left.T @ left, left.T @ y], axis=1)


def _solve(products: ndarray, strengths: ndarray) -> Iterator[tuple[ndarray, ndarray]]:
    """Weights and bias for each strength, from ``_products``; by the formula at the top of this file."""
    d = len(products) - 1
    count, x_sum, y_sum = products[0, 0], products[0, 1 : d + 1], products[0, d + 1 :]
    gram = products[1:, 1 : d + 1] - np.outer(x_sum, x_sum) / count
    cross = products[1:, d + 1 :] - np.outer(x_sum, y_sum) / count
    values, vectors = scipy.linalg.eigh(gram, overwrite_a=True, check_finite=False, driver="evd")
    rotated = vectors.T @ cross
    for strength in strengths:
        weights = vectors @ (rotated / (values.clip(0) + strength)[:, None])
        yield weights, (y_sum - x_sum @ weights) / count


def _save(models: tuple[RidgePose, ...], path: Path) -> None:
    weights = np.stack([model.weights for model in models])
    with np.errstate(over="ignore"):
        halves = weights.astype(np.float16)
    with atomic_write(path) as unfinished, unfinished.open("wb") as file:  # a name of any ending
        np.savez_compressed(
            file,
            format=np.array(_FORMAT),
            joints=np.array(models[0].joints),
            mean=np.stack([model.mean for model in models]),
            scale=np.stack([model.scale for model in models]),
            weights=halves if np.array_equal(halves, weights) else weights,
            bias=np.stack([model.bias for model in models]),
            strength=np.array([model.strength for model in models]),
            frame=np.array([model.frame for model in models]),
            views=np.array([model.views for model in models]),
            labels=np.array([model.labels for model in models]),
            clip=np.array([model.clip for model in models], dtype=np.float64),
        )


_ARRAYS = {
    "joints": ArrayType("j", "U"), "mean": ArrayType(f"m {FEATURE_COUNT}", "f"),
    "scale": ArrayType(f"m {FEATURE_COUNT}", "f"), "bias": ArrayType(f"m {3 * len(JOINTS)}", "f"),
    "weights": ArrayType(f"m {FEATURE_COUNT} {3 * len(JOINTS)}", "f"), "strength": ArrayType("m", "f"),
    "clip": ArrayType("m", "f"), "views": ArrayType("m", "i"), "frame": ArrayType("m", "U"),
    "labels": ArrayType("m", "U"),
}  # fmt: skip


def _load(path: Path) -> tuple[RidgePose, ...]:
    check_file(path, "a pose model is made by fit_ridge and saved as .npz")
    try:
        version = str(read_npz(path, {"format": ArrayType("", "U")})["format"])
        if version != _FORMAT:
            raise InputError(f"it is of the format {version!r}, not {_FORMAT!r}")
        arrays = read_npz(path, _ARRAYS)
    except InputError as error:
        raise InputError(f"{path} is not a pose model (.npz): {error_reason(error, path)}") from None
    count = len(arrays["views"])
    joints = tuple(arrays["joints"].tolist())
    if joints != JOINTS:
        raise InputError(f"{path} predicts the joints {joints}, expected {JOINTS}")
    frames = arrays["frame"].tolist()
    if not set(frames) <= set(get_args(FeatureFrame)):
        raise InputError(f"{path}: frame must be one of {', '.join(get_args(FeatureFrame))}, got {frames}")
    numbers = {name: arrays[name].astype(np.float32) for name in ("mean", "scale", "weights", "bias")}
    if not all(np.isfinite(array).all() for array in numbers.values()) or (numbers["scale"] <= 0).any():
        raise InputError(f"{path} holds numbers that are not finite or scales that are not positive")
    return tuple(
        RidgePose(
            **{name: array[i] for name, array in numbers.items()},
            strength=float(arrays["strength"][i]),
            joints=joints,
            frame=cast(FeatureFrame, str(arrays["frame"][i])),
            views=int(arrays["views"][i]),
            labels=str(arrays["labels"][i]),
            clip=float(arrays["clip"][i]),
        )
        for i in range(count)
    )
