"""Background model of a static camera: the empty scene's depth, estimated from frames and updated while it changes."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from depthmocap.kernels.segmentation import fill_unknown, limits_of, update_background

#: Quantile of a pixel's depths that is its background: high, as people are nearer, but not 1, because of far outliers.
FAR_QUANTILE = 0.88
#: A pixel that is valid in this share of the frames has a background.
MOSTLY_VALID = 0.7
#: So has a pixel where this share of the frames agrees on a depth. Other pixels show people in front of a room that is
#: out of range.
LEAST_AGREED = 0.3
#: A person is nearer than the background by at least this (metres)
MARGIN_M = 0.04
#: plus this times the squared depth (1/metres), as depth noise grows.
MARGIN_PER_M = 0.004
#: The foreground limit (metres) where no background is known: every depth is in front of it.
FAR_M = np.float32(1e6)
#: Time between updates of the background (seconds).
UPDATE_PERIOD_S = 0.2
#: Share of the difference to a measured depth by which an update moves the background: follows drift, ignores noise.
DRIFT_SHARE = 0.03
#: Updates that must agree on a new background depth: where none is known, where it is farther, and where it is nearer
#: than the known one. Nearer takes longest, because it may be a person who stands still.
UPDATES_NEEDED = (5, 8, 20)
#: Share of the room's pixels with a known background from which a model counts as learnt.
LEARNT_SHARE = 0.5
#: Pixels this near to a person's pixels (pixels) do not update the background: silhouettes are noisy.
PEOPLE_MARGIN_PX = 4
_MARGINS = np.float32(MARGIN_M), np.float32(MARGIN_PER_M)
#: An unknown pixel whose neighbours this near (pixels) are known is a pinhole.
_AROUND = np.ones((5, 5), np.uint8)


def estimate_background(samples_m: Sequence[Float[ndarray, "_ _"]]) -> Float[ndarray, "h w"]:
    """Empty scene (metres, float32, 0 = unknown) from frames of one size in which a person moves.

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


def foreground_limit(background_m: Float[ndarray, "h w"]) -> Float[ndarray, "h w"]:
    """Depth (metres) below which a pixel is foreground; ``FAR_M`` where the background is unknown."""
    return _limits(np.ascontiguousarray(background_m, np.float32), np.ones(background_m.shape, np.uint8))


def _limits(background_m: Float[ndarray, "h w"], out_of_range: UInt8[ndarray, "h w"]) -> Float[ndarray, "h w"]:
    """The foreground limit (metres). Pinholes take the nearest depth around them: otherwise they would be specks of
    foreground in every frame."""
    filled_m, limit_m = np.empty_like(background_m), np.empty_like(background_m)
    fill_unknown(background_m, FAR_M, filled_m)
    limits_of(filled_m, cv2.erode(filled_m, _AROUND), out_of_range, *_MARGINS, FAR_M, limit_m)
    return limit_m


class BackgroundModel:
    """One camera's empty scene over time.

    Attributes:
        background_m: (h, w) depth of the empty scene (metres), 0 where it is unknown.
        limit_m: (h, w) depth (metres) below which a pixel is foreground; ``FAR_M`` where the room is out of range,
            twice that where nothing is known yet.
        learning: whether less than ``LEARNT_SHARE`` of the room is known.
    """

    def __init__(self, shape: tuple[int, int], background_m: Float[ndarray, "h w"] | None = None) -> None:
        """Start from a known empty scene, or from none: then whatever does not move becomes the background."""
        self.background_m = (np.zeros(shape) if background_m is None else background_m).astype(np.float32)
        self._out_of_range = (self.background_m == 0).astype(np.uint8)
        if background_m is None:
            self._out_of_range[:] = 0
        self.limit_m = self._limit_m()
        self._candidate_m = np.zeros(shape, np.float32)
        self._candidate_updates = np.zeros(shape, np.uint8)
        self.learning = background_m is None
        self._updated_ns: int | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the depth images."""
        rows, columns = self.limit_m.shape
        return rows, columns

    def is_due(self, timestamp_ns: int) -> bool:
        """Whether it is time for an update. A timestamp before the last one makes it due at once."""
        return self._updated_ns is None or not 0 <= timestamp_ns - self._updated_ns < UPDATE_PERIOD_S * 1e9

    def update(self, depth_m: Float[ndarray, "h w"], people: Bool[ndarray, "h w"], timestamp_ns: int) -> None:
        """Update from a frame.

        Args:
            depth_m: depth (metres), 0 where invalid.
            people: mask of all people; the background is not updated there.
            timestamp_ns: of the frame.
        """
        self._updated_ns = timestamp_ns
        size = 2 * PEOPLE_MARGIN_PX + 1
        occupied = cv2.dilate(people.view(np.uint8), np.ones((size, size), np.uint8))
        update_background(
            depth_m, occupied, self.background_m, self._out_of_range, self._candidate_m, self._candidate_updates,
            UPDATES_NEEDED, MARGIN_M, MARGIN_PER_M, DRIFT_SHARE,
        )  # fmt: skip
        self.limit_m = self._limit_m()
        if self.learning:
            room = (depth_m > 0) & (occupied == 0)
            known = np.count_nonzero(room & (self.background_m > 0))
            self.learning = bool(known < LEARNT_SHARE * np.count_nonzero(room))

    def _limit_m(self) -> Float[ndarray, "h w"]:
        return _limits(self.background_m, self._out_of_range)
