"""A view with a body region for every pixel: the output of classification and the input of view aggregation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

from jaxtyping import Float, UInt8
from numpy import ndarray

from depthmocap.frames import View

if TYPE_CHECKING:
    from depthmocap.classify.classifier import Classifier

#: Labels of a view: the network's, or its true ones.
Labels = Literal["network", "true"]
LABELS: tuple[Labels, ...] = ("network", "true")


class LabelledView(NamedTuple):
    """A view with its label per pixel, the labels' probabilities (None: true labels), the joints that the network
    estimates from this view alone: world position and expected error (metres; None or NaN without an estimate), and
    the log odds that what is labelled front is not the back (NaN where unknown)."""

    view: View
    labels: UInt8[ndarray, "_ _"]
    weights: Float[ndarray, "_ _"] | None = None
    joints: Float[ndarray, "18 4"] | None = None
    front_log_odds: float = float("nan")


def label_people(views: Sequence[View], classifier: Classifier, up: str | None = None) -> list[LabelledView]:
    """Views with the network's labels inside the person's mask; a view without a mask is labelled wherever it has
    depth.

    Args:
        up: the world's up axis if known (see ``Classifier.label_views``).
    """
    masks = [view.depth_m > 0 if view.mask is None else view.mask for view in views]
    return [
        LabelledView(view, *labels)
        for view, labels in zip(views, classifier.label_views(views, masks, up), strict=True)
    ]
