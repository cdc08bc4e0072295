"""Notices a camera that is moved while it runs, by the room: what stood still before it is elsewhere for it alone.

A bump of some centimetres or degrees changes the depth of most of a picture, by more than sensors waver; people and
what they move change a part of it. No other camera is needed, so that the one that was moved is told even of two.
"""

from __future__ import annotations

import collections

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.frames import View

#: Pictures are compared over windows of this length (ns),
WINDOW_NS = 2_500_000_000
#: by so many pictures or fewer,
_PICTURES = 10
#: at so many columns.
_COLUMNS = 48
#: A window is compared with at least so many before it,
_LEAST_BEFORE = 4
#: and at most with so many.
_MOST_BEFORE = 24
#: So many windows together must tell of a move.
_WINDOWS = 2
#: Depth that mostly stays within this over the windows before is still (metres),
_STILL_M = 0.004
#: and per squared metre of depth,
_STILL_PER_M2 = 0.0006
#: and has changed if it differs by more than this (metres),
_CHANGED_M = 0.01
#: and by so many times what it wavered.
_WAVERS = 6.0
#: What is nearer or farther by more than this (metres) is somebody or something that came before it, or went away; what
#: is nearer than what was ever seen behind it came, and may go on.
_CAME_M = 0.25
#: A camera was moved if this share of what was still has changed,
MOVED_SHARE = 0.12
#: counted in at least this share of it
_LEAST_SEEN = 0.3
#: and so many samples.
_LEAST_STILL = 120


class SceneWatch:
    """Watches one camera's room."""

    def __init__(self) -> None:
        self._pictures: list[Float[ndarray, "rows columns"]] = []
        self._start_ns: int | None = None
        self._seen_ns: int | None = None
        self._farthest_m: Float[ndarray, "rows columns"] | None = None
        self._windows: collections.deque[Float[ndarray, "rows columns"]] = collections.deque(
            maxlen=_MOST_BEFORE + _WINDOWS
        )

    def __call__(self, view: View, timestamp_ns: int) -> float | None:
        """Add a view. If the camera was moved, the share of the still scene that has changed; it is told once."""
        if self._start_ns is None or not 0 <= timestamp_ns - self._start_ns < 4 * WINDOW_NS:
            self._pictures.clear()
            self._start_ns, self._seen_ns = timestamp_ns, None
        if self._seen_ns is None or timestamp_ns - self._seen_ns >= WINDOW_NS / _PICTURES:
            step = max(view.depth_m.shape[1] // _COLUMNS, 1)
            self._pictures.append(view.depth_m[::step, ::step].copy())
            self._seen_ns = timestamp_ns
        if timestamp_ns - self._start_ns < WINDOW_NS:
            return None
        window = _median(self._pictures)
        self._pictures.clear()
        self._start_ns = self._seen_ns = None
        if self._windows and self._windows[0].shape != window.shape:
            self._start_anew()
        self._windows.append(window)
        if len(self._windows) > _WINDOWS:
            older = self._windows[-1 - _WINDOWS]
            self._farthest_m = older if self._farthest_m is None else np.maximum(self._farthest_m, older)
        share = self._changed()
        if share is None or share < MOVED_SHARE:
            return None
        self._start_anew()  # what comes next is compared with what is now
        return share

    def _start_anew(self) -> None:
        self._windows.clear()
        self._farthest_m = None

    def _changed(self) -> float | None:
        """Least share of the still scene that has changed in each of the last windows; None where it is not known."""
        windows = np.stack(self._windows)
        before, last = windows[:-_WINDOWS], windows[-_WINDOWS:]
        if len(before) < _LEAST_BEFORE or self._farthest_m is None:
            return None
        known = (before > 0).sum(0) >= 0.75 * len(before)
        was_m = _median(list(before))
        wavered_m = _median([np.where(window_m > 0, np.abs(window_m - was_m) + 1e-6, 0) for window_m in before])
        known &= was_m > self._farthest_m - _CAME_M
        still = known & (was_m > 0) & (wavered_m < _STILL_M + _STILL_PER_M2 * was_m**2)
        shares = []
        for window in last:
            known_now = still & (window > 0)
            came, went = known_now & (window < was_m - _CAME_M), known_now & (window > was_m + _CAME_M)
            seen = known_now & ~came & ~went
            knocked = min(came.sum(), went.sum()) > MOVED_SHARE * still.sum()  # little is left to compare
            if seen.sum() < max(_LEAST_STILL, 0 if knocked else _LEAST_SEEN * still.sum()):
                return None
            changed = np.abs(window - was_m) > np.maximum(_CHANGED_M, _WAVERS * wavered_m)
            shares.append(float((changed & seen).sum() / seen.sum()))
        return min(shares)


def _median(pictures: list[Float[ndarray, "rows columns"]]) -> Float[ndarray, "rows columns"]:
    """Median depth where most pictures have one, 0 elsewhere."""
    stack = np.sort(np.stack(pictures), axis=0)  # unknown zeros first
    valid = np.count_nonzero(stack, axis=0)
    index = len(stack) - valid + valid // 2
    median = np.take_along_axis(stack, np.minimum(index, len(stack) - 1)[None], 0)[0]
    return np.where(valid > len(stack) / 2, median, 0.0)
