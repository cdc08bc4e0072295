"""The playback time of recorded and synthetic frames."""

from __future__ import annotations

import threading
import time

from depthmocap.errors import InputError


class PlaybackClock:
    """Tells when frames are due: ``speed`` times as fast as they were taken, or at once if ``speed`` is 0.

    Cameras that play in step share one clock.
    """

    def __init__(self, speed: float = 0.0) -> None:
        if not 0 <= speed < float("inf"):
            raise InputError(f"the speed must be a number of at least 0, got {speed}")
        self._speed = speed
        self._start: tuple[int, int] | None = None
        self._lock = threading.Lock()

    def wait(self, timestamp_ns: int, timeout_s: float) -> bool:
        """Wait until a frame is due; False if ``timeout_s`` passes first. The first frame is due at once."""
        if self._speed == 0:
            return True
        with self._lock:
            if self._start is None:
                self._start = (timestamp_ns, time.monotonic_ns())
            first_ns, begun_ns = self._start
        wait_s = ((timestamp_ns - first_ns) / self._speed - (time.monotonic_ns() - begun_ns)) / 1e9
        time.sleep(min(max(wait_s, 0), timeout_s))
        return wait_s <= timeout_s
