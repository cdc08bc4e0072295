"""Plots of a take: a joint and its confidence around the instant that is shown, and the whole take at a glance."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import viser
import viser.uplot
from jaxtyping import Float, Int
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.viewing.viewed_take import ViewedPerson, ViewedTake

#: Seconds that are shown before and after the instant.
AROUND_S = 2.0
#: Columns of the plot of the whole take.
OVERVIEW = 400
#: Most instants that a plot has.
_MOST = 1000
#: Of the scale of confidence.
_TOP = 1.05
_AXES = ("x", "y", "z")
_COLOURS = {"x": "#ff6b6b", "y": "#6bd48a", "z": "#6ba8ff"}
_GRID: viser.uplot.Axis = {"stroke": "#b8b8c0", "grid": {"stroke": "#3c3c46", "width": 1}, "size": 42}
_TIME_AXIS: viser.uplot.Axis = {"stroke": "#b8b8c0", "grid": {"stroke": "#3c3c46", "width": 1}, "size": 28}
_NO_TIME: dict[str, viser.uplot.Scale] = {"x": {"time": False}}


def _line(label: str, colour: str, dash: tuple[float, ...] = (), width: float = 1.5) -> viser.uplot.Series:
    series: viser.uplot.Series = {"label": label, "stroke": colour, "width": width, "points": {"show": False}}
    if dash:
        series["dash"] = dash
    return series


def binned(values: Float[ndarray, " t"], bins: Int[ndarray, " t"], count: int) -> Float[ndarray, " n"]:
    """The least value of every bin, NaN where none of its values is known."""
    lowest = np.full(count, np.inf)
    known = np.isfinite(values)
    np.minimum.at(lowest, bins[known], values[known])
    return np.where(np.isinf(lowest), np.nan, lowest)


def with_gaps(*columns: Float[ndarray, " n"]) -> list[list[float | None]]:
    """Columns of a plot in which what is not known is None: the plot leaves a gap there, and would draw across NaN."""
    return [[value if math.isfinite(value) else None for value in column.tolist()] for column in columns]


class TakePlots:
    """Plots that follow the instant that is shown."""

    def __init__(self, gui: viser.GuiApi, take: ViewedTake) -> None:
        self._gui = gui
        more = [("truth", (4.0, 3.0))] if take.has_truth else []
        more += [("beside", (1.0, 3.0))] if take.beside else []
        series = [viser.uplot.Series(label="s")]
        for kind, dash in [("", ()), *more]:
            series += [_line(f"{axis} {kind}".strip(), _COLOURS[axis], dash) for axis in _AXES]
        self._more = tuple(kind for kind, _ in more)
        blank = np.array([-AROUND_S, AROUND_S])
        unknown = np.full(2, np.nan)
        self._joint = gui.add_uplot(
            (blank, *[unknown] * (len(series) - 1)), tuple(series), title="joint (m)", height=170,
            scales={"x": {"time": False, "range": (-AROUND_S, AROUND_S)}}, axes=(_TIME_AXIS, _GRID),
            legend={"show": False}, cursor={"show": True},
        )  # fmt: skip
        self._confidence = gui.add_uplot(
            (blank, unknown), ({"label": "s"}, _line("confidence", "#ffd166")), title="confidence of the joint",
            height=110,
            scales={"x": {"time": False, "range": (-AROUND_S, AROUND_S)}, "y": {"range": (0.0, _TOP)}},
            axes=(_TIME_AXIS, _GRID), legend={"show": False},
        )  # fmt: skip
        self._overview = gui.add_uplot(
            (blank, unknown, unknown),
            ({"label": "s"}, _line("lowest confidence", "#ffd166"), _line("now", "#ffffff", width=2.0)),
            title="whole take: confidence", height=110, scales={"x": {"time": False}, "y": {"range": (0.0, _TOP)}},
            axes=(_TIME_AXIS, _GRID), legend={"show": False},
        )  # fmt: skip
        self._error: viser.GuiUplotHandle | None = None
        if take.has_truth and take.people:
            self._error = gui.add_uplot(
                (blank, unknown, unknown),
                ({"label": "s"}, _line("error", "#ff8fab"), _line("now", "#ffffff", width=2.0)),
                title="whole take: distance from the truth (cm)", height=120, scales=_NO_TIME,
                axes=(_TIME_AXIS, _GRID), legend={"show": False},
            )  # fmt: skip
        self.set_take(take, None)

    def set_take(self, take: ViewedTake, number: int | None) -> None:
        """Plot another take, or the same after corrections; ``number`` is the person whose confidence is shown."""
        self._take = take
        columns = min(OVERVIEW, len(take))
        self._bins = np.arange(len(take)) * columns // len(take)
        self._bin_times_s = take.times_s[np.searchsorted(self._bins, np.arange(columns))]
        # Who is not seen has no confidence.
        self._lowest = np.nan_to_num(binned(take.confidence(number), self._bins, columns))
        if self._error is not None:
            self._errors_cm = -binned(-100 * take.error_m(number), self._bins, columns)
            known = self._errors_cm[np.isfinite(self._errors_cm)]
            self._top_cm = max(float(known.max()) if len(known) else 0.0, 1.0)
            self._error.scales = {"x": {"time": False}, "y": {"range": (0.0, 1.05 * self._top_cm)}}
        self._shown_bin = -1

    def show(self, index: int, joint: str, person: ViewedPerson | None) -> None:
        """Show the instant of this number and a joint around it."""
        self._show_overview(int(self._bins[index]))
        take, now_s = self._take, float(self._take.times_s[index])
        first, end = np.searchsorted(take.times_s, [now_s - AROUND_S, now_s + AROUND_S + 1e-9])
        if end - first > _MOST:
            first, end = max(index - _MOST // 2, 0), index + _MOST // 2
        times_s = take.times_s[first:end] - now_s
        column, unknown = JOINT_INDEX[joint], np.full((len(times_s), 3), np.nan)
        joints, confidence = unknown, unknown[:, 0]
        if person is not None:
            all_joints, all_confidence = person.series(int(first), int(end))
            joints, confidence = all_joints[:, column], all_confidence[:, column]
        parts = [joints]
        for kind in self._more:
            other = take.truth(int(first), int(end))[:, column] if kind == "truth" else unknown
            if kind == "beside" and take.beside:
                number = None if person is None else person.number
                twin = next((run for run in take.beside if run.number == number), take.beside[0])
                other = twin.series(int(first), int(end))[0][:, column]
            parts.append(other)
        # A list, because viser makes the columns of a tuple arrays, which know no None.
        data: Any = [times_s, *with_gaps(*(part[:, axis] for part in parts for axis in range(3)))]
        self._joint.data = data
        self._confidence.data = (times_s, np.nan_to_num(confidence).astype(np.float64))

    def _show_overview(self, now: int) -> None:
        if now == self._shown_bin:
            return
        self._shown_bin = now
        self._overview.data = (self._bin_times_s, self._lowest, self._cursor(now, _TOP))
        if self._error is not None:
            data: Any = [self._bin_times_s, *with_gaps(self._errors_cm), self._cursor(now, self._top_cm)]
            self._error.data = data

    def _cursor(self, now: int, top: float) -> Float[ndarray, " n"]:
        """A line upright at a column; elsewhere it is below what is shown."""
        cursor = np.full(len(self._bin_times_s), -100 * top)
        cursor[now] = 100 * top
        return cursor
