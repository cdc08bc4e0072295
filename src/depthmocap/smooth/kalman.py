"""A Kalman filter for every joint.

A joint's velocity is an Ornstein–Uhlenbeck process: it lasts for a while (``memory_s``) and dies away, and chance adds
to it. For frames that are near to each other this is the constant-velocity model; over a gap the prediction comes to
rest instead of flying off. What chance adds grows with the present speed v, so that a joint at rest is held still and
a fast one is followed. With a = exp(−t/τ) and q = 2 (still² + agility² v²) / τ:

    position += τ (1 − a) velocity,  velocity ·= a
    Q = [ q τ² (t − 2τ(1 − a) + τ(1 − a²)/2),  q τ² (1 − a)² / 2 ;  ·,  q τ (1 − a²) / 2 ]

The noise of a measurement follows from its confidence. One that is far outside of what is expected counts for less, in
the measure that it is outside; when a joint stays there, it is believed.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float64
from numpy import ndarray

from depthmocap.body.skeleton import JOINTS
from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.smooth.pose_filter import FORGET_S, PoseFilter, seen_joints

#: Speed along an axis that a joint may have when it is first seen.
_START_MPS = 0.5
#: Confidence of a joint that was not seen in the frame, but bridged: after half a second, the most that is bridged, two
#: of five are still within 10 cm.
BRIDGED = 0.3


@dataclasses.dataclass(frozen=True)
class KalmanSettings:
    """How joints move, and how well they are measured.

    Attributes:
        still_mps: speed along an axis that chance gives a joint at rest.
        agility: and, to one that moves, so many times its present speed.
        memory_s: how long a velocity lasts.
        sure_m, unsure_m: error of a measurement along an axis with confidence 1 and 0; between them geometrically.
        outlier: deviations from what is expected beyond which a measurement counts for less.
        restart_s: a joint that is so long beyond that is believed.
        bridge_s: a joint that is missing is predicted for so long, with confidence ``BRIDGED``; 0 leaves gaps.
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
        if not 0 <= self.bridge_s <= FORGET_S:
            raise InputError(f"--bridge-s must be from 0 to {FORGET_S}, got {self.bridge_s}")


@dataclasses.dataclass(frozen=True, eq=False)
class Belief:
    """Position and velocity of every joint with their covariance, which is one for all axes; NaN where not known."""

    mean: Float64[ndarray, "18 2 3"]
    covariance: Float64[ndarray, "18 2 2"]

    @classmethod
    def nothing(cls) -> Belief:
        """Of no joint."""
        return cls(np.full((len(JOINTS), 2, 3), np.nan), np.full((len(JOINTS), 2, 2), np.nan))

    def where(self, mask: Bool[ndarray, "18"], other: Belief) -> Belief:
        """This one for the joints marked, the other for the rest."""
        mask = mask[:, None, None]
        return Belief(np.where(mask, self.mean, other.mean), np.where(mask, self.covariance, other.covariance))


def transition(tau: float, period_s: float) -> tuple[Float64[ndarray, "2 2"], Float64[ndarray, "2 2"]]:
    """How (position, velocity) with a memory tau (s) go on over a time (s), and the covariance of what chance adds at a
    speed of 1 m/s."""
    kept = np.exp(-period_s / tau)
    position = 2 * tau * (period_s - 2 * tau * (1 - kept) + tau * (1 - kept**2) / 2)
    both, velocity = tau * (1 - kept) ** 2, 1 - kept**2
    return np.array([[1, tau * (1 - kept)], [0, kept]]), np.array([[position, both], [both, velocity]])


class Kalman(PoseFilter):
    """The filter; a joint that was away for ``FORGET_S`` starts anew.

    Attributes:
        predicted, step, belief: of the last frame: what was expected, the transition to it, and what is now believed.
        began: the joints that started anew in it, which have no past.
        shown: the joints that were seen in it, or are bridged.
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
        """None by design: a velocity that lasts is followed without lag."""
        return 0.0

    def reset(self) -> None:
        """See :class:`PoseFilter`."""
        self.belief = self.predicted = Belief.nothing()
        self.step = np.eye(2)
        self.began, self.shown = np.zeros((2, len(JOINTS)), bool)
        self._now_ns: int | None = None
        self._seen_ns = np.zeros(len(JOINTS), np.int64)
        self._fitting_ns = np.zeros(len(JOINTS), np.int64)

    def __call__(self, pose: Pose) -> Pose:
        """See :class:`PoseFilter`."""
        self.update(pose)
        return self.estimate(pose, self.belief, self.shown)

    def estimate(self, measured: Pose, belief: Belief, shown: Bool[ndarray, "18"]) -> Pose:
        """What is believed about the time of a measured pose; NaN but for the joints shown."""
        joints = np.where(shown[:, None], belief.mean[:, 0], np.nan)
        bridged = shown & ~seen_joints(measured)
        return Pose(measured.timestamp_ns, joints, np.where(bridged, BRIDGED, measured.confidence))

    def update(self, pose: Pose) -> None:
        """Take the measurements of a frame."""
        settings, now_ns = self._settings, pose.timestamp_ns
        if self._now_ns is not None and now_ns < self._now_ns:
            self.reset()
        period_s = 0.0 if self._now_ns is None else (now_ns - self._now_ns) / 1e9
        self.step, added = transition(settings.memory_s, period_s)
        chance = settings.still_mps**2 + settings.agility**2 * (self.belief.mean[:, 1] ** 2).mean(1)
        mean = self.step @ self.belief.mean
        covariance = self.step @ self.belief.covariance @ self.step.T + chance[:, None, None] * added
        away_s = (now_ns - self._seen_ns) / 1e9
        lost = away_s > FORGET_S
        self.predicted = Belief.nothing().where(lost, Belief(mean, covariance))

        seen, joints = seen_joints(pose), pose.joints.astype(np.float64)
        sure = np.clip(pose.confidence.astype(np.float64), 0, 1)
        noise = (settings.sure_m**sure * settings.unsure_m ** (1 - sure)) ** 2
        known = np.isfinite(self.predicted.mean).all((1, 2))
        surprise = joints - self.predicted.mean[:, 0]
        expected = self.predicted.covariance[:, 0, 0] + noise
        # Mean over the axes of the squared deviation, in units of what is expected.
        excess = (surprise**2).mean(1) / expected / settings.outlier**2
        outlying = seen & known & (excess > 1)
        self._fitting_ns[~outlying] = now_ns
        stuck = outlying & ((now_ns - self._fitting_ns) / 1e9 >= settings.restart_s)
        self.began = seen & (~known | stuck)
        start = Belief(
            np.stack([joints, np.zeros_like(joints)], 1),
            noise[:, None, None] * np.diag([1.0, 0.0]) + np.diag([0.0, _START_MPS**2]),
        )
        doubted = noise * np.where(outlying, excess, 1)
        gain = self.predicted.covariance[:, :, 0] / (self.predicted.covariance[:, 0, 0] + doubted)[:, None]
        updated = Belief(
            self.predicted.mean + gain[:, :, None] * surprise[:, None],
            self.predicted.covariance - gain[:, :, None] * self.predicted.covariance[:, None, 0],
        )
        self.belief = start.where(self.began, updated.where(seen, self.predicted))
        bridged = np.isfinite(self.belief.mean).all((1, 2)) & (away_s <= settings.bridge_s)
        self.shown = seen | bridged
        self._seen_ns[seen] = self._fitting_ns[self.began] = self._now_ns = now_ns
