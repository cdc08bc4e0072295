"""Quantiles in fixed memory."""

import math

import numpy as np

from depthmocap.realtime.meters import Meter


def test_quantiles_are_near_the_exact_ones():
    values = np.random.default_rng(0).lognormal(3, 0.5, 20_000)
    meter = Meter()
    for value in values.tolist():
        meter.add(value)
    assert len(meter) == 20_000
    for name, share in (("p50", 0.5), ("p95", 0.95)):
        np.testing.assert_allclose(meter.overall()[name], np.quantile(values, share), rtol=0.03)
    np.testing.assert_allclose(meter.recent(), np.quantile(values[-300:], [0.5, 0.95]))


def test_without_values_and_beyond_the_range():
    meter = Meter()
    assert math.isnan(meter.overall()["p50"])
    assert math.isnan(meter.recent()[1])
    for value in (-1.0, 0.0, 1e9):
        meter.add(value)
    assert meter.overall()["p50"] < 0.02
    assert meter.overall()["p95"] > 10_000
