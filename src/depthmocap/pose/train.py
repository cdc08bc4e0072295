"""``depthmocap train pose``: fit the joint regressors on generated or recorded samples."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray
from rich.console import Console
from rich.progress import Progress

from depthmocap.classify.runtime import Classifier
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.pose.cloud import LabelledView, merge_views
from depthmocap.pose.features import FEATURE_COUNT, cloud_features
from depthmocap.pose.ridge import RidgeBank, fit_ridge
from depthmocap.settings import check_seed, plain_settings
from depthmocap.synth.sample import ANY_SENSOR, CameraRange, Recipe, Sample, Sampler

#: Bound of standardised features of network labels, in deviations. Mislabelled specks move a region's minimum and
#: maximum: with one view it took a tenth off the mean error, with three it changed nothing. True labels have no specks.
CLIP = 3.0


@dataclasses.dataclass(frozen=True)
class PoseTraining:
    """Settings of one fit of the pose stage.

    Attributes:
        out: folder for ridge.npz, which ``run`` and ``evaluate`` load, and settings.json.
        data: "synth" makes samples; a folder is read as a UBC3V root (its <subset>-pose/train).
        labels: fit on the true labels or on the network's.
        weights: a classifier.onnx of your own.
        postures: folder of motion capture clips, or a pool made of them; without it the packaged prior.
        subset: who is in the samples: easy, inter, hard, or open (all builds); by default open bodies are made, and
            hard is read from a folder.
        samples: postures.
        views: numbers of cameras to fit a regressor for; the last also serves more cameras.
        absolute: features in the world's frame, the paper's form, instead of relative to the cloud's centre.
    """

    out: Path
    data: str = "synth"
    labels: Literal["true", "network"] = "network"
    weights: Path | None = None
    postures: Path | None = None
    subset: Literal["easy", "inter", "hard", "open"] | None = None
    samples: int = 3000
    views: tuple[int, ...] = (1, 2, 3, 4)
    absolute: bool = False
    seed: int = 0

    @property
    def people(self) -> Literal["easy", "inter", "hard", "open"]:
        """The subset, its default resolved."""
        return self.subset or ("open" if self.data == "synth" else "hard")


def _synth_samples(settings: PoseTraining) -> Iterator[Sample]:
    recipe = Recipe(
        settings.people, "train", max(settings.views), settings.postures, vary=True,
        sensors=(ANY_SENSOR,), noise="random", cameras=CameraRange(roll_rad=0.03),
    )  # fmt: skip
    draw = Sampler(recipe, settings.seed)
    for index in range(settings.samples):
        yield draw(index)


def _folder_samples(settings: PoseTraining) -> Iterator[Sample]:
    """Samples of a UBC3V split; blocks of ten neighbouring frames are one group of the cross-validation."""
    from depthmocap.datasets.ubc3v import iterate

    frames = iterate(Path(settings.data), f"{settings.people}-pose", "train", settings.samples)
    for index, frame in enumerate(frames):
        if frame.true_joints is not None:
            yield Sample(frame.views, frame.true_joints, index // 10)


def label_sample(
    views: tuple[View, ...], labels: Literal["true", "network"], classifier: Classifier | None
) -> list[LabelledView]:
    """Views with their true labels, or with the network's on the person's mask.

    Raises:
        InputError: when true labels are wanted and a view has none.
    """
    if labels == "network":
        assert classifier is not None
        masks = [view.mask if view.mask is not None else view.depth_m > 0 for view in views]
        found = classifier.label_views(views, masks)
        return [(view, each, weights) for view, (each, weights) in zip(views, found, strict=True)]
    parts: list[LabelledView] = []
    for view in views:
        if view.labels is None:
            raise InputError(f"{view.camera.name} has no true labels: use --labels network")
        parts.append((view, view.labels, None))
    return parts


def _choices(available: int, wanted: int, rng: np.random.Generator) -> list[tuple[int, ...]]:
    """Which views to take: up to two random choices of so many, so that one sample teaches several placements."""
    if wanted > available:
        return []
    draws = {tuple(sorted(rng.choice(available, wanted, replace=False).tolist())) for _ in range(2)}
    return sorted(draws)


def collect(settings: PoseTraining, console: Console) -> dict[int, tuple[ndarray, ndarray, ndarray]]:
    """Features (n, 1032), joints (n, 18, 3) in the features' frame and groups (n,), by number of views."""
    classifier = Classifier(settings.weights) if settings.labels == "network" else None
    samples = _synth_samples(settings) if settings.data == "synth" else _folder_samples(settings)
    rows: dict[int, list[tuple[UInt8[ndarray, "f"], ndarray, int]]] = {count: [] for count in settings.views}
    rng = np.random.default_rng(settings.seed)
    with Progress(console=console) as progress:
        task = progress.add_task("features", total=settings.samples)
        for sample in samples:
            parts = label_sample(sample.views, settings.labels, classifier)
            for count in settings.views:
                for chosen in _choices(len(parts), count, rng):
                    features = cloud_features(merge_views([parts[i] for i in chosen]), "z", settings.absolute)
                    if np.isfinite(features.values).any():
                        rows[count].append((features.values, features.from_world(sample.joints), sample.group))
            progress.advance(task)
    empty = [count for count, found in rows.items() if len(found) < 20]
    if empty:
        raise InputError(f"too few samples with {empty} views to fit a regressor: give more --samples or fewer --views")
    return {
        count: (
            np.array([row[0] for row in found], dtype=np.float32).reshape(-1, FEATURE_COUNT),
            np.array([row[1] for row in found]),
            np.array([row[2] for row in found]),
        )
        for count, found in rows.items()
    }


def train_pose(settings: PoseTraining, console: Console | None = None) -> Path:
    """Fit one ridge regressor per number of views and write ridge.npz; returns its path.

    Raises:
        InputError: too few samples, or labels or weights that cannot be read.
    """
    check_seed(settings.seed)
    console = console or Console(stderr=True)
    settings.out.mkdir(parents=True, exist_ok=True)
    (settings.out / "settings.json").write_text(json.dumps(plain_settings(settings), indent=1) + "\n")
    models = []
    for count, (features, joints, groups) in collect(settings, console).items():
        model = fit_ridge(
            features, joints, groups, absolute=settings.absolute, views=count, labels=settings.labels,
            clip=CLIP if settings.labels == "network" and not settings.absolute else np.inf,
        )  # fmt: skip
        error = np.linalg.norm(model.predict(features) - joints, axis=-1).mean() * 100
        console.print(f"{count} views: {len(features)} samples, strength {model.strength:g}, fit {error:.2f} cm")
        models.append(model)
    path = settings.out / "ridge.npz"
    RidgeBank(tuple(models)).save(path)
    return path
