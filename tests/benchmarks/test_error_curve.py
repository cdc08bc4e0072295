"""The curve of expected errors."""

from __future__ import annotations

import numpy as np
from make_error_curve import KNOTS, fit_curve

from depthmocap.frames import expected_error_m


def test_the_curve_that_errors_were_drawn_from_is_found() -> None:
    rng = np.random.default_rng(1)
    confidence = np.concatenate([rng.uniform(0, 1, 20000), 1 - rng.uniform(0, 0.02, 20000)])
    true = expected_error_m(confidence)
    heights = fit_curve(confidence, true * rng.exponential(1, len(true)))
    assert (np.diff(heights) <= 0).all()
    assert np.allclose(np.interp(confidence, KNOTS, heights), true, atol=0.02)


def test_it_never_grows() -> None:
    confidence = np.linspace(0, 1, 4000)
    assert (np.diff(fit_curve(confidence, confidence)) <= 0).all()
