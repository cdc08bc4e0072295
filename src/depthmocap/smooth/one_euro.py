"""The One-Euro filter (Casiez, Roussel and Vogel, CHI 2012): a low-pass filter whose cutoff rises with speed.

Slow joints are smoothed strongly, fast ones lag little. Each joint has one cutoff, from its speed, so that the result
does not depend on the world's axes.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64
from numpy import ndarray

from depthmocap.body.skeleton import JOINTS
from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.smooth.pose_filter import MAX_GAP_S, PoseFilter, observed_joints


@dataclasses.dataclass(frozen=True)
class OneEuroSettings:
    """Cutoff frequencies of the One-Euro filter.

    Attributes:
        still_hz: cutoff at rest (Hz); lower is smoother.
        per_speed_hz: increase of the cutoff for each m/s of speed (Hz); higher lags less.
        speed_hz: cutoff of the velocity (Hz).
    """

    still_hz: float = 1.0
    per_speed_hz: float = 30.0
    speed_hz: float = 1.0

    def __post_init__(self) -> None:
        if not (self.still_hz > 0 and self.speed_hz > 0 and self.per_speed_hz >= 0):
            raise InputError(f"One-Euro filter: cutoffs must be above 0, the rise with speed at least 0; got {self}")


class OneEuro(PoseFilter):
    """The filter of every joint. A joint missing for ``MAX_GAP_S`` starts anew."""

    def __init__(self, settings: OneEuroSettings = OneEuroSettings()) -> None:
        self._settings = settings
        self.reset()

    @property
    def settings(self) -> OneEuroSettings:
        """The cutoffs."""
        return self._settings

    @property
    def latency_s(self) -> float:
        """The lag at 1 m/s: the low-pass filter's time constant."""
        return 1 / (2 * np.pi * (self._settings.still_hz + self._settings.per_speed_hz))

    def reset(self) -> None:
        """See :class:`PoseFilter`."""
        self._smooth = np.full((len(JOINTS), 3), np.nan)
        self._raw = self._smooth.copy()
        self._velocity = np.zeros((len(JOINTS), 3))
        self._observed_ns = np.zeros(len(JOINTS), np.int64)

    def __call__(self, pose: Pose) -> Pose:
        """See :class:`PoseFilter`."""
        if pose.timestamp_ns < self._observed_ns.max():
            self.reset()
        observed, joints = observed_joints(pose), pose.joints.astype(np.float64)
        gap_s = (pose.timestamp_ns - self._observed_ns) / 1e9
        starting = observed & (np.isnan(self._raw).any(1) | (gap_s > MAX_GAP_S))
        self._raw[starting], self._smooth[starting], self._velocity[starting] = joints[starting], joints[starting], 0.0
        # A repeated frame and the first frame of a joint change nothing.
        row = np.flatnonzero(observed & ~starting & (gap_s > 0))
        period = gap_s[row, None]
        velocity = (joints[row] - self._raw[row]) / period
        self._velocity[row] += _low_pass_weight(self._settings.speed_hz, period) * (velocity - self._velocity[row])
        speed = np.linalg.norm(self._velocity[row], axis=1, keepdims=True)
        cutoff = self._settings.still_hz + self._settings.per_speed_hz * speed
        self._smooth[row] += _low_pass_weight(cutoff, period) * (joints[row] - self._smooth[row])
        self._raw[row] = joints[row]
        self._observed_ns[observed] = pose.timestamp_ns
        return dataclasses.replace(pose, joints=np.where(observed[:, None], self._smooth, np.nan))


def _low_pass_weight(cutoff_hz: float | ndarray, period_s: Float64[ndarray, "n 1"]) -> Float64[ndarray, "n 1"]:
    """Weight of the new value in a first-order low-pass filter."""
    phase = 2 * np.pi * cutoff_hz * period_s
    return phase / (phase + 1)
