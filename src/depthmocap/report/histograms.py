"""Small histograms side by side, as a PNG file in memory."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Num
from numpy import ndarray

from depthmocap.report.charts import COLOURS, as_png, name_axes, new_figure


@dataclasses.dataclass(frozen=True, eq=False)
class Histogram:
    """Counts between edges (one more than counts), of what ``title`` says."""

    title: str
    edges: Float[ndarray, "m"]
    counts: Num[ndarray, "n"]

    @classmethod
    def of(cls, title: str, values: Num[ndarray, "k"], edges: Float[ndarray, "m"]) -> Histogram:
        """Of values; those beyond the edges count in the outermost bins."""
        return cls(title, edges, np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0])


def histogram_row(histograms: Sequence[Histogram]) -> bytes:
    """The histograms in one row, each as shares of its own total."""
    figure, axes = new_figure(2.9 * len(histograms), 2.3, len(histograms))
    for each, histogram in zip(axes, histograms, strict=True):
        shares = 100 * histogram.counts / max(histogram.counts.sum(), 1)
        each.bar(histogram.edges[:-1], shares, np.diff(histogram.edges), align="edge", color=COLOURS[1])
        each.set_xlim(histogram.edges[0], histogram.edges[-1])
        name_axes(each, histogram.title, "%" if each is axes[0] else "")
    return as_png(figure)
