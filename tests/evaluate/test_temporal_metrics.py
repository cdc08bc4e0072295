"""The numbers over time, where they are known in closed form."""

import numpy as np
import pytest

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS, MIRROR
from depthmocap.evaluate.temporal_metrics import (
    acceleration_errors,
    bone_deviations,
    exchanged_limbs,
    lag_frames,
    steps_at_rest,
    temporal_metrics,
)
from depthmocap.smooth.swap_guard import limb_joints

PERIOD = 1 / 30


def body():
    """A pose whose joints are all apart, sides 40 cm."""
    joints = np.zeros((len(JOINTS), 3))
    joints[:, 2] = 0.1 * np.minimum(np.arange(18), MIRROR)
    joints[:, 0] = [0.2 * np.sign(MIRROR[i] - i) for i in range(18)]
    return joints


def still(frames=60):
    return np.tile(body(), (frames, 1, 1))


def swaying(frames=90, late=0.0):
    joints = still(frames)
    joints[..., 1] += 0.3 * np.sin(2 * np.pi * 0.5 * (np.arange(frames) - late) * PERIOD)[:, None]
    return joints


def test_perfect_estimates_have_no_faults():
    found = temporal_metrics([swaying()], [swaying()], PERIOD)
    assert found.mean_joint_error_cm == found.acceleration_error_mm == found.flips_per_1000 == found.exchanged == 0
    assert found.lag_ms == pytest.approx(0, abs=0.3)
    assert found.bone_deviation_mm == pytest.approx(0, abs=1e-9)


def test_shaking_from_frame_to_frame():
    # ±2 mm along x in turn: 4 mm from frame to frame, a second difference of 8 mm.
    shaking = still()
    shaking[..., 0] += 0.002 * (-1.0) ** np.arange(60)[:, None]
    found = temporal_metrics([shaking], [still()], PERIOD)
    assert found.mean_joint_error_cm == pytest.approx(0.2)
    assert found.rest_jitter_mm == pytest.approx(4)
    assert found.acceleration_error_mm == pytest.approx(8)
    assert found.acceleration_error_mps2 == pytest.approx(0.008 * 900)
    assert found.foot_skate_cmps == pytest.approx(0.4 * 30)
    assert found.bone_deviation_mm == pytest.approx(0, abs=1e-9)


def test_a_constant_error_and_one_that_grows_evenly_have_no_acceleration():
    off = still() + np.arange(60)[:, None, None] * 0.01 + 0.3
    np.testing.assert_allclose(acceleration_errors(off, still()), 0, atol=1e-12)


def test_only_joints_at_rest_count_for_rest():
    truth = still()
    truth[30:, JOINT_INDEX["LHand"], 0] += 0.1 * np.arange(1, 31)
    steps = steps_at_rest(truth, truth, PERIOD)
    assert np.isnan(steps[29:, JOINT_INDEX["LHand"]]).all()
    assert (steps[:29] == 0).all()
    assert np.isfinite(steps).sum() == 59 * 18 - 30


def test_feet_that_slide():
    sliding = still()
    sliding[:, JOINT_INDEX["LFoot"], 1] += 0.01 * np.arange(60)
    assert temporal_metrics([sliding], [still()], PERIOD).foot_skate_cmps == pytest.approx((30 + 0) / 2)


def test_a_bone_that_breathes():
    breathing = still()
    breathing[:, JOINT_INDEX["Head"]] += np.array([0, 0, 0.01]) * (-1.0) ** np.arange(60)[:, None]
    deviations = bone_deviations(breathing)
    assert (deviations > 1e-6).sum() == 1
    bone = body()[JOINT_INDEX["Head"]] - body()[JOINT_INDEX["Neck"]]
    lengths = [np.linalg.norm(bone + np.array([0, 0, sign * 0.01])) for sign in (1, -1)]
    assert deviations.max() == pytest.approx(abs(lengths[0] - lengths[1]) / 2)


def test_flips_are_counted_by_limb():
    legs = np.where(limb_joints("legs"), MIRROR, np.arange(18))
    flipping = still(100)
    flipping[10:20] = flipping[10:20][:, legs]
    flipping[50] = flipping[50][MIRROR]
    wrong = exchanged_limbs(flipping, still(100))
    assert wrong[:, 0].sum() == 11 and wrong[:, 1].sum() == 1
    found = temporal_metrics([flipping], [still(100)], PERIOD)
    assert found.exchanged == pytest.approx(0.11)
    assert found.flips_per_1000 == pytest.approx(40)  # there and back, twice


@pytest.mark.parametrize("late", [-1.5, 0.0, 0.4, 1.0, 3.7])
def test_the_lag_is_found_between_frames(late):
    estimates = [swaying(90, late) + 0.05, swaying(120, late)]
    assert lag_frames(estimates, [swaying(90), swaying(120)]) == pytest.approx(late, abs=0.02)
    assert temporal_metrics(estimates, [swaying(90), swaying(120)], PERIOD).lag_ms == pytest.approx(
        late * PERIOD * 1e3, abs=0.7
    )


def test_gaps_do_not_count():
    estimate, truth = swaying(90, 1.0), swaying(90)
    estimate[20:30] = np.nan
    estimate[40:, 3] = np.nan
    found = temporal_metrics([estimate], [truth], PERIOD)
    assert found.lag_ms == pytest.approx(PERIOD * 1e3, abs=1)
    assert np.isfinite([found.mean_joint_error_cm, found.acceleration_error_mm, found.bone_deviation_mm]).all()


def test_nothing_to_measure_is_nan():
    found = temporal_metrics([np.full((5, 18, 3), np.nan)], [still(5)], PERIOD)
    assert np.isnan(found.mean_joint_error_cm) and np.isnan(found.lag_ms) and np.isnan(found.bone_deviation_mm)
    assert np.isnan(temporal_metrics([], [], PERIOD).exchanged)
