"""A file's motion as our postures: every bone takes its joint's world rotation, rest directions brought together."""

from __future__ import annotations

import dataclasses
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.errors import InputError
from depthmocap.geometry.transforms import rotation_between
from depthmocap.synth.body.bones import POSTURE_BONES, POSTURE_PARENTS, local_rotations
from depthmocap.synth.motion.clips.clip_motion import Motion
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
#: Our spine's bones, and the bone of the body at whose head each bends.
_SPINE = {"spine_low": "spine05", "spine_mid": "spine03", "spine_up": "spine01"}
Up = Literal["x", "y", "z", "-x", "-y", "-z"]
AXES: dict[Up, Float[ndarray, "3"]] = {
    "x": np.array([1.0, 0, 0]), "y": np.array([0, 1.0, 0]), "z": np.array([0, 0, 1.0]),
    "-x": np.array([-1.0, 0, 0]), "-y": np.array([0, -1.0, 0]), "-z": np.array([0, 0, -1.0]),
}  # fmt: skip
#: Frames that tell which way is up, and how upright (cosine) trunks are along it.
_LOOKS, _UPRIGHT = 60, 0.8
#: Up in a file whose zero pose does not tell.
_USUAL_UP = np.array([0.0, 1.0, 0.0])
#: No joint is farther from its parent, in any unit of length.
_FARTHEST = 1e9
_QUARTER_TURNS = Rotation.create_group("O").as_matrix()


class Retargeted(NamedTuple):
    """Postures of a motion; and which way is up in the file's world, where that is not up in its rest pose."""

    postures: Float[ndarray, "n 20 3"]
    up: Up | None


def retarget(
    motion: Motion, skeleton: SkeletonMap, anny_rest: dict[str, Float[ndarray, "3"]], up: Up | None = None
) -> Retargeted:
    """Postures of a motion.

    ``world rotation of our bone = world rotation in the file @ (our rest pose → the file's)``. The file's rest pose is
    its zero pose where a person stands in it; files whose offsets are in the bones' own frames have no such pose, and
    then it is the frame that stands most upright. A bone that the file has not follows its parent; the bend of a spine
    of fewer joints than ours is shared out so that its middle is as high as in the file.

    Args:
        motion: of any axes: which way its rest pose stands and faces is found from hips, shoulders and spine.
        skeleton: the joints of our bones.
        anny_rest: head of every bone of the body at rest (Z up), which gives our rest directions.
        up: the axis that is up in the file's world; by default that of its rest pose, or another along which the root
            is as high as who moves along it stands.

    Raises:
        InputError: when a limb has no length, or the skeleton a number that is not finite.
    """
    # An impossible tip of a limb counts as none; an impossible joint is an error.
    motion = dataclasses.replace(motion, ends=np.where(_possible(motion.ends)[:, None], motion.ends, 0.0))
    if not all(np.abs(array).max() < _FARTHEST for array in (motion.offsets, motion.rotations)):
        raise InputError("its skeleton has a number that is not finite, or no length that can be")
    tails = {bone: _tail(motion, skeleton, bone) for bone in skeleton.joints if bone.partition(".")[0] in _AIMS}
    for bone, tail in tails.items():
        if np.linalg.norm(tail) < 1e-6 and bone.partition(".")[0] in _NEXT:
            raise InputError(f"bone {motion.names[skeleton.joints[bone]]} ({bone}) has no length")
    world = motion.world_rotations()
    reference = np.broadcast_to(np.eye(3), world.shape[1:])
    axes = _snapped(_body_axes(motion, skeleton, reference))
    rest_up = axes[:, 2]
    if not _stands(tails, rest_up):
        rest_up = _USUAL_UP if up is None else AXES[up]
        reference = world[_most_upright(tails, skeleton, world, rest_up)]
        axes = _orthonormal(_body_axes(motion, skeleton, reference)[:, 0], rest_up)
    world_up = _world_up(motion, skeleton, tails, world, rest_up) if up is None else AXES[up]
    z_up = rotation_between(world_up, np.array([0.0, 0.0, 1.0]))
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
    _share_bend(result, motion, skeleton, reference, anny_rest)
    other: Up | None = None
    if rest_up @ world_up < 0.5:
        other = next(name for name, axis in AXES.items() if axis @ world_up > 0.5)
    return Retargeted(local_rotations(result).astype(np.float32), other)


def _possible(places: Float[ndarray, "j 3"]) -> Bool[ndarray, "j"]:
    """Which of some places are finite, and no farther than anything can be."""
    return np.asarray((np.abs(np.nan_to_num(places, nan=np.inf)) < _FARTHEST).all(1))


def _share_bend(
    result: Float[ndarray, "n 20 3 3"],
    motion: Motion,
    skeleton: SkeletonMap,
    reference: Float[ndarray, "j 3 3"],
    anny_rest: dict[str, Float[ndarray, "3"]],
) -> None:
    """Share the bends of a spine of one or two joints out among our three, so that the shoulders come as far over the
    hips as in the file: each joint's rotation goes to the two of ours between which it lies, by its height."""
    there = [bone for bone in _SPINE if bone in skeleton.joints]
    if not 0 < len(there) < len(_SPINE):
        return
    heads = motion.heads(reference)
    bones = skeleton.joints

    def heights(spine: list[ndarray], hips: list[ndarray], shoulders: list[ndarray]) -> ndarray:
        low = np.mean(hips, 0)
        trunk = np.mean(shoulders, 0) - low
        return (np.array(spine) - low) @ trunk / (trunk @ trunk)

    theirs = heights(
        [heads[bones[bone]] for bone in there],
        *([heads[bones[f"{bone}.{side}"]] for side in "RL"] for bone in ("thigh", "upper_arm")),
    )
    ours = heights(
        [anny_rest[bone] for bone in _SPINE.values()],
        *([anny_rest[f"{bone}.{side}"] for side in "RL"] for bone in ("upperleg01", "upperarm01")),
    )
    pelvis = result[:, POSTURE_BONES.index("pelvis")].copy()
    below = pelvis
    turns: list[Rotation] = []
    for bone in there:
        here = result[:, POSTURE_BONES.index(bone)].copy()
        turns.append(Rotation.from_matrix(np.swapaxes(below, -1, -2) @ here))
        below = here
    for i, bone in enumerate(_SPINE):
        spread = pelvis
        for turn, height in zip(turns, theirs, strict=True):
            # What of this joint's rotation is at our bone and below it: all of it at the highest.
            share = 1.0 if i == 2 else float(np.interp(height, ours[i : i + 2], [1.0, 0.0]))
            spread = spread @ Rotation.from_rotvec(turn.as_rotvec() * share).as_matrix()
        result[:, POSTURE_BONES.index(bone)] = spread


def _world_up(
    motion: Motion,
    skeleton: SkeletonMap,
    tails: dict[str, Float[ndarray, "3"]],
    world: Float[ndarray, "n j 3 3"],
    rest_up: Float[ndarray, "3"],
) -> Float[ndarray, "3"]:
    """Which way is up where the person moves: that of the rest pose, unless trunks stand along another axis, the root
    is as high along that as legs are long, and along the first it is not where that of somebody who lies is."""
    some = np.unique(np.linspace(0, len(world) - 1, _LOOKS).astype(int))
    trunks = np.stack([_trunk(motion, skeleton, world[frame]) for frame in some])
    trunks /= np.maximum(np.linalg.norm(trunks, axis=1, keepdims=True), 1e-9)
    if np.median(trunks @ rest_up) > 0.5:
        return rest_up
    best = max(AXES.values(), key=lambda axis: float(np.median(trunks @ axis)))
    if np.median(trunks @ best) < _UPRIGHT:
        return rest_up
    leg = sum(float(np.linalg.norm(tails[f"{bone}.{side}"])) for bone in ("thigh", "shin") for side in "RL") / 2
    high, low = (motion.root_path @ axis / leg for axis in (best, rest_up))
    stands = 0.6 < np.median(high) < 1.5
    lies = 0.07 < np.median(low) < 0.5 and np.ptp(low) < 0.4
    return best if stands and not lies else rest_up


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
    heads, joints = motion.heads(world), skeleton.joints
    across = (heads[joints[f"{bone}.L"]] - heads[joints[f"{bone}.R"]] for bone in ("thigh", "upper_arm"))
    return _orthonormal(sum(across, np.zeros(3)), _trunk(motion, skeleton, world))


def _trunk(motion: Motion, skeleton: SkeletonMap, world: Float[ndarray, "j 3 3"]) -> Float[ndarray, "3"]:
    """From between the hips to between the shoulders."""
    heads, joints = motion.heads(world), skeleton.joints
    hips, shoulders = ((heads[joints[f"{bone}.L"]] + heads[joints[f"{bone}.R"]]) / 2 for bone in ("thigh", "upper_arm"))
    return shoulders - hips


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
