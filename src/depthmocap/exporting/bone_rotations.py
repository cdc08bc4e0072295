"""Bone rotations from joint positions, for formats that animate a rest skeleton of constant bone lengths.

The objective: of the rotation ``R_j`` of every joint, in its parent's frame,

    minimise over R_j  sum over the children c of j  | v_c - R_parents R_j o_c |²

where ``v_c`` is the observed vector from the joint to the child and ``o_c`` the same vector in the rest skeleton. With
several children this is an orthogonal Procrustes problem, solved by the rotation nearest to the vectors' covariance.
With one child the twist about the bone is not observed, and the shortest rotation is used.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import BONES, JOINT_INDEX, JOINTS, MIRROR, PARENTS
from depthmocap.geometry import rotation_between
from depthmocap.kernels.nearest_rotation import nearest_rotations

ROOT = "Hip"
CHILDREN: dict[str, tuple[str, ...]] = {
    joint: tuple(child for parent, child in BONES if parent == joint) for joint in PARENTS
}

_DOWN, _LEFT, _RIGHT = (0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)

#: The rest skeleton: a T pose that faces +Z, Y up, the subject's left at +X; the trunk as in somebody who stands at
#: ease, so that pelvis and head are level; shoulders and neck 3° further forwards, as people mostly hold them who move.
#: For each joint the direction from its parent, and an adult's length (m), which is used only for a bone that is never
#: observed. At the joints with several children, Hip and Spine2, the
#: person's own directions are used, rotated to fit these best.
REST: dict[str, tuple[tuple[float, float, float], float]] = {
    "Spine": ((0.0, 0.915, 0.404), 0.10), "Spine1": ((0.0, 0.994, 0.105), 0.16), "Spine2": ((0.0, 0.995, -0.098), 0.14),
    "Neck": ((0.0, 0.977, 0.213), 0.19), "Head": ((0.0, 0.944, 0.331), 0.11),
    "RHip": ((-0.837, 0.023, 0.546), 0.13), "RKnee": (_DOWN, 0.42), "RFoot": (_DOWN, 0.40),
    "LHip": ((0.837, 0.023, 0.546), 0.13), "LKnee": (_DOWN, 0.42), "LFoot": (_DOWN, 0.40),
    "RShoulder": ((-0.877, 0.417, 0.236), 0.21), "RElbow": (_RIGHT, 0.27), "RHand": (_RIGHT, 0.25),
    "LShoulder": ((0.877, 0.417, 0.236), 0.21), "LElbow": (_LEFT, 0.27), "LHand": (_LEFT, 0.25),
}  # fmt: skip

#: End sites of the last bones in the rest skeleton: offset (m) from the joint. They are not observed.
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
_ROOT = JOINT_INDEX[ROOT]
#: Of each joint (row) itself and the joints between it and the root.
_ANCESTRY = np.eye(len(JOINTS))
for _joint, _parent in PARENTS.items():  # parents before children
    if _parent is not None:
        _ANCESTRY[JOINT_INDEX[_joint]] += _ANCESTRY[JOINT_INDEX[_parent]] * (_parent != ROOT)
#: A vector shorter than this (m) has no direction.
_SHORTEST_M = 1e-6
#: Least ratio of the singular values for a fit: children nearly on one line do not determine the twist about it.
_LEAST_SPREAD = 0.01


def _index(names: Sequence[str]) -> list[int]:
    return [JOINT_INDEX[name] for name in names]


def bone_vectors(joints: Float[ndarray, "t 18 3"]) -> Float[ndarray, "t 18 3"]:
    """From each joint's parent to the joint, NaN where either is unobserved; NaN for the root."""
    vectors = np.full_like(joints, np.nan)
    parents, children = zip(*BONES, strict=True)
    vectors[:, _index(children)] = joints[:, _index(children)] - joints[:, _index(parents)]
    return vectors


def fit_rotation(rest: Float[ndarray, "*b k 3"], observed: Float[ndarray, "t *b k 3"]) -> Float[ndarray, "t *b 3 3"]:
    """Rotations that fit the rest vectors best to the observed ones; NaN where these do not determine them.

    Args:
        rest: k vectors of each of b bones.
    """
    covariance = np.swapaxes(np.nan_to_num(observed), -1, -2) @ rest
    # Of the squares of singular values the sum, and the sum of products of two.
    squares = np.swapaxes(covariance, -1, -2) @ covariance
    size = np.einsum("...ii->...", squares)
    spread = (size**2 - np.einsum("...ij,...ij->...", squares, squares)) / 2
    rotation = nearest_rotations(covariance)
    rotation[spread <= (_LEAST_SPREAD * size) ** 2] = np.nan
    return rotation


def _shortest_rotation(rest: Float[ndarray, " 3"], observed: Float[ndarray, "t 3"]) -> Float[ndarray, "t 3 3"]:
    rotation = np.full((len(observed), 3, 3), np.nan)
    if np.linalg.norm(rest) <= _SHORTEST_M:
        return rotation
    valid = np.linalg.norm(observed, axis=-1) > _SHORTEST_M  # False for NaN
    rotation[valid] = rotation_between(np.broadcast_to(rest, (int(valid.sum()), 3)), observed[valid])
    return rotation


def forward_filled(
    values: Float[ndarray, "t ..."], default: Float[ndarray, " ..."] | None = None
) -> Float[ndarray, "t ..."]:
    """Values with NaN replaced by the last known value; before the first by ``default`` or, if None, by the first."""
    known = np.asarray(~np.isnan(values).any(axis=tuple(range(1, values.ndim))))
    last = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
    initial = values[np.argmax(known)] if default is None else default
    return np.where((last < 0).reshape(-1, *[1] * (values.ndim - 1)), initial, values[np.maximum(last, 0)])


def rest_offsets(joints_y_up: Float[ndarray, "t 18 3"]) -> Float[ndarray, "18 3"]:
    """The person's rest skeleton: each joint's offset (m) from its parent, zero for the root.

    Lengths are medians over the recording. A bone that was never observed has the length of its mirror image.
    """
    vectors = bone_vectors(joints_y_up)
    lengths_by_frame = np.linalg.norm(vectors, axis=-1)
    lengths = np.full(len(JOINTS), np.nan)
    for joint in REST:
        observed_lengths = lengths_by_frame[:, JOINT_INDEX[joint]]
        if not np.isnan(observed_lengths).all():
            lengths[JOINT_INDEX[joint]] = np.nanmedian(observed_lengths)
    lengths = np.where(np.isnan(lengths), lengths[MIRROR], lengths)

    offsets = np.zeros((len(JOINTS), 3))
    for joint, (direction, adult_length) in REST.items():
        i = JOINT_INDEX[joint]
        unit = np.array(direction) / np.linalg.norm(direction)
        offsets[i] = unit * (adult_length if np.isnan(lengths[i]) else lengths[i])
    for children in CHILDREN.values():
        index = _index(children)
        if len(index) < 2:
            continue
        rotation = fit_rotation(offsets[index], vectors[:, index])
        rest_vectors = vectors[:, index] @ rotation  # row vectors: R^T v
        rest_vectors = rest_vectors[~np.isnan(rest_vectors).any((1, 2))]
        if len(rest_vectors):
            directions = np.median(rest_vectors, axis=0)
            norms = np.linalg.norm(directions, axis=-1, keepdims=True)
            norms[norms < _SHORTEST_M] = np.inf
            offsets[index] = directions / norms * np.linalg.norm(offsets[index], axis=-1, keepdims=True)
    return offsets


def bone_rotations(
    joints_y_up: Float[ndarray, "t 18 3"], offsets: Float[ndarray, "18 3"]
) -> tuple[Float[ndarray, "t 18 3 3"], Float[ndarray, "t 3"], Bool[ndarray, "t 18"]]:
    """Each joint's rotation in its parent's frame, the root's position (m), and the mask of held joints, by frame.

    A rotation that a frame does not observe holds its last observed value in its parent's frame, so that a hidden arm
    moves with the body; before its first observation it is that of the rest skeleton. An unobserved root follows the
    nearest observed joint. Without any joint it holds its last position, and before the first one it has the first.
    """
    vectors = bone_vectors(joints_y_up)
    unobserved = np.asarray(np.isnan(joints_y_up).any(-1))
    held = unobserved.copy()
    local = np.zeros((len(joints_y_up), len(JOINTS), 3, 3))
    world = np.zeros_like(local)
    for joint, parent in PARENTS.items():
        i = JOINT_INDEX[joint]
        world_from_parent = np.eye(3) if parent is None else world[:, JOINT_INDEX[parent]]
        local[:, i] = np.eye(3)
        if children := _index(CHILDREN[joint]):
            in_parent = vectors[:, children] @ world_from_parent
            if len(children) > 1:
                rotation = fit_rotation(offsets[children], in_parent)
            else:
                rotation = _shortest_rotation(offsets[children[0]], in_parent[:, 0])
            held[:, children] |= (unobserved[:, i] | np.isnan(rotation[:, 0, 0]))[:, None]
            local[:, i] = forward_filled(rotation, np.eye(3))
        world[:, i] = world_from_parent @ local[:, i]
    return local, root_positions(joints_y_up, local, offsets), held


def root_positions(
    joints_y_up: Float[ndarray, "t 18 3"], local: Float[ndarray, "t 18 3 3"], offsets: Float[ndarray, "18 3"]
) -> Float[ndarray, "t 3"]:
    """Where the root is (m), from the known joint that is nearest to it in the tree: the root itself first. Without any
    joint it holds its last position, and before the first one it has the first."""
    if not np.isnan(joints_y_up[:, _ROOT]).any():
        return joints_y_up[:, _ROOT].copy()
    observed = np.asarray(~np.isnan(joints_y_up).any(-1))
    roots = (joints_y_up - joint_positions(local, np.zeros((len(local), 3)), offsets))[:, _FROM_ROOT]
    nearest = np.argmax(observed[:, _FROM_ROOT], axis=1)
    return forward_filled(roots[np.arange(len(roots)), nearest])


def world_rotations(local: Float[ndarray, "t 18 3 3"]) -> Float[ndarray, "t 18 3 3"]:
    """Each bone's rotation in the world; a bone starts at the joint of its name."""
    world = np.zeros_like(local)
    for joint, parent in PARENTS.items():
        i = JOINT_INDEX[joint]
        world[:, i] = local[:, i] if parent is None else world[:, JOINT_INDEX[parent]] @ local[:, i]
    return world


def rest_positions(offsets: Float[ndarray, "18 3"]) -> Float[ndarray, "18 3"]:
    """The joints (m) of the rest skeleton, its root at the origin."""
    return _ANCESTRY @ offsets


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
    """Euler angles (degrees) z, x, y of ``R = Rz Rx Ry``, without jumps of 360° between frames."""
    sin_x = np.clip(rotation[..., 2, 1], -1, 1)
    locked = np.abs(sin_x) > 1 - 1e-9  # gimbal lock: z and y rotate about the same axis, and z gets the whole angle
    z = np.where(
        locked,
        np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0]),
        np.arctan2(-rotation[..., 0, 1], rotation[..., 1, 1]),
    )
    y = np.where(locked, 0.0, np.arctan2(-rotation[..., 2, 0], rotation[..., 2, 2]))
    return np.rad2deg(np.unwrap(np.stack([z, np.arcsin(sin_x), y], -1), axis=0))


def quaternions(rotation: Float[ndarray, "t n 3 3"]) -> Float[ndarray, "t n 4"]:
    """Unit quaternions x, y, z, w, without jumps of sign between frames."""
    values = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_quat().reshape(*rotation.shape[:2], 4)
    turned = (values[1:] * values[:-1]).sum(-1) < 0
    signs = np.cumprod(np.where(turned, -1.0, 1.0), axis=0)
    return np.concatenate([values[:1], values[1:] * signs[..., None]])
