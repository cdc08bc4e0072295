"""A person's motion as a skeleton of constant bone lengths: the one place where files get their rotations from."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX, PARENTS
from depthmocap.exporting.bone_rotations import CHILDREN, bone_rotations, joint_positions, rest_offsets
from depthmocap.exporting.gap_filling import fill_gaps
from depthmocap.exporting.timeline import Timeline


@dataclasses.dataclass(frozen=True, eq=False)
class BodyMotion:
    """A moving skeleton: metres, Y up; at rest a T pose that faces +Z, all bones' axes those of the world.

    Attributes:
        times_s: of the frames, from the take's start.
        joints: as observed or filled; NaN where unknown.
        frame_s: the interval of frames.
        offsets: of each joint from its parent, at rest.
        local: each joint's rotation in its parent's frame.
        root: position of the root, Hip.
        held: joints whose bones keep their last rotation, because nothing was seen of them.
        filled: joints whose position was interpolated.
    """

    times_s: Float[ndarray, " t"]
    frame_s: float
    joints: Float[ndarray, "t 18 3"]
    offsets: Float[ndarray, "18 3"]
    local: Float[ndarray, "t 18 3 3"]
    root: Float[ndarray, "t 3"]
    held: Bool[ndarray, "t 18"]
    filled: Bool[ndarray, "t 18"]

    def world_rotations(self) -> Float[ndarray, "t 18 3 3"]:
        """Each bone's rotation in the world; a bone starts at the joint of its name."""
        world = np.zeros_like(self.local)
        for joint, parent in PARENTS.items():
            i = JOINT_INDEX[joint]
            world[:, i] = self.local[:, i] if parent is None else world[:, JOINT_INDEX[parent]] @ self.local[:, i]
        return world

    @property
    def rotation_held(self) -> Bool[ndarray, "t 18"]:
        """Bones whose rotation is not observed: it is the last one that was."""
        held = self.held.copy()
        for joint, children in CHILDREN.items():
            if children:
                held[:, JOINT_INDEX[joint]] = self.held[:, [JOINT_INDEX[child] for child in children]].all(1)
        return held

    def positions(self) -> Float[ndarray, "t 18 3"]:
        """The skeleton's joints."""
        return joint_positions(self.local, self.root, self.offsets)


def solve_body(line: Timeline, fill_s: float = 0.0) -> BodyMotion:
    """The motion of a person's joints.

    Lengths are medians over the recording (:func:`rest_offsets`), rotations those of :func:`bone_rotations`, so that
    joints of the skeleton differ from those of the poses by as much as the estimated lengths vary.

    Args:
        fill_s: gaps of a joint up to so long are filled first (:func:`fill_gaps`).
    """
    offsets = rest_offsets(line.joints_y_up)
    joints, filled = fill_gaps(line.times_s, line.joints_y_up, fill_s)
    local, root, held = bone_rotations(joints, offsets)
    return BodyMotion(line.times_s, line.frame_s, joints, offsets, local, root, held, filled)
