"""Charts and pictures of a classifier's labels."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from depthmocap.body.regions import DISPLAY_COLOURS, REGION_COUNT, REGION_NAMES
from depthmocap.errors import InputError
from depthmocap.evaluate.label_measures import Calibration
from depthmocap.report.charts import COLOURS, INK, SOFT, as_png, name_axes, new_figure
from depthmocap.report.drawing import colour_labels, depth_picture

_CELL, _GAP = 220, 4


def region_bars(per_class_accuracy: Float[ndarray, " 43"]) -> bytes:
    """A bar per region in its colour: the share of its pixels labelled right; a region that does not occur has none."""
    shares = np.nan_to_num(per_class_accuracy) * 100
    figure, (axes,) = new_figure(8.4, 3.4)
    places = np.arange(REGION_COUNT)
    axes.bar(places, shares, color=DISPLAY_COLOURS[1:] / 255, edgecolor=SOFT, linewidth=0.4, width=0.8)
    axes.set_xticks(places, REGION_NAMES[1:], rotation=90, fontsize=6.5)
    axes.set_xlim(-0.7, REGION_COUNT - 0.3)
    axes.set_ylim(0, 100)
    known = per_class_accuracy[~np.isnan(per_class_accuracy)]
    if known.size:
        axes.axhline(known.mean() * 100, color=INK, linewidth=1, linestyle=(0, (4, 3)))
        axes.set_title(f"mean {known.mean():.1%}", color=SOFT, fontsize=9, loc="right")
    name_axes(axes, "", "labelled right (%)")
    return as_png(figure)


def reliability_diagram(calibration: Calibration) -> bytes:
    """Share of right labels against the probability that the network gave them, and how many pixels have it."""
    figure, (left, right) = new_figure(8.0, 3.4, 2)
    left.plot([0, 100], [0, 100], color=SOFT, linewidth=1, linestyle=(0, (4, 3)))
    rows = np.array(calibration.rows).reshape(-1, 3)
    left.plot(rows[:, 1] * 100, rows[:, 2] * 100, color=COLOURS[0], linewidth=2, marker="o", markersize=3.5)
    left.set_xlim(0, 100)
    left.set_ylim(0, 100)
    left.set_title(
        f"expected calibration error {calibration.error * 100:.1f} points", color=SOFT, fontsize=9, loc="right"
    )
    name_axes(left, "probability (%)", "labelled right (%)")
    share = calibration.pixels / max(calibration.pixels.sum(), 1) * 100
    width = 100 / len(share)
    right.bar((np.arange(len(share)) + 0.5) * width, share, width=0.9 * width, color=COLOURS[1])
    right.set_xlim(0, 100)
    name_axes(right, "probability (%)", "pixels (%)")
    return as_png(figure)


#: Depth (m) of a view, the person's mask, the true and the predicted labels.
LabelExample = tuple[Float[ndarray, "_ _"], Bool[ndarray, "_ _"], UInt8[ndarray, "_ _"], UInt8[ndarray, "_ _"]]


def label_grid(examples: Sequence[LabelExample]) -> UInt8[ndarray, "h w 3"]:
    """A column per view, cut to the person: depth, true regions, predicted regions, as the paper shows them.

    Raises:
        InputError: when there are no views.
    """
    if not examples:
        raise InputError("a grid of labels needs at least one view")
    columns = []
    for depth_m, mask, truth, predicted in examples:
        cut = _square_around(mask)
        pictures = (
            depth_picture(np.where(mask, depth_m, 0)),
            *(colour_labels(np.where(mask, labels, np.uint8(0))) for labels in (truth, predicted)),
        )
        columns.append(np.concatenate([_cell(picture, cut) for picture in pictures], 0))
    return np.concatenate(columns, 1)[:-_GAP, :-_GAP]


def _square_around(mask: Bool[ndarray, "h w"]) -> tuple[int, int, int]:
    """Left, top and side of a square around a mask with a little room; it may reach over the picture."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(rows):
        return 0, 0, max(mask.shape)
    top, bottom, left, right = (int(edge) for edge in (rows[0], rows[-1], columns[0], columns[-1]))
    side = round(1.08 * max(bottom - top, right - left) + 3)
    return (left + right - side) // 2, (top + bottom - side) // 2, side


def _cell(picture: UInt8[ndarray, "h w 3"], cut: tuple[int, int, int]) -> UInt8[ndarray, "c c 3"]:
    left, top, side = cut
    shift = np.array([[1, 0, -left], [0, 1, -top]], dtype=np.float32)
    square = cv2.warpAffine(picture, shift, (side, side), flags=cv2.INTER_NEAREST)
    # Fewer pixels are averaged, more are repeated: a region's colour stays its own.
    smaller = side > _CELL
    scaled = cv2.resize(square, (_CELL, _CELL), interpolation=cv2.INTER_AREA if smaller else cv2.INTER_NEAREST)
    return cv2.copyMakeBorder(scaled, 0, _GAP, 0, _GAP, cv2.BORDER_CONSTANT, value=(255, 255, 255)).astype(np.uint8)
