"""What pixel accuracy hides of labels: whole limbs on the wrong side, how much of what is wrong lies at the borders of
regions, and probabilities that promise too much."""

from __future__ import annotations

import dataclasses
import itertools

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Integer, UInt8
from numpy import ndarray

from depthmocap.body.regions import REGION, REGION_COUNT

_ARM = ("upper arm", "elbow", "forearm", "wrist", "hand")
_LEG = ("thigh", "knee", "shin", "ankle", "forefoot")
_FRONT = ("chest", "belly", "shoulder front")
_BACK = ("upper back", "lower back", "shoulder back")


def _regions(names: tuple[str, ...], sides: str) -> list[int]:
    return [REGION[f"{name} {side}"] for name in names for side in sides]


#: Each part of the body: its regions, each group of them with the regions that they are swapped with.
_PARTS: dict[str, list[tuple[list[int], list[int]]]] = {
    **{
        f"{name} {side}": [(_regions(names, side), _regions(names, other))]
        for name, names in (("arm", _ARM), ("leg", _LEG))
        for side, other in ("RL", "LR")
    },
    "torso, left for right": [
        (_regions(_FRONT + _BACK, side), _regions(_FRONT + _BACK, other)) for side, other in ("RL", "LR")
    ],
    "torso, front for back": [
        (_regions(names, "RL"), _regions(others, "RL")) for names, others in ((_FRONT, _BACK), (_BACK, _FRONT))
    ],
}
PARTS = tuple(_PARTS)
#: By part, true region and predicted region: 1 where the true one is of the part, and where they are swapped.
_OF_PART, _SWAPPED = np.zeros((2, len(PARTS), REGION_COUNT + 1, REGION_COUNT + 1), dtype=np.int64)
for _part, _groups in enumerate(_PARTS.values()):
    for _group, _opposite in _groups:
        _OF_PART[_part, _group] = 1
        _SWAPPED[_part][np.ix_(_group, _opposite)] = 1
#: A part of which a window shows fewer labelled pixels is not judged.
LEAST_PIXELS = 60


def _no_counts() -> Int[ndarray, " parts"]:
    return np.zeros(len(PARTS), dtype=np.int64)


@dataclasses.dataclass(eq=False)
class PartSwaps:
    """Parts of the body that are labelled as their opposite: left for right, front for back.

    A part that a view shows (with at least ``LEAST_PIXELS`` labelled pixels) is swapped where more than half of those
    are given regions of the opposite part: of the other arm, of the torso's other side, of its back for its front. A
    back taken for a front is swapped in both ways, since its sides change as well.
    """

    views: int = 0
    #: Views with any part swapped.
    swapped_views: int = 0
    #: By part, in the order of ``PARTS``: views that show it, and those of them that swap it.
    shown: Int[ndarray, " parts"] = dataclasses.field(default_factory=_no_counts)
    swapped: Int[ndarray, " parts"] = dataclasses.field(default_factory=_no_counts)

    def add(self, labels_true: Integer[ndarray, "*n"], labels_predicted: Integer[ndarray, "*n"]) -> bool:
        """Count one view, of any shape; pixels whose true region is not 1–43 are left out. Tells whether it swaps."""
        counted = (labels_true >= 1) & (labels_true <= REGION_COUNT)
        classes = REGION_COUNT + 1
        pairs = labels_true[counted].astype(np.int64) * classes + labels_predicted[counted]
        confusion = np.bincount(pairs, minlength=classes**2).reshape(classes, classes)
        total, opposite = ((table * confusion).sum((1, 2)) for table in (_OF_PART, _SWAPPED))
        shown = total >= LEAST_PIXELS
        swapped = shown & (2 * opposite > total)
        self.views += 1
        self.swapped_views += int(swapped.any())
        self.shown += shown
        self.swapped += swapped
        return bool(swapped.any())

    @property
    def per_1000_views(self) -> float:
        """Of a thousand views, those with any part swapped; NaN without views."""
        return 1000 * self.swapped_views / self.views if self.views else float("nan")


#: Pixels are told apart by how many pixels the next border of a region is away: less than these, or more.
BORDER_PX = (1, 2, 4, 8)


def _no_rings() -> Int[ndarray, " rings"]:
    return np.zeros(len(BORDER_PX) + 1, dtype=np.int64)


@dataclasses.dataclass(eq=False)
class BorderAccuracy:
    """Pixels labelled right by their distance from the nearest border between two true regions, as the trimaps of
    semantic segmentation tell it (Kohli et al., "Robust higher order potentials", CVPR 2008).

    A pixel beside one of another region is 0 away. The silhouette is no border.
    """

    #: By distance: pixels, and those labelled right.
    pixels: Int[ndarray, " rings"] = dataclasses.field(default_factory=_no_rings)
    right: Int[ndarray, " rings"] = dataclasses.field(default_factory=_no_rings)

    def add(
        self, labels_true: UInt8[ndarray, "h w"], labels_predicted: UInt8[ndarray, "h w"], counted: Bool[ndarray, "h w"]
    ) -> None:
        """Count the ``counted`` pixels of a window."""
        known = (labels_true >= 1) & (labels_true <= REGION_COUNT)
        at_border = np.zeros(labels_true.shape, bool)
        for here, there in (
            ((slice(None), slice(1, None)), (slice(None), slice(None, -1))),
            ((slice(1, None), slice(None)), (slice(None, -1), slice(None))),
        ):
            differ = known[here] & known[there] & (labels_true[here] != labels_true[there])
            at_border[here] |= differ
            at_border[there] |= differ
        if at_border.any():
            distance = cv2.distanceTransform((~at_border).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        else:
            distance = np.full(labels_true.shape, np.inf)
        ring = np.digitize(distance[counted], BORDER_PX)
        hit = labels_true[counted] == labels_predicted[counted]
        self.pixels += np.bincount(ring, minlength=len(self.pixels))
        self.right += np.bincount(ring[hit], minlength=len(self.right))

    @property
    def rows(self) -> list[tuple[str, float, float]]:
        """Of every distance that occurs: its name, its share of all pixels, and the share of them labelled right."""
        edges = (0, *BORDER_PX)
        names = [f"{low} to {high}" for low, high in itertools.pairwise(edges)] + [f"{edges[-1]} and more"]
        total = self.pixels.sum()
        return [
            (name, float(pixels / total), float(right / pixels))
            for name, pixels, right in zip(names, self.pixels, self.right, strict=True)
            if pixels
        ]


_BINS = 20


def _no_sums() -> Float[ndarray, " bins"]:
    return np.zeros(_BINS)


@dataclasses.dataclass(eq=False)
class Calibration:
    """How often pixels of a probability are right (reliability diagram), in 20 bins of equal width."""

    pixels: Float[ndarray, " bins"] = dataclasses.field(default_factory=_no_sums)
    #: Sums of the probabilities, and of the pixels labelled right.
    confidence: Float[ndarray, " bins"] = dataclasses.field(default_factory=_no_sums)
    right: Float[ndarray, " bins"] = dataclasses.field(default_factory=_no_sums)

    def add(self, confidence: Float[ndarray, "*n"], right: Bool[ndarray, "*n"]) -> None:
        """Count pixels with the probability (0–1) of their label, and whether it is the true one."""
        flat = confidence.ravel().astype(np.float64)
        place = np.minimum((flat * _BINS).astype(np.intp), _BINS - 1)
        self.pixels += np.bincount(place, minlength=_BINS)
        self.confidence += np.bincount(place, flat, minlength=_BINS)
        self.right += np.bincount(place, right.ravel(), minlength=_BINS)

    @property
    def error(self) -> float:
        """Expected calibration error (0–1): the mean, over pixels, of the distance between a bin's probability and its
        share of right labels; NaN without pixels."""
        total = self.pixels.sum()
        return float(np.abs(self.confidence - self.right).sum() / total) if total else float("nan")

    @property
    def rows(self) -> list[tuple[int, float, float]]:
        """Of every bin that holds pixels: how many, their mean probability, the share labelled right."""
        kept = self.pixels > 0
        columns = self.pixels[kept], self.confidence[kept] / self.pixels[kept], self.right[kept] / self.pixels[kept]
        return [(int(n), float(p), float(share)) for n, p, share in zip(*columns, strict=True)]
