"""Accuracy on labelled frames (paper, Sec. V-A): pixels with the right label, and joint errors."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray
from rich.console import Console
from rich.table import Table

from depthmocap.body.regions import REGION_NAMES, UNLABELLED
from depthmocap.classify.classifier import Classifier
from depthmocap.core.network_devices import NetworkSettings, networks_on
from depthmocap.errors import InputError
from depthmocap.evaluate.evaluation_report import Outputs
from depthmocap.evaluate.facing import facing_numbers
from depthmocap.frames import FrameSet, View
from depthmocap.pose.cloud import merge_views
from depthmocap.pose.estimators import JointEstimator, load_estimator
from depthmocap.pose.labelled_view import LabelledView
from depthmocap.pose.labelled_view import Labels as Labels
from depthmocap.report.metrics import (
    CONFIDENCE_BINS,
    PixelAccuracy,
    joint_errors_cm,
    joint_metrics,
    joint_numbers,
    reliability,
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class AccuracyEvaluation(NetworkSettings, Outputs):
    """What the protocols on labelled data have in common.

    Attributes:
        labels: "network" runs the classifier; "true" gives the pose stage the true labels, its floor.
        weights: a classifier.onnx of your own.
        estimator: of the joints: votes, ridge (the paper's), or a file that ``train pose`` wrote.
    """

    labels: Labels = "network"
    weights: Path | None = None
    estimator: str = "votes"

    def load(self) -> tuple[JointEstimator, Classifier | None]:
        """The estimator, and the network unless the true labels are taken.

        Raises:
            InputError: when a file is missing or not such a model.
        """
        with networks_on(self.device):
            classifier = Classifier(self.weights) if self.labels == "network" else None
            return load_estimator(self.estimator, self.labels), classifier


def check_views(views: int) -> None:
    """Raise InputError unless the number of views is at least 1."""
    if views < 1:
        raise InputError(f"--views must be at least 1, got {views}")


class _Accuracy:
    """Counts over frames: pixels by true and predicted label, joints, confidences and times."""

    def __init__(self, views: int, estimator: JointEstimator, classifier: Classifier | None) -> None:
        self._views, self._estimator, self._classifier = views, estimator, classifier
        self.window, self.image = PixelAccuracy(), PixelAccuracy()
        self.samples = self.most_views = 0
        self.estimates: list[ndarray] = []
        self.truths: list[ndarray] = []
        self.confidences: list[ndarray] = []
        self.eyes: list[ndarray] = []
        self.spent_ms: list[float] = []
        #: Of the true joints, so that results on the same frames can be recognised.
        self.digest = hashlib.sha256()

    def add(self, frames: FrameSet) -> None:
        """Label and estimate one frame set; without labels, masks or joints it only counts as a sample."""
        self.samples += 1
        views = [view for view in frames.views if view.mask is not None and view.labels is not None]
        if not views or frames.true_joints is None:
            return
        self.most_views = max(self.most_views, len(views))
        self.digest.update(np.nan_to_num(np.round(frames.true_joints * 1e4)).astype("<i4").tobytes())
        start = time.perf_counter()
        labelled = list(self._label(views))
        labelled_ms = (time.perf_counter() - start) * 1e3
        for chosen in itertools.combinations(labelled, min(self._views, len(labelled))):
            start = time.perf_counter()
            joints, confidence = self._estimator(merge_views(list(chosen)), "z")
            self.spent_ms.append((time.perf_counter() - start) * 1e3 + labelled_ms * len(chosen) / len(labelled))
            self.estimates.append(joints)
            self.confidences.append(confidence)
            self.truths.append(frames.true_joints)
            self.eyes.append(chosen[0].view.camera.world_from_camera[:3, 3])
        for view, labels, *_ in labelled:
            if view.labels is not None and view.mask is not None:
                self.image.add(view.labels[view.mask], labels[view.mask])

    def _label(self, views: list[View]) -> Iterator[LabelledView]:
        """The views with the network's labels, which are counted in its windows; or with the true labels."""
        if self._classifier is None:
            yield from (LabelledView(view, view.labels) for view in views if view.labels is not None)
            return
        masks = [view.depth_m > 0 if view.mask is None else view.mask for view in views]
        for view, mask, result in zip(views, masks, self._classifier.label_masks(views, masks), strict=True):
            yield LabelledView(view, *result.prediction)
            if result.window is None or result.window_prediction is None or view.labels is None:
                continue
            truth = result.window.labels_from_image(view.labels, UNLABELLED)
            # All pixels of the person count. Those that the window leaves out as stray have no label, which is wrong.
            inside = result.window.labels_from_image((mask & (view.depth_m > 0)).astype(np.uint8)) > 0
            self.window.add(truth[inside], result.window_prediction.labels[inside])

    def numbers(self) -> dict[str, Any]:
        """All numbers, with the keys of the JSON file."""
        pixels = self.image if self._classifier is None else self.window
        estimates, truths = np.stack(self.estimates), np.stack(self.truths)
        confidences = np.stack(self.confidences).astype(np.float64)
        calibration = reliability(confidences, joint_errors_cm(estimates, truths))
        return {
            "labels": "true" if self._classifier is None else "network", "views": self._views, "frames": self.samples,
            "true_joints": self.digest.hexdigest(),
            "pixel_accuracy": pixels.pixel_accuracy,
            "class_accuracy": pixels.class_accuracy,
            "per_class_accuracy": [None if np.isnan(x) else float(x) for x in pixels.per_class_accuracy],
            "side_swap": pixels.side_swap,
            "image_pixel_accuracy": self.image.pixel_accuracy,
            **joint_numbers(joint_metrics(estimates, truths), calibration),
            **facing_numbers(estimates, truths, confidences, np.stack(self.eyes) if self._views == 1 else None),
            "ms_per_frame": float(np.median(self.spent_ms)),
        }  # fmt: skip


def measure_accuracy(
    frames: Iterable[FrameSet], views: int, estimator: JointEstimator, classifier: Classifier | None
) -> dict[str, Any] | None:
    """Accuracy over frames that have true labels, masks and joints; None where no frame has them.

    Frames are independent, nothing is smoothed. With a classifier, pixels are counted in the network's windows. With
    ``classifier=None`` the pose stage gets the true labels (the floor of its error), and pixels are counted at the
    resolution of the image.

    Args:
        views: 1 evaluates each camera alone and averages, 2 each pair, and so on. A sample with fewer views is
            evaluated with all of them.

    Raises:
        InputError: when no sample has so many views.
    """
    accuracy = _Accuracy(views, estimator, classifier)
    for frame_set in frames:
        accuracy.add(frame_set)
    if not accuracy.estimates:
        return None
    if accuracy.most_views < views:
        raise InputError(f"no sample has {views} views: the data have labels of {accuracy.most_views} cameras")
    return accuracy.numbers()


def _confident_joints(reliability: dict[str, Any]) -> dict[str, str]:
    """Share of the joints in the highest bin of confidence, and share of those within 10 cm."""
    joints = reliability["joints"]
    if not joints or reliability["confidence"][-1] < 1 - 1 / CONFIDENCE_BINS:
        return {"confidence 0.9 or more": "none"}
    share = joints[-1] / sum(joints)
    return {"confidence 0.9 or more (within 10 cm)": f"{share:.1%} ({reliability['within_10cm'][-1]:.1%})"}


def _expected_error(reliability: dict[str, Any]) -> str:
    """The mean of what the confidences say of the errors."""
    if not reliability["joints"]:
        return "–"
    return f"{np.average(reliability['expected_error_cm'], weights=reliability['joints']):.2f} cm"


def _by_heading(numbers: dict[str, Any]) -> dict[str, str]:
    shares = numbers.get("turned_round_by_heading")
    if shares is None:
        return {}
    return {"… by eighths from facing it": " ".join("–" if share is None else f"{share:.0%}" for share in shares)}


def print_numbers(title: str, numbers: dict[str, Any], console: Console) -> None:
    """The numbers of :func:`measure_accuracy` as a table."""
    table = Table(title=f"{title}, {numbers['views']} views, {numbers['labels']} labels")
    table.add_column("measure")
    table.add_column("value", justify="right")
    rows = {
        "samples": str(numbers["frames"]),
        "pixel accuracy": f"{numbers['pixel_accuracy']:.1%}",
        "mean class accuracy": f"{numbers['class_accuracy']:.1%}",
        "pixels on the other side": f"{numbers['side_swap']:.2%}",
        "mean joint error": f"{numbers['mean_joint_error_cm']:.2f} cm",
        "expected by the confidences": _expected_error(numbers["reliability"]),
        "within 10 cm": f"{numbers['within_10cm']:.1%}",
        **_confident_joints(numbers["reliability"]),
        "turned round (surely)": f"{numbers['turned_round']:.1%} ({numbers['turned_round_surely']:.1%})",
        **_by_heading(numbers),
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
