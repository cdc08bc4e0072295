"""A camera's clock against the host's, estimated on the run from pairs of device timestamp and arrival.

    arrival = (1 + drift) device + offset + delay,   delay ≥ 0

Delays are one-sided and of unknown spread, so a regression would follow their mean; the frames that came through at
once tell the clock. Of all lines under the pairs, the one nearest to them in sum is taken: a linear programme whose
solution is the edge of the lower convex hull over the mean time (Moon, Skelly and Towsley, INFOCOM 1999). The least
delay of a camera cannot be seen this way: where cameras of different makes differ by more than some milliseconds in it,
it has to be given.
"""

from __future__ import annotations

import collections

import numpy as np
from jaxtyping import Float
from numpy import ndarray

#: One pair, the least delayed, is kept of each stretch of this length (seconds), for the last so many stretches.
STRETCH_S = 0.5
STRETCHES = 240
#: The drift is fitted once the pairs span so many seconds; over less, delays would pass for drift.
DRIFT_SPAN_S = 8.0
#: Larger drifts (a share of one) are no clock's.
LARGEST_DRIFT = 0.002
#: A frame this much (seconds) ahead of the line cannot be: the clock jumped, or the line is still young.
AHEAD_S, AHEAD_YOUNG_S = 0.008, 0.05
#: Behind the line a frame may be late. It is a jump if frames agree on it for a while, or if it is this large.
BEHIND_S, FAR_BEHIND_S = 0.05, 1.0
BEHIND_FOR_S = 1.0
#: So many frames in a row must agree on a jump, to within this, for at least this long (seconds): frames that were held
#: up come all at once.
CONFIRMATIONS, AGREEMENT_S, AGREEMENT_FOR_S = 3, 0.05, 0.06


class ClockTracker:
    """Host time of a device's timestamps. Time is linear between restarts; a clock that jumps starts anew.

    Attributes:
        restarts: jumps found so far.
        went_back: whether the last of them was backwards.
    """

    def __init__(self) -> None:
        self.restarts, self.went_back = 0, False
        self._suspects: list[tuple[float, int, int]] = []
        self._begun = False

    @property
    def drift_ppm(self) -> float:
        """How much the host gains on the device, in millionths; 0 until enough was seen."""
        return self._drift * 1e6 if self._begun else 0.0

    @property
    def span_s(self) -> float:
        """Seconds of pairs that the estimate rests on."""
        return self._points[-1][0] - self._points[0][0] if self._begun and self._points else 0.0

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
        if not self._begun:
            raise ValueError("no pair of timestamps was given yet: call update first")
        since_s = (device_ns - self._device0) * 1e-9
        return self._arrival0 + (device_ns - self._device0) + round(self._line(since_s) * 1e9)

    def update(self, device_ns: int, arrival_ns: int) -> int | None:
        """Take one frame's pair; gives its host time of exposure, or None while its clock seems to have jumped."""
        if not self._begun:
            self._start(device_ns, arrival_ns)
            return self.host_ns(device_ns)
        # Differences of integers: nanoseconds since 1970 do not fit in a double.
        since_s = (device_ns - self._device0) * 1e-9
        delay_s = ((arrival_ns - self._arrival0) - (device_ns - self._device0)) * 1e-9
        late_s = delay_s - self._line(since_s)
        ahead_s = AHEAD_S if self.span_s >= DRIFT_SPAN_S else AHEAD_YOUNG_S
        if late_s < -ahead_s or late_s > BEHIND_S:
            if self._jumped(late_s, device_ns, arrival_ns):
                return self.host_ns(device_ns)
            # Late frames are believed meanwhile; a frame from the future, or from long ago, is not.
            return self.host_ns(device_ns) if 0 < late_s < FAR_BEHIND_S else None
        self._suspects.clear()
        self._take(since_s, delay_s, late_s)
        return self.host_ns(device_ns)

    def _line(self, since_s: float) -> float:
        """Delay (seconds, relative to the first pair) of a frame that comes through at once."""
        return self._base_s + self._drift * (since_s - self._about_s)

    def _start(self, device_ns: int, arrival_ns: int) -> None:
        self._device0, self._arrival0 = device_ns, arrival_ns
        self._base_s, self._drift, self._about_s = 0.0, 0.0, 0.0
        #: (time, delay) of the least delayed pair of each stretch; the last one is still open.
        self._points: collections.deque[tuple[float, float]] = collections.deque(maxlen=STRETCHES)
        self._points.append((0.0, 0.0))
        self._stretch, self._least_late_s = 0, 0.0
        self._suspects.clear()
        self._begun = True

    def _take(self, since_s: float, delay_s: float, late_s: float) -> None:
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

    def _jumped(self, late_s: float, device_ns: int, arrival_ns: int) -> bool:
        """Whether the frames since the clock was last believed agree that it jumped; then it starts anew with them."""
        if self._suspects and abs(late_s - self._suspects[0][0]) > AGREEMENT_S:
            self._suspects.clear()
        self._suspects.append((late_s, device_ns, arrival_ns))
        for_s = (arrival_ns - self._suspects[0][2]) * 1e-9
        if len(self._suspects) < CONFIRMATIONS:
            return False
        if for_s < (BEHIND_FOR_S if 0 < late_s < FAR_BEHIND_S else AGREEMENT_FOR_S):
            return False
        # The least delayed of them, so that the new line starts under as many as possible.
        _, device, arrival = min(self._suspects, key=lambda suspect: suspect[0])
        self._start(device, arrival)
        self.restarts, self.went_back = self.restarts + 1, late_s > 0
        return True


def lower_edge(points: Float[ndarray, "n 2"], about: float) -> tuple[float, float]:
    """Height at ``about`` and slope of the edge of the points' lower convex hull there.

    The hull's height is the least that any segment between a point on the left and one on the right has there.
    """
    left, right = points[points[:, 0] <= about], points[points[:, 0] > about]
    run = right[None, :, 0] - left[:, None, 0]
    rise = right[None, :, 1] - left[:, None, 1]
    height = left[:, None, 1] + rise / run * (about - left[:, None, 0])
    i, j = np.unravel_index(int(height.argmin()), height.shape)
    return float(height[i, j]), float(rise[i, j] / run[i, j])
