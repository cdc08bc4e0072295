"""What every evaluation on labelled frames measures (paper, Sec. V-A): pixels labelled right, and joint errors."""

from __future__ import annotations

import hashlib
import itertools
import time
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy import ndarray
from rich.console import Console
from rich.table import Table

from depthmocap.body.regions import REGION_NAMES, UNLABELLED
from depthmocap.classify.classifier import Classifier
from depthmocap.errors import InputError
from depthmocap.evaluate.facing import facing_numbers
from depthmocap.frames import FrameSet, View
from depthmocap.pose.cloud import merge_views
from depthmocap.pose.estimators import JointEstimator
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


def _network_labels(classifier: Classifier, views: list[View], accuracy: PixelAccuracy) -> Iterator[LabelledView]:
    """Views with the network's labels and probabilities; counts its labels in the windows on the way."""
    masks = [view.depth_m > 0 if view.mask is None else view.mask for view in views]
    for view, mask, found in zip(views, masks, classifier.label_masks(views, masks), strict=True):
        yield LabelledView(view, *found.found)
        if found.window is None or found.in_window is None or view.labels is None:
            continue
        truth = found.window.labels_from_image(view.labels, UNLABELLED)
        # All of the person counts, also what the window leaves out as stray: it goes without a label, which is wrong.
        inside = found.window.labels_from_image((mask & (view.depth_m > 0)).astype(np.uint8)) > 0
        accuracy.add(truth[inside], found.in_window.labels[inside])


def check_views(views: int) -> None:
    """Raise InputError unless so many views can be looked at together."""
    if views < 1:
        raise InputError(f"--views must be at least 1, got {views}")


def measure(
    frames: Iterable[FrameSet], views: int, estimator: JointEstimator, classifier: Classifier | None
) -> dict[str, Any] | None:
    """Accuracy over frames that carry true labels, masks and joints; None where none does.

    Frames are independent, nothing is smoothed. Pixels count in the network's windows, or with ``classifier=None``
    (true labels go to the pose stage, its floor) at the picture's own resolution.

    Args:
        views: 1 evaluates every camera alone and averages, 2 every pair, and so on. A sample that lacks some of them
            is evaluated with those it has.

    Raises:
        InputError: when no sample has so many views.
    """
    window_accuracy, image_accuracy = PixelAccuracy(), PixelAccuracy()
    estimates: list[ndarray] = []
    truths: list[ndarray] = []
    confidences: list[ndarray] = []
    eyes: list[ndarray] = []
    spent_ms: list[float] = []
    samples = most = 0
    digest = hashlib.sha256()  # of what is measured against, so that results of the same frames are known
    for frame in frames:
        samples += 1
        seen = [view for view in frame.views if view.mask is not None and view.labels is not None]
        if not seen or frame.true_joints is None:
            continue
        most = max(most, len(seen))
        digest.update(np.nan_to_num(np.round(frame.true_joints * 1e4)).astype("<i4").tobytes())
        start = time.perf_counter()
        parts: list[LabelledView]
        if classifier is None:
            parts = [LabelledView(view, view.labels) for view in seen if view.labels is not None]
        else:
            parts = list(_network_labels(classifier, seen, window_accuracy))
        labelled_ms = (time.perf_counter() - start) * 1e3
        for chosen in itertools.combinations(parts, min(views, len(parts))):
            start = time.perf_counter()
            joints, confidence = estimator(merge_views(list(chosen)), "z")
            spent_ms.append((time.perf_counter() - start) * 1e3 + labelled_ms * len(chosen) / len(parts))
            estimates.append(joints)
            confidences.append(confidence)
            truths.append(frame.true_joints)
            eyes.append(chosen[0].view.camera.world_from_camera[:3, 3])
        for view, labels, _, _ in parts:
            if view.labels is not None and view.mask is not None:
                image_accuracy.add(view.labels[view.mask], labels[view.mask])
    if not estimates:
        return None
    if most < views:
        raise InputError(f"no sample has {views} views: the data have labels of {most} cameras")
    pixels = image_accuracy if classifier is None else window_accuracy
    found, true = np.stack(estimates), np.stack(truths)
    sure = np.stack(confidences).astype(np.float64)
    calibration = reliability(sure, joint_errors_cm(found, true))
    return {
        "labels": "true" if classifier is None else "network", "views": views, "frames": samples,
        "true_joints": digest.hexdigest(),
        "pixel_accuracy": pixels.pixel_accuracy,
        "class_accuracy": pixels.class_accuracy,
        "per_class_accuracy": [None if np.isnan(x) else float(x) for x in pixels.per_class_accuracy],
        "side_swap": pixels.side_swap,
        "image_pixel_accuracy": image_accuracy.pixel_accuracy,
        **joint_numbers(joint_metrics(found, true), calibration),
        **facing_numbers(found, true, sure, np.stack(eyes) if views == 1 else None),
        "ms_per_frame": float(np.median(spent_ms)),
    }  # fmt: skip


def _told_surely(reliability: dict[str, Any]) -> dict[str, str]:
    """Joints of the highest bin of confidence: how many there are, and how many of those lie within 10 cm."""
    joints = reliability["joints"]
    if not joints or reliability["confidence"][-1] < 1 - 1 / CONFIDENCE_BINS:
        return {"told at 0.9 or more": "none"}
    share = joints[-1] / sum(joints)
    return {"told at 0.9 or more (within 10 cm)": f"{share:.1%} ({reliability['within_10cm'][-1]:.1%})"}


def _by_heading(numbers: dict[str, Any]) -> dict[str, str]:
    shares = numbers.get("turned_round_by_heading")
    if shares is None:
        return {}
    return {"… by eighths from facing it": " ".join("–" if share is None else f"{share:.0%}" for share in shares)}


def print_numbers(title: str, numbers: dict[str, Any], console: Console) -> None:
    """The numbers of :func:`measure` as a table."""
    table = Table(title=f"{title}, {numbers['views']} views, {numbers['labels']} labels")
    table.add_column("measure")
    table.add_column("value", justify="right")
    rows = {
        "samples": str(numbers["frames"]),
        "pixel accuracy": f"{numbers['pixel_accuracy']:.1%}",
        "mean class accuracy": f"{numbers['class_accuracy']:.1%}",
        "pixels on the other side": f"{numbers['side_swap']:.2%}",
        "mean joint error": f"{numbers['mean_joint_error_cm']:.2f} cm",
        "within 10 cm": f"{numbers['within_10cm']:.1%}",
        **_told_surely(numbers["reliability"]),
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
