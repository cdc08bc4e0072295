"""Clocks of several recordings from pairs: chains, drift, contradictions, recordings that nothing leads to."""

from __future__ import annotations

import numpy as np
import pytest

from depthmocap.calibration.clock_network import ClockLink, solve_clocks

MIDDLES_S = [10.0, 10.0, 10.0]


def test_a_chain_of_recordings_and_one_that_nothing_leads_to() -> None:
    links = [ClockLink(0, 1, 5.0, 0.003, 10.0), ClockLink(1, 2, -2.0, 0.004, 4.0)]
    clocks = solve_clocks(4, links, [*MIDDLES_S, 10.0])
    np.testing.assert_allclose(clocks.shift_s, [0, 5, 3, 0], atol=1e-9)
    assert clocks.sigma_s[0] == 0
    assert 0.004 < clocks.sigma_s[2] < 0.006
    assert clocks.unlinked == (3,)
    assert not clocks.drift.any()
    assert not clocks.contradictions


def test_pairs_that_contradict_each_other_are_named() -> None:
    links = [ClockLink(0, 1, 5.0, 0.003, 10.0), ClockLink(1, 2, -2.0, 0.003, 4.0), ClockLink(0, 2, 4.2, 0.003, 8.0)]
    clocks = solve_clocks(3, links, MIDDLES_S)
    assert len(clocks.contradictions) == 3
    assert abs(clocks.contradictions[0][1]) == pytest.approx(0.4, abs=0.01)


def test_drift_is_given_where_it_is_certain() -> None:
    sure = ClockLink(0, 1, 5.0, 0.002, 200.0, 1e-4, 1e-5, 300.0)
    doubtful = ClockLink(0, 1, 5.0, 0.002, 200.0, 1e-4, 1e-4, 300.0)
    assert sure.drifts
    assert not doubtful.drifts
    clocks = solve_clocks(2, [sure], [200.0, 195.0])
    assert clocks.drift[1] == pytest.approx(1e-4, rel=1e-3)
    # At the middle of what both saw, the shift is as it was told.
    assert 195.0 * (1 + clocks.drift[1]) + clocks.shift_s[1] == pytest.approx(200.0, abs=1e-6)
    assert clocks.sigma_s[1] < 0.003
