"""Skeletons as other tools name them: joints under other names, bones added that these tools expect, T or A pose.

Bones' axes are those of the world at rest (x the subject's left, y up, z forward) whatever the names: tools that fit an
animation to a character by names and rest pose need no others.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS, PARENTS
from depthmocap.exporting.body_motion import BodyMotion
from depthmocap.geometry import rotation_between

SkeletonName = Literal["depthmocap", "unity", "unreal", "mixamo", "cmu", "vrm"]
RestPose = Literal["t", "a"]

#: How far the arms of an A pose hang below those of a T pose (radians).
_A_POSE_RAD = np.pi / 4
_TRUNK = ("Hip", "Spine", "Spine1", "Spine2", "Neck", "Head")
_LIMBS = ("Shoulder", "Elbow", "Hand", "Hip", "Knee", "Foot")
#: Where a collarbone starts, as shares of the way (left, up, forward) from Spine2 to the shoulder.
_COLLARBONE = np.array([0.15, 0.9, 1.0])
#: The ball of the foot from the ankle (m).
_BALL = np.array([0.0, -0.06, 0.12])


@dataclasses.dataclass(frozen=True)
class _Names:
    """Names of one tool.

    Attributes:
        trunk: of Hip, Spine, Spine1, Spine2, Neck and Head.
        side: how a limb's name is made of the words for its side and itself.
        sides: the words for right and left.
        limbs: of Shoulder, Elbow, Hand, Hip, Knee and Foot.
        collarbone, toes, hip: of bones that are added on both sides; "" for none.
        root: of a bone on the floor that does not move; "" for none.
    """

    trunk: tuple[str, ...]
    side: str
    sides: tuple[str, str]
    limbs: tuple[str, ...]
    collarbone: str = ""
    toes: str = ""
    hip: str = ""
    root: str = ""


_NAMES: dict[SkeletonName, _Names] = {
    "depthmocap": _Names(_TRUNK, "{side}{limb}", ("R", "L"), _LIMBS),
    "unity": _Names(
        ("Hips", "Spine", "Chest", "UpperChest", "Neck", "Head"), "{side}{limb}", ("Right", "Left"),
        ("UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot"), "Shoulder", "Toes",
    ),
    "unreal": _Names(
        ("pelvis", "spine_01", "spine_02", "spine_03", "neck_01", "head"), "{limb}_{side}", ("r", "l"),
        ("upperarm", "lowerarm", "hand", "thigh", "calf", "foot"), "clavicle", "ball", root="root",
    ),
    "mixamo": _Names(
        tuple(f"mixamorig:{name}" for name in ("Hips", "Spine", "Spine1", "Spine2", "Neck", "Head")),
        "mixamorig:{side}{limb}", ("Right", "Left"),
        ("Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot"), "Shoulder", "ToeBase",
    ),
    "cmu": _Names(
        ("Hips", "LowerBack", "Spine", "Spine1", "Neck", "Head"), "{side}{limb}", ("Right", "Left"),
        ("Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot"), "Shoulder", "ToeBase", hip="HipJoint",
    ),
    "vrm": _Names(
        ("hips", "spine", "chest", "upperChest", "neck", "head"), "{side}{limb}", ("right", "left"),
        ("UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot"), "Shoulder", "Toes",
    ),
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Bone:
    """A bone of a skeleton: its name, its parent's number (-1 for none), and the joint of ours that it starts at, whose
    rotation it has; an added bone has none, and follows its parent."""

    name: str
    parent: int
    joint: str | None


def bones_of(skeleton: SkeletonName) -> tuple[Bone, ...]:
    """The bones of a skeleton, parents before children."""
    names = _NAMES[skeleton]
    bones: list[Bone] = []
    number: dict[str, int] = {}

    def add(name: str, parent: int, joint: str | None = None) -> int:
        bones.append(Bone(name, parent, joint))
        if joint is not None:
            number[joint] = len(bones) - 1
        return len(bones) - 1

    def limb(side: str, name: str) -> str:
        return names.side.format(side=names.sides["RL".index(side)], limb=name)

    parent = add(names.root, -1) if names.root else -1
    for joint, name in zip(_TRUNK, names.trunk, strict=True):
        parent = add(name, parent, joint)
    for side in "RL":
        for i, part in enumerate(_LIMBS):
            joint = side + part
            parent = number[PARENTS[joint] or ""]
            if part == "Shoulder" and names.collarbone:
                parent = add(limb(side, names.collarbone), parent)
            if part == "Hip" and names.hip:
                parent = add(f"{side}{names.hip}", parent)
            parent = add(limb(side, names.limbs[i]), parent, joint)
            if part == "Foot" and names.toes:
                add(limb(side, names.toes), parent)
    return tuple(bones)


def rest_turns(rest: RestPose) -> Float[ndarray, "18 3 3"]:
    """How each bone is turned in the rest pose away from the T pose."""
    turns = np.tile(np.eye(3), (len(JOINTS), 1, 1))
    if rest == "a":
        for side, across in (("R", -1.0), ("L", 1.0)):
            down = np.array([across * np.cos(_A_POSE_RAD), -np.sin(_A_POSE_RAD), 0.0])
            arm = [JOINT_INDEX[side + part] for part in ("Shoulder", "Elbow", "Hand")]
            turns[arm] = rotation_between(np.array([across, 0.0, 0.0]), down)
    return turns


@dataclasses.dataclass(frozen=True, eq=False)
class PosedSkeleton:
    """A moving skeleton with another tool's names: metres, Y up, facing +Z at rest.

    Attributes:
        offsets: of each bone from its parent at rest; of a bone without parent, where it stands.
        local: rotation in its parent's frame, which at rest is that of the world.
        hips: the number of the bone that also moves, and ``root`` where it is; its parent, if any, is at the origin.
        bone_of_joint: the number of the bone that starts at each joint.
    """

    bones: tuple[Bone, ...]
    offsets: Float[ndarray, "b 3"]
    local: Float[ndarray, "t b 3 3"]
    hips: int
    root: Float[ndarray, "t 3"]
    bone_of_joint: Int[ndarray, "18"]

    @property
    def rest_positions(self) -> Float[ndarray, "b 3"]:
        """Where bones start at rest."""
        positions = self.offsets.copy()
        for i, bone in enumerate(self.bones):
            if bone.parent >= 0:
                positions[i] += positions[bone.parent]
        return positions

    def children(self, bone: int) -> list[int]:
        """Numbers of the bones that hang from one."""
        return [i for i, other in enumerate(self.bones) if other.parent == bone]

    def positions(self) -> Float[ndarray, "t b 3"]:
        """Where bones start: forward kinematics."""
        positions, world = np.zeros((*self.local.shape[:2], 3)), self.local.copy()
        for i, bone in enumerate(self.bones):
            offset = self.root if i == self.hips else np.broadcast_to(self.offsets[i], self.root.shape)
            if bone.parent < 0:
                positions[:, i] = offset
                continue
            parent = world[:, bone.parent]
            positions[:, i] = positions[:, bone.parent] + np.einsum("tij,tj->ti", parent, offset)
            world[:, i] = parent @ self.local[:, i]
        return positions


def retarget(motion: BodyMotion, skeleton: SkeletonName, rest: RestPose) -> PosedSkeleton:
    """A motion as a skeleton of another tool; joints stay where they are.

    The hips stand at rest as high as the lowest ankle needs, over the origin.
    """
    bones = bones_of(skeleton)
    turns = rest_turns(rest)
    world = motion.world_rotations() @ np.swapaxes(turns, -1, -2)
    of_joint = {bone.joint: i for i, bone in enumerate(bones) if bone.joint is not None}
    offsets = np.zeros((len(bones), 3))
    worlds = np.zeros((len(world), len(bones), 3, 3))
    local = worlds.copy()
    for i, bone in enumerate(bones):
        parent = bones[bone.parent] if bone.parent >= 0 else None
        if bone.joint is None:
            worlds[:, i] = np.eye(3) if parent is None else worlds[:, bone.parent]
            if parent is not None and parent.joint == "Spine2":
                shoulder = next(other.joint for other in bones if other.parent == i)
                offsets[i] = _COLLARBONE * motion.offsets[JOINT_INDEX[shoulder or ""]]
            elif parent is not None and parent.joint in ("RFoot", "LFoot"):
                offsets[i] = _BALL
        else:
            worlds[:, i] = world[:, JOINT_INDEX[bone.joint]]
            before = PARENTS[bone.joint]
            if before is not None:
                turn = turns[JOINT_INDEX[before]]
                offsets[i] = turn @ motion.offsets[JOINT_INDEX[bone.joint]]
                if parent is not None and parent.joint is None:
                    offsets[i] -= offsets[bone.parent]
        local[:, i] = worlds[:, i] if parent is None else np.swapaxes(worlds[:, bone.parent], -1, -2) @ worlds[:, i]
    hips = of_joint["Hip"]
    posed = PosedSkeleton(bones, offsets, local, hips, motion.root, np.array([of_joint[joint] for joint in JOINTS]))
    lowest = posed.rest_positions[[of_joint["RFoot"], of_joint["LFoot"]], 1].min()
    offsets[hips, 1] = ANKLE_HEIGHT_M - lowest
    return posed


#: Height of an ankle over the floor.
ANKLE_HEIGHT_M = 0.08
