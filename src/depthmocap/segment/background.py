"""The empty scene before a camera that stands still: estimated from frames, and followed while it changes."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.kernels.segmentation import follow_background

#: The share of a pixel's depths that are nearer than its background; the rest outvote stray far readings.
FAR_QUANTILE = 0.88
#: A pixel has a background if it is valid in most frames, or if this share of frames agrees on a depth; otherwise the
#: room is out of range there, and what returns light is passing by.
MOSTLY_VALID, LEAST_AGREED = 0.7, 0.3
#: A person is nearer than the background by this, and by the noise of depth, which grows with its square.
MARGIN_M, MARGIN_PER_M = 0.04, 0.004
#: The limit where no background is known (metres): everything is before it.
FAR_M = np.float32(1e6)
#: The background is looked at so often (s); with every look it moves this share of the way to what is seen.
LOOK_S, RATE = 0.2, 0.03
#: So many looks that agree make a background: where none was known, farther than the known one, nearer than it.
NEEDS = (5, 8, 20)
#: A background is learnt when this share of the room's pixels is known.
LEARNT = 0.5
#: People's pixels, and those so near to them in the picture (pixels), tell nothing about the background.
NEAR_PEOPLE = 4


def estimate_background(samples_m: Sequence[Float[ndarray, "_ _"]]) -> Float[ndarray, "h w"]:
    """Empty scene (metres, float32, 0 = not known) from frames of one size with a person moving in them.

    Per pixel: the far quantile of its valid depths, then the mean of all depths that agree with it.
    """
    # uint16 mm: half the memory, and a sort several times as fast, for half a millimetre of rounding.
    stack = np.stack([np.clip(sample * 1000 + 0.5, 0, 65535).astype(np.uint16) for sample in samples_m], -1)
    height, width, count = stack.shape
    stack = np.sort(stack.reshape(-1, count), axis=1)  # invalid zeros first
    valid = np.count_nonzero(stack, axis=1)
    rank = count - valid + np.floor(FAR_QUANTILE * np.maximum(valid - 1, 0)).astype(np.intp)
    far = np.take_along_axis(stack, np.minimum(rank, count - 1)[:, None], 1).astype(np.float32)
    margin = 1000 * _margin_m(far / 1000)
    agree = (stack > far - margin) & (stack < far + margin) & (stack > 0)
    agreed = np.count_nonzero(agree, axis=1)
    background = np.where(agree, stack, 0).sum(1, dtype=np.float32) / np.maximum(agreed, 1) / 1000
    background[(valid < MOSTLY_VALID * count) & (agreed < LEAST_AGREED * count)] = 0
    return background.reshape(height, width).astype(np.float32)


def _margin_m(depth_m: Float[ndarray, "*shape"]) -> Float[ndarray, "*shape"]:
    return MARGIN_M + MARGIN_PER_M * depth_m * depth_m


def limit_m(background_m: Float[ndarray, "h w"]) -> Float[ndarray, "h w"]:
    """Depth below which a pixel is in front of the background; anything where the background is not known."""
    known = np.where(background_m > 0, background_m, FAR_M).astype(np.float32)
    # Pinholes take the nearest depth around them, or they would be specks of foreground in every frame.
    filled = np.where(known < FAR_M, known, cv2.erode(known, np.ones((5, 5), np.uint8)))
    return np.where(filled < FAR_M, filled - _margin_m(filled), FAR_M).astype(np.float32)


class Background:
    """One camera's empty scene over time.

    Attributes:
        limit_m: depth below which a pixel is in front of it; ``FAR_M`` where the room is out of range, and more where
            nothing is known yet.
        learning: whether hardly anything is known yet of what stands still.
    """

    def __init__(self, shape: tuple[int, int], background_m: Float[ndarray, "h w"] | None = None) -> None:
        """Begin with a known empty scene, or with none: then whatever stays where it is becomes the background."""
        known = np.zeros(shape) if background_m is None else background_m
        self.background_m = known.astype(np.float32)
        self._empty = (self.background_m == 0).astype(np.uint8)
        if background_m is None:
            self._empty[:] = 0
        self.limit_m = self._limit_m()
        self._other_m = np.zeros(shape, np.float32)
        self._age = np.zeros(shape, np.uint8)
        self.learning = background_m is None
        self._looked_ns: int | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the pictures."""
        rows, columns = self.limit_m.shape
        return rows, columns

    def is_due(self, timestamp_ns: int) -> bool:
        """Whether it is time for another look. Time that goes back begins anew."""
        return self._looked_ns is None or not 0 <= timestamp_ns - self._looked_ns < LOOK_S * 1e9

    def look(self, depth_m: Float[ndarray, "h w"], people: Bool[ndarray, "h w"], timestamp_ns: int) -> None:
        """Learn from a frame in which these pixels are people's."""
        self._looked_ns = timestamp_ns
        size = 2 * NEAR_PEOPLE + 1
        occupied = cv2.dilate(people.view(np.uint8), np.ones((size, size), np.uint8))
        follow_background(
            depth_m, occupied, self.background_m, self._empty, self._other_m, self._age, NEEDS, MARGIN_M, MARGIN_PER_M,
            RATE,
        )  # fmt: skip
        self.limit_m = self._limit_m()
        if self.learning:
            room = (depth_m > 0) & (occupied == 0)
            self.learning = bool(np.count_nonzero(room & (self.background_m > 0)) < LEARNT * np.count_nonzero(room))

    def _limit_m(self) -> Float[ndarray, "h w"]:
        limit = limit_m(self.background_m)
        limit[(limit >= FAR_M) & (self._empty == 0)] = 2 * FAR_M
        return limit
