"""Where a take is played: the instant that is shown, and how it goes on with time."""

from __future__ import annotations

import threading

import numpy as np
from jaxtyping import Float
from numpy import ndarray

SPEEDS = ("0.1×", "0.25×", "0.5×", "1×", "2×", "4×", "8×")


class TakePlayer:
    """The instant that is shown. Any thread may change it; :meth:`wait` gives it to the one thread that draws."""

    def __init__(self, times_s: Float[ndarray, " t"]) -> None:
        """``times_s`` are the instants of the take in order."""
        self._times_s = times_s
        self._changed = threading.Condition()
        self._position_s, self._playing, self._again, self._stopped = float(times_s[0]), False, True, False
        self.speed, self.loop = 1.0, True

    @property
    def index(self) -> int:
        """The instant that is shown."""
        return max(int(np.searchsorted(self._times_s, self._position_s + 1e-9, side="right")) - 1, 0)

    @property
    def playing(self) -> bool:
        """Whether time goes on."""
        return self._playing

    @property
    def stopped(self) -> bool:
        """Whether nothing is to be drawn any more."""
        return self._stopped

    def set_times(self, times_s: Float[ndarray, " t"], index: int) -> None:
        """Go on with another timeline, at this instant of it."""
        with self._changed:
            self._times_s = times_s
        self.go_to(index)

    def play(self, playing: bool) -> None:
        """Start or stop; from the end it starts again."""
        with self._changed:
            if playing and self._position_s >= self._times_s[-1]:
                self._position_s = float(self._times_s[0])
            self._playing = playing
            self._changed.notify_all()

    def go_to(self, index: int) -> None:
        """Show an instant, the first or last if there is none of this number."""
        with self._changed:
            self._position_s = float(self._times_s[min(max(index, 0), len(self._times_s) - 1)])
            self._again = True
            self._changed.notify_all()

    def step(self, by: int) -> None:
        """Stop, and show the instant so many further on."""
        self.play(False)
        self.go_to(self.index + by)

    def redraw(self) -> None:
        """Draw the same instant again."""
        with self._changed:
            self._again = True
            self._changed.notify_all()

    def stop(self) -> None:
        """Let the thread that draws end."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def advance(self, seconds: float) -> None:
        """Let time go on by so many seconds of the clock on the wall."""
        with self._changed:
            self._position_s += seconds * self.speed
            first_s, last_s = float(self._times_s[0]), float(self._times_s[-1])
            if self._position_s > last_s:
                self._playing = self.loop and last_s > first_s
                self._position_s = first_s if self._playing else last_s

    def wait(self, seconds: float) -> bool:
        """Wait until something is to be drawn anew, at most so long; returns whether a user wants it."""
        with self._changed:
            self._changed.wait_for(lambda: self._again or self._stopped or self._playing, seconds)
            again, self._again = self._again, False
            return again
