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

#: Bones whose direction at rest differs between skeletons (T-pose, arms down): bones of the body at their ends.
_DIRECTIONS: dict[str, tuple[str, str]] = {
    "upper_arm": ("upperarm01", "lowerarm01"),
    "forearm": ("lowerarm01", "wrist"),
    "hand": ("wrist", "finger3-1"),
    "thigh": ("upperleg01", "lowerleg01"),
    "shin": ("lowerleg01", "foot"),
    "foot": ("foot", "toe3-1"),
}
#: Next bone of the limb.
_NEXT_BONES = {"upper_arm": "forearm", "forearm": "hand", "thigh": "shin", "shin": "foot"}
#: Posture bones of the spine, and the bone of the body at whose head each bends.
_SPINE = {"spine_low": "spine05", "spine_mid": "spine03", "spine_up": "spine01"}
#: Up axis of a file's world.
Up = Literal["x", "y", "z", "-x", "-y", "-z"]
#: Direction of each up axis.
AXES: dict[Up, Float[ndarray, "3"]] = {
    "x": np.array([1.0, 0, 0]), "y": np.array([0, 1.0, 0]), "z": np.array([0, 0, 1.0]),
    "-x": np.array([-1.0, 0, 0]), "-y": np.array([0, -1.0, 0]), "-z": np.array([0, 0, -1.0]),
}  # fmt: skip
#: Number of frames from which the up axis is estimated.
_UP_FRAMES = 60
#: Least median cosine between trunks and an up axis that differs from the rest pose's.
_UPRIGHT_COSINE = 0.8
#: Up axis of files whose zero pose does not stand.
_DEFAULT_UP = np.array([0.0, 1.0, 0.0])
#: Largest plausible offset of a joint, in any unit of length.
_LARGEST_OFFSET = 1e9
_QUARTER_TURNS = Rotation.create_group("O").as_matrix()


class Retargeted(NamedTuple):
    """Postures of a motion, and the up axis of the file's world if it differs from that of the rest pose."""

    postures: Float[ndarray, "n 20 3"]
    up: Up | None


def retarget(
    motion: Motion, skeleton: SkeletonMap, anny_rest: dict[str, Float[ndarray, "3"]], up: Up | None = None
) -> Retargeted:
    """Postures of a motion.

    ``world rotation of a posture bone = world rotation in the file @ (our rest pose → the file's)``. The file's rest
    pose is its zero pose if a person stands in it, otherwise (in files whose offsets are in the bones' frames) the most
    upright frame. Bones that the file lacks follow their parents. The bend of a spine with fewer joints than ours is
    distributed so that the shoulders move as in the file.

    Args:
        motion: in any axes; the rest pose's up axis and heading are estimated from hips, shoulders and spine.
        skeleton: the joints of the posture bones.
        anny_rest: head of every bone of the body at rest (Z up), which gives our rest directions.
        up: up axis of the file's world; by default it is estimated: that of the rest pose, or another one along which
            trunks are upright and the root is as high as that of a standing person.

    Raises:
        InputError: when a limb has no length, or the skeleton a number that is not finite.
    """
    # An impossible tip of a limb counts as none; an impossible joint is an error.
    motion = dataclasses.replace(motion, ends=np.where(_is_plausible(motion.ends)[:, None], motion.ends, 0.0))
    if not all(np.abs(array).max() < _LARGEST_OFFSET for array in (motion.offsets, motion.rotations)):
        raise InputError("its skeleton has a number that is not finite, or no length that can be")
    tails = {bone: _tail(motion, skeleton, bone) for bone in skeleton.joints if bone.partition(".")[0] in _DIRECTIONS}
    for bone, tail in tails.items():
        if np.linalg.norm(tail) < 1e-6 and bone.partition(".")[0] in _NEXT_BONES:
            raise InputError(f"bone {motion.names[skeleton.joints[bone]]} ({bone}) has no length")
    world = motion.world_rotations()
    reference = np.broadcast_to(np.eye(3), world.shape[1:])
    axes = _snap_to_quarter_turn(_body_axes(motion, skeleton, reference))
    rest_up = axes[:, 2]
    if not _stands(tails, rest_up):
        rest_up = _DEFAULT_UP if up is None else AXES[up]
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
        if kind in _DIRECTIONS:
            direction = reference[joint] @ tails[bone]
            if np.linalg.norm(direction) > 1e-6:  # in some files feet end without an offset
                head, tail = (anny_rest[f"{name}.{side}"] for name in _DIRECTIONS[kind])
                align = rotation_between(axes @ (tail - head), direction) @ axes
        result[:, index] = z_up @ world[:, joint] @ (reference[joint].T @ align)
    _distribute_spine_bend(result, motion, skeleton, reference, anny_rest)
    new_up: Up | None = None
    if rest_up @ world_up < 0.5:
        new_up = next(name for name, axis in AXES.items() if axis @ world_up > 0.5)
    return Retargeted(local_rotations(result).astype(np.float32), new_up)


def _is_plausible(places: Float[ndarray, "j 3"]) -> Bool[ndarray, "j"]:
    """Which offsets are finite and at most ``_LARGEST_OFFSET``."""
    return np.asarray((np.abs(np.nan_to_num(places, nan=np.inf)) < _LARGEST_OFFSET).all(1))


def _distribute_spine_bend(
    result: Float[ndarray, "n 20 3 3"],
    motion: Motion,
    skeleton: SkeletonMap,
    reference: Float[ndarray, "j 3 3"],
    anny_rest: dict[str, Float[ndarray, "3"]],
) -> None:
    """Distribute the bends of a spine of one or two joints over our three bones: each joint's rotation is divided
    between the two bones next to its height, so that the shoulders move as in the file."""
    available = [bone for bone in _SPINE if bone in skeleton.joints]
    if not 0 < len(available) < len(_SPINE):
        return
    heads = motion.heads(reference)
    bones = skeleton.joints

    def heights(spine: list[ndarray], hips: list[ndarray], shoulders: list[ndarray]) -> ndarray:
        low = np.mean(hips, 0)
        trunk = np.mean(shoulders, 0) - low
        return (np.array(spine) - low) @ trunk / (trunk @ trunk)

    file_heights = heights(
        [heads[bones[bone]] for bone in available],
        *([heads[bones[f"{bone}.{side}"]] for side in "RL"] for bone in ("thigh", "upper_arm")),
    )
    body_heights = heights(
        [anny_rest[bone] for bone in _SPINE.values()],
        *([anny_rest[f"{bone}.{side}"] for side in "RL"] for bone in ("upperleg01", "upperarm01")),
    )
    pelvis = result[:, POSTURE_BONES.index("pelvis")].copy()
    parent_rotations = pelvis
    turns: list[Rotation] = []
    for bone in available:
        rotations = result[:, POSTURE_BONES.index(bone)].copy()
        turns.append(Rotation.from_matrix(np.swapaxes(parent_rotations, -1, -2) @ rotations))
        parent_rotations = rotations
    for i, bone in enumerate(_SPINE):
        rotation = pelvis
        for turn, height in zip(turns, file_heights, strict=True):
            # Share of this joint's rotation at our bone and below; 1 at the highest bone.
            share = 1.0 if i == 2 else float(np.interp(height, body_heights[i : i + 2], [1.0, 0.0]))
            rotation = rotation @ Rotation.from_rotvec(turn.as_rotvec() * share).as_matrix()
        result[:, POSTURE_BONES.index(bone)] = rotation


def _world_up(
    motion: Motion,
    skeleton: SkeletonMap,
    tails: dict[str, Float[ndarray, "3"]],
    world: Float[ndarray, "n j 3 3"],
    rest_up: Float[ndarray, "3"],
) -> Float[ndarray, "3"]:
    """Up axis of the motion: that of the rest pose, unless trunks are upright along another axis, the root's height
    along it is about a leg length, and its height along the first is not that of a lying person."""
    frames = np.unique(np.linspace(0, len(world) - 1, _UP_FRAMES).astype(int))
    trunks = np.stack([_trunk(motion, skeleton, world[frame]) for frame in frames])
    trunks /= np.maximum(np.linalg.norm(trunks, axis=1, keepdims=True), 1e-9)
    if np.median(trunks @ rest_up) > 0.5:
        return rest_up
    best = max(AXES.values(), key=lambda axis: float(np.median(trunks @ axis)))
    if np.median(trunks @ best) < _UPRIGHT_COSINE:
        return rest_up
    leg = sum(float(np.linalg.norm(tails[f"{bone}.{side}"])) for bone in ("thigh", "shin") for side in "RL") / 2
    heights, rest_heights = (motion.root_path @ axis / leg for axis in (best, rest_up))
    stands = 0.6 < np.median(heights) < 1.5
    lies = 0.07 < np.median(rest_heights) < 0.5 and np.ptp(rest_heights) < 0.4
    return best if stands and not lies else rest_up


def _tail(motion: Motion, skeleton: SkeletonMap, bone: str) -> Float[ndarray, "3"]:
    """From a bone's joint to the next bone's joint in the zero pose, or to the nearest descendant."""
    joint = skeleton.joints[bone]
    kind, _, side = bone.partition(".")
    next_joint = skeleton.joints.get(f"{_NEXT_BONES.get(kind)}.{side}")
    if next_joint is None:
        return motion.tail(joint)
    chain = motion.ancestors(next_joint)
    if joint not in chain:
        return motion.tail(joint)
    return motion.offsets[chain[: chain.index(joint)]].sum(0)


def _body_axes(motion: Motion, skeleton: SkeletonMap, world: Float[ndarray, "j 3 3"]) -> Float[ndarray, "3 3"]:
    """Columns: the body's left, backward and up directions under world rotations, in the file's axes."""
    heads, joints = motion.heads(world), skeleton.joints
    across = (heads[joints[f"{bone}.L"]] - heads[joints[f"{bone}.R"]] for bone in ("thigh", "upper_arm"))
    return _orthonormal(sum(across, np.zeros(3)), _trunk(motion, skeleton, world))


def _trunk(motion: Motion, skeleton: SkeletonMap, world: Float[ndarray, "j 3 3"]) -> Float[ndarray, "3"]:
    """From the middle of the hips to the middle of the shoulders."""
    heads, joints = motion.heads(world), skeleton.joints
    hips, shoulders = ((heads[joints[f"{bone}.L"]] + heads[joints[f"{bone}.R"]]) / 2 for bone in ("thigh", "upper_arm"))
    return shoulders - hips


def _orthonormal(left: Float[ndarray, "3"], up: Float[ndarray, "3"]) -> Float[ndarray, "3 3"]:
    """Orthonormal axes with this up direction and approximately this left direction."""
    up_length = np.linalg.norm(up)
    left = left - up * (left @ up) / max(up_length, 1e-12) ** 2
    if min(up_length, float(np.linalg.norm(left))) < 1e-6:
        raise InputError("the trunk has no length or no width: hips and shoulders are at the same place")
    left, up = left / np.linalg.norm(left), up / up_length
    return np.stack([left, np.cross(up, left), up], axis=1)


def _snap_to_quarter_turn(axes: Float[ndarray, "3 3"]) -> Float[ndarray, "3 3"]:
    """The nearest quarter turn, if within 30 degrees: small angles come from a skeleton's build, not from posture."""
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
    """Index of the frame with the most vertical thighs and shins."""
    heights = np.zeros(len(world))
    for bone in (f"{bone}.{side}" for bone in ("thigh", "shin") for side in "RL"):
        heights += world[:, skeleton.joints[bone]] @ tails[bone] @ up / np.linalg.norm(tails[bone])
    return int(heights.argmin())
