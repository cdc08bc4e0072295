"""The One-Euro filter (Casiez, Roussel and Vogel, CHI 2012): a low pass whose cutoff rises with speed.

Slow joints are smoothed much, fast ones lag little. One cutoff a joint, of the length of its velocity, so that the
result does not depend on the world's axes.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64
from numpy import ndarray

from depthmocap.body.skeleton import JOINTS
from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.smooth.pose_filter import FORGET_S, PoseFilter, seen_joints


@dataclasses.dataclass(frozen=True)
class OneEuroSettings:
    """Cutoffs of the One-Euro filter.

    Attributes:
        still_hz: cutoff at rest; lower is smoother.
        per_speed_hz: how much it rises with each metre a second; higher lags less.
        speed_hz: cutoff of the speed itself.
    """

    still_hz: float = 1.0
    per_speed_hz: float = 30.0
    speed_hz: float = 1.0

    def __post_init__(self) -> None:
        if not (self.still_hz > 0 and self.speed_hz > 0 and self.per_speed_hz >= 0):
            raise InputError(f"One-Euro filter: cutoffs must be above 0, the rise with speed at least 0; got {self}")


class OneEuro(PoseFilter):
    """Joint by joint; a joint that was away for ``FORGET_S`` starts anew."""

    def __init__(self, settings: OneEuroSettings = OneEuroSettings()) -> None:
        self._settings = settings
        self.reset()

    @property
    def settings(self) -> OneEuroSettings:
        """The cutoffs."""
        return self._settings

    @property
    def latency_s(self) -> float:
        """The lag at 1 m/s: the low pass's time constant."""
        return 1 / (2 * np.pi * (self._settings.still_hz + self._settings.per_speed_hz))

    def reset(self) -> None:
        """See :class:`PoseFilter`."""
        self._smooth = np.full((len(JOINTS), 3), np.nan)
        self._raw = self._smooth.copy()
        self._velocity = np.zeros((len(JOINTS), 3))
        self._seen_ns = np.zeros(len(JOINTS), np.int64)

    def __call__(self, pose: Pose) -> Pose:
        """See :class:`PoseFilter`."""
        if pose.timestamp_ns < self._seen_ns.max():
            self.reset()
        seen, joints = seen_joints(pose), pose.joints.astype(np.float64)
        away_s = (pose.timestamp_ns - self._seen_ns) / 1e9
        anew = seen & (np.isnan(self._raw).any(1) | (away_s > FORGET_S))
        self._raw[anew], self._smooth[anew], self._velocity[anew] = joints[anew], joints[anew], 0.0
        # A frame given twice, and one that starts a joint, change nothing.
        row = np.flatnonzero(seen & ~anew & (away_s > 0))
        period = away_s[row, None]
        speed = (joints[row] - self._raw[row]) / period
        self._velocity[row] += _share(self._settings.speed_hz, period) * (speed - self._velocity[row])
        pace = np.linalg.norm(self._velocity[row], axis=1, keepdims=True)
        cutoff = self._settings.still_hz + self._settings.per_speed_hz * pace
        self._smooth[row] += _share(cutoff, period) * (joints[row] - self._smooth[row])
        self._raw[row] = joints[row]
        self._seen_ns[seen] = pose.timestamp_ns
        return dataclasses.replace(pose, joints=np.where(seen[:, None], self._smooth, np.nan))


def _share(cutoff_hz: float | ndarray, period_s: Float64[ndarray, "n 1"]) -> Float64[ndarray, "n 1"]:
    """Weight of the new value in a first-order low pass."""
    turn = 2 * np.pi * cutoff_hz * period_s
    return turn / (turn + 1)
