"""Bone rotations of one person while they come, by the same method as in BVH files (``exporting.bone_rotations``)."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.exporting.bone_rotations import bone_rotations, joint_positions, rest_offsets
from depthmocap.exporting.timeline import LEAST_CONFIDENCE, Y_UP_FROM_Z_UP
from depthmocap.frames import Pose
from depthmocap.geometry import z_up_from

#: The rest skeleton is learnt from the first so many poses, at doubling distances.
LEARNT_POSES = 512


@dataclasses.dataclass(frozen=True, eq=False)
class PosedSkeleton:
    """A skeleton of constant bone lengths in a pose; Y up, right-handed, metres.

    Attributes:
        local: each joint's rotation in its parent's frame, away from a T pose that faces +Z, the subject's left at +X.
        root: position of the hips.
        offsets: each joint's offset from its parent in the T pose; zero for the root.
    """

    local: Float[ndarray, "18 3 3"]
    root: Float[ndarray, "3"]
    offsets: Float[ndarray, "18 3"]


class RunningSkeleton:
    """Takes the poses of one person and gives rotations; a bone that is not seen holds its last rotation."""

    def __init__(self, up: str) -> None:
        """``up``: the up axis of the poses' world."""
        self._y_up_from_world = Y_UP_FROM_Z_UP @ z_up_from(up)
        self._learnt: list[Float[ndarray, "18 3"]] = []
        self._count, self._posed = 0, PosedSkeleton(np.zeros((18, 3, 3)), np.zeros(3), np.zeros((18, 3)))

    def __call__(self, pose: Pose) -> PosedSkeleton | None:
        """The posed skeleton; None while nothing was ever seen."""
        sure = np.isfinite(pose.joints).all(1) & (pose.confidence >= LEAST_CONFIDENCE)
        joints = np.where(sure[:, None], pose.joints @ self._y_up_from_world.T, np.nan)
        if not self._learnt and not sure.any():
            return None
        offsets = self._posed.offsets
        if self._count < LEARNT_POSES and sure.any():
            self._count += 1
            self._learnt.append(joints)
            if self._count & (self._count - 1) == 0:  # a power of two
                offsets = rest_offsets(np.stack(self._learnt))
        frames = [joints]
        if self._count > 1 or not sure.any():  # what was there before, for what is not seen now
            before = self._posed
            frames.insert(0, joint_positions(before.local[None], before.root[None], before.offsets)[0])
        local, root, _ = bone_rotations(np.stack(frames), offsets)
        self._posed = PosedSkeleton(local[-1], root[-1], offsets)
        return self._posed
