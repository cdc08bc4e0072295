"""Whether a frame can be of a working camera, told from its time and a few rows in a fraction of a millisecond."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import UInt16
from numpy import ndarray

from depthmocap.geometry import DepthCamera

Fault = Literal["", "size", "dark", "noise", "frozen", "clock"]
#: In words, for the user.
FAULTS: dict[Fault, str] = {
    "size": "its frames are not of the size it was calibrated at; calibrate it again, or ask the device for that size",
    "dark": "no pixel has depth: is it covered, or too near to something?",
    "noise": "its depth is noise: check the cable and the USB port",
    "frozen": "it repeats one picture: reconnect it",
    "clock": "its time runs backwards or stands still: reconnect it",
}
#: Every so many rows are looked at.
ROWS = 8
#: Neighbours further apart than this (metres) are of different surfaces; more than this share of them are of none.
STEP_M, TORN = 0.3, 0.5
#: The sensor's own noise makes even pictures of an empty room differ; so many equal ones in a row are stuck. So many
#: times in a row that do not advance are of no clock: one that was set back advances again, as does what came twice.
EQUAL = 10


class HealthCheck:
    """Looks at the frames of one camera, in the order of their arrival."""

    def __init__(self, camera: DepthCamera) -> None:
        self._shape = (camera.height, camera.width)
        self._step = max(round(STEP_M / camera.depth_unit_m), 1)
        self._last: ndarray | None = None
        self._last_ns: int | None = None
        self._equal = self._no_later = 0

    def __call__(self, raw: UInt16[ndarray, "h w"], timestamp_ns: int) -> Fault:
        """What is wrong with a frame of raw depth and its time by the camera's clock; "" if nothing."""
        self._no_later = self._no_later + 1 if self._last_ns is not None and timestamp_ns <= self._last_ns else 0
        self._last_ns = timestamp_ns
        if self._no_later >= EQUAL:
            return "clock"
        if raw.shape != self._shape:
            return "size"
        rows = raw[::ROWS]
        self._equal = self._equal + 1 if self._last is not None and np.array_equal(rows, self._last) else 0
        self._last = rows.copy()
        valid = (rows > 0) & (rows < 65535)
        if not valid.any() and not raw.any():
            return "dark"
        both = valid[:, 1:] & valid[:, :-1]
        torn = both & (np.abs(rows[:, 1:].astype(np.int32) - rows[:, :-1]) > self._step)
        if 2 * np.count_nonzero(both) > both.size and np.count_nonzero(torn) > TORN * np.count_nonzero(both):
            return "noise"
        return "frozen" if self._equal >= EQUAL else ""
