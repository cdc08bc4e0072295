"""Clocks of known offset and drift behind delays that only ever make frames late."""

import numpy as np
import pytest

from depthmocap.realtime.clock import ClockTracker, lower_edge

START_NS = 1_700_000_000_000_000_000


def pairs(rng, seconds=60.0, rate=30.0, drift=200e-6, offset_s=12.5, spread_s=0.02):
    """Device timestamps (ns), arrivals (ns) and true exposures (host ns): ±10 ms about a mean delay of 10 ms."""
    exposure = (np.arange(round(seconds * rate)) / rate * 1e9).astype(np.int64)
    device = (exposure * (1 + drift)).astype(np.int64) + round(offset_s * 1e9)
    arrival = exposure + (rng.uniform(0, spread_s, len(exposure)) * 1e9).astype(np.int64)
    return device.tolist(), (START_NS + arrival).tolist(), (START_NS + exposure).tolist()


@pytest.mark.parametrize("drift", [-200e-6, 0.0, 200e-6])
@pytest.mark.parametrize("seed", range(2))
def test_offset_and_drift_of_a_minute(drift, seed):
    tracker = ClockTracker()
    device, arrival, true = pairs(np.random.default_rng(seed), drift=drift)
    for d, a in zip(device, arrival, strict=True):
        tracker.update(d, a)
    assert abs(tracker.host_ns(device[-1]) - true[-1]) < 2e6
    assert abs(tracker.drift_ppm - (1 / (1 + drift) - 1) * 1e6) < 5
    assert tracker.restarts == 0


def test_long_delays_of_many_frames_do_not_pull():
    rng = np.random.default_rng(0)
    device, arrival, true = pairs(rng)
    tracker = ClockTracker()
    for i, (d, a) in enumerate(zip(device, arrival, strict=True)):
        late = rng.exponential(0.03) * 1e9 if i % 3 else 0
        tracker.update(d, a + round(late))
    assert abs(tracker.host_ns(device[-1]) - true[-1]) < 2e6
    assert tracker.restarts == 0


def test_offset_is_near_within_two_seconds_of_the_start():
    device, arrival, true = pairs(np.random.default_rng(1), seconds=2.0)
    tracker = ClockTracker()
    for d, a in zip(device, arrival, strict=True):
        host = tracker.update(d, a)
        assert host is not None
    assert abs(tracker.host_ns(device[-1]) - true[-1]) < 3e6


@pytest.mark.parametrize("jump_s", [-3600.0, -0.5, 0.03, 0.5, 86400.0])
def test_a_jump_is_found_and_the_clock_starts_anew(jump_s):
    device, arrival, true = pairs(np.random.default_rng(2))
    tracker = ClockTracker()
    worst_ns, unsure = 0, 0
    for i, (d, a, t) in enumerate(zip(device, arrival, true, strict=True)):
        host = tracker.update(d + (round(jump_s * 1e9) if i >= 900 else 0), a)
        unsure += host is None
        if host is not None and i > 960:
            worst_ns = max(worst_ns, abs(host - t))
    assert tracker.restarts == 1
    assert unsure <= 5
    assert worst_ns < 12e6


def test_a_single_wrong_timestamp_is_not_a_jump():
    device, arrival, true = pairs(np.random.default_rng(3))
    tracker = ClockTracker()
    for i, (d, a) in enumerate(zip(device, arrival, strict=True)):
        host = tracker.update(d + (3_000_000_000 if i == 900 else 0), a)
        assert (host is None) == (i == 900)
    assert tracker.restarts == 0
    assert abs(tracker.host_ns(device[-1]) - true[-1]) < 2e6


@pytest.mark.parametrize("seconds", [1, 5])
def test_frames_that_were_held_up_are_late_but_not_a_jump(seconds):
    device, arrival, true = pairs(np.random.default_rng(4))
    tracker = ClockTracker()
    end = 900 + 30 * seconds
    for i, (d, a) in enumerate(zip(device, arrival, strict=True)):
        held = arrival[end - 1] + i * 1_000_000 if 900 <= i < end else a  # all of them come at the end, one a ms
        host = tracker.update(d, max(held, a))
        assert host is None or i < 900 or abs(host - true[i]) < 2e6
    assert tracker.restarts == 0


def test_before_the_first_pair_there_is_no_time():
    with pytest.raises(ValueError, match="update"):
        ClockTracker().host_ns(0)


def test_lower_edge_lies_under_all_points():
    rng = np.random.default_rng(6)
    points = np.column_stack([np.arange(50.0), rng.exponential(1.0, 50) + 0.1 * np.arange(50)])
    about = float(points[:, 0].mean())
    height, slope = lower_edge(points, about)
    gaps = points[:, 1] - (height + slope * (points[:, 0] - about))
    assert gaps.min() == pytest.approx(0, abs=1e-9)
    assert np.count_nonzero(gaps < 1e-9) == 2
