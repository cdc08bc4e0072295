"""Who has left, and for whose stature somebody new waits."""

import numpy as np
import pytest

from depthmocap.segment.departed import Departed, match_stature, may_match


def away(number: int, stature_m: float) -> Departed:
    return Departed(number, stature_m, 1.9, np.zeros(3), 0.0)


@pytest.mark.parametrize(
    ("statures_m", "expected"),
    [
        ((), False), ((np.nan,), False), ((1.7,), True), ((np.nan, 1.7), True), ((1.7, 1.8), True),
        ((1.7, 1.72), False), ((1.7, 1.72, 1.74), False), ((1.7, 1.72, 1.85), True),
    ],
)  # fmt: skip
def test_nobody_waits_for_their_stature_where_it_would_tell_nothing(statures_m, expected):
    departed = [away(number, stature_m) for number, stature_m in enumerate(statures_m, 1)]
    assert may_match(departed, np.nan) == expected
    assert any(match_stature(departed, stature_m) for stature_m in np.arange(1.5, 2.0, 0.01)) == expected
