"""Bone rotations from joint positions, for formats that animate a rest skeleton of constant bone lengths.

The objective: of the rotation ``R_j`` of every joint, in its parent's frame,

    minimise over R_j  sum over the children c of j  | v_c - R_parents R_j o_c |²

with ``v_c`` the observed vector from joint to child and ``o_c`` the same in the rest skeleton. With several children
that is an orthogonal Procrustes problem, solved by a singular value decomposition (Kabsch); with one, the twist about
the bone is not observed, and the shortest rotation is taken.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.body.skeleton import BONES, JOINT_INDEX, JOINTS, MIRROR, PARENTS
from depthmocap.geometry import rotation_between

ROOT = "Hip"
CHILDREN: dict[str, tuple[str, ...]] = {
    joint: tuple(child for parent, child in BONES if parent == joint) for joint in PARENTS
}

_UP, _DOWN, _LEFT, _RIGHT = (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)

#: The rest skeleton: a T pose that faces +Z, Y up, the subject's left at +X. By joint, the direction from its parent,
#: and an adult's length (m), used only for a bone that is never observed. At the joints with several children, Hip and
#: Spine2, the directions are the person's own, turned to fit these as well as possible.
REST: dict[str, tuple[tuple[float, float, float], float]] = {
    "Spine": (_UP, 0.10), "Spine1": (_UP, 0.12), "Spine2": (_UP, 0.12), "Neck": (_UP, 0.15), "Head": (_UP, 0.10),
    "RHip": ((-0.8, -0.6, 0.0), 0.11), "RKnee": (_DOWN, 0.42), "RFoot": (_DOWN, 0.40),
    "LHip": ((0.8, -0.6, 0.0), 0.11), "LKnee": (_DOWN, 0.42), "LFoot": (_DOWN, 0.40),
    "RShoulder": ((-0.8, 0.6, 0.0), 0.20), "RElbow": (_RIGHT, 0.27), "RHand": (_RIGHT, 0.25),
    "LShoulder": ((0.8, 0.6, 0.0), 0.20), "LElbow": (_LEFT, 0.27), "LHand": (_LEFT, 0.25),
}  # fmt: skip

#: Where the last bones end in the rest skeleton: the offset (m) from the joint. They are not observed.
END_SITES: dict[str, tuple[float, float, float]] = {
    "Head": (0.0, 0.20, 0.0),
    "RHand": (-0.18, 0.0, 0.0),
    "LHand": (0.18, 0.0, 0.0),
    "RFoot": (0.0, -0.06, 0.18),
    "LFoot": (0.0, -0.06, 0.18),
}


def _depth(joint: str) -> int:
    parent = PARENTS[joint]
    return 0 if parent is None else 1 + _depth(parent)


#: Joints by their distance from the root in the tree.
_FROM_ROOT = sorted(range(len(JOINTS)), key=lambda i: _depth(JOINTS[i]))
#: A shorter vector (m) has no direction.
_SHORTEST_M = 1e-6
#: Children nearly on one line leave the twist about it open: below this ratio of singular values it is not fitted.
_LEAST_SPREAD = 0.01


def _index(names: Sequence[str]) -> list[int]:
    return [JOINT_INDEX[name] for name in names]


def _bone_vectors(joints: Float[ndarray, "t 18 3"]) -> Float[ndarray, "t 18 3"]:
    """From each joint's parent to the joint, NaN where either is unobserved; NaN for the root."""
    vectors = np.full_like(joints, np.nan)
    parents, children = zip(*BONES, strict=True)
    vectors[:, _index(children)] = joints[:, _index(children)] - joints[:, _index(parents)]
    return vectors


def _fit_rotation(rest: Float[ndarray, "k 3"], observed: Float[ndarray, "t k 3"]) -> Float[ndarray, "t 3 3"]:
    """Rotations that take the rest vectors closest to the observed ones; NaN where they leave it open."""
    covariance = np.swapaxes(np.nan_to_num(observed), 1, 2) @ rest
    U, singular, Vt = np.linalg.svd(covariance)
    U[..., 2] *= np.sign(np.linalg.det(U @ Vt))[:, None]  # a rotation, not a reflection
    rotation = U @ Vt
    rotation[singular[:, 1] <= _LEAST_SPREAD * singular[:, 0]] = np.nan
    return rotation


def _shortest_rotation(rest: Float[ndarray, " 3"], observed: Float[ndarray, "t 3"]) -> Float[ndarray, "t 3 3"]:
    rotation = np.full((len(observed), 3, 3), np.nan)
    if np.linalg.norm(rest) <= _SHORTEST_M:
        return rotation
    clear = np.linalg.norm(observed, axis=-1) > _SHORTEST_M  # False for NaN
    rotation[clear] = rotation_between(np.broadcast_to(rest, (int(clear.sum()), 3)), observed[clear])
    return rotation


def _held(values: Float[ndarray, "t ..."], default: Float[ndarray, " ..."] | None = None) -> Float[ndarray, "t ..."]:
    """NaN replaced by the last good value; before the first by ``default``, or without one by the first itself."""
    good = np.asarray(~np.isnan(values).any(axis=tuple(range(1, values.ndim))))
    last = np.maximum.accumulate(np.where(good, np.arange(len(values)), -1))
    before = values[np.argmax(good)] if default is None else default
    return np.where((last < 0).reshape(-1, *[1] * (values.ndim - 1)), before, values[np.maximum(last, 0)])


def rest_offsets(joints_y_up: Float[ndarray, "t 18 3"]) -> Float[ndarray, "18 3"]:
    """The person's rest skeleton: each joint's offset (m) from its parent, zero for the root.

    Lengths are medians over the recording; a bone that was never observed takes its mirror image's.
    """
    vectors = _bone_vectors(joints_y_up)
    lengths_by_frame = np.linalg.norm(vectors, axis=-1)
    lengths = np.full(len(JOINTS), np.nan)
    for joint in REST:
        seen = lengths_by_frame[:, JOINT_INDEX[joint]]
        if not np.isnan(seen).all():
            lengths[JOINT_INDEX[joint]] = np.nanmedian(seen)
    lengths = np.where(np.isnan(lengths), lengths[MIRROR], lengths)

    offsets = np.zeros((len(JOINTS), 3))
    for joint, (direction, adult_length) in REST.items():
        i = JOINT_INDEX[joint]
        offsets[i] = np.array(direction) * (adult_length if np.isnan(lengths[i]) else lengths[i])
    for children in CHILDREN.values():
        index = _index(children)
        if len(index) < 2:
            continue
        rotation = _fit_rotation(offsets[index], vectors[:, index])
        unturned = vectors[:, index] @ rotation  # row vectors: R^T v
        unturned = unturned[~np.isnan(unturned).any((1, 2))]
        if len(unturned):
            own = np.median(unturned, axis=0)
            own_length = np.linalg.norm(own, axis=-1, keepdims=True)
            own_length[own_length < _SHORTEST_M] = np.inf
            offsets[index] = own / own_length * np.linalg.norm(offsets[index], axis=-1, keepdims=True)
    return offsets


def bone_rotations(
    joints_y_up: Float[ndarray, "t 18 3"], offsets: Float[ndarray, "18 3"]
) -> tuple[Float[ndarray, "t 18 3 3"], Float[ndarray, "t 3"], Bool[ndarray, "t 18"]]:
    """Each joint's rotation in its parent's frame, the root's position (m), and the joints that were held, by frame.

    What a frame does not observe keeps its rotation of the last frame that does, in its parent's frame, so that a
    hidden arm moves with the body; before it is first observed it has that of the rest skeleton. A root that is not
    observed follows the observed joint next to it; without any it keeps its position, and before the first it has that.
    """
    vectors = _bone_vectors(joints_y_up)
    unseen = np.asarray(np.isnan(joints_y_up).any(-1))
    held = unseen.copy()
    local = np.zeros((len(joints_y_up), len(JOINTS), 3, 3))
    world = np.zeros_like(local)
    for joint, parent in PARENTS.items():
        i = JOINT_INDEX[joint]
        world_from_parent = np.eye(3) if parent is None else world[:, JOINT_INDEX[parent]]
        local[:, i] = np.eye(3)
        if children := _index(CHILDREN[joint]):
            in_parent = vectors[:, children] @ world_from_parent
            if len(children) > 1:
                rotation = _fit_rotation(offsets[children], in_parent)
            else:
                rotation = _shortest_rotation(offsets[children[0]], in_parent[:, 0])
            held[:, children] |= (unseen[:, i] | np.isnan(rotation[:, 0, 0]))[:, None]
            local[:, i] = _held(rotation, np.eye(3))
        world[:, i] = world_from_parent @ local[:, i]
    # Where the root is by each observed joint, the nearest in the tree first, which is the root itself.
    roots = (joints_y_up - joint_positions(local, np.zeros((len(local), 3)), offsets))[:, _FROM_ROOT]
    nearest = np.argmax(~unseen[:, _FROM_ROOT], axis=1)
    return local, _held(roots[np.arange(len(roots)), nearest]), held


def joint_positions(
    local: Float[ndarray, "t 18 3 3"], root: Float[ndarray, "t 3"], offsets: Float[ndarray, "18 3"]
) -> Float[ndarray, "t 18 3"]:
    """Forward kinematics: the joints (m) of a posed rest skeleton."""
    positions = np.zeros((len(local), len(JOINTS), 3))
    world = np.zeros_like(local)
    for joint, parent in PARENTS.items():
        i = JOINT_INDEX[joint]
        if parent is None:
            positions[:, i], world[:, i] = root, local[:, i]
        else:
            p = JOINT_INDEX[parent]
            positions[:, i] = positions[:, p] + world[:, p] @ offsets[i]
            world[:, i] = world[:, p] @ local[:, i]
    return positions


def euler_zxy_deg(rotation: Float[ndarray, "t *n 3 3"]) -> Float[ndarray, "t *n 3"]:
    """Angles (degrees) z, x, y of ``R = Rz Rx Ry``, without jumps of a turn between frames."""
    sin_x = np.clip(rotation[..., 2, 1], -1, 1)
    locked = np.abs(sin_x) > 1 - 1e-9  # z and y turn about the same axis: all of it is given to z
    z = np.where(
        locked,
        np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0]),
        np.arctan2(-rotation[..., 0, 1], rotation[..., 1, 1]),
    )
    y = np.where(locked, 0.0, np.arctan2(-rotation[..., 2, 0], rotation[..., 2, 2]))
    return np.rad2deg(np.unwrap(np.stack([z, np.arcsin(sin_x), y], -1), axis=0))
