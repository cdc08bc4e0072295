"""The fixed-lag smoother: every frame is estimated from the frames before it and a few frames after it.

With each new frame a Rauch–Tung–Striebel pass runs backwards over the last n frames (Rauch, Tung and Striebel, AIAA
Journal 1965). It delays poses by n frames, and does not lag behind the movement.
"""

from __future__ import annotations

import collections
import dataclasses

import numpy as np
from jaxtyping import Bool, Float64
from numpy import ndarray

from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.smooth.kalman import Kalman, KalmanSettings, State
from depthmocap.smooth.pose_filter import PoseFilter


@dataclasses.dataclass(frozen=True)
class FixedLagSettings:
    """The delay in frames, and the Kalman filter's settings."""

    frames: int = 4
    model: KalmanSettings = dataclasses.field(default_factory=KalmanSettings)

    def __post_init__(self) -> None:
        if self.frames < 1:
            raise InputError(f"the fixed-lag smoother waits for at least 1 frame, not {self.frames}")


@dataclasses.dataclass(frozen=True, eq=False)
class _Frame:
    """The Kalman filter's output for one frame."""

    measured: Pose
    prediction: State
    transition_matrix: Float64[ndarray, "2 2"]
    state: State
    started: Bool[ndarray, "18"]
    reported: Bool[ndarray, "18"]


class FixedLag(PoseFilter):
    """Returns each pose ``settings.frames`` frames late, with its own timestamp."""

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
        """The delay (seconds) at the rate of the last frames; at 30 Hz before there are two."""
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
        self._frames.append(
            _Frame(pose, kalman.prediction, kalman.transition_matrix, kalman.state, kalman.started, kalman.reported)
        )
        return self._smoothed()[0]

    def finish(self) -> list[Pose]:
        """See :class:`PoseFilter`."""
        poses = self._smoothed() if self._frames else []
        if len(poses) > self.delay_frames:
            poses = poses[1:]  # the first was already returned
        self.reset()
        return poses

    def _smoothed(self) -> list[Pose]:
        """The smoothed poses of the buffered frames, oldest first."""
        frames = list(self._frames)
        state = frames[-1].state
        states = [state]
        for earlier, later in zip(reversed(frames[:-1]), reversed(frames[1:]), strict=True):
            state = _backward_step(earlier.state, later, state)
            states.append(state)
        return [
            self._kalman.estimate(frame.measured, state, frame.reported)
            for frame, state in zip(frames, reversed(states), strict=True)
        ]


def _backward_step(earlier: State, later: _Frame, smoothed: State) -> State:
    """A frame's state, smoothed by the next frame's smoothed state."""
    gain = earlier.covariance @ later.transition_matrix.T @ _inverse(later.prediction.covariance)
    mean = earlier.mean + gain @ (smoothed.mean - later.prediction.mean)
    covariance = earlier.covariance + gain @ (smoothed.covariance - later.prediction.covariance) @ gain.swapaxes(1, 2)
    continues = np.isfinite(mean).all((1, 2)) & ~later.started
    return State(mean, covariance).where(continues, earlier)


def _inverse(matrices: Float64[ndarray, "n 2 2"]) -> Float64[ndarray, "n 2 2"]:
    a, b, c, d = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 0], matrices[:, 1, 1]
    adjugate = np.stack([np.stack([d, -b], -1), np.stack([-c, a], -1)], 1)
    return adjugate / (a * d - b * c)[:, None, None]
