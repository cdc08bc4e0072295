"""Charts of a person's movement."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from numpy import ndarray

from depthmocap.analysis.joint_angles import SIDES, column
from depthmocap.analysis.measures import Movement, Trial
from depthmocap.analysis.quantities import ANGLES
from depthmocap.report.charts import COLOURS, SOFT, as_png, name_axes, new_figure

_SIDE_COLOURS = dict(zip(SIDES, COLOURS, strict=False))
#: Charts of angles over time, two side by side.
_PAIRS = (
    ("hip_flexion", "knee_flexion"),
    ("shoulder_elevation", "elbow_flexion"),
    ("pelvis_tilt", "trunk_lean"),
    ("trunk_bend", "trunk_rotation"),
)
#: Instants of a stride at which its angles are taken.
_CYCLE = np.linspace(0, 100, 101)


def angle_charts(moved: Movement, trials: Sequence[Trial]) -> list[bytes]:
    """Angles over time, left and right; lines are where trials begin. Gaps are gaps."""
    pictures = []
    for pair in _PAIRS:
        figure, axes = new_figure(8.4, 2.6, 2)
        for panel, angle in zip(axes, pair, strict=True):
            for side in SIDES if column(angle, "left") in moved.angles else ("",):
                colour = _SIDE_COLOURS.get(side, COLOURS[2])
                panel.plot(
                    moved.steady.times_s, moved.angles[column(angle, side)], color=colour, linewidth=1.2, label=side
                )
            for trial in trials:
                if np.isfinite(trial.start_s):
                    panel.axvline(trial.start_s, color=SOFT, linewidth=0.8, linestyle=(0, (4, 3)))
            _finish(panel, "time (s)", f"{ANGLES[angle].label} (°)")
        pictures.append(as_png(figure))
    return pictures


def cycle_chart(moved: Movement) -> bytes | None:
    """Hip and knee over the stride, from heel strike to heel strike: mean and standard deviation of the strides of each
    side; None where no stride was seen as a whole."""
    figure, axes = new_figure(8.4, 2.8, 2)
    drawn = False
    for panel, angle in zip(axes, ("hip_flexion", "knee_flexion"), strict=True):
        for side in SIDES:
            curves = cycles(moved, angle, side)
            if not len(curves):
                continue
            mean, deviation = curves.mean(0), curves.std(0)
            colour = _SIDE_COLOURS[side]
            panel.plot(_CYCLE, mean, color=colour, linewidth=1.6, label=f"{side}, {len(curves)} strides")
            panel.fill_between(_CYCLE, mean - deviation, mean + deviation, color=colour, alpha=0.18, linewidth=0)
            drawn = True
        _finish(panel, "share of the stride (%)", f"{ANGLES[angle].label} (°)")
    return as_png(figure) if drawn else None


def cycles(moved: Movement, angle: str, side: str) -> Float[ndarray, "n 101"]:
    """An angle over each stride of a side that was seen as a whole."""
    times_s, values = moved.steady.times_s, moved.angles[column(angle, side)]
    curves = []
    for stride in moved.strides:
        at = stride.start_s + _CYCLE / 100 * (stride.end_s - stride.start_s)
        inside = (times_s >= at[0] - moved.steady.frame_s) & (times_s <= at[-1] + moved.steady.frame_s)
        if stride.side == side and inside.any() and not np.isnan(values[inside]).any():
            curves.append(np.interp(at, times_s[inside], values[inside]))
    return np.array(curves).reshape(-1, len(_CYCLE))


def _finish(panel: Axes, x: str, y: str) -> None:
    name_axes(panel, x, y)
    if len(panel.get_legend_handles_labels()[0]) > 1:
        panel.legend(frameon=False, fontsize=8)
