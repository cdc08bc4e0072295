"""Joint errors in centimetres, and the accuracy of body-part labels, as the paper reports them (Sec. 5)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Integer
from numpy import ndarray

from depthmocap.body.regions import MIRROR, REGION_COUNT
from depthmocap.body.skeleton import JOINTS
from depthmocap.errors import InputError
from depthmocap.frames import expected_error_m

#: Thresholds (cm) of the precision curve.
CURVE_THRESHOLDS_CM: tuple[int, ...] = tuple(range(31))
#: Number of bins of the confidence, in which it is compared with the joints' errors.
CONFIDENCE_BINS = 10


def joint_errors_cm(estimates: Float[ndarray, "t j 3"], truths: Float[ndarray, "t j 3"]) -> Float[ndarray, "t j"]:
    """Distances (cm) between estimated and true joints (m) of the same frame and name; NaN where either is NaN."""
    return np.linalg.norm(estimates.astype(np.float64) - truths, axis=-1) * 100


@dataclasses.dataclass(frozen=True)
class JointMetrics:
    """Joint errors over frames.

    Means and deviations are over the joints that have both an estimate and ground truth. The shares (0–1) are of the
    joints with ground truth: a joint without an estimate is a miss. A number without any joints is NaN.
    """

    frames: int
    #: Joints with ground truth, over all frames.
    observed: int
    #: Those of them without an estimate.
    missing: int
    mean_joint_error_cm: float
    deviation_cm: float
    #: By joint name.
    per_joint_error_cm: dict[str, float]
    per_joint_deviation_cm: dict[str, float]
    per_joint_within_10cm: dict[str, float]
    within_10cm: float
    #: Share within each of CURVE_THRESHOLDS_CM.
    curve: tuple[float, ...]

    @property
    def mean_ap_10cm(self) -> float:
        """Mean over the joint names of the share within 10 cm: each name has the same weight."""
        shares = np.array(list(self.per_joint_within_10cm.values()))
        return float(shares[~np.isnan(shares)].mean()) if (~np.isnan(shares)).any() else float("nan")


def joint_metrics(
    estimates: Float[ndarray, "t j 3"], truths: Float[ndarray, "t j 3"], joints: Sequence[str] = JOINTS
) -> JointMetrics:
    """Metrics of estimated joints (m, NaN where missing) against true ones (m, NaN where unknown).

    Args:
        joints: their names.
    """
    errors_cm = joint_errors_cm(estimates, truths)
    observed = np.asarray(~np.isnan(truths).any(-1))
    missing = observed & np.isnan(errors_cm)

    def share_within(threshold_cm: int, which: int | slice = slice(None)) -> float:
        of = observed[:, which].sum()
        return float((errors_cm[:, which] <= threshold_cm).sum() / of) if of else float("nan")

    def mean_and_deviation(values: Float[ndarray, "*n"]) -> tuple[float, float]:
        values = values[~np.isnan(values)]
        return (float(values.mean()), float(values.std())) if values.size else (float("nan"), float("nan"))

    mean, deviation = mean_and_deviation(errors_cm)
    by_joint = {joint: mean_and_deviation(errors_cm[:, i]) for i, joint in enumerate(joints)}
    return JointMetrics(
        frames=len(errors_cm),
        observed=int(observed.sum()),
        missing=int(missing.sum()),
        mean_joint_error_cm=mean,
        deviation_cm=deviation,
        per_joint_error_cm={joint: numbers[0] for joint, numbers in by_joint.items()},
        per_joint_deviation_cm={joint: numbers[1] for joint, numbers in by_joint.items()},
        per_joint_within_10cm={joint: share_within(10, i) for i, joint in enumerate(joints)},
        within_10cm=share_within(10),
        curve=tuple(share_within(threshold) for threshold in CURVE_THRESHOLDS_CM),
    )


@dataclasses.dataclass(frozen=True)
class Reliability:
    """Confidence against errors: joints in bins of confidence, the lowest first, without empty bins.

    Attributes:
        confidence: mean confidence of each bin.
        within_10cm: share (0–1) of the bin's joints within 10 cm of the truth; a calibrated confidence equals it.
        beyond_20cm: share (0–1) of the bin's joints farther than 20 cm from the truth.
        joints: number of joints in the bin.
        error_cm: mean error of the bin's joints.
        expected_error_cm: the mean of what their confidences say of it (:func:`~depthmocap.frames.expected_error_m`).
        calibration_error: mean difference between confidence and ``within_10cm`` over all joints; NaN without joints.
    """

    confidence: tuple[float, ...]
    within_10cm: tuple[float, ...]
    beyond_20cm: tuple[float, ...]
    joints: tuple[int, ...]
    error_cm: tuple[float, ...]
    expected_error_cm: tuple[float, ...]
    calibration_error: float


def reliability(confidence: Float[ndarray, "t j"], errors_cm: Float[ndarray, "t j"]) -> Reliability:
    """The reliability of the joints that have a confidence and an error; both are NaN where unknown."""
    known = ~(np.isnan(confidence) | np.isnan(errors_cm))
    confidence, errors_cm = confidence[known].astype(np.float64), errors_cm[known]
    bins = np.minimum((confidence * CONFIDENCE_BINS).astype(np.int64), CONFIDENCE_BINS - 1)
    count = np.bincount(bins, minlength=CONFIDENCE_BINS)
    filled = count > 0
    means, near, far, errors, expected = (
        np.bincount(bins, values, CONFIDENCE_BINS)[filled] / count[filled]
        for values in (confidence, errors_cm <= 10, errors_cm > 20, errors_cm, 100 * expected_error_m(confidence))
    )
    error = float((np.abs(means - near) * count[filled]).sum() / count.sum()) if filled.any() else float("nan")
    means, near, far, errors, expected = (tuple(values.tolist()) for values in (means, near, far, errors, expected))
    return Reliability(means, near, far, tuple(count[filled].tolist()), errors, expected, error)


def joint_numbers(metrics: JointMetrics, confidence: Reliability | None = None) -> dict[str, Any]:
    """The joint metrics of every evaluation's JSON file, by key."""
    numbers: dict[str, Any] = {
        "mean_joint_error_cm": metrics.mean_joint_error_cm,
        "deviation_cm": metrics.deviation_cm,
        "within_10cm": metrics.within_10cm,
        "mean_ap_10cm": metrics.mean_ap_10cm,
        "per_joint_error_cm": metrics.per_joint_error_cm,
        "per_joint_deviation_cm": metrics.per_joint_deviation_cm,
        "per_joint_within_10cm": metrics.per_joint_within_10cm,
        "curve": list(metrics.curve),
        "joints_observed": metrics.observed,
        "joints_missing": metrics.missing,
    }
    if confidence is not None:
        numbers["reliability"] = dataclasses.asdict(confidence)
    return numbers


def _empty_confusion() -> Int[ndarray, "44 44"]:
    return np.zeros((REGION_COUNT + 1, REGION_COUNT + 1), dtype=np.int64)


@dataclasses.dataclass(eq=False)
class PixelAccuracy:
    """Counts of predicted against true regions, over the pixels whose true region is 1–43.

    Pixels of true background (0) and unlabelled pixels (255) are left out. Background predicted on the person is an
    error. A number without any pixels is NaN.
    """

    #: Pixels by true (row) and predicted (column) region.
    confusion: Int[ndarray, "44 44"] = dataclasses.field(default_factory=_empty_confusion)

    def add(self, labels_true: Integer[ndarray, "*n"], labels_predicted: Integer[ndarray, "*n"]) -> None:
        """Count the pixels of an image or a batch, of any shape.

        Raises:
            InputError: when a counted pixel's prediction is not a region 0–43.
        """
        counted = (labels_true >= 1) & (labels_true <= REGION_COUNT)
        true, predicted = labels_true[counted].astype(np.int64), labels_predicted[counted].astype(np.int64)
        classes = REGION_COUNT + 1
        if ((predicted < 0) | (predicted >= classes)).any():
            raise InputError(f"predicted labels must be 0–{REGION_COUNT}, got {predicted.min()} to {predicted.max()}")
        self.confusion += np.bincount(true * classes + predicted, minlength=classes**2).reshape(classes, classes)

    @property
    def pixels(self) -> int:
        """Number of pixels counted."""
        return int(self.confusion.sum())

    @property
    def pixel_accuracy(self) -> float:
        """Share (0–1) of the pixels whose predicted region is the true one."""
        return float(np.trace(self.confusion) / self.pixels) if self.pixels else float("nan")

    @property
    def per_class_accuracy(self) -> Float[ndarray, " 43"]:
        """Recall (0–1) of regions 1–43, each pooled over all pixels; NaN where the region does not occur."""
        totals = self.confusion.sum(1)[1:]
        return np.divide(np.diagonal(self.confusion)[1:], totals, out=np.full(REGION_COUNT, np.nan), where=totals > 0)

    @property
    def class_accuracy(self) -> float:
        """Mean recall (0–1) over the regions that occur."""
        return float(np.nanmean(self.per_class_accuracy)) if self.pixels else float("nan")

    @property
    def side_swap(self) -> float:
        """Share (0–1) of the pixels whose predicted region is the mirror image of the true one (left for right)."""
        if not self.pixels:
            return float("nan")
        regions = np.arange(REGION_COUNT + 1)
        sided = regions[regions != MIRROR]
        return float(self.confusion[sided, MIRROR[sided]].sum() / self.pixels)
