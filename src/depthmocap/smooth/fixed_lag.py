"""The fixed-lag smoother: every frame from the frames before it and from a few after it.

A Rauch–Tung–Striebel pass runs back from the newest frame over the last n, each time one comes (Rauch, Tung and
Striebel, AIAA Journal 1965). It costs n frames of delay, and needs no lag to be smooth.
"""

from __future__ import annotations

import collections
import dataclasses

import numpy as np
from jaxtyping import Bool, Float64
from numpy import ndarray

from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.smooth.kalman import Belief, Kalman, KalmanSettings
from depthmocap.smooth.pose_filter import PoseFilter


@dataclasses.dataclass(frozen=True)
class FixedLagSettings:
    """``frames`` to wait for, and the model that the frames are joined by."""

    frames: int = 4
    model: KalmanSettings = dataclasses.field(default_factory=KalmanSettings)

    def __post_init__(self) -> None:
        if self.frames < 1:
            raise InputError(f"the fixed-lag smoother waits for at least 1 frame, not {self.frames}")


@dataclasses.dataclass(frozen=True, eq=False)
class _Frame:
    """What the Kalman filter knew when the frame came."""

    measured: Pose
    predicted: Belief
    step: Float64[ndarray, "2 2"]
    belief: Belief
    began: Bool[ndarray, "18"]
    shown: Bool[ndarray, "18"]


class FixedLag(PoseFilter):
    """Gives each pose ``settings.frames`` frames late, with its own timestamp."""

    def __init__(self, settings: FixedLagSettings = FixedLagSettings()) -> None:
        self._settings = settings
        self.delay_frames = settings.frames
        self._kalman = Kalman(settings.model)
        self._frames: collections.deque[_Frame] = collections.deque(maxlen=settings.frames + 1)

    @property
    def settings(self) -> FixedLagSettings:
        """Delay and model."""
        return self._settings

    @property
    def latency_s(self) -> float:
        """The frames waited for, at the rate of the last frames; of 30 a second before there are two."""
        stamps = [frame.measured.timestamp_ns for frame in self._frames]
        period_s = float(np.median(np.diff(stamps))) / 1e9 if len(stamps) > 1 else 1 / 30
        return self.delay_frames * period_s

    def reset(self) -> None:
        """See :class:`PoseFilter`."""
        self._kalman.reset()
        self._frames.clear()

    def __call__(self, pose: Pose) -> Pose:
        """See :class:`PoseFilter`."""
        if self._frames and pose.timestamp_ns < self._frames[-1].measured.timestamp_ns:
            self.reset()
        kalman = self._kalman
        kalman.update(pose)
        self._frames.append(_Frame(pose, kalman.predicted, kalman.step, kalman.belief, kalman.began, kalman.shown))
        return self._smoothed()[0]

    def finish(self) -> list[Pose]:
        """See :class:`PoseFilter`."""
        held = self._smoothed() if self._frames else []
        if len(held) > self.delay_frames:
            held = held[1:]  # the first was given back already
        self.reset()
        return held

    def _smoothed(self) -> list[Pose]:
        """The frames kept, oldest first."""
        frames = list(self._frames)
        belief = frames[-1].belief
        beliefs = [belief]
        for earlier, later in zip(reversed(frames[:-1]), reversed(frames[1:]), strict=True):
            belief = _back(earlier.belief, later, belief)
            beliefs.append(belief)
        return [
            self._kalman.estimate(frame.measured, belief, frame.shown)
            for frame, belief in zip(frames, reversed(beliefs), strict=True)
        ]


def _back(earlier: Belief, later: _Frame, smoothed: Belief) -> Belief:
    """What is believed of a frame, given what is now known of the next one."""
    gain = earlier.covariance @ later.step.T @ _inverse(later.predicted.covariance)
    mean = earlier.mean + gain @ (smoothed.mean - later.predicted.mean)
    covariance = earlier.covariance + gain @ (smoothed.covariance - later.predicted.covariance) @ gain.swapaxes(1, 2)
    linked = np.isfinite(mean).all((1, 2)) & ~later.began
    return Belief(mean, covariance).where(linked, earlier)


def _inverse(matrices: Float64[ndarray, "n 2 2"]) -> Float64[ndarray, "n 2 2"]:
    a, b, c, d = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 0], matrices[:, 1, 1]
    adjugate = np.stack([np.stack([d, -b], -1), np.stack([-c, a], -1)], 1)
    return adjugate / (a * d - b * c)[:, None, None]
