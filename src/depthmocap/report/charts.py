"""Charts for reports, as PNG files in memory, on white. They are drawn at twice the size at which they are shown."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from io import BytesIO
from typing import Any

import numpy as np
from jaxtyping import Integer
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import EngFormatter, MaxNLocator
from numpy import ndarray

from depthmocap.body.regions import REGION_NAMES
from depthmocap.report.metrics import CURVE_THRESHOLDS_CM, JointMetrics, Reliability

#: Colour of text and important lines.
INK = "#2a2f35"
#: Colour of axes and less important text.
SOFT = "#6b737c"
_GRID = "#e4e5e2"
#: Colours of data series.
COLOURS = ("#c4452f", "#2f6fb5", "#3f8f5b", "#8a5bb0", "#b8862b", "#4d5661")
#: Resolution at which a chart is shown (dots per inch).
_DPI = 100
#: Factor by which it is drawn larger, for sharp screens.
_SCALE = 2


def new_figure(width: float, height: float, columns: int = 1) -> tuple[Figure, list[Axes]]:
    """A figure of a size in inches (shown at 100 dots per inch) and its axes, without pyplot's global state."""
    figure = Figure(figsize=(width, height), dpi=_DPI * _SCALE, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    axes = [figure.add_subplot(1, columns, i + 1) for i in range(columns)]
    for panel in axes:
        panel.spines[["top", "right"]].set_visible(False)
        panel.spines[["left", "bottom"]].set_color(SOFT)
        panel.tick_params(colors=SOFT, labelsize=9, length=3)
        panel.grid(axis="y", color=_GRID, linewidth=0.8)
        panel.set_axisbelow(True)
    return figure, axes


def name_axes(axes: Axes, x: str, y: str) -> None:
    axes.set_xlabel(x, color=INK, fontsize=10)
    axes.set_ylabel(y, color=INK, fontsize=10)


def _legend(axes: Axes) -> None:
    axes.legend(frameon=False, fontsize=9, labelcolor=INK)


def label_of(name: str) -> str:
    """A name as a label for the legend, which would leave out names that begin with an underscore."""
    return f" {name}" if name.startswith("_") else name


def as_png(figure: Figure) -> bytes:
    """The figure as a PNG file.

    Its texts may contain any names: none is read as a formula, and letters that the font lacks are shown as boxes
    without a warning.
    """
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        text.set_parse_math(False)
    buffer = BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph", UserWarning)
        figure.savefig(buffer, format="png")
    return buffer.getvalue()


def joint_error_bars(metrics: JointMetrics) -> bytes:
    """A bar for each joint: mean error (cm), with the standard deviation above; no bar without an estimate."""
    names = list(metrics.per_joint_error_cm)
    means = np.nan_to_num(np.array([metrics.per_joint_error_cm[name] for name in names]))
    deviations = np.nan_to_num(np.array([metrics.per_joint_deviation_cm[name] for name in names]))
    figure, (axes,) = new_figure(8.0, 3.4)
    # Only upwards: an error is never below zero.
    axes.bar(
        names, means, color=COLOURS[0], width=0.66,
        yerr=[np.zeros(len(names)), deviations], error_kw={"ecolor": SOFT, "elinewidth": 1.2, "capsize": 2.5},
    )  # fmt: skip
    axes.axhline(metrics.mean_joint_error_cm, color=INK, linewidth=1, linestyle=(0, (4, 3)))
    axes.set_xticks(range(len(names)), names, rotation=40, ha="right", rotation_mode="anchor")
    axes.set_xlim(-0.6, len(names) - 0.4)
    axes.set_title(f"mean {metrics.mean_joint_error_cm:.2f} cm", color=SOFT, fontsize=9, loc="right")
    name_axes(axes, "", "error (cm)")
    return as_png(figure)


def precision_curve(metrics: Mapping[str, JointMetrics]) -> bytes:
    """Share of the joints within each distance of the ground truth, a curve for each label."""
    figure, (axes,) = new_figure(6.4, 3.6)
    for i, (label, joint_metrics) in enumerate(metrics.items()):
        shares = np.array(joint_metrics.curve) * 100
        axes.plot(CURVE_THRESHOLDS_CM, shares, color=COLOURS[i % 6], linewidth=2, label=label_of(label))
    axes.axvline(10, color=SOFT, linewidth=0.8, linestyle=(0, (4, 3)))
    axes.set_xlim(0, CURVE_THRESHOLDS_CM[-1])
    axes.set_ylim(0, 101)
    name_axes(axes, "distance (cm)", "joints within it (%)")
    if any(metrics):
        _legend(axes)
    return as_png(figure)


def reliability_diagram(reliabilities: Mapping[str, Reliability]) -> bytes:
    """Share of the joints within 10 cm against their confidence, a line for each label. The size of a marker grows with
    the number of joints in its bin."""
    figure, (axes,) = new_figure(4.6, 4.2)
    axes.plot([0, 100], [0, 100], color=SOFT, linewidth=0.8, linestyle=(0, (4, 3)))
    for i, (label, bins) in enumerate(reliabilities.items()):
        x, y, joints = np.array(bins.confidence) * 100, np.array(bins.within_10cm) * 100, np.array(bins.joints)
        name = f"{label}: off by {bins.calibration_error:.1%}" if joints.size else label
        axes.plot(x, y, color=COLOURS[i % 6], linewidth=1.4, label=label_of(name))
        sizes = 12 + 120 * np.sqrt(joints / max(joints.sum(), 1))
        axes.scatter(x, y, s=sizes, color=COLOURS[i % 6], clip_on=False, zorder=3)
    axes.set_xlim(0, 101)
    axes.set_ylim(0, 101)
    name_axes(axes, "confidence (%)", "joints within 10 cm (%)")
    if reliabilities:
        _legend(axes)
    return as_png(figure)


def confusion_picture(confusion: Integer[ndarray, "44 44"]) -> bytes:
    """The confusion matrix: predicted regions as shares of each true region's pixels, on a square-root scale that shows
    small shares."""
    totals = confusion.sum(1, keepdims=True)
    shares = np.divide(confusion, totals, out=np.zeros(confusion.shape), where=totals > 0)[1:]
    figure, (axes,) = new_figure(8.4, 7.6)
    image = axes.imshow(np.sqrt(shares), cmap="Blues", vmin=0, vmax=1, interpolation="nearest")
    axes.grid(False)
    axes.set_xticks(range(44), REGION_NAMES, rotation=90, fontsize=6.5)
    axes.set_yticks(range(43), REGION_NAMES[1:], fontsize=6.5)
    name_axes(axes, "predicted", "true")
    bar = figure.colorbar(image, ax=axes, shrink=0.5, pad=0.01, ticks=np.sqrt([0, 0.01, 0.1, 0.25, 0.5, 1]))
    bar.ax.set_yticklabels(["0", "1 %", "10 %", "25 %", "50 %", "100 %"])
    bar.ax.tick_params(colors=SOFT, labelsize=8)
    bar.outline.set_visible(False)
    return as_png(figure)


def loss_curves(history: Sequence[Mapping[str, Any]]) -> bytes:
    """Training curves against ``step``: keys with "loss" in their names on the left, keys with "accuracy" on the right.

    An entry need not have every key, because validation is rarer than training. Accuracies are shares, 0–1.
    """
    figure, axes = new_figure(8.4, 3.2, 2)
    keys = list(dict.fromkeys(key for entry in history for key in entry))
    for panel, word, factor, name in ((axes[0], "loss", 1, "loss"), (axes[1], "accuracy", 100, "accuracy (%)")):
        for i, key in enumerate(key for key in keys if word in key):
            points = [(entry["step"], entry[key] * factor) for entry in history if entry.get(key) is not None]
            # Few values, as of validation, have markers: a line alone would not show where they were measured.
            marker = "o" if len(points) < 25 else ""
            steps, values = zip(*points, strict=True)
            label = key.replace("_", " ")
            panel.plot(steps, values, color=COLOURS[i % 6], linewidth=1.6, marker=marker, markersize=3.5, label=label)
        name_axes(panel, "step", name)
        panel.xaxis.set_major_locator(MaxNLocator(5))
        panel.xaxis.set_major_formatter(EngFormatter(sep=""))
        if panel.lines:
            _legend(panel)
    return as_png(figure)
