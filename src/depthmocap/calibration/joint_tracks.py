"""Skeletons of several cameras on one line of time."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

#: Joints are interpolated between frames that are no more than so many periods of the camera apart.
_BRIDGE = 2.5


@dataclasses.dataclass(frozen=True, eq=False)
class Track:
    """A person as one camera sees them, frame by frame, in the camera's frame.

    Attributes:
        times_s: of the frames that show somebody, in order, by the recording's timestamps.
        joints: places (metres), NaN where unknown.
        sigma_m: the error to expect of each.
    """

    times_s: Float[ndarray, " t"]
    joints: Float[ndarray, "t 18 3"]
    sigma_m: Float[ndarray, "t 18"]

    def at(
        self, times_s: Float[ndarray, " n"], period_s: float
    ) -> tuple[Float[ndarray, "n 18 3"], Float[ndarray, "n 18"]]:
        """Joints and errors to expect at any times, interpolated; NaN where there are no frames around."""
        count, own = len(times_s), self.times_s
        if len(own) < 2:
            return np.full((count, *self.joints.shape[1:]), np.nan), np.full((count, self.sigma_m.shape[1]), np.nan)
        after = np.clip(np.searchsorted(own, times_s), 1, len(own) - 1)
        gap = own[after] - own[after - 1]
        share = (times_s - own[after - 1]) / gap
        share[(gap > _BRIDGE * period_s) | (share < 0) | (share > 1)] = np.nan
        later = share[:, None]
        joints = self.joints[after - 1] * (1 - later[..., None]) + self.joints[after] * later[..., None]
        return joints, self.sigma_m[after - 1] * (1 - later) + self.sigma_m[after] * later


@dataclasses.dataclass(frozen=True, eq=False)
class Skeletons:
    """Tracks of several cameras at common times, each in its camera's frame; NaN where a camera sees nobody."""

    times_s: Float[ndarray, " n"]
    joints: Float[ndarray, "c n 18 3"]
    sigma_m: Float[ndarray, "c n 18"]

    def velocities(self) -> Float[ndarray, "c n 18 3"]:
        """Of the joints (m/s), each in its camera's frame, by the moments before and after."""
        moved = np.full_like(self.joints, np.nan)
        moved[:, 1:-1] = self.joints[:, 2:] - self.joints[:, :-2]
        return moved / (2 * (self.times_s[1] - self.times_s[0]))


def common_times(tracks: Sequence[Track]) -> Float[ndarray, " n"]:
    """Even times (s) over all tracks, as many as the frames of the camera that has most."""
    seen = [track.times_s for track in tracks if len(track.times_s) > 1]
    period = min(float(np.median(np.diff(times_s))) for times_s in seen)
    first, last = min(float(t[0]) for t in seen), max(float(t[-1]) for t in seen)
    # Rounding must not push the ends beyond the frames there.
    return np.linspace(first, last, max(round((last - first) / period), 2) + 1)


def at_common_times(tracks: Sequence[Track], times_s: Float[ndarray, " n"], late_s: Float[ndarray, " c"]) -> Skeletons:
    """The tracks at common times, where each camera looks ``late_s`` later than its timestamps say."""
    found = []
    for track, late in zip(tracks, late_s, strict=True):
        period = float(np.median(np.diff(track.times_s))) if len(track.times_s) > 1 else 0.0
        found.append(track.at(times_s - late, period))
    return Skeletons(times_s, np.stack([joints for joints, _ in found]), np.stack([sigma for _, sigma in found]))
