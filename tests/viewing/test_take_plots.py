"""Plots of a take: a scale whatever is missing, and the least of each column of the whole take."""

from __future__ import annotations

import numpy as np

from depthmocap.viewing.take_plots import binned, drawable

NAN = np.nan


def test_columns_begin_with_a_number() -> None:
    missing, known, nothing = np.array([NAN, NAN, 2.0]), np.array([1.0, NAN, 3.0]), np.full(3, NAN)
    first, second, third = drawable(missing, known, nothing)
    assert np.array_equal(first, [2.0, NAN, 2.0], equal_nan=True)
    assert np.array_equal(second, known, equal_nan=True)
    assert np.array_equal(third, [2.0, NAN, NAN], equal_nan=True)
    assert np.array_equal(drawable(nothing)[0], [0.0, NAN, NAN], equal_nan=True)
    assert len(drawable(np.zeros(0))[0]) == 0


def test_the_least_of_every_column() -> None:
    values, bins = np.array([3.0, 1.0, NAN, 4.0]), np.array([0, 0, 1, 2])
    assert np.array_equal(binned(values, bins, 3), [1.0, NAN, 4.0], equal_nan=True)
