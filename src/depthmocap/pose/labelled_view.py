"""A view with a region for every pixel: what classification hands to view aggregation."""

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
    """A view, its labels per pixel, the probabilities of those labels (None: the labels are true), and where the
    network takes the joints to be in the world, with the error to expect (metres; None or NaN: it does not tell)."""

    view: View
    labels: UInt8[ndarray, "_ _"]
    weights: Float[ndarray, "_ _"] | None = None
    joints: Float[ndarray, "18 4"] | None = None


def label_people(views: Sequence[View], classifier: Classifier, up: str | None = None) -> list[LabelledView]:
    """Views with what the network finds at the person's mask, or where there is none at every pixel with depth.

    Args:
        up: the world's up axis, where it is known (see ``Classifier.label_views``).
    """
    masks = [view.depth_m > 0 if view.mask is None else view.mask for view in views]
    return [
        LabelledView(view, *found) for view, found in zip(views, classifier.label_views(views, masks, up), strict=True)
    ]
