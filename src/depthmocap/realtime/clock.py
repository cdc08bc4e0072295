"""Offset and drift of a camera's clock against the host's, estimated while running from device and arrival times.

    arrival = (1 + drift) device + offset + delay,   delay ≥ 0

Delays are never negative and their spread is unknown, so a regression would follow their mean. The frames with the
least delay tell the clock. Of all lines under the pairs, the estimate is the one whose distances to them have the
smallest sum. This linear programme is solved by the edge of the lower convex hull at the mean time (Moon, Skelly and
Towsley, INFOCOM 1999). A camera's least delay cannot be estimated this way: it has to be given where cameras of
different makes differ in it by more than a few milliseconds.
"""

from __future__ import annotations

import collections

import numpy as np
from jaxtyping import Float
from numpy import ndarray

#: Length (seconds) of the intervals of which only the least delayed pair is kept.
STRETCH_S = 0.5
#: Number of these intervals that are kept.
STRETCHES = 240
#: The drift is fitted once the pairs span so many seconds; over a shorter span, delays would look like drift.
DRIFT_SPAN_S = 8.0
#: No clock has a larger drift (a ratio).
LARGEST_DRIFT = 0.002
#: A frame can only be further ahead of the line (seconds) if the clock jumped.
AHEAD_S = 0.008
#: The same while the pairs span less than ``DRIFT_SPAN_S``, when the line is still uncertain.
AHEAD_YOUNG_S = 0.05
#: A frame further behind the line (seconds) is late, or the clock jumped back.
BEHIND_S = 0.05
#: A frame further behind the line (seconds) is never only late.
FAR_BEHIND_S = 1.0
#: Frames less far behind must agree for so long (seconds) before they count as a jump.
BEHIND_FOR_S = 1.0
#: So many frames in a row must agree on a jump.
CONFIRMATIONS = 3
#: They must agree to within this (seconds).
AGREEMENT_S = 0.05
#: They must agree for at least so long (seconds), because delayed frames all arrive at once.
AGREEMENT_FOR_S = 0.06


class ClockTracker:
    """Converts a device's timestamps to host time. The relation is linear between jumps; a jump restarts the estimate.

    Attributes:
        restarts: number of jumps so far.
        went_back: whether the last of them was backwards.
    """

    def __init__(self) -> None:
        self.restarts, self.went_back = 0, False
        self._jump_pairs: list[tuple[float, int, int]] = []
        self._started = False

    @property
    def drift_ppm(self) -> float:
        """Drift of the host's clock against the device's, in millionths; 0 until the pairs span enough time."""
        return self._drift * 1e6 if self._started else 0.0

    @property
    def span_s(self) -> float:
        """Time span (seconds) of the pairs from which the clock is estimated."""
        return self._points[-1][0] - self._points[0][0] if self._started and self._points else 0.0

    def offset_s(self, device_ns: int) -> float:
        """Host time minus device time at a device timestamp, seconds.

        Raises:
            ValueError: before the first pair.
        """
        return (self.host_ns(device_ns) - device_ns) * 1e-9

    def host_ns(self, device_ns: int) -> int:
        """Host time of exposure of a device timestamp.

        Raises:
            ValueError: before the first pair.
        """
        if not self._started:
            raise ValueError("no pair of timestamps was given yet: call update first")
        since_s = (device_ns - self._device0) * 1e-9
        return self._arrival0 + (device_ns - self._device0) + round(self._line(since_s) * 1e9)

    def update(self, device_ns: int, arrival_ns: int) -> int | None:
        """Add a frame's times; returns its host time of exposure, or None while its clock seems to have jumped."""
        if not self._started:
            self._start(device_ns, arrival_ns)
            return self.host_ns(device_ns)
        # Differences of integers: nanoseconds since 1970 do not fit in a double.
        since_s = (device_ns - self._device0) * 1e-9
        delay_s = ((arrival_ns - self._arrival0) - (device_ns - self._device0)) * 1e-9
        late_s = delay_s - self._line(since_s)
        ahead_s = AHEAD_S if self.span_s >= DRIFT_SPAN_S else AHEAD_YOUNG_S
        if late_s < -ahead_s or late_s > BEHIND_S:
            if self._confirm_jump(late_s, device_ns, arrival_ns):
                return self.host_ns(device_ns)
            # Frames that are only late are used meanwhile; a frame from the future, or from long ago, is not.
            return self.host_ns(device_ns) if 0 < late_s < FAR_BEHIND_S else None
        self._jump_pairs.clear()
        self._add_pair(since_s, delay_s, late_s)
        return self.host_ns(device_ns)

    def _line(self, since_s: float) -> float:
        """Delay (seconds, relative to the first pair) of a frame with the least delay."""
        return self._base_s + self._drift * (since_s - self._about_s)

    def _start(self, device_ns: int, arrival_ns: int) -> None:
        self._device0, self._arrival0 = device_ns, arrival_ns
        self._base_s, self._drift, self._about_s = 0.0, 0.0, 0.0
        #: (time, delay) of the least delayed pair of each interval; the last interval is still open.
        self._points: collections.deque[tuple[float, float]] = collections.deque(maxlen=STRETCHES)
        self._points.append((0.0, 0.0))
        self._stretch, self._least_late_s = 0, 0.0
        self._jump_pairs.clear()
        self._started = True

    def _add_pair(self, since_s: float, delay_s: float, late_s: float) -> None:
        stretch = int(since_s // STRETCH_S)
        if stretch > self._stretch:
            self._refit()
            self._stretch, self._least_late_s = stretch, delay_s - self._line(since_s)
            self._points.append((since_s, delay_s))
        elif late_s < self._least_late_s and stretch == self._stretch:
            self._least_late_s = late_s
            self._points[-1] = (since_s, delay_s)
        if late_s < 0:  # the line stays under all pairs
            self._base_s = min(self._base_s, self._base_s + delay_s - self._line(since_s))

    def _refit(self) -> None:
        points = np.array(self._points)
        if self.span_s < DRIFT_SPAN_S:
            self._base_s, self._drift, self._about_s = float(points[:, 1].min()), 0.0, 0.0
            return
        self._about_s = float(points[:, 0].mean())
        self._base_s, drift = lower_edge(points, self._about_s)
        self._drift = float(np.clip(drift, -LARGEST_DRIFT, LARGEST_DRIFT))

    def _confirm_jump(self, late_s: float, device_ns: int, arrival_ns: int) -> bool:
        """Whether the latest doubtful frames agree that the clock jumped; if so, the estimate restarts from them."""
        if self._jump_pairs and abs(late_s - self._jump_pairs[0][0]) > AGREEMENT_S:
            self._jump_pairs.clear()
        self._jump_pairs.append((late_s, device_ns, arrival_ns))
        for_s = (arrival_ns - self._jump_pairs[0][2]) * 1e-9
        if len(self._jump_pairs) < CONFIRMATIONS:
            return False
        if for_s < (BEHIND_FOR_S if 0 < late_s < FAR_BEHIND_S else AGREEMENT_FOR_S):
            return False
        # Starts from the least delayed frame, so that the new line lies under as many as possible.
        _, device, arrival = min(self._jump_pairs, key=lambda suspect: suspect[0])
        self._start(device, arrival)
        self.restarts, self.went_back = self.restarts + 1, late_s > 0
        return True


def lower_edge(points: Float[ndarray, "n 2"], about: float) -> tuple[float, float]:
    """Height and slope of the points' lower convex hull at ``about``.

    The hull's height is the smallest height that any segment from a point on the left to one on the right has there.
    """
    left, right = points[points[:, 0] <= about], points[points[:, 0] > about]
    run = right[None, :, 0] - left[:, None, 0]
    rise = right[None, :, 1] - left[:, None, 1]
    height = left[:, None, 1] + rise / run * (about - left[:, None, 0])
    i, j = np.unravel_index(int(height.argmin()), height.shape)
    return float(height[i, j]), float(rise[i, j] / run[i, j])
