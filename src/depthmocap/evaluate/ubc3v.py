"""``depthmocap evaluate ubc3v``: the paper's synthetic evaluation (Sec. V-A), with true labels or the network's."""

from __future__ import annotations

import dataclasses
import itertools
import json
import time
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from numpy import ndarray
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from depthmocap.body.regions import REGION_NAMES
from depthmocap.classify.preprocess import make_window
from depthmocap.classify.runtime import Classifier
from depthmocap.datasets.ubc3v import UNLABELLED, iterate, sections
from depthmocap.errors import InputError
from depthmocap.evaluate.metrics import PixelAccuracy, joint_metrics
from depthmocap.frames import View
from depthmocap.pipeline import load_ridge
from depthmocap.pose.cloud import merge_views
from depthmocap.pose.estimate import estimate_joints
from depthmocap.pose.train import label_sample


@dataclasses.dataclass(frozen=True)
class Ubc3vEvaluation:
    """Accuracy of labels and joints on UBC3V, or on a set of the same layout.

    Attributes:
        root: holds hard-pose and its kin.
        json: file for all numbers.
        labels: "network" runs the classifier; "true" gives the pose stage the true labels, its floor.
        views: 1 evaluates every camera alone and averages, 2 every pair, 3 all.
        limit: evaluate the first so many samples only.
        weights: a classifier.onnx of your own.
        regressor: a ridge.npz of your own.
    """

    root: tyro.conf.Positional[Path]
    subset: str = "hard-pose"
    split: str = "test"
    json: Path | None = None
    labels: Literal["network", "true"] = "network"
    views: int = 3
    limit: int | None = None
    weights: Path | None = None
    regressor: Path | None = None


def _window_accuracy(classifier: Classifier, views: list[View], accuracy: PixelAccuracy) -> None:
    """Count the network's labels on the person's labelled pixels of its own windows."""
    pairs = [(view, make_window(view.depth_m, view.mask, view.camera)) for view in views if view.mask is not None]
    found = [(view, window) for view, window in pairs if window is not None and view.labels is not None]
    for (view, window), (labels, _) in zip(found, classifier.label_windows([w for _, w in found]), strict=True):
        assert view.labels is not None
        truth = window.labels_from_image(view.labels, UNLABELLED)
        # All of the person counts, also what the window leaves out as stray: it goes without a label, which is wrong.
        assert view.mask is not None
        inside = window.labels_from_image((view.mask & (view.depth_m > 0)).astype(np.uint8)) > 0
        accuracy.add(truth[inside], labels[inside])


def evaluate_ubc3v(settings: Ubc3vEvaluation, console: Console | None = None) -> dict[str, Any]:
    """Run the evaluation and return its numbers; samples are independent, nothing is smoothed.

    Raises:
        InputError: when the data or the weights cannot be read, or hold no labels.
    """
    console = console or Console(stderr=True)
    total = sum(1 for _ in sections(settings.root, settings.subset, settings.split))
    classifier = Classifier(settings.weights) if settings.labels == "network" else None
    regressor = load_ridge(settings.regressor, settings.labels)
    window_accuracy, image_accuracy = PixelAccuracy(), PixelAccuracy()
    estimates: list[ndarray] = []
    truths: list[ndarray] = []
    spent_ms: list[float] = []
    samples = 0
    with Progress(console=console) as progress:
        task = progress.add_task(f"{settings.subset}/{settings.split} ({total} sections)", total=settings.limit)
        for frame in iterate(settings.root, settings.subset, settings.split, settings.limit):
            samples += 1
            progress.advance(task)
            views = [view for view in frame.views if view.mask is not None and view.labels is not None]
            if not views or frame.true_joints is None:
                continue
            start = time.perf_counter()
            parts = label_sample(tuple(views), settings.labels, classifier)
            labelled_ms = (time.perf_counter() - start) * 1e3
            for chosen in itertools.combinations(parts, min(settings.views, len(parts))):
                start = time.perf_counter()
                joints, _ = estimate_joints(regressor, merge_views(list(chosen)), "z", len(chosen))
                spent_ms.append((time.perf_counter() - start) * 1e3 + labelled_ms * len(chosen) / len(parts))
                estimates.append(joints)
                truths.append(frame.true_joints)
            for view, labels, _ in parts:
                if view.labels is not None and view.mask is not None:
                    image_accuracy.add(view.labels[view.mask], labels[view.mask])
            if classifier is not None:
                _window_accuracy(classifier, views, window_accuracy)
    if not estimates:
        raise InputError(f"{settings.root}: no sample of {settings.subset}/{settings.split} has labels and joints")
    pixels = window_accuracy if classifier is not None else image_accuracy
    metrics = joint_metrics(np.stack(estimates), np.stack(truths))
    numbers: dict[str, Any] = {
        "data": str(settings.root), "subset": settings.subset, "split": settings.split, "labels": settings.labels,
        "views": settings.views, "frames": samples,
        "pixel_accuracy": pixels.pixel_accuracy,
        "class_accuracy": pixels.class_accuracy,
        "per_class_accuracy": [None if np.isnan(x) else float(x) for x in pixels.per_class_accuracy],
        "side_swap": pixels.side_swap,
        "image_pixel_accuracy": image_accuracy.pixel_accuracy,
        "mean_joint_error_cm": metrics.mean_joint_error_cm,
        "deviation_cm": metrics.deviation_cm,
        "within_10cm": metrics.within_10cm,
        "per_joint_error_cm": metrics.per_joint_error_cm,
        "per_joint_deviation_cm": metrics.per_joint_deviation_cm,
        "curve": list(metrics.curve),
        "joints_missing": metrics.missing,
        "ms_per_frame": float(np.median(spent_ms)),
    }  # fmt: skip
    if settings.json is not None:
        settings.json.parent.mkdir(parents=True, exist_ok=True)
        settings.json.write_text(json.dumps(numbers, indent=1) + "\n")
    _print(numbers, console)
    return numbers


def _print(numbers: dict[str, Any], console: Console) -> None:
    table = Table(title=f"{numbers['subset']}/{numbers['split']}, {numbers['views']} views, {numbers['labels']} labels")
    table.add_column("measure")
    table.add_column("value", justify="right")
    rows = {
        "samples": str(numbers["frames"]),
        "pixel accuracy": f"{numbers['pixel_accuracy']:.1%}",
        "mean class accuracy": f"{numbers['class_accuracy']:.1%}",
        "pixels on the other side": f"{numbers['side_swap']:.2%}",
        "mean joint error": f"{numbers['mean_joint_error_cm']:.2f} cm",
        "within 10 cm": f"{numbers['within_10cm']:.1%}",
        "time a sample (median)": f"{numbers['ms_per_frame']:.1f} ms",
    }
    for name, value in rows.items():
        table.add_row(name, value)
    console.print(table)
    worst = sorted(
        (accuracy, name) for accuracy, name in zip(numbers["per_class_accuracy"], REGION_NAMES[1:], strict=True)
        if accuracy is not None
    )  # fmt: skip
    console.print("weakest regions: " + ", ".join(f"{name} {accuracy:.0%}" for accuracy, name in worst[:5]))
    console.print("joints (cm): " + ", ".join(f"{k} {v:.1f}" for k, v in numbers["per_joint_error_cm"].items()))
