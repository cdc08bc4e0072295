"""Events and strides of a walk whose numbers are known; gaps stay gaps."""

from __future__ import annotations

import numpy as np
import pytest
from even_walk import FPS, STEP_M, STEP_S, SWING_S, WIDTH_M, landings, walk

from depthmocap.analysis.gait_events import swings
from depthmocap.analysis.measures import Trial, measure, movement
from depthmocap.analysis.steady_joints import SteadyJoints, steady_joints
from depthmocap.analysis.strides import asymmetry, strides
from depthmocap.body.landmarks import POINTS
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.exporting.timeline import Y_UP_FROM_Z_UP, Timeline

STEPS = 7


def steady(joints: np.ndarray, fill_s: float = 0.1, cutoff_hz: float = 6.0) -> SteadyJoints:
    line = Timeline(np.arange(len(joints)) / FPS, joints @ Y_UP_FROM_Z_UP.T, 1 / FPS)
    return steady_joints(line, cutoff_hz, fill_s)


@pytest.mark.parametrize("heading_rad", [0.0, 2.0])
def test_a_walk_is_measured(heading_rad: float) -> None:
    found = swings(steady(walk(STEPS, heading_rad) + np.random.default_rng(0).normal(0, 0.003, (1, 18, 3))))
    assert [swing.side[0].upper() for swing in found] == [side for side, _ in landings(STEPS)]
    for swing, (_, landing_s) in zip(found, landings(STEPS), strict=True):
        # Feet that start and stop gently have gone and come to rest a little inside their swing.
        assert swing.heel_strike_s == pytest.approx(landing_s - 0.06, abs=0.04)
        assert swing.toe_off_s == pytest.approx(landing_s - SWING_S + 0.08, abs=0.04)
    middle = strides(found)[1:-1]
    assert len(middle) == STEPS - 4
    for stride in middle:
        assert stride.values["stride_length"] == pytest.approx(2 * STEP_M, abs=0.005)
        assert stride.values["step_length"] == pytest.approx(STEP_M, abs=0.005)
        assert stride.values["stride_time"] == pytest.approx(2 * STEP_S, abs=0.01)
        assert stride.values["step_width"] == pytest.approx(WIDTH_M, abs=0.005)
        assert stride.values["walking_speed"] == pytest.approx(STEP_M / STEP_S, abs=0.02)
        assert stride.values["cadence"] == pytest.approx(60 / STEP_S, abs=1.5)
        assert stride.values["stance"] + stride.values["swing"] == pytest.approx(100)
        assert 25 < stride.values["double_support"] < 60


def test_toes_that_are_seen_tell_when_they_leave() -> None:
    joints = walk(STEPS) @ Y_UP_FROM_Z_UP.T
    times_s = np.arange(len(joints)) / FPS
    beside = np.full((len(joints), len(POINTS), 3), np.nan)
    before = swings(steady_joints(Timeline(times_s, joints, 1 / FPS, beside), 6.0, 0.1))  # as without toes
    # Toes that go as the ankle did 0.1 s ago.
    later = np.clip(np.arange(len(joints)) - round(0.1 * FPS), 0, None)
    for side in "RL":
        ankle = joints[:, JOINT_INDEX[f"{side}Foot"]]
        beside[:, POINTS.index(f"{side}Toe")] = ankle[later] - ankle + [0.0, -0.05, 0.15]
    late = swings(steady_joints(Timeline(times_s, joints, 1 / FPS, beside), 6.0, 0.1))
    assert [swing.heel_strike_s for swing in late] == [swing.heel_strike_s for swing in before]
    assert 0.03 < np.mean([swing.toe_off_s for swing in late]) - np.mean([swing.toe_off_s for swing in before]) < 0.1
    # Toes that are lost on the way tell nothing.
    beside[:: round(0.3 * FPS)] = np.nan
    lost = swings(steady_joints(Timeline(times_s, joints, 1 / FPS, beside), 6.0, 0.0))
    assert [swing.toe_off_s for swing in lost] == pytest.approx([swing.toe_off_s for swing in before], abs=0.15)


def test_what_is_not_seen_is_not_measured() -> None:
    joints = walk(STEPS)
    hidden = joints.copy()
    _, landing_s = landings(STEPS)[3]  # of the right foot
    around = slice(round((landing_s - 0.3) * FPS), round((landing_s + 0.1) * FPS))
    hidden[around, JOINT_INDEX["RFoot"]] = np.nan
    whole, part = swings(steady(joints)), swings(steady(hidden))
    assert len(part) == len(whole) - 1
    assert not [each for each in part if each.side == "right" and abs(each.heel_strike_s - landing_s) < 0.3]
    # No stride of either foot goes over the hidden step.
    assert not [each for each in strides(part) if each.start_s < landing_s < each.end_s and each.side == "left"]
    angles = movement(steady(hidden)).angles
    assert np.isnan(angles["knee_flexion_right"][around]).all()
    assert not np.isnan(angles["knee_flexion_left"]).any()
    # A short gap is filled, where it may be.
    short = joints.copy()
    short[round((landing_s - 0.2) * FPS), JOINT_INDEX["RFoot"]] = np.nan
    assert len(swings(steady(short))) == len(whole)
    assert len(swings(steady(short, fill_s=0.0))) < len(whole)


def test_standing_is_no_walking() -> None:
    joints = np.repeat(walk(2)[:1], 90, axis=0)
    joints += np.random.default_rng(1).normal(0, 0.01, joints.shape)
    assert swings(steady(joints)) == []
    names = {each.quantity for each in measure(movement(steady(joints)), Trial("all", -np.inf, np.inf))}
    assert "stride_length" not in names and "knee_flexion" in names


def test_asymmetry_names_the_larger_side() -> None:
    assert asymmetry(0.5, 0.6) == pytest.approx(18.18, abs=0.01)
    assert asymmetry(0.6, 0.5) < 0


def test_low_frame_rates_are_not_filtered() -> None:
    joints = walk(3)[::6]
    line = Timeline(np.arange(len(joints)) / 5.0, joints @ Y_UP_FROM_Z_UP.T, 0.2)
    np.testing.assert_allclose(steady_joints(line, 6.0, 0.0).joints, line.joints_y_up, atol=1e-9)


def test_lost_frames_are_gaps() -> None:
    joints = walk(3)
    kept = np.r_[0:20, 40 : len(joints)]
    line = Timeline(kept / FPS, joints[kept] @ Y_UP_FROM_Z_UP.T, 1 / FPS)
    found = steady_joints(line, 0.0, 0.1)
    assert len(found.times_s) == len(joints)
    assert np.isnan(found.joints[20:40]).all() and not np.isnan(found.joints[40:]).any()


def test_a_pause_of_years_is_refused_in_one_line() -> None:
    joints = walk(3)
    line = Timeline(np.r_[np.arange(len(joints) - 1) / FPS, 1e9], joints, 1 / FPS)
    with pytest.raises(InputError, match=r"pauses for 9999999\d\d s after frame"):
        steady_joints(line, 0.0, 0.1)
