"""True rotations of bones, in the convention of files: away from a T pose that faces +Z, Y up, palms down, elbows and
knees as hinges.

In the T pose the right elbow bends about +Y and the left about −Y, hands to the front; knees bend about +X, heels to
the back. The engine's rest pose has its arms down and its elbows bent: what brings its bones into the T pose follows
from each body's own joints.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.geometry import z_up_from
from depthmocap.synth.body.bones import POSTURE_INDEX, world_rotations
from depthmocap.synth.body.mesh import Body

#: Of the bone that starts at each joint, the posture bone that it turns with.
_TRUNK = {
    "Hip": "pelvis",
    "Spine": "spine_low",
    "Spine1": "spine_mid",
    "Spine2": "spine_up",
    "Neck": "neck",
    "Head": "head",
}
_LIMBS = {
    "Shoulder": "upper_arm",
    "Elbow": "forearm",
    "Hand": "hand",
    "Hip": "thigh",
    "Knee": "shin",
    "Foot": "foot",
}
_POSTURE_BONE = [
    POSTURE_INDEX[_TRUNK[joint] if joint in _TRUNK else f"{_LIMBS[joint[1:]]}.{joint[0]}"] for joint in JOINTS
]
#: An elbow bent by less does not tell its hinge.
_BENT_RAD = np.deg2rad(25.0)
#: Frames with a bent elbow that tell where its hinge is.
_FEWEST_BENT = 5
_Y_UP = z_up_from("y").T
_PELVIS = POSTURE_INDEX["pelvis"]


@dataclasses.dataclass(frozen=True, eq=False)
class TrueMotion:
    """Joints (metres) and rotations of the bones that start at them, Y up."""

    joints: Float[ndarray, "t 18 3"]
    rotations: Float[ndarray, "t 18 3 3"]


def true_motion(
    body: Body, postures: Float[ndarray, "t 20 3"], pelvis_y_up: Float[ndarray, "t 3"] | None = None
) -> TrueMotion:
    """A body's joints and bone rotations in every posture of one motion.

    Args:
        pelvis_y_up: where the joint Hip is; by default where it is at rest.
    """
    model = body.model
    world = world_rotations(np.asarray(postures, dtype=np.float64))
    of_bone = world[:, model.posture_of_bone]
    heads = np.zeros((len(postures), len(body.rest_heads), 3))
    heads[:, 0] = body.rest_heads[0]
    for bones, parents in model.levels:
        offsets = body.rest_heads[bones] - body.rest_heads[parents]
        heads[:, bones] = heads[:, parents] + np.einsum("tbij,bj->tbi", of_bone[:, parents], offsets)
    joints = heads[:, model.joint_bones] @ _Y_UP.T
    if pelvis_y_up is not None:
        joints += (pelvis_y_up - joints[:, JOINT_INDEX["Hip"]])[:, None]
    rotations = _away_from_t_pose(body, world)
    _turn_to_hinges(joints, rotations)
    return TrueMotion(joints, rotations)


def bone_frames(body: Body, postures: Float[ndarray, "t 20 3"]) -> Float[ndarray, "t 18 3 3"]:
    """Rotations of the mesh's bones away from the T pose, Y up; elbows are not turned to their hinges."""
    return _away_from_t_pose(body, world_rotations(np.asarray(postures, dtype=np.float64)))


def _away_from_t_pose(body: Body, world: Float[ndarray, "t 20 3 3"]) -> Float[ndarray, "t 18 3 3"]:
    return _Y_UP @ world[:, _POSTURE_BONE] @ _Y_UP.T @ t_pose_from_rest(body).swapaxes(-1, -2)


def _turn_to_hinges(joints: Float[ndarray, "t 18 3"], rotations: Float[ndarray, "t 18 3 3"]) -> None:
    """Turn upper arms and forearms about themselves, by one angle each for the whole motion, so that elbows bend about
    their hinge. Clips have bones' rotations up to such an angle, which depends on how each file's rest pose was drawn.
    Of arms that never bend it is unknown, and so are their rotations: NaN."""
    for side, left in (("R", -1.0), ("L", 1.0)):
        shoulder, elbow, hand = (joints[:, JOINT_INDEX[side + name]] for name in ("Shoulder", "Elbow", "Hand"))
        hinge = np.cross(elbow - shoulder, hand - elbow)
        size = np.linalg.norm(hinge, axis=-1)
        length = np.linalg.norm(elbow - shoulder, axis=-1) * np.linalg.norm(hand - elbow, axis=-1)
        bent = size > np.sin(_BENT_RAD) * length
        for name in ("Shoulder", "Elbow"):
            i = JOINT_INDEX[side + name]
            if bent.sum() < _FEWEST_BENT:
                rotations[:, i] = np.nan
                continue
            inside = np.einsum("tij,ti->tj", rotations[bent, i], hinge[bent] / size[bent, None])
            mean = np.median(inside, axis=0)
            # About +X, from the T pose's hinge (0, ∓1, 0) to where it is.
            angle = np.arctan2(-left * mean[2], -left * mean[1])
            rotations[:, i] = rotations[:, i] @ Rotation.from_rotvec([angle, 0.0, 0.0]).as_matrix()


def t_pose_from_rest(body: Body) -> Float[ndarray, "18 3 3"]:
    """Of every bone, the rotation (Y up) that brings it from the body's rest pose into the T pose."""
    rest = body.rest_heads[body.model.joint_bones] @ _Y_UP.T
    turns = np.tile(np.eye(3), (len(JOINTS), 1, 1))
    for side, left in (("R", -1.0), ("L", 1.0)):
        shoulder, elbow, hand, hip, knee, foot = (rest[JOINT_INDEX[side + name]] for name in _LIMBS)
        arm, across = np.array([left, 0.0, 0.0]), np.array([0.0, -left, 0.0])
        hinge = np.cross(elbow - shoulder, hand - elbow)
        down, sideways = np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0])
        for name, bone, axis, bone_then, axis_then in (
            ("Shoulder", elbow - shoulder, hinge, arm, across),
            ("Elbow", hand - elbow, hinge, arm, across),
            ("Hand", hand - elbow, hinge, arm, across),
            ("Hip", knee - hip, sideways, down, sideways),
            ("Knee", foot - knee, sideways, down, sideways),
        ):
            turns[JOINT_INDEX[side + name]] = _frame(bone_then, axis_then) @ _frame(bone, axis).T
    return turns


def _frame(along: Float[ndarray, "3"], axis: Float[ndarray, "3"]) -> Float[ndarray, "3 3"]:
    """Orthonormal columns: a direction, and the part of an axis that is perpendicular to it."""
    first = along / np.linalg.norm(along)
    second = axis - (axis @ first) * first
    second = second / np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)], 1)
