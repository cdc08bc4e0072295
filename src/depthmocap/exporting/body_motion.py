"""A person's motion as a skeleton of constant bone lengths: the one place where files get their rotations from."""

from __future__ import annotations

import dataclasses

from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.exporting.bone_rotations import CHILDREN, joint_positions, rest_offsets, world_rotations
from depthmocap.exporting.constant_bones import with_constant_bones
from depthmocap.exporting.foot_contacts import hold_feet, standing_feet
from depthmocap.exporting.gap_filling import fill_gaps
from depthmocap.exporting.kinematic_skeleton import solve_rotations
from depthmocap.exporting.timeline import Timeline

#: What is likely of rotations is smoothed over time by so much (s, standard deviation).
_SMOOTH_S = 0.06


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
        standing: whether the right and the left foot stand, and are held where they do.
    """

    times_s: Float[ndarray, " t"]
    frame_s: float
    joints: Float[ndarray, "t 18 3"]
    offsets: Float[ndarray, "18 3"]
    local: Float[ndarray, "t 18 3 3"]
    root: Float[ndarray, "t 3"]
    held: Bool[ndarray, "t 18"]
    filled: Bool[ndarray, "t 18"]
    standing: Bool[ndarray, "t 2"]

    def world_rotations(self) -> Float[ndarray, "t 18 3 3"]:
        """Each bone's rotation in the world; a bone starts at the joint of its name."""
        return world_rotations(self.local)

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


def solve_body(line: Timeline, fill_s: float = 0.0, offsets: Float[ndarray, "18 3"] | None = None) -> BodyMotion:
    """The motion of a person's joints, with joints, rotations and lengths that agree.

    Lengths are medians over the recording (:func:`rest_offsets`) unless they are given. The joints are moved as little
    as possible to have them (:func:`with_constant_bones`), feet that stand are held where they do (:func:`hold_feet`),
    and the bones turn as :func:`solve_rotations` says, which looks at what comes before and after.

    Args:
        fill_s: gaps of a joint up to so long are filled first (:func:`fill_gaps`).
        offsets: of each joint from its parent in the T pose (m), of a person who is known.
    """
    if offsets is None:
        offsets = rest_offsets(line.joints_y_up)
    joints, filled = fill_gaps(line.times_s, line.joints_y_up, fill_s)
    steady = with_constant_bones(joints, offsets)
    standing = standing_feet(steady, line.frame_s)
    steady = hold_feet(steady, standing, line.frame_s)
    local, root, held = solve_rotations(steady, offsets, line.times_s, _SMOOTH_S, line.beside_y_up)
    return BodyMotion(line.times_s, line.frame_s, joints, offsets, local, root, held, filled, standing)
