"""A camera of a recording as a source, as fast as it is read or at its own speed."""

from __future__ import annotations

import time

from depthmocap.capture.recording import Recording
from depthmocap.capture.source import CameraError, DepthFrame, DepthSource, NoFrame
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera


class RecordedCamera(DepthSource):
    """One camera of a recording. A frame that cannot be read is left out, as if it had been lost."""

    def __init__(
        self, recording: Recording, name: str, realtime: bool = False, start_ns: int | None = None, speed: float = 1.0
    ) -> None:
        """``realtime`` gives each frame when it is due, ``speed`` times as fast as it was recorded.

        Cameras that shall play in step take the same ``start_ns``: the host time (``time.monotonic_ns``) at which the
        recording's first set is due, by default when the camera is opened.

        Raises:
            CameraError: when the recording has no such camera, or no frame of it.
        """
        super().__init__(name)
        if name not in recording.rig.names:
            raise CameraError(f"{recording.path} has no camera {name!r}: it has {', '.join(recording.rig.names)}")
        self._recording, self._realtime, self._start_ns, self._speed = recording, realtime, start_ns, speed
        self._stamps = recording.stamps(name)
        if not self._stamps:
            raise CameraError(f"{recording.path} has no frames of camera {name!r}")
        self._origin_ns = min(min(recording.stamps(each), default=self._stamps[0]) for each in recording.rig.names)
        self._next = 0

    def _open(self) -> DepthCamera:
        self._next = 0
        self._zero_ns = time.monotonic_ns() if self._start_ns is None else self._start_ns
        return self._recording.rig[self.name]

    def _read(self, timeout_s: float) -> DepthFrame | None:
        while self._next < len(self._stamps):
            stamp = self._stamps[self._next]
            if self._realtime:
                due_ns = self._zero_ns + round((stamp - self._origin_ns) / self._speed)
                wait_s = (due_ns - time.monotonic_ns()) / 1e9
                if wait_s > timeout_s:
                    time.sleep(timeout_s)
                    raise NoFrame(f"camera {self.name!r}: the next frame is due in {wait_s - timeout_s:.1f} s")
                time.sleep(max(wait_s, 0))
            number, self._next = self._next, self._next + 1
            try:
                raw = self._recording.raw(self.name, stamp)
            except InputError:
                continue
            timestamp_ns, clock = self._recording.device_time(self.name, stamp)
            return DepthFrame(self.name, raw, timestamp_ns, clock, time.monotonic_ns(), number)
        return None

    def _close(self) -> None:
        """Nothing is held open."""
