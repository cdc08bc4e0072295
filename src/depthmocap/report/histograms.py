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
    """A histogram: ``counts`` between ``edges`` (one more than counts)."""

    title: str
    edges: Float[ndarray, "m"]
    counts: Num[ndarray, "n"]

    @classmethod
    def of(cls, title: str, values: Num[ndarray, "k"], edges: Float[ndarray, "m"]) -> Histogram:
        """The histogram of values; those beyond the edges count in the outermost bins."""
        return cls(title, edges, np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0])


def histogram_row(histograms: Sequence[Histogram]) -> bytes:
    """The histograms in one row, each in per cent of its total."""
    figure, axes = new_figure(2.9 * len(histograms), 2.3, len(histograms))
    for panel, histogram in zip(axes, histograms, strict=True):
        shares = 100 * histogram.counts / max(histogram.counts.sum(), 1)
        panel.bar(histogram.edges[:-1], shares, np.diff(histogram.edges), align="edge", color=COLOURS[1])
        panel.set_xlim(histogram.edges[0], histogram.edges[-1])
        name_axes(panel, histogram.title, "%" if panel is axes[0] else "")
    return as_png(figure)
