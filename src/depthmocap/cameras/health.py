"""Checks whether a frame comes from a working camera, by its timestamp and a few rows, in under a millisecond."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import UInt16
from numpy import ndarray

from depthmocap.geometry import DepthCamera

Fault = Literal["", "size", "dark", "noise", "frozen", "clock"]
#: The faults in words for the user.
FAULTS: dict[Fault, str] = {
    "size": "its frames are not of the size it was calibrated at; calibrate it again, or ask the device for that size",
    "dark": "no pixel has depth: is it covered, or too near to something?",
    "noise": "its depth is noise: check the cable and the USB port",
    "frozen": "it repeats one picture: reconnect it",
    "clock": "its time runs backwards or stands still: reconnect it",
}
#: The check looks at every eighth row only, to stay cheap.
ROW_STEP = 8
#: Neighbouring pixels whose depth differs by more (metres) belong to different surfaces.
EDGE_STEP_M = 0.3
#: If more than this share of the neighbours differ by ``EDGE_STEP_M``, the depth is noise and no surface.
NOISE_SHARE = 0.5
#: So many equal pictures in a row are a frozen stream: sensor noise makes even pictures of an empty room differ.
#: So many timestamps in a row that do not advance are a broken clock: a clock that was set back advances again, and a
#: frame that was delivered twice is followed by a new one.
MAX_REPEATS = 10


class HealthCheck:
    """Checks the frames of one camera in the order of their arrival."""

    def __init__(self, camera: DepthCamera) -> None:
        self._shape = (camera.height, camera.width)
        self._step = max(round(EDGE_STEP_M / camera.depth_unit_m), 1)
        self._last_rows: ndarray | None = None
        self._last_ns: int | None = None
        self._repeats = self._clock_stalls = 0

    def __call__(self, raw: UInt16[ndarray, "h w"], timestamp_ns: int) -> Fault:
        """What is wrong with a frame of raw depth and its time by the camera's clock; "" if nothing."""
        stalled = self._last_ns is not None and timestamp_ns <= self._last_ns
        self._clock_stalls = self._clock_stalls + 1 if stalled else 0
        self._last_ns = timestamp_ns
        if self._clock_stalls >= MAX_REPEATS:
            return "clock"
        if raw.shape != self._shape:
            return "size"
        rows = raw[::ROW_STEP]
        repeated = self._last_rows is not None and np.array_equal(rows, self._last_rows)
        self._repeats = self._repeats + 1 if repeated else 0
        self._last_rows = rows.copy()
        valid = (rows > 0) & (rows < 65535)
        if not valid.any() and not raw.any():
            return "dark"
        both = valid[:, 1:] & valid[:, :-1]
        edges = both & (np.abs(rows[:, 1:].astype(np.int32) - rows[:, :-1]) > self._step)
        if 2 * np.count_nonzero(both) > both.size and np.count_nonzero(edges) > NOISE_SHARE * np.count_nonzero(both):
            return "noise"
        return "frozen" if self._repeats >= MAX_REPEATS else ""
