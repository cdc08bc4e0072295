"""Rotations of all bones from joints of constant bones and from what is likely where the joints leave them open.

A bone with one child has, of the rotations that point it at its child, the one nearest to the likely one; a bone with
several the one that fits its children; a bone without children the likely one. All are within people's limits; where
one is brought back into these, the bones after it still point at where their children are.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS, PARENTS
from depthmocap.exporting.bone_rotations import (
    CHILDREN,
    bone_rotations,
    bone_vectors,
    fit_rotation,
    forward_filled,
    joint_positions,
    root_positions,
)
from depthmocap.exporting.joint_limits import beyond_limits, within_limits
from depthmocap.exporting.rotation_guess import likely_rotations
from depthmocap.geometry import rotation_between

_PARENT = np.array([JOINT_INDEX[PARENTS[joint] or joint] for joint in JOINTS])
_SINGLE = np.array([JOINT_INDEX[joint] for joint, children in CHILDREN.items() if len(children) == 1])
_ONLY_CHILD = np.array([JOINT_INDEX[children[0]] for children in CHILDREN.values() if len(children) == 1])
#: Joints from which several bones hang, and these bones' ends.
_BRANCHING = np.array([JOINT_INDEX[joint] for joint, children in CHILDREN.items() if len(children) > 1])
_BRANCHES = np.array([[JOINT_INDEX[name] for name in names] for names in CHILDREN.values() if len(names) > 1])
_ENDS = np.array([JOINT_INDEX[joint] for joint, children in CHILDREN.items() if not children])


def _depth(joint: str) -> int:
    parent = PARENTS[joint]
    return 0 if parent is None else 1 + _depth(parent)


_DEPTHS = np.array([_depth(joint) for joint in JOINTS])
#: Bones by their distance from the root, which is not among them.
_LEVELS = [np.flatnonzero(level == _DEPTHS) for level in range(1, int(_DEPTHS.max()) + 1)]
_BONES = np.concatenate(_LEVELS)
_ROOT = int(np.flatnonzero(_DEPTHS == 0)[0])
_BACK = JOINT_INDEX["Spine"]
#: Of each joint the only one that hangs from it, else -1.
_CHILD = np.full(len(JOINTS), -1)
_CHILD[_SINGLE] = _ONLY_CHILD
#: A vector shorter than this (m) has no direction,
_SHORTEST_M = 1e-6
#: and one shorter than this, of a bone that was moved, an uncertain one.
_NEAR_M = 0.02
#: Elements of rotations that differ by more are not those of equal ones.
_UNEQUAL = 1e-6


def solve_rotations(
    joints: Float[ndarray, "t 18 3"],
    offsets: Float[ndarray, "18 3"],
    times_s: Float[ndarray, " t"],
    smooth_s: float = 0.0,
    beside: Float[ndarray, "t 18 3"] | None = None,
) -> tuple[Float[ndarray, "t 18 3 3"], Float[ndarray, "t 3"], Bool[ndarray, "t 18"]]:
    """Each joint's rotation in its parent's frame, the root's position (m), and the mask of held joints, by frame.

    A rotation that a frame does not observe holds its last observed value in its parent's frame, so that a hidden arm
    moves with the body; before its first observation it is that of the rest skeleton.

    Args:
        joints: Y up, NaN where unknown, with the skeleton's lengths (:func:`with_constant_bones`).
        offsets: of the rest skeleton.
        smooth_s: what is likely is smoothed over time in both directions (s, standard deviation).
        beside: points of the skin from their joints (see ``seen_points.turned_by_points``).
    """
    whole = joints
    if np.isnan(joints).any():
        whole = joint_positions(*bone_rotations(joints, offsets)[:2], offsets)
    return pointed_rotations(joints, offsets, likely_rotations(whole, times_s, offsets, smooth_s, beside))


def pointed_rotations(
    joints: Float[ndarray, "t 18 3"], offsets: Float[ndarray, "18 3"], likely: Float[ndarray, "t 18 3 3"]
) -> tuple[Float[ndarray, "t 18 3 3"], Float[ndarray, "t 3"], Bool[ndarray, "t 18"]]:
    """As :func:`solve_rotations`, from likely rotations in the world."""
    vectors = bone_vectors(joints)
    held = np.asarray(np.isnan(joints).any(-1))
    unobserved = held.copy()
    world = likely.copy()
    along = vectors[:, _ONLY_CHILD]
    known = np.linalg.norm(along, axis=-1) > _SHORTEST_M  # False for NaN
    known &= np.linalg.norm(offsets[_ONLY_CHILD], axis=-1) > _SHORTEST_M
    guess = (likely[:, _SINGLE] @ offsets[_ONLY_CHILD][:, :, None])[..., 0]
    turn = rotation_between(np.where(known[..., None], guess, 1.0), np.where(known[..., None], along, 1.0))
    world[:, _SINGLE] = np.where(known[..., None, None], turn @ likely[:, _SINGLE], np.nan)
    held[:, _ONLY_CHILD] |= unobserved[:, _SINGLE] | ~known
    world[:, _BRANCHING] = fit_rotation(offsets[_BRANCHES], vectors[:, _BRANCHES])
    held[:, _BRANCHES] |= (unobserved[:, _BRANCHING] | np.isnan(world[:, _BRANCHING, 0, 0]))[..., None]
    world[:, _ENDS] = np.where(held[:, _ENDS, None, None], np.nan, world[:, _ENDS])
    seen = ~np.isnan(world[..., 0, 0])
    world[:, _ROOT] = forward_filled(world[:, _ROOT], np.eye(3))
    local = np.swapaxes(world[:, _PARENT], -1, -2) @ world
    local[:, _ROOT] = world[:, _ROOT]
    if not (np.isnan(local).any() or beyond_limits(_BONES, local[:, _BONES]).any()):
        return local, root_positions(joints, local, offsets), held
    _turn_pelvis(world, local, seen)
    places = joints.copy()
    places[:, _ROOT] = root_positions(joints, local, offsets)
    for bones in _LEVELS:
        parents = world[:, _PARENT[bones]]
        places[:, bones] = places[:, _PARENT[bones]] + (parents @ offsets[bones][:, :, None])[..., 0]
        turned = np.swapaxes(parents, -1, -2) @ _aimed(world, bones, places, joints, offsets)
        # A parent that nobody sees tells no range.
        turned = np.where(seen[:, _PARENT[bones], None, None], within_limits(bones, turned), turned)
        if np.isnan(turned).any():
            turned = np.stack([forward_filled(turned[:, i], np.eye(3)) for i in range(len(bones))], 1)
        local[:, bones] = turned
        world[:, bones] = parents @ turned
    return local, root_positions(joints, local, offsets), held


def _turn_pelvis(
    world: Float[ndarray, "t 18 3 3"], local: Float[ndarray, "t 18 3 3"], seen: Bool[ndarray, "t 18"]
) -> None:
    """Where the back would turn further than people's do, the pelvis yields, in place: its joints are close together,
    and mistaken first where sides are."""
    turned = local[:, [_BACK]]
    within = within_limits(np.array([_BACK]), turned)[:, 0]
    beyond = seen[:, _ROOT] & (np.abs(within - turned[:, 0]) > _UNEQUAL).any((1, 2))  # False for NaN
    world[beyond, _ROOT] = local[beyond, _ROOT] = world[beyond, _BACK] @ np.swapaxes(within[beyond], -1, -2)


def _aimed(
    world: Float[ndarray, "t 18 3 3"],
    bones: Int[ndarray, " k"],
    places: Float[ndarray, "t 18 3"],
    joints: Float[ndarray, "t 18 3"],
    offsets: Float[ndarray, "18 3"],
) -> Float[ndarray, "t k 3 3"]:
    """Rotations of bones (world, Y up) that point them from where they start to where their children are: a limit of
    another bone may have moved them."""
    rotations, children = world[:, bones], _CHILD[bones]
    way = joints[:, children] - places[:, bones]
    along = (rotations @ offsets[children][:, :, None])[..., 0]
    known = (children >= 0) & (np.linalg.norm(way, axis=-1) > _NEAR_M) & (np.linalg.norm(along, axis=-1) > _SHORTEST_M)
    turn = rotation_between(np.where(known[..., None], along, 1.0), np.where(known[..., None], way, 1.0))
    return np.where(known[..., None, None], turn @ rotations, rotations)
