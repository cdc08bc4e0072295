"""Plots of a running capture: sets a second and latency over the last minute."""

from __future__ import annotations

import collections

import numpy as np
import viser
import viser.uplot
from jaxtyping import Float
from numpy import ndarray

#: Seconds that are shown.
MINUTE_S = 60


class LivePlots:
    """Sets a second, and the time from the exposure to the page, each second of the last minute."""

    def __init__(self, gui: viser.GuiApi) -> None:
        #: By whole second: poses at its end, and latencies (ms) in it.
        self._poses: collections.OrderedDict[int, int] = collections.OrderedDict()
        self._latencies: collections.OrderedDict[int, list[float]] = collections.OrderedDict()
        self._samples = 0
        blank = np.array([-float(MINUTE_S), 0.0])
        unknown = np.full(2, np.nan)
        axis: viser.uplot.Axis = {"stroke": "#b8b8c0", "grid": {"stroke": "#3c3c46", "width": 1}, "size": 42}
        time_axis: viser.uplot.Axis = {**axis, "size": 28}
        x: viser.uplot.Scale = {"time": False, "range": (-float(MINUTE_S), 0.0)}
        self._rate = gui.add_uplot(
            (blank, unknown), ({"label": "s"}, {"label": "sets a second", "stroke": "#6bd48a", "width": 1.5}),
            title="sets a second", height=120, scales={"x": x}, axes=(time_axis, axis), legend={"show": False},
        )  # fmt: skip
        self._latency = gui.add_uplot(
            (blank, unknown, unknown),
            (
                {"label": "s"},
                {"label": "median", "stroke": "#ffd166", "width": 1.5},
                {"label": "longest", "stroke": "#ff6b6b", "width": 1.0},
            ),
            title="exposure to page (ms): median, longest", height=120, scales={"x": x}, axes=(time_axis, axis),
            legend={"show": False},
        )  # fmt: skip

    def add(self, now_s: float, latency_ms: float, poses: int | None) -> None:
        """Take a sample: when it came, its latency, and the poses so far; without them samples are counted."""
        self._samples += 1
        second = int(now_s)
        self._poses[second] = self._samples if poses is None else poses
        self._latencies.setdefault(second, []).append(latency_ms)
        for kept in (self._poses, self._latencies):
            while next(iter(kept)) < second - MINUTE_S - 1:
                kept.popitem(last=False)

    def series(self) -> tuple[Float[ndarray, " n"], Float[ndarray, " n"], Float[ndarray, "n 2"]]:
        """Seconds before the last whole one, sets in each, and median and longest latency (ms) in each."""
        seconds = list(self._poses)[:-1]  # the present one is not over
        if len(seconds) < 2:
            return np.zeros(0), np.zeros(0), np.zeros((0, 2))
        times = np.array(seconds[1:], np.float64)
        poses = np.array([self._poses[second] for second in seconds], np.float64)
        latencies = [self._latencies[second] for second in seconds[1:]]
        both = np.array([[np.median(values), max(values)] for values in latencies], np.float64)
        return times - times[-1], np.diff(poses) / np.diff(np.array(seconds, np.float64)), both

    def show(self) -> None:
        """Draw them."""
        times_s, rates, latencies_ms = self.series()
        if len(times_s) > 1:
            self._rate.data = (times_s, rates)
            self._latency.data = (times_s, latencies_ms[:, 0].copy(), latencies_ms[:, 1].copy())

    def words(self) -> str:
        """The last whole second in words."""
        times_s, rates, latencies_ms = self.series()
        if not len(times_s):
            return "measuring the rate"
        return f"{rates[-1]:.0f} sets a second, {latencies_ms[-1, 0]:.0f} ms after the exposure"
