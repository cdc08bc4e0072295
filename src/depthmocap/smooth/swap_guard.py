"""Left and right do not change places between two frames: where an estimate says so, it is undone.

The legs, and the arms, are compared with where they should be by now. When exchanging their sides fits that much
better, they are exchanged. A start on the wrong side would be kept for ever so; therefore the time undone is counted,
less the time that fits, and at ``limit_s`` the estimate is believed.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float64
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS, MIRROR
from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.smooth.pose_filter import FORGET_S, seen_joints

#: Limbs whose sides change places together.
LIMBS: dict[str, tuple[str, ...]] = {"legs": ("Hip", "Knee", "Foot"), "arms": ("Shoulder", "Elbow", "Hand")}
#: How long a velocity is believed to last.
_MEMORY_S = 0.1


def limb_joints(limb: str) -> Bool[ndarray, "18"]:
    """The joints of both sides of a pair of limbs."""
    joints = np.zeros(len(JOINTS), bool)
    joints[[JOINT_INDEX[side + name] for side in "RL" for name in LIMBS[limb]]] = True
    return joints


_PAIRS = {limb: limb_joints(limb) for limb in LIMBS}


@dataclasses.dataclass(frozen=True)
class SideSettings:
    """When sides count as exchanged.

    Attributes:
        ratio: exchanged joints are off by less than this share of what they are off as they are,
        gain_m: and by so much less on average.
        limit_s: an exchange is believed when it was there for so long more than it was not.
    """

    ratio: float = 0.5
    gain_m: float = 0.06
    limit_s: float = 0.5

    def __post_init__(self) -> None:
        if not (0 < self.ratio < 1 and self.gain_m >= 0 and self.limit_s >= 0):
            raise InputError(f"sides: the ratio must be between 0 and 1, gain and limit at least 0; got {self}")


class SideGuard:
    """Undoes exchanges of sides in a stream of poses."""

    def __init__(self, settings: SideSettings | None = None) -> None:
        self.settings = settings or SideSettings()
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._joints = np.full((len(JOINTS), 3), np.nan)
        self._velocity = np.zeros((len(JOINTS), 3))
        self._seen_ns = np.zeros(len(JOINTS), np.int64)
        self._now_ns = 0
        self._undone_s = dict.fromkeys(LIMBS, 0.0)

    def __call__(self, pose: Pose) -> Pose:
        """The pose with sides as they were."""
        if pose.timestamp_ns < self._now_ns:
            self.reset()
        since_s = (pose.timestamp_ns - self._now_ns) / 1e9
        self._now_ns = pose.timestamp_ns
        away_s = (pose.timestamp_ns - self._seen_ns) / 1e9
        self._joints[away_s > FORGET_S] = np.nan
        lasting_s = _MEMORY_S * (1 - np.exp(-away_s / _MEMORY_S))
        expected = self._joints + lasting_s[:, None] * self._velocity
        joints, confidence = pose.joints.astype(np.float64), pose.confidence.copy()
        for limb, pair in _PAIRS.items():
            if not self._changed_places(joints, expected, pair):
                self._undone_s[limb] = max(self._undone_s[limb] - since_s, 0.0)
                continue
            self._undone_s[limb] += since_s
            if self._undone_s[limb] > self.settings.limit_s:
                self._undone_s[limb] = 0.0
                self._joints[pair] = np.nan
            else:
                order = np.where(pair, MIRROR, np.arange(len(JOINTS)))
                joints, confidence = joints[order], confidence[order]
        self._remember(dataclasses.replace(pose, joints=joints, confidence=confidence), away_s)
        return Pose(pose.timestamp_ns, joints, confidence)

    def _changed_places(
        self, joints: Float64[ndarray, "18 3"], expected: Float64[ndarray, "18 3"], pair: Bool[ndarray, "18"]
    ) -> bool:
        off = np.stack([joints - expected, joints[MIRROR] - expected])
        both = pair & np.isfinite(off).all((0, 2))
        both &= both[MIRROR]
        if both.sum() < 4:  # two joints of each side
            return False
        as_is, exchanged = np.linalg.norm(off[:, both], axis=2).mean(1)
        return bool(exchanged < self.settings.ratio * as_is and as_is - exchanged > self.settings.gain_m)

    def _remember(self, pose: Pose, away_s: Float64[ndarray, "18"]) -> None:
        seen = seen_joints(pose)
        known = seen & np.isfinite(self._joints).all(1) & (away_s > 0)
        measured = (pose.joints - self._joints) / np.maximum(away_s, 1e-9)[:, None]
        share = 1 - np.exp(-away_s / _MEMORY_S)
        self._velocity += np.where(known, share, 0)[:, None] * (np.where(known[:, None], measured, 0) - self._velocity)
        self._velocity[~np.isfinite(self._joints).all(1)] = 0
        self._joints[seen] = pose.joints[seen]
        self._seen_ns[seen] = pose.timestamp_ns
