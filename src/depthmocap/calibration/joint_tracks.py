"""The skeletons of several cameras at common times."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

#: Joints are interpolated over at most this many frame periods of the camera.
_MAX_GAP_PERIODS = 2.5


@dataclasses.dataclass(frozen=True, eq=False)
class JointTrack:
    """The person's joints estimated from one camera alone, frame by frame, in the camera's frame.

    Attributes:
        times_s: timestamps of the frames with a person, in order.
        joints: positions (metres), NaN where unknown.
        sigma_m: expected error of each joint (metres).
    """

    times_s: Float[ndarray, " t"]
    joints: Float[ndarray, "t 18 3"]
    sigma_m: Float[ndarray, "t 18"]

    def interpolate(
        self, times_s: Float[ndarray, " n"], period_s: float
    ) -> tuple[Float[ndarray, "n 18 3"], Float[ndarray, "n 18"]]:
        """Joints and expected errors interpolated at any times; NaN where no frames are near."""
        count, frame_times_s = len(times_s), self.times_s
        if len(frame_times_s) < 2:
            return np.full((count, *self.joints.shape[1:]), np.nan), np.full((count, self.sigma_m.shape[1]), np.nan)
        after = np.clip(np.searchsorted(frame_times_s, times_s), 1, len(frame_times_s) - 1)
        gap = frame_times_s[after] - frame_times_s[after - 1]
        fraction = (times_s - frame_times_s[after - 1]) / gap
        fraction[(gap > _MAX_GAP_PERIODS * period_s) | (fraction < 0) | (fraction > 1)] = np.nan
        later = fraction[:, None]
        joints = self.joints[after - 1] * (1 - later[..., None]) + self.joints[after] * later[..., None]
        return joints, self.sigma_m[after - 1] * (1 - later) + self.sigma_m[after] * later


@dataclasses.dataclass(frozen=True, eq=False)
class Skeletons:
    """Tracks of several cameras at common times, each in its camera's frame; NaN where a camera has no estimate."""

    times_s: Float[ndarray, " n"]
    joints: Float[ndarray, "c n 18 3"]
    sigma_m: Float[ndarray, "c n 18"]

    def velocities(self) -> Float[ndarray, "c n 18 3"]:
        """Velocities of the joints (m/s), each in its camera's frame, by central differences."""
        displacement = np.full_like(self.joints, np.nan)
        displacement[:, 1:-1] = self.joints[:, 2:] - self.joints[:, :-2]
        return displacement / (2 * (self.times_s[1] - self.times_s[0]))


def common_times(tracks: Sequence[JointTrack]) -> Float[ndarray, " n"]:
    """Evenly spaced times (s) over all tracks, at the highest frame rate of the cameras."""
    with_frames = [track.times_s for track in tracks if len(track.times_s) > 1]
    period = min(float(np.median(np.diff(times_s))) for times_s in with_frames)
    first, last = min(float(t[0]) for t in with_frames), max(float(t[-1]) for t in with_frames)
    # linspace keeps the ends: rounding must not move them beyond the first and last frames.
    return np.linspace(first, last, max(round((last - first) / period), 2) + 1)


def resample(tracks: Sequence[JointTrack], times_s: Float[ndarray, " n"], offset_s: Float[ndarray, " c"]) -> Skeletons:
    """The tracks interpolated at common times; each camera exposes ``offset_s`` later than its timestamps say."""
    samples = []
    for track, late in zip(tracks, offset_s, strict=True):
        period = float(np.median(np.diff(track.times_s))) if len(track.times_s) > 1 else 0.0
        samples.append(track.interpolate(times_s - late, period))
    return Skeletons(times_s, np.stack([joints for joints, _ in samples]), np.stack([sigma for _, sigma in samples]))
