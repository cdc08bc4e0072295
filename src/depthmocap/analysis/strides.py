"""Strides, and what is measured of each: lengths, times, width, support."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from depthmocap.analysis.gait_events import Swing

#: A longer time between heel strikes of one foot is a pause.
_LONGEST_STRIDE_S = 2.5
#: Numbers of a stride, each of its own side.
STRIDE_QUANTITIES = (
    "stride_length", "stride_time", "step_length", "step_time", "step_width", "walking_speed", "cadence", "stance",
    "swing", "double_support",
)  # fmt: skip
#: Of these the difference of the sides is told.
SYMMETRIES = ("step_length", "step_time", "stance")


@dataclasses.dataclass(frozen=True)
class Stride:
    """From a heel strike of a foot to its next one, with one of the other foot between.

    Attributes:
        side: of the foot.
        start_s, end_s: the heel strikes.
        values: by the names of :data:`STRIDE_QUANTITIES` (m, s, m/s, 1/min, percent); NaN where not seen.
    """

    side: str
    start_s: float
    end_s: float
    values: dict[str, float]


def strides(swings: Sequence[Swing]) -> list[Stride]:
    """The strides of swings, which are in the order of their heel strikes.

    The line of progression of a stride goes from where the foot stood to where it stands next, so that turning does not
    count as width. The step belongs to the foot that ends the stride: from where the other foot stands, along the line.
    """
    whole = []
    for i, end in enumerate(swings):
        of_foot = [k for k in range(i) if swings[k].side == end.side]
        if not of_foot:
            continue
        first = of_foot[-1]
        start, between = swings[first], swings[first + 1 : i]
        duration_s = end.heel_strike_s - start.heel_strike_s
        if len(between) != 1 or duration_s > _LONGEST_STRIDE_S or not start.heel_strike_s < end.toe_off_s:
            continue
        other = between[0]
        line = end.place - start.place
        length = float(np.linalg.norm(line))
        unit = line / length if length > 0 else np.full(2, np.nan)
        across, along = other.place - start.place, end.place - other.place
        # Both feet stand from this heel strike to the other foot's toe-off, and from its heel strike to this toe-off.
        supports = (other.toe_off_s - start.heel_strike_s, end.toe_off_s - other.heel_strike_s)
        stance_s = end.toe_off_s - start.heel_strike_s
        values = {
            "stride_length": length,
            "stride_time": duration_s,
            "step_length": float(along @ unit),
            "step_time": end.heel_strike_s - other.heel_strike_s,
            "step_width": float(abs(across[0] * unit[1] - across[1] * unit[0])),
            "walking_speed": length / duration_s,
            "cadence": 120.0 / duration_s,
            "stance": 100 * stance_s / duration_s,
            "swing": 100 - 100 * stance_s / duration_s,
            # A negative one is a flight: somebody who runs is never on both feet.
            "double_support": 100 * sum(supports) / duration_s if min(supports) > 0 else float("nan"),
        }
        whole.append(Stride(end.side, start.heel_strike_s, end.heel_strike_s, values))
    return whole


def asymmetry(left: float, right: float) -> float:
    """Difference of the sides in percent of their mean, positive where the right one is larger."""
    return 200 * (right - left) / (right + left) if right + left else float("nan")
