"""The skeleton of one person while poses come: that of files (``exporting.body_motion``), without a future."""

from __future__ import annotations

import collections
import dataclasses

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.exporting.bone_rotations import bone_rotations, joint_positions, rest_offsets, world_rotations
from depthmocap.exporting.constant_bones import with_constant_bones
from depthmocap.exporting.foot_contacts import RunningFeet
from depthmocap.exporting.kinematic_skeleton import pointed_rotations
from depthmocap.exporting.learnt_rotations import LOOKED_BACK_S
from depthmocap.exporting.rotation_guess import likely_now
from depthmocap.exporting.seen_points import TURNED, point_places, turned_by_points
from depthmocap.exporting.timeline import LEAST_CONFIDENCE, Y_UP_FROM_Z_UP, points_beside
from depthmocap.frames import Pose
from depthmocap.geometry import z_up_from
from depthmocap.kernels.nearest_rotation import nearest_rotations

#: The rest skeleton is learnt from so many poses, at doubling distances,
LEARNT_POSES = 512
#: and for so long of somebody seen (s); from then on it stays.
LEARNT_S = 5.0
#: Time constant of the low-pass of how points of the skin turn bones (s).
_TURN_S = 0.1
#: Longer than this between poses nobody was seen (s).
_LONGEST_S = 0.2


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

    def world_rotations(self) -> Float[ndarray, "18 3 3"]:
        """Each bone's rotation in the world."""
        return world_rotations(self.local[None])[0]

    def positions(self) -> Float[ndarray, "18 3"]:
        """The joints."""
        return joint_positions(self.local[None], self.root[None], self.offsets)[0]


class RunningSkeleton:
    """Takes the poses of one person and gives rotations; a bone that is not seen holds its last rotation."""

    def __init__(self, up: str, offsets: Float[ndarray, "18 3"] | None = None) -> None:
        """``up``: the up axis of the poses' world; ``offsets``: the rest skeleton (m) of a person who is known."""
        self._up, self._y_up_from_world = up, Y_UP_FROM_Z_UP @ z_up_from(up)
        self._learnt: list[Float[ndarray, "18 3"]] = []
        self._count, self._seen_s, self._last_ns, self._given = 0, 0.0, 0, offsets is not None
        self._posed: PosedSkeleton | None = None
        #: By how much a bone's length has changed at most, from one pose to the next, while lengths were learnt (m).
        self.largest_change_m = 0.0
        self._offsets = np.zeros((18, 3)) if offsets is None else offsets
        self._feet = RunningFeet()
        self._past: collections.deque[tuple[int, Float[ndarray, "18 3"]]] = collections.deque(maxlen=16)
        self._turns = np.tile(np.eye(3), (len(TURNED), 1, 1))
        self._places = point_places(self._offsets)

    @property
    def learning(self) -> bool:
        """Whether lengths may still change."""
        return not self._given and self._count < LEARNT_POSES and self._seen_s < LEARNT_S

    def __call__(self, pose: Pose) -> PosedSkeleton | None:
        """The posed skeleton; None while nothing was ever seen."""
        sure = np.isfinite(pose.joints).all(1) & (pose.confidence >= LEAST_CONFIDENCE)
        joints = np.where(sure[:, None], pose.joints @ self._y_up_from_world.T, np.nan)
        if self._posed is None and not sure.any():
            return None
        step_s = (pose.timestamp_ns - self._last_ns) * 1e-9 if self._posed is not None else 0.0
        self._last_ns = pose.timestamp_ns
        if sure.any():
            self._learn(joints, step_s)
        steady = with_constant_bones(joints[None], self._offsets)
        steady = self._feet(steady, step_s)
        # What was there before, for what is not seen now.
        before = self._posed
        whole = steady
        if not sure.all():
            frames = steady if before is None else np.concatenate([before.positions()[None], steady])
            whole = joint_positions(*bone_rotations(frames, self._offsets)[:2], self._offsets)[-1:]
        likely = likely_now(self._window(pose.timestamp_ns, whole), self._offsets)
        if (beside := points_beside([pose], self._up)) is not None:
            likely = self._turned(likely, beside, step_s)
        if before is not None and not sure.all():
            steady = np.concatenate([before.positions()[None], steady])
            likely = np.concatenate([before.world_rotations()[None], likely])
        local, root, _ = pointed_rotations(steady, self._offsets, likely)
        self._posed = PosedSkeleton(local[-1], root[-1], self._offsets)
        return self._posed

    def _turned(
        self, likely: Float[ndarray, "1 18 3 3"], beside: Float[ndarray, "1 18 3"], step_s: float
    ) -> Float[ndarray, "1 18 3 3"]:
        """Likely rotations, turned as points of the skin tell, whose noise a low-pass takes away."""
        before = likely[0, TURNED]
        turns = np.swapaxes(before, -1, -2) @ turned_by_points(likely, beside, self._places)[0, TURNED]
        weight = 1 - np.exp(-max(step_s, 0.0) / _TURN_S) if self._posed is not None else 1.0
        self._turns = nearest_rotations(self._turns + weight * (turns - self._turns))
        likely = likely.copy()
        likely[0, TURNED] = before @ self._turns
        return likely

    def _learn(self, joints: Float[ndarray, "18 3"], step_s: float) -> None:
        if not self.learning:
            return
        self._count += 1
        self._seen_s += min(max(step_s, 0.0), _LONGEST_S)
        self._learnt.append(joints)
        if self._count & (self._count - 1) == 0 or not self.learning:  # a power of two, or the last
            before = np.linalg.norm(self._offsets, axis=-1)
            self._offsets = rest_offsets(np.stack(self._learnt))
            self._places = point_places(self._offsets)
            if self._count > 1:
                changes = np.abs(np.linalg.norm(self._offsets, axis=-1) - before)
                self.largest_change_m = max(self.largest_change_m, float(changes.max()))

    def _window(self, now_ns: int, whole: Float[ndarray, "1 18 3"]) -> Float[ndarray, "w 1 18 3"]:
        """The joints now and at the times before that the network looks at, of the poses nearest to these."""
        if self._past and now_ns <= self._past[-1][0]:
            self._past.clear()
        self._past.append((now_ns, whole[0]))
        ages_s = np.array([now_ns - then_ns for then_ns, _ in self._past]) * 1e-9
        nearest = [int(np.abs(ages_s - back_s).argmin()) for back_s in LOOKED_BACK_S]
        return np.stack([self._past[i][1][None] for i in nearest])
