"""Cases whose numbers are known."""

from __future__ import annotations

import numpy as np
import pytest

from depthmocap.body.regions import REGION
from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.errors import InputError
from depthmocap.frames import Pose, expected_error_m
from depthmocap.report.metrics import CURVE_THRESHOLDS_CM, PixelAccuracy, joint_errors_cm, joint_metrics, reliability


def test_joint_errors_are_distances_in_cm() -> None:
    truths = np.zeros((2, 18, 3))
    estimates = truths.copy()
    estimates[1, 4] = [0.03, 0.04, 0]
    estimates[0, 2, 1] = np.nan
    truths[0, 3] = np.nan
    errors_cm = joint_errors_cm(estimates.astype(np.float32), truths.astype(np.float32))
    assert errors_cm[1, 4] == pytest.approx(5)
    assert np.isnan(errors_cm[0, [2, 3]]).all()
    assert np.isnan(errors_cm).sum() == 2 and np.nansum(errors_cm) == pytest.approx(5)


def test_joint_metrics() -> None:
    truths = np.zeros((4, 18, 3))
    estimates = truths.copy()
    head, hip = JOINT_INDEX["Head"], JOINT_INDEX["Hip"]
    estimates[:, head, 2] = [0.02, 0.04, 0.10, 0.20]
    estimates[0, hip] = np.nan  # not estimated: a miss
    truths[1, hip] = np.nan  # no truth: not counted
    metrics = joint_metrics(estimates, truths)
    assert (metrics.frames, metrics.observed, metrics.missing) == (4, 71, 1)
    assert metrics.per_joint_error_cm["Head"] == pytest.approx(9)
    assert metrics.per_joint_deviation_cm["Head"] == pytest.approx(np.std([2, 4, 10, 20]))
    assert metrics.mean_joint_error_cm == pytest.approx(36 / 70)
    assert metrics.within_10cm == pytest.approx(69 / 71)
    assert list(metrics.per_joint_error_cm) == list(JOINTS)
    assert len(metrics.curve) == len(CURVE_THRESHOLDS_CM) == 31
    assert metrics.curve[0] == pytest.approx(66 / 71)
    assert metrics.curve[3] == pytest.approx(67 / 71)
    assert metrics.curve[10] == metrics.within_10cm
    assert metrics.curve[30] == pytest.approx(70 / 71)
    assert list(metrics.curve) == sorted(metrics.curve)


@pytest.mark.parametrize("frames", [0, 2])
def test_joint_metrics_of_nothing(frames: int) -> None:
    nothing = np.full((frames, 18, 3), np.nan)
    metrics = joint_metrics(nothing, nothing)
    assert np.isnan([metrics.mean_joint_error_cm, metrics.within_10cm, *metrics.curve]).all()
    assert metrics.observed == metrics.missing == 0
    known = joint_metrics(np.full((2, 18, 3), np.nan), np.zeros((2, 18, 3)))
    assert known.within_10cm == 0 and known.missing == 36


def test_every_joint_counts_alike_in_the_mean_average_precision() -> None:
    truths = np.zeros((10, 3, 3))
    truths[1:, 2] = np.nan  # known once, and missed
    estimates = np.nan_to_num(truths)
    estimates[:, 2] = 1
    estimates[:5, 1] = 0.2
    metrics = joint_metrics(estimates, truths, ("a", "b", "c"))
    assert metrics.per_joint_within_10cm == {"a": 1.0, "b": 0.5, "c": 0.0}
    assert metrics.mean_ap_10cm == pytest.approx(0.5)
    assert metrics.within_10cm == pytest.approx(15 / 21)


def test_reliability_of_confidence() -> None:
    confidence = np.array([[0.9, 0.95, 0.92, 0.91], [0.2, 0.22, 1.0, np.nan]])
    errors_cm = np.array([[1.0, 2.0, 30.0, 9.0], [50.0, 60.0, np.nan, 1.0]])
    found = reliability(confidence, errors_cm)
    assert found.joints == (2, 4)
    assert found.confidence == pytest.approx((0.21, 0.92))
    assert found.within_10cm == pytest.approx((0.0, 0.75))
    assert found.calibration_error == pytest.approx((2 * 0.21 + 4 * 0.17) / 6)
    assert found.error_cm == pytest.approx((55.0, 10.5))
    by_curve = 100 * expected_error_m(confidence)  # whose numbers change with the networks
    assert found.expected_error_cm == pytest.approx((by_curve[1, :2].mean(), by_curve[0].mean()))
    assert np.isnan(reliability(confidence * np.nan, errors_cm).calibration_error)


def test_expected_errors_fall_with_confidence() -> None:
    confidence = np.linspace(0, 1, 200)
    errors = expected_error_m(confidence)
    assert (np.diff(errors) < 0).all()
    assert errors[-1] < 0.02 < 0.4 < errors[0]
    joints = np.zeros((18, 3))
    joints[3] = np.nan
    told = Pose(0, joints, np.full(18, 0.9)).expected_error_m
    assert np.isnan(told[3]) and told[4] == pytest.approx(expected_error_m(np.array([0.9]))[0])


def test_pixel_accuracy() -> None:
    chest_r, chest_l, nape, head = REGION["chest R"], REGION["chest L"], REGION["nape"], REGION["hair L"]
    true = np.array([[0, 255, chest_r, chest_r], [chest_r, chest_r, nape, head]], dtype=np.uint8)
    said = np.array([[5, 5, chest_r, chest_l], [chest_r, 0, nape, nape]], dtype=np.uint8)
    accuracy = PixelAccuracy()
    accuracy.add(true, said)
    assert accuracy.pixels == 6
    assert accuracy.pixel_accuracy == pytest.approx(3 / 6)
    assert accuracy.side_swap == pytest.approx(1 / 6)
    assert accuracy.per_class_accuracy[chest_r - 1] == pytest.approx(0.5)
    assert accuracy.per_class_accuracy[nape - 1] == 1 and accuracy.per_class_accuracy[head - 1] == 0
    assert np.isnan(accuracy.per_class_accuracy[chest_l - 1])
    assert accuracy.class_accuracy == pytest.approx((0.5 + 1 + 0) / 3)
    assert accuracy.confusion[chest_r, 0] == 1 and accuracy.confusion[0].sum() == 0


def test_pixel_accuracy_is_pooled_over_images() -> None:
    rng = np.random.default_rng(0)
    true, said = rng.integers(0, 44, (2, 5, 40), dtype=np.uint8)
    whole, parts = PixelAccuracy(), PixelAccuracy()
    whole.add(true, said)
    parts.add(true[:2], said[:2])
    parts.add(true[2:].astype(np.int64), said[2:].astype(np.int64))
    np.testing.assert_array_equal(parts.confusion, whole.confusion)
    assert parts.pixels == whole.pixels == (true > 0).sum()


def test_pixel_accuracy_of_nothing_and_of_bad_labels() -> None:
    accuracy = PixelAccuracy()
    assert np.isnan([accuracy.pixel_accuracy, accuracy.class_accuracy, accuracy.side_swap]).all()
    accuracy.add(np.array([255, 0]), np.array([255, -1]))  # not counted, so not looked at
    with pytest.raises(InputError, match="0–43"):
        accuracy.add(np.array([1, 2]), np.array([1, 44]))
