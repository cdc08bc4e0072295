"""``depthmocap train pose``: collect samples, generated or recorded, and fit the joint estimators on them."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Literal

import numpy as np
import tyro
from rich.console import Console

from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.output import write_json
from depthmocap.core.settings import check_above_0, plain_settings
from depthmocap.errors import InputError, missing_extra
from depthmocap.pose.labelled_view import LABELS, Labels
from depthmocap.pose.ridge import RidgeBank, fit_ridge
from depthmocap.train.pose_samples import CollectedSamples, PoseSampleSettings, append_parts, collect, read_samples

#: Bound of standardised features of network labels, in deviations. Mislabelled specks move a region's minimum and
#: maximum: with one view it took a tenth off the mean error, with three it changed nothing. True labels have no specks.
CLIP = 3.0
#: A regressor is fitted on.
FEWEST_SAMPLES = 20

Estimators = Literal["all", "votes", "ridge"]


@dataclasses.dataclass(frozen=True)
class PoseTraining:
    """Settings of one fit of the pose stage. Run again, it goes on collecting where it stopped.

    Attributes:
        out: folder for votes.onnx, ridge_network.npz and ridge_true.npz, which ``run`` and ``evaluate`` load, for
            settings.json and for the samples.
        estimators: which are fitted: votes (extra: train), ridge or all.
        minutes: how long the voting network is trained.
        learning_rate: its peak, of the voting network.
        start: a votes.safetensors that its training goes on from.
        points_only: joints stay exactly those of --start, and points of the skin alone are learnt.
        earlier: folders of samples collected before (of other weights, of other postures), from which the voting
            network learns as well.
        bfloat16: multiply matrices in half precision; by default where the device has instructions for it.
    """

    out: Path
    source: tyro.conf.OmitArgPrefixes[PoseSampleSettings] = dataclasses.field(default_factory=PoseSampleSettings)
    estimators: Estimators = "all"
    minutes: float = 15.0
    learning_rate: float = 1.5e-3
    earlier: tuple[Path, ...] = ()
    start: Path | None = None
    points_only: bool = False
    bfloat16: bool | None = None

    def __post_init__(self) -> None:
        if self.points_only and self.start is None:
            raise InputError("--points-only needs --start, whose joints stay as they are")
        check_above_0({"--minutes": self.minutes, "--learning-rate": self.learning_rate})
        if self.estimators != "votes" and self.source.samples < FEWEST_SAMPLES:
            raise InputError(
                f"--samples must be at least {FEWEST_SAMPLES} to fit a regressor, got {self.source.samples}"
            )


def train_pose(settings: PoseTraining, console: Console | None = None) -> list[Path]:
    """Collect the samples and fit the estimators; returns the files written.

    Raises:
        InputError: too few samples, or labels or weights that cannot be read.
    """
    console = console or Terminal(stderr=True)
    if settings.estimators == "ridge":
        return _collect_and_fit(settings, console)
    try:
        import torch  # noqa: F401
    except ModuleNotFoundError:
        raise missing_extra("torch", "train") from None
    from depthmocap.train.distributed import trains

    return trains(_collect_and_train)(settings, console)


@locks_outputs(folder="out")
def _collect_and_fit(settings: PoseTraining, console: Console) -> list[Path]:
    samples = collect(settings.source, settings.out / "samples", console)
    write_json(settings.out / "settings.json", plain_settings(settings))
    return [fit_bank(samples, labels, settings, console) for labels in LABELS if _has(samples, labels)]


def _collect_and_train(settings: PoseTraining, console: Console) -> list[Path]:
    """In each process that trains; the first collects the samples and fits the regressors."""
    from depthmocap.train.distributed import process_rank, wait_for_all
    from depthmocap.train.train_votes import VotesTraining, train_votes

    written = []
    if process_rank() == 0:
        samples = collect(settings.source, settings.out / "samples", console)
        write_json(settings.out / "settings.json", plain_settings(settings))
        if settings.estimators == "all":
            written += [fit_bank(samples, labels, settings, console) for labels in LABELS if _has(samples, labels)]
        wait_for_all()
    else:
        console = Terminal(quiet=True)
        wait_for_all()
        samples = read_samples(settings.out / "samples", settings.source)
    training = VotesTraining(
        settings.minutes, settings.learning_rate, start=settings.start, points_only=settings.points_only,
        bfloat16=settings.bfloat16,
    )  # fmt: skip
    samples = append_parts(samples, [read_samples(folder, PoseSampleSettings(views=())) for folder in settings.earlier])
    written.append(train_votes(samples, training, settings.source.seed, settings.out, console))
    return written


def _has(samples: CollectedSamples, labels: Labels) -> bool:
    return bool(samples.parts[labels].any())


def fit_bank(samples: CollectedSamples, labels: Labels, settings: PoseTraining, console: Console) -> Path:
    """One ridge regressor per number of views, as ridge_network.npz or ridge_true.npz."""
    models = []
    for count in settings.source.views:
        features, joints, groups = samples.features[labels, count]
        if len(features) < FEWEST_SAMPLES:
            raise InputError(
                f"{len(features)} samples with {count} views are too few to fit a regressor, which needs "
                f"{FEWEST_SAMPLES}: give more --samples or fewer --views"
            )
        frame = settings.source.frame
        model = fit_ridge(
            features, joints, groups, frame=frame, views=count, labels=labels,
            clip=CLIP if labels == "network" and frame != "world" else np.inf,
        )  # fmt: skip
        error = np.linalg.norm(model.predict(features) - joints, axis=-1).mean() * 100
        console.print(f"ridge, {labels} labels, {count} views: {len(features)} samples, strength {model.strength:g}, "
                      f"fit {error:.2f} cm")  # fmt: skip
        models.append(model)
    path = settings.out / f"ridge_{labels}.npz"
    RidgeBank(tuple(models)).save(path)
    return path
