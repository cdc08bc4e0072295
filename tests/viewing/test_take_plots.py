"""Plots of a take: gaps where something is missing, and the least of each column of the whole take."""

from __future__ import annotations

import numpy as np

from depthmocap.viewing.take_plots import binned, with_gaps

NAN = np.nan


def test_what_is_not_known_is_a_gap() -> None:
    assert with_gaps(np.array([NAN, 2.0, np.inf]), np.zeros(3)) == [[None, 2.0, None], [0.0, 0.0, 0.0]]


def test_the_least_of_every_column() -> None:
    values, bins = np.array([3.0, 1.0, NAN, 4.0]), np.array([0, 0, 1, 2])
    assert np.array_equal(binned(values, bins, 3), [1.0, NAN, 4.0], equal_nan=True)
