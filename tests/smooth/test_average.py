import numpy as np
import pytest

from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.smooth.average import DEFAULT_WEIGHTS, Average, AverageSettings, fit_weights, smooth


def poses(*values):
    """A sequence whose poses are these numbers throughout."""
    return np.broadcast_to(np.array(values, float)[:, None, None], (len(values), 18, 3)).copy()


def test_small_case():
    smoothed = smooth(poses(0, 10, 20, 30), np.array([0.5, 0.3, 0.2]))
    expected = poses(0, (5 + 0) / 0.8, 10 + 3, 15 + 6 + 2)
    np.testing.assert_allclose(smoothed, expected)


def test_missing_frames_are_left_out_and_stay_missing():
    nan = np.nan
    smoothed = smooth(poses(0, nan, 20, 30), np.array([0.5, 0.3, 0.2]))
    np.testing.assert_allclose(smoothed, poses(0, nan, 10 / 0.7, 21 / 0.8))


def test_one_missing_joint_leaves_the_others_alone():
    joints = poses(0, 10, 20)
    joints[1, 4, 0] = np.nan
    smoothed = smooth(joints)
    assert np.isnan(smoothed[1, 4]).all()
    others = np.arange(18) != 4
    np.testing.assert_allclose(smoothed[:, others], smooth(poses(0, 10, 20))[:, others])


def test_without_usable_weights_the_current_estimate_is_kept():
    np.testing.assert_allclose(smooth(poses(3, 5), np.array([0.0, 1.0])), poses(3, 3))
    np.testing.assert_allclose(smooth(poses(3, 5), np.array([-1.0, 2.0])), poses(3, 1))


def test_empty_and_short_sequences():
    assert smooth(np.zeros((0, 18, 3))).shape == (0, 18, 3)
    np.testing.assert_array_equal(smooth(poses(4)), poses(4))


def test_stream_equals_batch():
    rng = np.random.default_rng(0)
    joints = rng.standard_normal((40, 18, 3)).astype(np.float32)
    joints[rng.uniform(size=(40, 18)) < 0.2] = np.nan
    joints[10:14] = np.nan
    weights = (0.4, 0.3, -0.1, 0.4)
    average = Average(AverageSettings(weights=weights))
    for _ in range(2):
        stream = [average(Pose(i, pose, np.ones(18))).joints for i, pose in enumerate(joints)]
        np.testing.assert_allclose(np.stack(stream), smooth(joints, np.array(weights)), atol=1e-12)
        average.reset()


def test_bad_weights_are_refused():
    with pytest.raises(InputError, match="time constant"):
        AverageSettings(time_constant_s=0.0)
    for weights in ([0.5, 0.4], [np.nan, 1.0], []):
        with pytest.raises(InputError, match="sum to one"):
            smooth(poses(1), np.array(weights))
        with pytest.raises(InputError, match="sum to one"):
            AverageSettings(weights=tuple(weights))
    assert DEFAULT_WEIGHTS.sum() == pytest.approx(1)


def walks(rng, speed, noise, count=6, length=200):
    """Truths that drift at random and estimates with white noise."""
    truths = [np.cumsum(rng.standard_normal((length, 18, 3)) * speed, axis=0) for _ in range(count)]
    return [truth + noise * rng.standard_normal(truth.shape) for truth in truths], truths


def error(estimates, truths, weights):
    pairs = zip(estimates, truths, strict=True)
    return np.mean([np.square(smooth(estimate, weights) - truth)[8:].mean() for estimate, truth in pairs])


@pytest.mark.parametrize("nonnegative", [True, False])
def test_a_still_body_gets_equal_weights(nonnegative):
    weights = fit_weights(*walks(np.random.default_rng(1), 0.0, 1.0), max_previous=4, nonnegative=nonnegative)
    np.testing.assert_allclose(weights, np.full(5, 0.2), atol=0.02)


@pytest.mark.parametrize("nonnegative", [True, False])
def test_without_noise_nothing_is_smoothed(nonnegative):
    weights = fit_weights(*walks(np.random.default_rng(2), 1.0, 0.0), nonnegative=nonnegative)
    np.testing.assert_allclose(weights[0], 1, atol=1e-6)


def test_weights_are_the_least_squares_ones():
    rng = np.random.default_rng(3)
    estimates, truths = walks(rng, 0.5, 1.0)
    weights = fit_weights(estimates, truths, max_previous=3)
    assert weights.sum() == pytest.approx(1)
    assert (weights >= 0).all()
    assert (np.diff(weights) < 0).all()
    best = error(estimates, truths, weights)
    for _ in range(20):
        step = 0.02 * rng.standard_normal(len(weights))
        assert error(estimates, truths, weights + step - step.mean()) > best - 1e-4


def test_negative_weights_extrapolate_a_steady_motion():
    # Estimates two frames late of a body at constant speed: only extrapolation can catch up.
    truths = [speed * poses(*range(30)) for speed in (1.0, 2.0, -1.5)]
    estimates = [np.concatenate([truth[:2], truth[:-2]]) for truth in truths]
    held_back = fit_weights(estimates, truths, 2)
    np.testing.assert_allclose(held_back[0], 1, atol=1e-6)
    weights = fit_weights(estimates, truths, 2, nonnegative=False)
    assert error(estimates, truths, weights) < 1e-2 * error(estimates, truths, held_back)


def test_gaps_do_not_reach_the_fit():
    estimates, truths = walks(np.random.default_rng(4), 0.5, 1.0)
    estimates[0][50:60] = np.nan
    truths[1][:, 3] = np.nan
    assert np.isfinite(fit_weights(estimates, truths)).all()


def test_bad_sequences_are_refused():
    one, two = poses(1, 2, 3), poses(1, 2)
    with pytest.raises(InputError, match="two sequences"):
        fit_weights([one], [one])
    with pytest.raises(InputError, match="3 estimates"):
        fit_weights([one, one], [two, one])
    with pytest.raises(InputError, match="in a row"):
        fit_weights([one, two], [one, two], max_previous=5)


@pytest.mark.parametrize("rate", [30, 60, 90])
def test_an_average_by_time_lags_alike_at_any_frame_rate(rate):
    average = Average()
    for i in range(19):
        average(Pose(round(i / rate * 1e9), np.full((18, 3), i / rate), np.ones(18)))
    smoothed = average(Pose(round(19 / rate * 1e9), np.full((18, 3), 19 / rate), np.ones(18))).joints
    assert 19 / rate - smoothed[0, 0] == pytest.approx(average.latency_s)
    # At 90 frames a second the oldest of them is not old enough to have lost all weight.
    assert 0.015 < average.latency_s < 0.035


def test_an_average_by_time_gives_lost_frames_their_age():
    average = Average(AverageSettings(time_constant_s=0.1))
    average(Pose(0, np.zeros((18, 3)), np.ones(18)))
    smoothed = average(Pose(100_000_000, np.ones((18, 3)), np.ones(18)))
    np.testing.assert_allclose(smoothed.joints, 1 / (1 + np.exp(-1)))
    again = average(Pose(0, np.full((18, 3), 5.0), np.ones(18)))  # time goes back: another stream
    np.testing.assert_allclose(again.joints, 5)
