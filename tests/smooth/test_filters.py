"""The filters over time, on motion that is known."""

import dataclasses

import numpy as np
import pytest

from depthmocap.body.skeleton import JOINTS
from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.smooth.average import Average
from depthmocap.smooth.filters import FILTERS, load_filter
from depthmocap.smooth.fixed_lag import FixedLag, FixedLagSettings
from depthmocap.smooth.kalman import BRIDGED_CONFIDENCE, Kalman, KalmanSettings, State, transition
from depthmocap.smooth.one_euro import OneEuro, OneEuroSettings
from depthmocap.smooth.pose_filter import PoseFilter

FPS = 30
SURE = np.ones(len(JOINTS))
ALL = [Average, OneEuro, Kalman, FixedLag]


def stream(joints, times_s=None, confidence=SURE):
    times_s = np.arange(len(joints)) / FPS if times_s is None else times_s
    return [Pose(round(t * 1e9), frame, confidence) for t, frame in zip(times_s, joints, strict=True)]


def filtered(filter_: PoseFilter, poses):
    """Every pose's result, those of a filter that waits in their place."""
    return [filter_(pose) for pose in poses][filter_.delay_frames :] + filter_.finish()


def joints_of(poses):
    return np.stack([pose.joints for pose in poses])


def steady(speed, frames=60):
    """All joints along x at a speed (m/s)."""
    joints = np.zeros((frames, len(JOINTS), 3))
    joints[..., 0] = (speed * np.arange(frames) / FPS)[:, None]
    return joints


@pytest.mark.parametrize("make", ALL)
def test_a_still_body_stays_where_it_is(make):
    joints = np.random.default_rng(0).normal(size=(1, 18, 3)).repeat(20, axis=0)
    np.testing.assert_allclose(joints_of(filtered(make(), stream(joints))), joints, atol=1e-9)


@pytest.mark.parametrize("make", ALL)
def test_noise_at_rest_is_smoothed(make):
    noise = 0.01 * np.random.default_rng(1).normal(size=(90, 18, 3))
    result = joints_of(filtered(make(), stream(noise)))[30:]
    assert np.diff(result, axis=0).std() < 0.65 * np.diff(noise, axis=0).std()
    assert result.std() < 0.8 * noise.std()


@pytest.mark.parametrize("make", ALL)
def test_the_lag_is_what_is_stated(make):
    filter_, joints = make(), steady(1.0, 90)
    poses = [filter_(pose) for pose in stream(joints)]
    # Frames waited for, and metres behind at 1 m/s.
    waited_s = (89 / FPS) - poses[-1].timestamp_ns / 1e9
    behind_s = poses[-1].timestamp_ns / 1e9 - poses[-1].joints[:, 0].max()
    tolerance = 0.012 if make is OneEuro else 0.004  # the low pass of sampled time lags a little less
    assert waited_s + behind_s == pytest.approx(filter_.latency_s, abs=tolerance)


@pytest.mark.parametrize("make", ALL)
def test_gaps_stay_gaps_and_the_joint_comes_back_where_it_is(make):
    joints = steady(0.5)
    joints[20:50, 4] = np.nan
    joints[30:33] = np.nan
    confidence = SURE
    result = filtered(make(), stream(joints, confidence=confidence))
    np.testing.assert_array_equal(np.isnan(joints_of(result)), np.isnan(joints))
    # After a second away the joint starts where it is measured.
    np.testing.assert_allclose(result[50].joints[4], joints[50, 4], atol=0.01 if make is FixedLag else 1e-9)
    np.testing.assert_allclose(joints_of(result)[59], joints[59], atol=0.05)


@pytest.mark.parametrize("make", ALL)
def test_a_stream_that_begins_again_has_no_past(make):
    filter_ = make()
    alone = joints_of(filtered(make(), stream(steady(1.0, 20))))
    filtered(filter_, stream(steady(-1.0, 30)))
    np.testing.assert_array_equal(joints_of(filtered(filter_, stream(steady(1.0, 20)))), alone)
    # Without finish: a timestamp that goes back.
    for pose in stream(steady(-1.0, 30)):
        filter_(pose)
    np.testing.assert_array_equal(joints_of(filtered(filter_, stream(steady(1.0, 20)))), alone)


@pytest.mark.parametrize("make", ALL)
@pytest.mark.parametrize("frames", [1, 3, 12])
def test_every_pose_comes_back_once_with_its_own_time_and_confidence(make, frames):
    confidence = np.linspace(0.2, 1, 18)
    poses = stream(np.random.default_rng(2).normal(size=(frames, 18, 3)), confidence=confidence)
    result = filtered(make(), poses)
    assert [pose.timestamp_ns for pose in result] == [pose.timestamp_ns for pose in poses]
    np.testing.assert_array_equal(result[0].confidence, confidence)
    assert make().finish() == []


@pytest.mark.parametrize("make", [OneEuro, Kalman, FixedLag])
def test_irregular_times_of_steady_motion_leave_no_jerks(make):
    rng = np.random.default_rng(3)
    times_s = np.cumsum(rng.uniform(0.01, 0.06, 80))
    joints = np.zeros((80, 18, 3))
    joints[..., 0] = times_s[:, None]
    result = joints_of(filtered(make(), stream(joints, times_s)))
    behind = (times_s[:, None] - result[..., 0])[30:-5]
    assert np.ptp(behind) < 0.02


@pytest.mark.parametrize("make", [Kalman, FixedLag])
def test_one_wild_measurement_is_not_followed(make):
    joints = steady(0.3)
    spoilt = joints.copy()
    spoilt[40, 7] += 1.0
    off = np.linalg.norm(joints_of(filtered(make(), stream(spoilt))) - joints, axis=-1)
    assert off[40, 7] < 0.15
    assert off[50:].max() < 0.02
    np.testing.assert_allclose(off[:36, 7], off[:36, 6])


@pytest.mark.parametrize("make", [Kalman, FixedLag])
def test_a_joint_that_stays_elsewhere_is_believed(make):
    joints = np.zeros((60, 18, 3))
    joints[30:, 7] = [1.0, 0.0, 0.0]
    result = joints_of(filtered(make(), stream(joints)))[:, 7, 0]
    settings = KalmanSettings()
    # It is not followed at once, and there when the stated time is over.
    assert result[30] < 0.4
    np.testing.assert_allclose(result[30 + round(settings.restart_s * FPS) + 1 :], 1.0, atol=0.01)


def test_a_sure_measurement_counts_for_more():
    joints = np.zeros((10, 18, 3))
    joints[-1] = 0.05
    sure, unsure = (filtered(Kalman(), stream(joints, confidence=np.full(18, c)))[-1].joints.mean() for c in (1.0, 0.1))
    assert 0 < unsure < 0.7 * sure < 0.7 * 0.05 + 1e-9


def test_gaps_are_bridged_for_the_time_asked():
    joints = steady(0.5)
    joints[30:45, 4] = np.nan
    settings = KalmanSettings(bridge_s=0.2)
    for filter_ in (Kalman(settings), FixedLag(FixedLagSettings(model=settings))):
        result = filtered(filter_, stream(joints))
        away = np.array([np.isnan(pose.joints[4, 0]) for pose in result])
        assert np.flatnonzero(away).tolist() == list(range(36, 45))
        assert result[32].confidence[4] == BRIDGED_CONFIDENCE and result[40].confidence[4] == 1  # as measured
        np.testing.assert_allclose(result[31].joints[4], steady(0.5)[31, 4], atol=0.03)


def test_a_smoother_that_waits_knows_the_gap_from_both_sides():
    joints, truth = steady(1.0), steady(1.0)
    joints[30:33] = np.nan
    settings = KalmanSettings(bridge_s=0.2)
    causal = joints_of(filtered(Kalman(settings), stream(joints)))
    waited = joints_of(filtered(FixedLag(FixedLagSettings(6, settings)), stream(joints)))
    assert np.abs(waited - truth)[30:33].max() < 0.3 * np.abs(causal - truth)[30:33].max()


def test_a_smoother_that_waits_is_the_regression_over_all_frames():
    """With the whole past and future it is the mean of the joint Gaussian, which is known in closed form."""
    # Without agility the model does not depend on the data.
    settings, n = KalmanSettings(still_mps=0.5, agility=0.0, outlier=100.0), 8
    rng = np.random.default_rng(4)
    z = 0.02 * rng.normal(size=n).cumsum()
    step, added = transition(settings.memory_s, 1 / FPS)
    added = settings.still_mps**2 * added
    noise = settings.sure_m**2
    # Precision of the stacked states (position, velocity): the start, the steps, the measurements.
    precision, information = np.zeros((2 * n, 2 * n)), np.zeros(2 * n)
    start = np.linalg.inv(np.diag([noise, 0.5**2]))
    precision[:2, :2] += start
    information[:2] += start @ [z[0], 0.0]
    for k in range(1, n):
        here, before = slice(2 * k, 2 * k + 2), slice(2 * k - 2, 2 * k)
        q = np.linalg.inv(added)
        precision[here, here] += q
        precision[before, before] += step.T @ q @ step
        precision[here, before] -= q @ step
        precision[before, here] -= step.T @ q
        precision[2 * k, 2 * k] += 1 / noise
        information[2 * k] += z[k] / noise
    expected = np.linalg.solve(precision, information)[::2]
    joints = np.broadcast_to(z[:, None, None], (n, 18, 3)).copy()
    result = joints_of(filtered(FixedLag(FixedLagSettings(n - 1, settings)), stream(joints)))
    np.testing.assert_allclose(result, np.broadcast_to(expected[:, None, None], result.shape), atol=1e-9)


def test_the_model_of_a_step_is_that_of_two_half_steps():
    (whole, added), (half, half_added) = transition(0.2, 0.08), transition(0.2, 0.04)
    np.testing.assert_allclose(half @ half, whole)
    np.testing.assert_allclose(half @ half_added @ half.T + half_added, added)
    still, unknown = transition(0.2, 0.0)
    np.testing.assert_allclose(still, np.eye(2))
    np.testing.assert_allclose(unknown, 0, atol=1e-12)


def test_one_euro_lags_less_the_faster_a_joint_is():
    behind = []
    for speed in (0.2, 2.0):
        joints = steady(speed, 90)
        result = joints_of(filtered(OneEuro(), stream(joints)))
        behind.append((joints - result)[-1, 0, 0] / speed)
    assert behind[1] < 0.5 * behind[0]


def test_the_axes_of_the_world_do_not_matter():
    rng = np.random.default_rng(5)
    joints = rng.normal(size=(40, 18, 3)).cumsum(0) * 0.02
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    for make in ALL:
        turned = joints_of(filtered(make(), stream(joints @ turn)))
        np.testing.assert_allclose(turned, joints_of(filtered(make(), stream(joints))) @ turn, atol=1e-9)


def test_nothing_believed_is_nan():
    assert np.isnan(State.unknown().mean).all()


@pytest.mark.parametrize(
    "make",
    [
        lambda: KalmanSettings(still_mps=0.0),
        lambda: KalmanSettings(bridge_s=2.0),
        lambda: OneEuroSettings(still_hz=-1.0),
        lambda: FixedLagSettings(0),
        lambda: load_filter("average", bridge_s=0.1),
    ],
)
def test_bad_settings_are_refused(make):
    with pytest.raises(InputError):
        make()


@pytest.mark.parametrize("value", [-1.0, 2.0, np.nan])
@pytest.mark.parametrize("name", ["kalman", "fixed-lag"])
def test_gaps_are_bridged_for_a_time_that_can_be(name, value):
    with pytest.raises(InputError, match=rf"^--bridge-s must be from 0 to 0\.5, got {value}$"):
        load_filter(name, bridge_s=value)


@pytest.mark.parametrize("value", [-1.0, np.nan])
@pytest.mark.parametrize(
    "name", [field.name for field in dataclasses.fields(KalmanSettings) if field.name != "bridge_s"]
)
def test_the_value_alone_is_named(name, value):
    limit = "at least 0" if name in ("agility", "restart_s") else "above 0"
    with pytest.raises(InputError, match=f"^Kalman filter: {name} must be {limit}, got {value}$"):
        KalmanSettings(**{name: value})


def test_filters_by_name_tell_what_they_are():
    for name in FILTERS:
        filter_ = load_filter(name, lag_frames=3)
        assert filter_.delay_frames == (3 if name == "fixed-lag" else 0)
        assert {"filter", "latency_s", "sides"} <= set(filter_.describe())
