"""``depthmocap evaluate estimators``: the paper's ridge beside its comparators (LASSO, a small neural network; paper,
Sec. IV-C) and the votes, all fitted on the same samples and measured on clips that none of them has seen."""

from __future__ import annotations

import dataclasses
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from jaxtyping import Float
from numpy import ndarray
from rich.console import Console
from rich.table import Table

from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.output import check_outputs
from depthmocap.core.settings import check_at_least
from depthmocap.errors import InputError, missing_extra
from depthmocap.evaluate.evaluation_report import JsonOutput
from depthmocap.pose.labelled_view import Labels
from depthmocap.pose.parts import body_frame, network_inputs
from depthmocap.pose.ridge import feature_moments, fit_ridge, grouped_folds, standardise
from depthmocap.train.pose_samples import CollectedSamples, PoseSampleSettings, read_samples
from depthmocap.train.train_pose import CLIP, FEWEST_SAMPLES

#: Strengths of LASSO, for standardised features and joints in metres.
_LASSO = np.logspace(-4, -2, 5)
_LAYER = 256

#: Standardised features to joint coordinates.
Predictor = Callable[[ndarray], ndarray]


@dataclasses.dataclass(frozen=True)
class EstimatorComparison(JsonOutput):
    """Estimators of joints fitted on collected samples, a part of whose clips is kept out to measure them on.

    Attributes:
        samples: folder of samples that ``train pose`` collected (its OUT/samples).
        labels: "network" or "true".
        views: numbers of cameras.
        folds: one in so many groups of clips is kept out.
        minutes: how long the voting network is trained; 0 leaves it out.
    """

    samples: tyro.conf.Positional[Path]
    labels: Labels = "network"
    views: tuple[int, ...] = (1, 2, 3)
    folds: int = 5
    minutes: float = 4.0
    seed: int = 0

    def __post_init__(self) -> None:
        check_at_least(0, {"--minutes": self.minutes})
        check_at_least(2, {"--folds": self.folds})
        check_outputs({"--json": self.json}, {"the samples": self.samples})


@locks_outputs(files=("json",))
def compare_estimators(settings: EstimatorComparison, console: Console | None = None) -> dict[str, Any]:
    """Fit and measure all of them; returns mean error (cm) and share within 10 cm by estimator and number of views.

    Raises:
        InputError: when the samples cannot be read or are of too few clips.
    """
    console = console or Terminal(stderr=True)
    samples = read_samples(settings.samples, PoseSampleSettings(views=settings.views))
    held_out = set(np.unique(samples.groups)[grouped_folds(np.unique(samples.groups), settings.folds) == 0].tolist())
    numbers: dict[str, dict[str, dict[str, float]]] = {}
    for count in settings.views:
        features, joints, groups = samples.features[settings.labels, count]
        test = np.isin(groups, list(held_out))
        if not test.any() or test.all():
            raise InputError(f"{settings.samples}: too few clips with {count} views to keep some out")
        if (learnt := int(np.count_nonzero(~test))) < FEWEST_SAMPLES:
            raise InputError(f"{settings.samples}: {learnt} samples with {count} views to learn from are too few")
        for name, fit in (("ridge", _ridge), ("LASSO", _lasso), ("neural network", _perceptron)):
            with console.status(f"{name}, {count} views"):
                predict = fit(features[~test], joints[~test], groups[~test], settings)
                estimates = predict(features[test]).reshape(-1, *joints.shape[1:])
            numbers.setdefault(name, {})[str(count)] = _summary(estimates, joints[test])
    if settings.minutes > 0:
        numbers["votes"] = _votes(samples, held_out, settings, console)
    result = {"labels": settings.labels, "samples": len(samples.joints), "clips_kept_out": len(held_out), **numbers}
    settings.write_numbers(result)
    table = Table(title=f"joint error in cm (within 10 cm), {settings.labels} labels, {len(samples.joints)} samples")
    table.add_column("estimator")
    for count in settings.views:
        table.add_column(f"{count} views", justify="right")
    for name, by_views in numbers.items():
        cells = [f"{row['mean_joint_error_cm']:.2f} ({row['within_10cm']:.1%})" for row in by_views.values()]
        table.add_row(name, *cells)
    console.print(table)
    return result


def _summary(estimates: ndarray, truth: ndarray) -> dict[str, float]:
    errors = np.linalg.norm(estimates - truth, axis=-1)
    return {"mean_joint_error_cm": float(errors.mean()) * 100, "within_10cm": float((errors <= 0.1).mean())}


def _clip(settings: EstimatorComparison) -> float:
    return CLIP if settings.labels == "network" else np.inf


def _ridge(features: ndarray, joints: ndarray, groups: ndarray, settings: EstimatorComparison) -> Predictor:
    return fit_ridge(features, joints, groups, labels=settings.labels, clip=_clip(settings)).predict


def _standardiser(features: ndarray, settings: EstimatorComparison) -> Predictor:
    """As for ridge."""
    mean, scale = feature_moments(features)
    return lambda rows: standardise(rows, mean, scale, _clip(settings))


def _lasso(features: ndarray, joints: ndarray, groups: ndarray, settings: EstimatorComparison) -> Predictor:
    """Each coordinate has its own weights; one strength for all, chosen on clips kept out of the fit."""
    try:
        from sklearn.linear_model import lasso_path
    except ModuleNotFoundError:
        raise missing_extra("scikit-learn", "train") from None
    standardise = _standardiser(features, settings)
    x, y = (array.reshape(len(joints), -1).astype(np.float64) for array in (standardise(features), joints))
    centre = y.mean(0)

    def fit(rows: ndarray, strengths: Float[ndarray, "s"]) -> Float[ndarray, "s f o"]:
        part, gram = x[rows], x[rows].T @ x[rows]
        paths = []
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # near enough to convergence
            for target in (y[rows] - centre).T:
                _, weights, _ = lasso_path(
                    part, target, max_iter=300, tol=1e-3,
                    alphas=strengths, precompute=gram,  # pyright: ignore[reportArgumentType] - both take arrays
                )  # fmt: skip
                paths.append(weights.T[::-1])  # strongest first, as it returns them; ours rise
        return np.stack(paths, -1)

    inner = grouped_folds(groups, 5) == 0
    errors = [
        np.linalg.norm((x[inner] @ weights + centre - y[inner]).reshape(-1, joints.shape[1], 3), axis=-1).mean()
        for weights in fit(np.flatnonzero(~inner), _LASSO)
    ]
    best = int(np.argmin(errors))
    weights = fit(np.arange(len(x)), _LASSO[best : best + 1])[0]
    return lambda rows: standardise(rows) @ weights + centre


def _perceptron(features: ndarray, joints: ndarray, groups: ndarray, settings: EstimatorComparison) -> Predictor:
    """One hidden layer, stopped when a tenth that it does not learn from gets no better."""
    try:
        from sklearn.neural_network import MLPRegressor
    except ModuleNotFoundError:
        raise missing_extra("scikit-learn", "train") from None
    standardise = _standardiser(features, settings)
    network = MLPRegressor(
        hidden_layer_sizes=(_LAYER,),
        alpha=1.0,
        batch_size=32,  # pyright: ignore[reportArgumentType] - it takes numbers too
        learning_rate_init=3e-4,
        early_stopping=True,
        max_iter=60,
        random_state=settings.seed,
        n_iter_no_change=8,
    )
    y = joints.reshape(len(joints), -1).astype(np.float32)
    centre, scale = y.mean(0), y.std()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # near enough to convergence
        network.fit(standardise(features), (y - centre) / scale)
    return lambda rows: np.asarray(network.predict(standardise(rows))) * scale + centre


def _votes(
    samples: CollectedSamples, held_out: set[int], settings: EstimatorComparison, console: Console
) -> dict[str, dict[str, float]]:
    """Trained on the other clips; measured on up to two random choices of cameras a sample, as the others are."""
    from depthmocap.pose.votes import run_votes, voting_session
    from depthmocap.train.train_votes import VotesTraining, train_votes

    test = np.isin(samples.groups, list(held_out))
    train = dataclasses.replace(
        samples,
        parts={labels: parts[~test] for labels, parts in samples.parts.items()},
        joints=samples.joints[~test],
        landmarks=samples.landmarks[~test],
        groups=samples.groups[~test],
    )
    with tempfile.TemporaryDirectory() as folder:
        path = train_votes(train, VotesTraining(settings.minutes), settings.seed, Path(folder), console)
        session = voting_session(path)
    parts, joints = samples.parts[settings.labels][test], samples.joints[test]
    rng = np.random.default_rng(settings.seed)
    numbers: dict[str, dict[str, float]] = {}
    for count in settings.views:
        cameras = np.concatenate([rng.random(parts.shape[:2]).argsort(1)[:, :count] for _ in range(2)])
        observed = np.take_along_axis(np.concatenate([parts, parts]), cameras[:, :, None, None], 1)
        truth = np.concatenate([joints, joints])
        usable = (observed[..., 0] > 0).any((1, 2))
        frame = body_frame(observed[usable])
        estimates, _ = run_votes(session, network_inputs(observed[usable], frame)[0])
        numbers[str(count)] = _summary(estimates, frame.from_world(truth[usable]))
    return numbers
