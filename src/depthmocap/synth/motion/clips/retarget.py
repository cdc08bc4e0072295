"""A file's motion as our postures: every bone takes its joint's world rotation, rest directions brought together."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.posture import POSTURE_BONES, POSTURE_PARENTS, local_rotations
from depthmocap.errors import InputError
from depthmocap.geometry.transforms import rotation_between
from depthmocap.synth.motion.clips.motion import Motion
from depthmocap.synth.motion.clips.skeletons import SkeletonMap

#: Bones whose direction at rest differs between skeletons (T-pose, arms down): from their own head to this bone's.
_AIMS: dict[str, tuple[str, str]] = {
    "upper_arm": ("upperarm01", "lowerarm01"),
    "forearm": ("lowerarm01", "wrist"),
    "hand": ("wrist", "finger3-1"),
    "thigh": ("upperleg01", "lowerleg01"),
    "shin": ("lowerleg01", "foot"),
    "foot": ("foot", "toe3-1"),
}
#: The next bone of the limb, where the file's bone ends.
_NEXT = {"upper_arm": "forearm", "forearm": "hand", "thigh": "shin", "shin": "foot"}
#: Up in a file whose zero pose does not tell.
_USUAL_UP = np.array([0.0, 1.0, 0.0])
#: No joint is farther from its parent, in any unit of length.
_FARTHEST = 1e9
_QUARTER_TURNS = Rotation.create_group("O").as_matrix()


def retarget(
    motion: Motion, skeleton: SkeletonMap, anny_rest: dict[str, Float[ndarray, "3"]]
) -> Float[ndarray, "n 20 3"]:
    """Postures of a motion.

    ``world rotation of our bone = world rotation in the file @ (our rest pose → the file's)``. The file's rest pose is
    its zero pose where a person stands in it; files whose offsets are in the bones' own frames have no such pose, and
    then it is the frame that stands most upright. A bone that the file has not follows its parent.

    Args:
        motion: of any axes: which way its rest pose stands and faces is found from hips, shoulders and spine.
        skeleton: the joints of our bones.
        anny_rest: head of every bone of the body at rest (Z up), which gives our rest directions.

    Raises:
        InputError: when a limb has no length, or the skeleton a number that is not finite.
    """
    if not all(np.abs(each).max() < _FARTHEST for each in (motion.offsets, motion.ends, motion.rotations)):
        raise InputError("its skeleton has a number that is not finite, or no length that can be")
    tails = {bone: _tail(motion, skeleton, bone) for bone in skeleton.joints if bone.partition(".")[0] in _AIMS}
    for bone, tail in tails.items():
        if np.linalg.norm(tail) < 1e-6 and bone.partition(".")[0] in _NEXT:
            raise InputError(f"bone {motion.names[skeleton.joints[bone]]} ({bone}) has no length")
    world = motion.world_rotations()
    reference = np.broadcast_to(np.eye(3), world.shape[1:])
    axes = _snapped(_body_axes(motion, skeleton, reference))
    up = axes[:, 2]
    if not _stands(tails, up):
        up = _USUAL_UP
        reference = world[_most_upright(tails, skeleton, world, up)]
        axes = _orthonormal(_body_axes(motion, skeleton, reference)[:, 0], up)
    z_up = rotation_between(up, np.array([0.0, 0.0, 1.0]))
    result = np.empty((len(world), len(POSTURE_BONES), 3, 3))
    for index, (bone, parent) in enumerate(zip(POSTURE_BONES, POSTURE_PARENTS, strict=True)):
        if bone not in skeleton.joints:
            result[:, index] = result[:, parent]
            continue
        joint = skeleton.joints[bone]
        align = axes
        kind, _, side = bone.partition(".")
        if kind in _AIMS:
            direction = reference[joint] @ tails[bone]
            if np.linalg.norm(direction) > 1e-6:  # some files end a foot without an offset
                head, tail = (anny_rest[f"{name}.{side}"] for name in _AIMS[kind])
                align = rotation_between(axes @ (tail - head), direction) @ axes
        result[:, index] = z_up @ world[:, joint] @ (reference[joint].T @ align)
    return local_rotations(result).astype(np.float32)


def _tail(motion: Motion, skeleton: SkeletonMap, bone: str) -> Float[ndarray, "3"]:
    """From a bone's joint to the next bone's in the zero pose, or to the nearest joint below it."""
    joint = skeleton.joints[bone]
    kind, _, side = bone.partition(".")
    following = skeleton.joints.get(f"{_NEXT.get(kind)}.{side}")
    if following is None:
        return motion.tail(joint)
    between = motion.ancestors(following)
    if joint not in between:
        return motion.tail(joint)
    return motion.offsets[between[: between.index(joint)]].sum(0)


def _body_axes(motion: Motion, skeleton: SkeletonMap, world: Float[ndarray, "j 3 3"]) -> Float[ndarray, "3 3"]:
    """Columns: the body's left, backwards and up under world rotations, in the file's axes."""
    heads = motion.heads(world)
    places = {bone: heads[joint] for bone, joint in skeleton.joints.items()}
    hips = (places["thigh.L"] + places["thigh.R"]) / 2
    shoulders = (places["upper_arm.L"] + places["upper_arm.R"]) / 2
    left = places["thigh.L"] - places["thigh.R"] + places["upper_arm.L"] - places["upper_arm.R"]
    return _orthonormal(left, shoulders - hips)


def _orthonormal(left: Float[ndarray, "3"], up: Float[ndarray, "3"]) -> Float[ndarray, "3 3"]:
    """Axes with this up and about this left."""
    up_length = np.linalg.norm(up)
    left = left - up * (left @ up) / max(up_length, 1e-12) ** 2
    if min(up_length, float(np.linalg.norm(left))) < 1e-6:
        raise InputError("the trunk has no length or no width: hips and shoulders are at the same place")
    left, up = left / np.linalg.norm(left), up / up_length
    return np.stack([left, np.cross(up, left), up], axis=1)


def _snapped(axes: Float[ndarray, "3 3"]) -> Float[ndarray, "3 3"]:
    """The nearest quarter turn if it is within 30 degrees: a rest pose leans a little by build, not by posture."""
    cosines = (np.einsum("nij,ij->n", _QUARTER_TURNS, axes) - 1) / 2
    best = int(cosines.argmax())
    return _QUARTER_TURNS[best] if cosines[best] > np.cos(np.deg2rad(30)) else axes


def _stands(tails: dict[str, Float[ndarray, "3"]], up: Float[ndarray, "3"]) -> bool:
    """Whether thighs and shins point downwards, within 60 degrees, in the zero pose."""
    legs = [tails[f"{bone}.{side}"] for bone in ("thigh", "shin") for side in "RL"]
    return all(leg @ up < -0.5 * np.linalg.norm(leg) for leg in legs)


def _most_upright(
    tails: dict[str, Float[ndarray, "3"]],
    skeleton: SkeletonMap,
    world: Float[ndarray, "n j 3 3"],
    up: Float[ndarray, "3"],
) -> int:
    """The frame whose thighs and shins point downwards most."""
    heights = np.zeros(len(world))
    for bone in (f"{bone}.{side}" for bone in ("thigh", "shin") for side in "RL"):
        heights += world[:, skeleton.joints[bone]] @ tails[bone] @ up / np.linalg.norm(tails[bone])
    return int(heights.argmin())
