"""Cameras of recordings as sources, as fast as they are read or at their own speed."""

from __future__ import annotations

import threading
import time

from jaxtyping import UInt16
from numpy import ndarray

from depthmocap.capture.recording import Recording
from depthmocap.capture.source import CameraError, DepthFrame, DepthSource, NoFrame
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera


class Pace:
    """When frames are due: ``speed`` times as fast as they were taken, or at once if that is 0.

    Cameras that shall play in step share one.
    """

    def __init__(self, speed: float = 0.0) -> None:
        if not 0 <= speed < float("inf"):
            raise InputError(f"the speed must be a number of at least 0, got {speed}")
        self._speed = speed
        self._start: tuple[int, int] | None = None
        self._lock = threading.Lock()

    def wait(self, timestamp_ns: int, timeout_s: float) -> bool:
        """Wait until a frame is due; False when ``timeout_s`` was over before. The first frame ever is due at once."""
        if self._speed == 0:
            return True
        with self._lock:
            if self._start is None:
                self._start = (timestamp_ns, time.monotonic_ns())
            first_ns, begun_ns = self._start
        wait_s = ((timestamp_ns - first_ns) / self._speed - (time.monotonic_ns() - begun_ns)) / 1e9
        time.sleep(min(max(wait_s, 0), timeout_s))
        return wait_s <= timeout_s


class RecordedCamera(DepthSource):
    """One camera of a recording. A frame that cannot be read is left out, as if it had been lost."""

    patience_s = float("inf")  # a gap was recorded as it was
    reopens = False

    def __init__(self, recording: Recording, name: str, pace: Pace | None = None) -> None:
        """Raises CameraError when the recording has no such camera, or no frame of it."""
        super().__init__(name)
        if name not in recording.rig.names:
            raise CameraError(f"{recording.path} has no camera {name!r}: it has {', '.join(recording.rig.names)}")
        self.up = recording.up
        self._recording, self._pace = recording, pace or Pace()
        self._stamps = recording.stamps(name)
        if not self._stamps:
            raise CameraError(f"{recording.path} has no frames of camera {name!r}")
        self._next = 0

    @property
    def raw_background(self) -> UInt16[ndarray, "h w"] | None:
        return self._recording.raw_background(self.name)

    def _open(self) -> DepthCamera:
        self._next = 0
        return self._recording.rig[self.name]

    def _read(self, timeout_s: float) -> DepthFrame | None:
        while self._next < len(self._stamps):
            stamp = self._stamps[self._next]
            if not self._pace.wait(stamp, timeout_s):
                raise NoFrame(f"camera {self.name!r}: the next frame is not due yet")
            number, self._next = self._next, self._next + 1
            try:
                raw = self._recording.raw(self.name, stamp)
            except InputError as error:
                self.problems.append(str(error))
                continue
            timestamp_ns, clock = self._recording.device_time(self.name, stamp)
            return DepthFrame(self.name, raw, timestamp_ns, clock, time.monotonic_ns(), number)
        return None

    def _close(self) -> None:
        """Nothing is held open."""
