"""Clocks that share nothing, by movement: what is found, what cannot be told, drift, jumps."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from jaxtyping import Float
from numpy import ndarray
from walker import REST, stand, track, walk, wander

from depthmocap.calibration.clock_steps import find_large_step, find_step
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.time_fit import fit_time
from depthmocap.calibration.time_search import find_time

PERIOD_S = 1 / 15


@functools.cache
def joints(seed: int = 0, seconds: float = 90.0) -> tuple[ndarray, ndarray]:
    """Movement that does not repeat, in steps of 1/60 s."""
    fine_s = np.arange(0, seconds, 1 / 60)
    return fine_s, wander(fine_s, seed)


def moving(times_s: Float[ndarray, " n"], seed: int = 0, seconds: float = 90.0) -> Float[ndarray, "n 18 3"]:
    fine_s, positions = joints(seed, seconds)
    flat = positions.reshape(len(fine_s), -1)
    return np.stack([np.interp(times_s, fine_s, column) for column in flat.T], 1).reshape(-1, *REST.shape)


def clocked(seen: JointTrack, at_s: Float[ndarray, " n"]) -> JointTrack:
    """The same track by another clock."""
    order = np.argsort(at_s, kind="stable")
    return JointTrack(at_s[order], seen.joints[order], seen.sigma_m[order])


@pytest.mark.parametrize(("begin_s", "clock_s"), [(10.0, 0.4), (22.0, -431.7), (1.0, 590.0)])
def test_separate_recordings_are_put_in_step_over_minutes(begin_s, clock_s):
    rng = np.random.default_rng(0)
    a = track(stand(0), np.arange(10, 30, PERIOD_S), rng, movement=moving)
    b = track(stand(95), begin_s + 0.021 + np.arange(0, 20, PERIOD_S), rng, movement=moving)
    match = find_time(a, clocked(b, b.times_s - clock_s), rng)
    assert match.told
    assert match.fit is not None
    assert match.fit.shift_s == pytest.approx(clock_s, abs=0.006)
    assert abs(match.fit.shift_s - clock_s) < 3 * match.fit.sigma_s + 0.001
    assert match.fit.sigma_s < 0.006


def test_who_walks_like_clockwork_looks_the_same_after_each_round():
    def steps(times_s):
        positions = walk(times_s)  # its arms do not repeat with the round
        still = walk(np.zeros(1)) - walk(np.zeros(1))[:, :1]
        turn = 2 * np.pi * times_s / 8
        cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
        x, y = still[..., 0] * cos - still[..., 1] * sin, still[..., 0] * sin + still[..., 1] * cos
        swing = 0.2 * np.sin(2 * np.pi * times_s)[:, None]
        body = np.stack([x + swing * cos, y + swing * sin, np.broadcast_to(still[..., 2], x.shape)], -1)
        return positions[:, :1] * [1, 1, 1] + body

    rng = np.random.default_rng(1)
    a = track(stand(0), np.arange(0, 20, PERIOD_S), rng, movement=steps)
    b = track(stand(95), np.arange(3, 23, PERIOD_S), rng, movement=steps)
    match = find_time(a, b, rng)
    assert not match.told
    assert "the movement repeats itself" in match.why


def test_what_cannot_be_told_is_not():
    rng = np.random.default_rng(2)
    times_s = np.arange(0, 15, PERIOD_S)
    a = track(stand(0), times_s, rng, movement=moving)
    stranger = track(stand(95), times_s, rng, movement=functools.partial(moving, seed=3))
    assert "the same movement" in find_time(a, stranger, rng).why
    statue = track(stand(95), times_s, rng, 0.01, movement=lambda at: np.tile(REST, (len(at), 1, 1)))
    assert find_time(a, statue, rng).why == "nobody moves"
    nobody = JointTrack(np.empty(0), np.empty((0, 18, 3)), np.empty((0, 18)))
    assert find_time(a, nobody, rng).why == "nobody is seen for long enough"
    years_apart = dataclasses.replace(a, times_s=a.times_s + np.where(np.arange(len(a.times_s)) > 200, 1e9, 0))
    assert find_time(years_apart, a, rng).why.startswith("a recording spans 277777.8 hours")
    assert "at the same time" in find_time(a, clocked(a, a.times_s + 700), rng, longest_s=600.0).why


def test_drift_of_a_clock():
    rng = np.random.default_rng(3)
    times_s = np.arange(1, 88, PERIOD_S)
    a = track(stand(0), times_s, rng, movement=moving)
    b = track(stand(95), times_s, rng, movement=moving)
    match = find_time(a, clocked(b, b.times_s * (1 - 4e-4) - 20), rng)
    assert match.told
    assert match.fit is not None
    assert match.fit.drift == pytest.approx(4e-4, abs=1.5e-4)
    assert match.fit.drift == pytest.approx(4e-4, abs=4 * match.fit.drift_sigma)


@pytest.mark.parametrize("by_s", [0.08, 0.5])
def test_a_clock_that_jumps_is_told(by_s):
    rng = np.random.default_rng(4)
    times_s = np.arange(10, 36, PERIOD_S)
    a = track(stand(0), times_s, rng, movement=moving)
    b = track(stand(95), times_s, rng, movement=moving)
    jumped = clocked(b, times_s - np.where(times_s > 25, by_s, 0))
    match = find_time(a, jumped, rng)
    assert match.best_s is not None
    step = find_step(a, jumped, match.fit) if match.told and match.fit is not None else None
    step = step or find_large_step(a, jumped, match.best_s)
    assert step is not None
    assert step.at_s == pytest.approx(25, abs=4)
    assert step.by_s == pytest.approx(by_s, abs=0.12)


def test_a_recording_that_stops_half_way_is_put_in_step_by_what_it_has():
    rng = np.random.default_rng(6)
    a = track(stand(0), np.arange(10, 34, PERIOD_S), rng, movement=moving)
    b = track(stand(95), np.arange(10, 20, PERIOD_S), rng, movement=moving)
    match = find_time(a, clocked(b, b.times_s + 120.5), rng)
    assert match.told and match.fit is not None
    assert match.fit.shift_s == pytest.approx(-120.5, abs=0.008)
    assert match.shared_s == pytest.approx(10, abs=0.5)


def test_steady_clocks_do_not_jump():
    rng = np.random.default_rng(5)
    times_s = np.arange(10, 36, PERIOD_S)
    a, b = (track(stand(azimuth), times_s, rng, movement=moving) for azimuth in (0, 95))
    fit = fit_time(a, b, 0.03, rng)
    assert fit is not None
    assert fit.shift_s == pytest.approx(0, abs=0.006)
    assert find_step(a, b, fit) is None
