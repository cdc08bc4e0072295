"""Rigid transforms, named so that inner names cancel: ``a_from_b @ b_from_c`` is ``a_from_c``."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

_NEXT, _LAST = [1, 2, 0], [2, 0, 1]


def transform_points(b_from_a: Float[ndarray, "4 4"], points_a: Float[ndarray, "*n 3"]) -> Float[ndarray, "*n 3"]:
    """Points of frame ``a`` in frame ``b``, in the dtype of the points."""
    b_from_a = b_from_a.astype(points_a.dtype, copy=False)
    return points_a @ b_from_a[:3, :3].T + b_from_a[:3, 3]


def unit(vector: Float[ndarray, "3"]) -> Float[ndarray, "3"]:
    """The unit vector of the same direction; zero for the zero vector."""
    return vector / max(float(np.linalg.norm(vector)), 1e-9)


def rigid_inverse(b_from_a: Float[ndarray, "4 4"]) -> Float[ndarray, "4 4"]:
    """Inverse of a rigid transform."""
    a_from_b = np.eye(4)
    a_from_b[:3, :3] = b_from_a[:3, :3].T
    a_from_b[:3, 3] = -b_from_a[:3, :3].T @ b_from_a[:3, 3]
    return a_from_b


def is_rigid(matrix: Float[ndarray, "4 4"], tolerance: float = 1e-3) -> bool:
    """Whether a 4×4 matrix is a proper rotation and a translation."""
    rotation = matrix[:3, :3]
    return bool(
        np.isfinite(matrix).all()
        and np.abs(rotation).max() < 2  # so that no product overflows
        and np.abs(rotation @ rotation.T - np.eye(3)).max() < tolerance
        and np.linalg.det(rotation) > 0
        and np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-9)
    )


def look_at(
    eye_world: Float[ndarray, "3"], target_world: Float[ndarray, "3"], roll_rad: float = 0.0
) -> Float[ndarray, "4 4"]:
    """``world_from_camera`` of a camera (x right, y down, z forward) that looks at a point in a Z-up world."""
    forward = target_world - eye_world
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-9:  # straight up or down: any direction is right
        right = np.array([1.0, 0.0, 0.0])
    right = right / np.linalg.norm(right)
    down = np.cross(forward, right)
    cos, sin = np.cos(roll_rad), np.sin(roll_rad)
    world_from_camera = np.eye(4)
    world_from_camera[:3, 0] = cos * right + sin * down
    world_from_camera[:3, 1] = -sin * right + cos * down
    world_from_camera[:3, 2] = forward
    world_from_camera[:3, 3] = eye_world
    return world_from_camera


def cross(a: Float[ndarray, "*n 3"], b: Float[ndarray, "*n 3"]) -> Float[ndarray, "*n 3"]:
    """The vector products of few vectors, several times as fast as NumPy's."""
    return a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT]


def rotation_between(a: Float[ndarray, "*n 3"], b: Float[ndarray, "*n 3"]) -> Float[ndarray, "*n 3 3"]:
    """Shortest rotation that takes direction ``a`` to direction ``b`` (neither needs unit length)."""
    a, b = a.astype(np.float64), b.astype(np.float64)  # near 180° single precision is not enough
    a, b = (direction / np.sqrt((direction * direction).sum(-1, keepdims=True)) for direction in (a, b))
    cos = (a * b).sum(-1)[..., None, None]
    ax, ay, az, bx, by, bz = (direction[..., i] for direction in (a, b) for i in range(3))
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    cross = np.zeros((*x.shape, 3, 3))
    cross[..., 2, 1], cross[..., 0, 2], cross[..., 1, 0] = x, y, z
    cross[..., 1, 2], cross[..., 2, 0], cross[..., 0, 1] = -x, -y, -z
    opposite = cos < -1 + 1e-9  # 180° about any perpendicular axis
    rotation = np.eye(3) + cross + cross @ cross / np.where(opposite, 1.0, 1 + cos)
    if opposite.any():
        seed = np.where(np.abs(a[..., :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        normal = np.cross(a, seed)
        normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
        half_turn = 2 * normal[..., :, None] * normal[..., None, :] - np.eye(3)
        rotation = np.where(opposite, half_turn, rotation)
    return rotation


def z_up_from(up: str) -> Float[ndarray, "3 3"]:
    """Rotation into a Z-up world from a world whose up axis is ``"z"``, ``"y"`` or ``"-y"``.

    Raises:
        ValueError: for any other axis.
    """
    if up == "z":
        return np.eye(3)
    if up == "y":
        return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    if up == "-y":
        return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    raise ValueError(f"up must be 'z', 'y' or '-y', not {up!r}")
