"""Training samples of the pose stage: what each camera sees of each region, and the true joints.

They are stored on disk, so that collecting, which is most of the work, can be stopped and resumed, and all estimators
learn from the same samples.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Generator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy import ndarray
from rich.console import Console
from rich.progress import Progress

from depthmocap.body.landmarks import LANDMARKS
from depthmocap.classify.classifier import Classifier
from depthmocap.core.output import atomic_write
from depthmocap.core.reading.array_files import ArrayType, error_reason, read_npz
from depthmocap.core.settings import check_seed, claim_folder
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.pose.cloud import merge_views
from depthmocap.pose.features import FEATURE_COUNT, FeatureFrame, cloud_features
from depthmocap.pose.labelled_view import LABELS, LabelledView, Labels, label_people
from depthmocap.pose.parts import PART_COLUMNS, PART_COUNT, part_statistics
from depthmocap.synth.sample import ANY_SENSOR, CameraRange, Recipe, Sample, Subset
from depthmocap.synth.writing.stream import stream
from depthmocap.train.windows import default_subset

#: Share of varied samples in which a part of the person is hidden.
_CUT = 0.3
#: Share of varied samples that all cameras see from overhead.
_FROM_OVERHEAD = 0.1
#: Camera positions of the other varied samples: nearer, higher and with more roll.
_PLACES = CameraRange(distance_m=(0.8, 4.5), height_m=(0.1, 3.0), roll_rad=0.1, truncated=0.08)
#: Samples per file.
_CHUNK = 100


@dataclasses.dataclass(frozen=True)
class PoseSampleSettings:
    """Settings of the samples.

    Attributes:
        data: "synth" makes samples; a folder is read as a UBC3V root (its <subset>-pose/train).
        weights: a classifier.onnx of your own.
        postures: folder of motion capture clips, or a pool made of them; without it the packaged prior.
        subset: who is in the samples: easy, inter, hard, or open (all builds); by default open bodies are made, and
            hard is read from a folder.
        views: numbers of cameras that the paper's features are made for; the largest is the number of a sample's.
        vary: recombine, perturb and tilt the postures, and cut people off; without, they are as recorded, which suits
            the ridge.
        frame: of the paper's features: world (the paper's), cloud (relative to its middle) or body (turned with it).
        workers: processes that make pictures; 0 makes them between the labelling.
    """

    data: str = "synth"
    weights: Path | None = None
    postures: Path | None = None
    subset: Subset | None = None
    samples: int = 6000
    views: tuple[int, ...] = (1, 2, 3, 4)
    vary: bool = True
    frame: FeatureFrame = "body"
    seed: int = 0
    workers: int = 1

    @property
    def people(self) -> Subset:
        """The subset, its default resolved."""
        return self.subset or default_subset(self.data)


@dataclasses.dataclass(frozen=True, eq=False)
class CollectedSamples:
    """Samples as arrays.

    Attributes:
        parts: by kind of labels, statistics of each part in each view (``parts.part_statistics``); 0 for the cameras
            that a sample lacks.
        joints: true joints in the world, metres.
        landmarks: true surface landmarks in the world, metres; NaN of recorded people, and of older files.
        groups: group (clip) of each posture.
        features: by kind of labels and number of cameras: the paper's features, the joints in the features' frame, and
            the groups.
    """

    parts: dict[Labels, Float32[ndarray, "n views 61 16"]]
    joints: Float[ndarray, "n 18 3"]
    landmarks: Float[ndarray, "n 58 3"]
    groups: Int[ndarray, "n"]
    features: dict[tuple[Labels, int], tuple[ndarray, ndarray, ndarray]]


def collect(settings: PoseSampleSettings, folder: Path, console: Console | None = None) -> CollectedSamples:
    """Make the samples, or what is missing of them in ``folder``, and read them all.

    Raises:
        InputError: when the folder holds samples of other settings, or labels or weights cannot be read.
    """
    check_seed(settings.seed)
    if not settings.views or min(settings.views) < 1 or settings.samples < 1:
        raise InputError("--samples and every number of --views must be at least 1")
    # Settings that do not change the samples may differ when collecting is resumed.
    claim_folder(folder, settings, "samples", ("samples", "workers"))

    files = [folder / f"{first:06d}.npz" for first in range(0, settings.samples, _CHUNK)]
    done = next((i for i, file in enumerate(files) if not file.exists()), len(files))
    if done < len(files):
        classifier = Classifier(settings.weights)
        rng_seed = [settings.seed, 7]
        with Progress(console=console) as progress, contextlib.closing(_samples(settings, done * _CHUNK)) as samples:
            task = progress.add_task("samples", total=settings.samples, completed=done * _CHUNK)
            for file in files[done:]:
                rows = []
                for sample in itertools.islice(samples, min(_CHUNK, settings.samples - int(file.stem))):
                    rng = np.random.default_rng([*rng_seed, int(file.stem), len(rows)])
                    rows.append(_measure(sample, settings, classifier, rng))
                    progress.advance(task)
                if rows:
                    with atomic_write(file) as unfinished:
                        np.savez(unfinished, **_stack(rows))  # pyright: ignore[reportArgumentType] - none is allow_pickle
    return _read([file for file in files if file.exists()], settings)


def read_samples(folder: Path, settings: PoseSampleSettings) -> CollectedSamples:
    """Read the collected samples of a folder; of the settings only the views matter.

    Raises:
        InputError: when the folder holds no samples, or none of so many views.
    """
    return _read(sorted(folder.glob("[0-9]*.npz")), settings)


def append_parts(samples: CollectedSamples, others: Sequence[CollectedSamples]) -> CollectedSamples:
    """Samples with the parts, joints and landmarks of others appended, for the voting network. The paper's features
    remain those of the first samples. Samples with fewer cameras are padded with cameras that see nothing."""
    collections = [samples, *others]
    views = max(part.parts[LABELS[0]].shape[1] for part in collections)

    def padded(parts: ndarray) -> ndarray:
        return np.pad(parts, ((0, 0), (0, views - parts.shape[1]), (0, 0), (0, 0)))

    return dataclasses.replace(
        samples,
        parts={labels: np.concatenate([padded(part.parts[labels]) for part in collections]) for labels in LABELS},
        joints=np.concatenate([part.joints for part in collections]),
        landmarks=np.concatenate([part.landmarks for part in collections]),
        groups=np.concatenate([part.groups for part in collections]),
    )


def _samples(settings: PoseSampleSettings, first: int) -> Generator[Sample, None, None]:
    if settings.data == "synth":
        recipe = Recipe(
            settings.people, "train", max(settings.views), settings.postures, vary=settings.vary,
            sensors=(ANY_SENSOR,), noise="random", cameras=CameraRange(roll_rad=0.03, truncated=0.05),
        )  # fmt: skip
        if settings.vary:
            recipe = dataclasses.replace(
                recipe, cut="any", cut_share=_CUT, cameras=_PLACES, overhead=_FROM_OVERHEAD
            )  # fmt: skip
        for _, sample in stream(recipe, settings.seed, first, settings.samples, settings.workers):
            yield sample
        return
    from depthmocap.datasets.ubc3v import iterate

    frames = iterate(Path(settings.data), f"{settings.people}-pose", "train", settings.samples)
    for index, frame in enumerate(frames):
        if index >= first and frame.true_joints is not None:
            # Blocks of ten neighbouring frames are one group of the cross-validation.
            yield Sample(frame.views, frame.true_joints, index // 10)


def label_sample(views: tuple[View, ...], classifier: Classifier | None) -> list[LabelledView] | None:
    """Views with the network's labels on the person's mask; without a network with the true labels, None where a view
    has none."""
    if classifier is not None:
        return label_people(views, classifier, "z")
    parts: list[LabelledView] = []
    for view in views:
        if view.labels is None:
            return None
        parts.append(LabelledView(view, view.labels))
    return parts


def _measure(
    sample: Sample, settings: PoseSampleSettings, classifier: Classifier, rng: np.random.Generator
) -> dict[str, ndarray]:
    row: dict[str, ndarray] = {"joints": sample.joints, "groups": np.array(sample.group)}
    unknown = np.full((len(LANDMARKS), 3), np.nan)
    row["landmarks"] = (unknown if sample.landmarks is None else sample.landmarks).astype(np.float32)
    chosen = {count: _choices(len(sample.views), count, rng) for count in settings.views}
    for labels in LABELS:
        views = label_sample(sample.views, classifier if labels == "network" else None)
        parts = np.zeros((max(settings.views), PART_COUNT, PART_COLUMNS), np.float32)
        if views is not None:
            statistics = part_statistics(merge_views(views))[: len(parts)]
            parts[: len(statistics)] = statistics
        row[f"parts {labels}"] = parts
        for count, choices in chosen.items():
            features = []
            for choice in choices:
                if views is None:
                    break
                feature = cloud_features(merge_views([views[i] for i in choice]), "z", settings.frame)
                if np.isfinite(feature.values).any():
                    features.append((feature.values, feature.from_world(sample.joints).astype(np.float32)))
            key = f"{labels} {count}"
            row[f"features {key}"] = np.array([f for f, _ in features], np.float32).reshape(-1, FEATURE_COUNT)
            row[f"targets {key}"] = np.array([t for _, t in features], np.float32).reshape(-1, 18, 3)
            row[f"members {key}"] = np.full(len(features), sample.group)
    return row


def _choices(available: int, count: int, rng: np.random.Generator) -> list[tuple[int, ...]]:
    """Up to two random combinations of ``count`` views, so that one sample teaches several placements."""
    if count > available:
        return []
    draws = {tuple(sorted(rng.choice(available, count, replace=False).tolist())) for _ in range(2)}
    return sorted(draws)


def _stacked(name: str) -> bool:
    """Whether a name's arrays have one row a sample; the others have any number."""
    return name.split()[0] in ("joints", "landmarks", "groups", "parts")


def _stack(rows: list[dict[str, ndarray]]) -> dict[str, ndarray]:
    join = {name: np.stack if _stacked(name) else np.concatenate for name in rows[0]}
    return {name: join[name]([row[name] for row in rows]) for name in rows[0]}


def _read(files: list[Path], settings: PoseSampleSettings) -> CollectedSamples:
    types = {"joints": ArrayType("n 18 3", "f"), "groups": ArrayType("n", "iu")}
    for labels in LABELS:
        types[f"parts {labels}"] = ArrayType(f"n v {PART_COUNT} {PART_COLUMNS}", "f")
        for count in settings.views:
            key = f"{labels} {count}"
            types[f"features {key}"] = ArrayType(f"{labels}{count} {FEATURE_COUNT}", "f")
            types[f"targets {key}"] = ArrayType(f"{labels}{count} 18 3", "f")
            types[f"members {key}"] = ArrayType(f"{labels}{count}", "iu")
    chunks = []
    for file in files:
        try:
            chunk = read_npz(file, types, optional={"landmarks": ArrayType(f"n {len(LANDMARKS)} 3", "f")})
            unknown = np.full((len(chunk["joints"]), len(LANDMARKS), 3), np.nan, np.float32)
            chunks.append({"landmarks": unknown, **chunk})
        except InputError as error:
            what = "remove it, and it is made again, or give the --views that it has"
            views = list(settings.views)
            raise InputError(f"{file} cannot be read for {views} views ({error_reason(error, file)}): {what}") from None
    if not chunks:
        raise InputError("no samples with joints: give a folder that train pose collected, or data that has joints")
    if len({chunk[f"parts {LABELS[0]}"].shape[1] for chunk in chunks}) > 1:
        raise InputError(f"{files[0].parent} holds samples of different numbers of cameras: collect them anew")
    arrays = {name: np.concatenate([chunk[name] for chunk in chunks]) for name in chunks[0]}
    return CollectedSamples(
        {labels: arrays[f"parts {labels}"] for labels in LABELS},
        arrays["joints"],
        arrays["landmarks"],
        arrays["groups"],
        {
            (labels, count): (
                arrays[f"features {labels} {count}"],
                arrays[f"targets {labels} {count}"],
                arrays[f"members {labels} {count}"],
            )
            for labels in LABELS
            for count in settings.views
        },
    )
