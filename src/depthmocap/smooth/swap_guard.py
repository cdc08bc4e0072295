"""The left–right swap guard: corrects estimates in which left and right are swapped from one frame to the next.

The legs, and the arms, are compared with their predicted positions. If swapped sides fit much better, they are swapped.
A wrong start would then last for ever. Therefore the guard counts the time with corrections, minus the time without,
and at ``limit_s`` it accepts the estimate.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float64
from numpy import ndarray

from depthmocap.body.landmarks import POINT_JOINTS, POINT_MIRROR
from depthmocap.body.skeleton import JOINT_INDEX, JOINTS, MIRROR
from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.smooth.pose_filter import MAX_GAP_S, observed_joints

#: Joints of the limbs that are swapped together.
LIMBS: dict[str, tuple[str, ...]] = {"legs": ("Hip", "Knee", "Foot"), "arms": ("Shoulder", "Elbow", "Hand")}
#: Time constant of the predicted velocity (seconds).
_MEMORY_S = 0.1


def limb_joints(limb: str) -> Bool[ndarray, "18"]:
    """The joints of both sides of a pair of limbs."""
    joints = np.zeros(len(JOINTS), bool)
    joints[[JOINT_INDEX[side + name] for side in "RL" for name in LIMBS[limb]]] = True
    return joints


_PAIRS = {limb: limb_joints(limb) for limb in LIMBS}


@dataclasses.dataclass(frozen=True)
class SwapGuardSettings:
    """When sides count as swapped.

    Attributes:
        ratio: swapped joints have less than this share of the mean residual of the joints as they are,
        gain_m: and a mean residual smaller by at least this (metres).
        limit_s: a swap is accepted when it has lasted this much longer than correct sides (seconds).
    """

    ratio: float = 0.5
    gain_m: float = 0.06
    limit_s: float = 0.5

    def __post_init__(self) -> None:
        if not (0 < self.ratio < 1 and self.gain_m >= 0 and self.limit_s >= 0):
            raise InputError(f"sides: the ratio must be between 0 and 1, gain and limit at least 0; got {self}")


class SwapGuard:
    """Corrects swapped sides in a stream of poses."""

    def __init__(self, settings: SwapGuardSettings | None = None) -> None:
        self.settings = settings or SwapGuardSettings()
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._joints = np.full((len(JOINTS), 3), np.nan)
        self._velocity = np.zeros((len(JOINTS), 3))
        self._observed_ns = np.zeros(len(JOINTS), np.int64)
        self._now_ns = 0
        self._swapped_s = dict.fromkeys(LIMBS, 0.0)

    def __call__(self, pose: Pose) -> Pose:
        """The pose with its sides as in the frames before."""
        if pose.timestamp_ns < self._now_ns:
            self.reset()
        elapsed_s = (pose.timestamp_ns - self._now_ns) / 1e9
        self._now_ns = pose.timestamp_ns
        gap_s = (pose.timestamp_ns - self._observed_ns) / 1e9
        self._joints[gap_s > MAX_GAP_S] = np.nan
        horizon_s = _MEMORY_S * (1 - np.exp(-gap_s / _MEMORY_S))
        predicted = self._joints + horizon_s[:, None] * self._velocity
        joints, confidence = pose.joints.astype(np.float64), pose.confidence.copy()
        points, points_confidence = pose.points, pose.points_confidence
        for limb, pair in _PAIRS.items():
            if not self._is_swapped(joints, predicted, pair):
                self._swapped_s[limb] = max(self._swapped_s[limb] - elapsed_s, 0.0)
                continue
            self._swapped_s[limb] += elapsed_s
            if self._swapped_s[limb] > self.settings.limit_s:
                self._swapped_s[limb] = 0.0
                self._joints[pair] = np.nan
            else:
                order = np.where(pair, MIRROR, np.arange(len(JOINTS)))
                joints, confidence = joints[order], confidence[order]
                if points is not None and points_confidence is not None:
                    order = np.where(pair[POINT_JOINTS], POINT_MIRROR, np.arange(len(POINT_JOINTS)))
                    points, points_confidence = points[order], points_confidence[order]
        self._update(dataclasses.replace(pose, joints=joints, confidence=confidence), gap_s)
        return Pose(pose.timestamp_ns, joints, confidence, points, points_confidence)

    def _is_swapped(
        self, joints: Float64[ndarray, "18 3"], predicted: Float64[ndarray, "18 3"], pair: Bool[ndarray, "18"]
    ) -> bool:
        residuals = np.stack([joints - predicted, joints[MIRROR] - predicted])
        compared = pair & np.isfinite(residuals).all((0, 2))
        compared &= compared[MIRROR]
        if compared.sum() < 4:  # fewer than two joints of each side
            return False
        as_is, swapped = np.linalg.norm(residuals[:, compared], axis=2).mean(1)
        return bool(swapped < self.settings.ratio * as_is and as_is - swapped > self.settings.gain_m)

    def _update(self, pose: Pose, gap_s: Float64[ndarray, "18"]) -> None:
        observed = observed_joints(pose)
        known = observed & np.isfinite(self._joints).all(1) & (gap_s > 0)
        velocity = (pose.joints - self._joints) / np.maximum(gap_s, 1e-9)[:, None]
        weight = 1 - np.exp(-gap_s / _MEMORY_S)
        self._velocity += np.where(known, weight, 0)[:, None] * (np.where(known[:, None], velocity, 0) - self._velocity)
        self._velocity[~np.isfinite(self._joints).all(1)] = 0
        self._joints[observed] = pose.joints[observed]
        self._observed_ns[observed] = pose.timestamp_ns
