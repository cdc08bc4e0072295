"""A Kalman filter for every joint.

A joint's velocity is an Ornstein–Uhlenbeck process: it decays with the time constant τ (``memory_s``), and process
noise adds to it. For consecutive frames this is the constant-velocity model; over a gap the prediction comes to rest.
The process noise grows with the present speed v: a joint at rest is smoothed more, and a fast one is followed. With a =
exp(−t/τ) and q = 2 (still² + agility² v²) / τ:

    position += τ (1 − a) velocity,  velocity ·= a
    Q = [ q τ² (t − 2τ(1 − a) + τ(1 − a²)/2),  q τ² (1 − a)² / 2 ;  ·,  q τ (1 − a²) / 2 ]

The measurement noise follows from the confidence. An outlier gets more noise, the more it deviates from the prediction.
A joint that stays an outlier for ``restart_s`` starts anew where it is measured.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float64
from numpy import ndarray

from depthmocap.body.skeleton import JOINTS
from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.smooth.pose_filter import MAX_GAP_S, PoseFilter, observed_joints

#: Deviation of a new joint's speed along an axis (m/s).
_START_MPS = 0.5
#: Confidence of a joint in a filled gap: after half a second, the longest gap filled, two in five are within 10 cm.
BRIDGED_CONFIDENCE = 0.3


@dataclasses.dataclass(frozen=True)
class KalmanSettings:
    """Process and measurement noise, outliers and gap filling.

    Attributes:
        still_mps: process noise of the velocity along an axis at rest (m/s).
        agility: process noise of the velocity of a moving joint, as a multiple of its speed.
        memory_s: time constant of the velocity (seconds).
        sure_m, unsure_m: deviation of a measurement along an axis (metres) with confidence 1 and 0; geometric between.
        outlier: standard deviations from the prediction beyond which a measurement is an outlier.
        restart_s: time after which a joint that stays an outlier starts anew (seconds).
        bridge_s: longest gap of a joint that is filled by prediction, with confidence ``BRIDGED_CONFIDENCE`` (seconds);
            0 leaves gaps.
    """

    still_mps: float = 0.05
    agility: float = 2.0
    memory_s: float = 0.2
    sure_m: float = 0.006
    unsure_m: float = 0.5
    outlier: float = 4.0
    restart_s: float = 0.2
    bridge_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("still_mps", "memory_s", "sure_m", "unsure_m", "outlier"):
            if not getattr(self, name) > 0:
                raise InputError(f"Kalman filter: {name} must be above 0, got {getattr(self, name)}")
        for name in ("agility", "restart_s"):
            if not getattr(self, name) >= 0:
                raise InputError(f"Kalman filter: {name} must be at least 0, got {getattr(self, name)}")
        if not 0 <= self.bridge_s <= MAX_GAP_S:
            raise InputError(f"--bridge-s must be from 0 to {MAX_GAP_S}, got {self.bridge_s}")


@dataclasses.dataclass(frozen=True, eq=False)
class State:
    """Position and velocity of every joint, with their covariance, which is the same for all axes; NaN if unknown."""

    mean: Float64[ndarray, "18 2 3"]
    covariance: Float64[ndarray, "18 2 2"]

    @classmethod
    def unknown(cls) -> State:
        """The state of which no joint is known."""
        return cls(np.full((len(JOINTS), 2, 3), np.nan), np.full((len(JOINTS), 2, 2), np.nan))

    def where(self, mask: Bool[ndarray, "18"], other: State) -> State:
        """This state for the joints in the mask, the other for the rest."""
        mask = mask[:, None, None]
        return State(np.where(mask, self.mean, other.mean), np.where(mask, self.covariance, other.covariance))


def transition(tau: float, period_s: float) -> tuple[Float64[ndarray, "2 2"], Float64[ndarray, "2 2"]]:
    """Transition matrix of (position, velocity) over a time, and the process noise's covariance at 1 m/s.

    Args:
        tau: time constant of the velocity (seconds).
        period_s: the time (seconds).
    """
    decay = np.exp(-period_s / tau)
    position = 2 * tau * (period_s - 2 * tau * (1 - decay) + tau * (1 - decay**2) / 2)
    cross, velocity = tau * (1 - decay) ** 2, 1 - decay**2
    return np.array([[1, tau * (1 - decay)], [0, decay]]), np.array([[position, cross], [cross, velocity]])


class Kalman(PoseFilter):
    """The filter. A joint missing for ``MAX_GAP_S`` starts anew.

    Attributes:
        prediction, state: of the last frame, before and after its measurements.
        transition_matrix: of the step to the last frame.
        started: joints that started anew in the last frame.
        reported: joints that were observed in the last frame, or whose gap is filled.
    """

    def __init__(self, settings: KalmanSettings = KalmanSettings()) -> None:
        self._settings = settings
        self.reset()

    @property
    def settings(self) -> KalmanSettings:
        """The model."""
        return self._settings

    @property
    def latency_s(self) -> float:
        """0: a constant velocity is followed without lag."""
        return 0.0

    def reset(self) -> None:
        """See :class:`PoseFilter`."""
        self.state = self.prediction = State.unknown()
        self.transition_matrix = np.eye(2)
        self.started, self.reported = np.zeros((2, len(JOINTS)), bool)
        self._now_ns: int | None = None
        self._observed_ns = np.zeros(len(JOINTS), np.int64)
        self._inlier_ns = np.zeros(len(JOINTS), np.int64)

    def __call__(self, pose: Pose) -> Pose:
        """See :class:`PoseFilter`."""
        self.update(pose)
        return self.estimate(pose, self.state, self.reported)

    def estimate(self, measured: Pose, state: State, reported: Bool[ndarray, "18"]) -> Pose:
        """The pose of a state at the time of a measured pose; NaN except for the joints reported."""
        joints = np.where(reported[:, None], state.mean[:, 0], np.nan)
        bridged = reported & ~observed_joints(measured)
        return Pose(measured.timestamp_ns, joints, np.where(bridged, BRIDGED_CONFIDENCE, measured.confidence))

    def update(self, pose: Pose) -> None:
        """Predict the state to a frame's time and correct it by the frame's measurements."""
        now_ns = pose.timestamp_ns
        if self._now_ns is not None and now_ns < self._now_ns:
            self.reset()
        gap_s = (now_ns - self._observed_ns) / 1e9
        self._predict(now_ns, gap_s > MAX_GAP_S)
        self._correct(pose)
        bridged = np.isfinite(self.state.mean).all((1, 2)) & (gap_s <= self._settings.bridge_s)
        observed = observed_joints(pose)
        self.reported = observed | bridged
        self._observed_ns[observed] = self._inlier_ns[self.started] = self._now_ns = now_ns

    def _predict(self, now_ns: int, forgotten: Bool[ndarray, "18"]) -> None:
        settings = self._settings
        period_s = 0.0 if self._now_ns is None else (now_ns - self._now_ns) / 1e9
        self.transition_matrix, process_noise = transition(settings.memory_s, period_s)
        variance = settings.still_mps**2 + settings.agility**2 * (self.state.mean[:, 1] ** 2).mean(1)
        mean = self.transition_matrix @ self.state.mean
        covariance = self.transition_matrix @ self.state.covariance @ self.transition_matrix.T
        covariance = covariance + variance[:, None, None] * process_noise
        self.prediction = State.unknown().where(forgotten, State(mean, covariance))

    def _correct(self, pose: Pose) -> None:
        settings, now_ns = self._settings, pose.timestamp_ns
        observed, joints = observed_joints(pose), pose.joints.astype(np.float64)
        confidence = np.clip(pose.confidence.astype(np.float64), 0, 1)
        noise = (settings.sure_m**confidence * settings.unsure_m ** (1 - confidence)) ** 2
        predicted = np.isfinite(self.prediction.mean).all((1, 2))
        innovation = joints - self.prediction.mean[:, 0]
        innovation_variance = self.prediction.covariance[:, 0, 0] + noise
        # Mean over the axes of the squared innovation, in units of its variance, relative to the outlier limit.
        excess = (innovation**2).mean(1) / innovation_variance / settings.outlier**2
        outlying = observed & predicted & (excess > 1)
        self._inlier_ns[~outlying] = now_ns
        restarting = outlying & ((now_ns - self._inlier_ns) / 1e9 >= settings.restart_s)
        self.started = observed & (~predicted | restarting)
        initial = State(
            np.stack([joints, np.zeros_like(joints)], 1),
            noise[:, None, None] * np.diag([1.0, 0.0]) + np.diag([0.0, _START_MPS**2]),
        )
        inflated_noise = noise * np.where(outlying, excess, 1)
        gain = self.prediction.covariance[:, :, 0] / (self.prediction.covariance[:, 0, 0] + inflated_noise)[:, None]
        updated = State(
            self.prediction.mean + gain[:, :, None] * innovation[:, None],
            self.prediction.covariance - gain[:, :, None] * self.prediction.covariance[:, None, 0],
        )
        self.state = initial.where(self.started, updated.where(observed, self.prediction))
