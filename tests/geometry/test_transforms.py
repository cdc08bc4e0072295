"""Rigid transforms: inverses, cameras that look where they should, shortest rotations, up axes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from depthmocap.geometry import is_rigid, look_at, rigid_inverse, rotation_between, transform_points, z_up_from


def random_pose(rng: np.random.Generator) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(rng=rng).as_matrix()
    pose[:3, 3] = rng.normal(size=3)
    return pose


def test_transforms_chain_and_invert() -> None:
    rng = np.random.default_rng(0)
    a_from_b, b_from_c = random_pose(rng), random_pose(rng)
    points_c = rng.normal(size=(5, 7, 3))
    points_a = transform_points(a_from_b @ b_from_c, points_c)
    np.testing.assert_allclose(points_a, transform_points(a_from_b, transform_points(b_from_c, points_c)))
    c_from_a = rigid_inverse(b_from_c) @ rigid_inverse(a_from_b)
    np.testing.assert_allclose(transform_points(c_from_a, points_a), points_c)
    np.testing.assert_allclose(rigid_inverse(a_from_b), np.linalg.inv(a_from_b))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_points_keep_their_dtype(dtype: type) -> None:
    points = np.ones((4, 3), dtype=dtype)
    assert transform_points(random_pose(np.random.default_rng(1)), points).dtype == dtype


def test_is_rigid() -> None:
    pose = random_pose(np.random.default_rng(2))
    assert is_rigid(pose)
    mirrored, scaled, sheared, unfinished, infinite = (pose.copy() for _ in range(5))
    mirrored[:, 0] *= -1
    scaled[:3, :3] *= 1.01
    sheared[:3, 0] += 0.05 * sheared[:3, 1]
    unfinished[3] = [0, 0, 0, 2]
    infinite[0, 3] = np.nan
    assert not any(is_rigid(matrix) for matrix in (mirrored, scaled, sheared, unfinished, infinite))


@pytest.mark.parametrize(
    ("eye", "target"), [((3.0, -2.0, 1.5), (0.0, 0.1, 0.9)), ((0.0, 0.0, 3.0), (0.0, 0.0, 0.0))], ids=["side", "top"]
)
@pytest.mark.parametrize("roll_rad", [0.0, 0.4])
def test_look_at(eye: tuple[float, ...], target: tuple[float, ...], roll_rad: float) -> None:
    pose = look_at(np.array(eye), np.array(target), roll_rad)
    assert is_rigid(pose, 1e-9)
    target_camera = transform_points(rigid_inverse(pose), np.array(target))
    distance = float(np.linalg.norm(np.subtract(eye, target)))
    np.testing.assert_allclose(target_camera, [0, 0, distance], atol=1e-12)


def test_look_at_is_upright_and_rolls_clockwise() -> None:
    eye, target = np.array([0.0, -3.0, 1.0]), np.array([0.0, 0.0, 1.0])
    level = look_at(eye, target)
    np.testing.assert_allclose(level[:3, :3], [[1, 0, 0], [0, 0, 1], [0, -1, 0]], atol=1e-12)
    # A camera turned clockwise, seen from behind it, has its right below the horizon.
    assert look_at(eye, target, 0.3)[2, 0] == pytest.approx(-np.sin(0.3))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_rotation_between(dtype: type) -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, 200, 3)).astype(dtype)
    b[:20] = -2 * a[:20]  # half a turn
    b[20:40] = a[20:40] * 3
    b[40:60] = -a[40:60] + 1e-5 * rng.normal(size=(20, 3))  # nearly half a turn
    rotation = rotation_between(a, b)
    assert all(is_rigid(np.block([[r, np.zeros((3, 1))], [np.zeros(3), 1]]), 1e-5) for r in rotation)
    turned = np.einsum("nij,nj->ni", rotation, a / np.linalg.norm(a, axis=1, keepdims=True))
    np.testing.assert_allclose(turned, b / np.linalg.norm(b, axis=1, keepdims=True), atol=1e-4)
    np.testing.assert_allclose(rotation[20:40], np.broadcast_to(np.eye(3), (20, 3, 3)), atol=1e-5)
    # The shortest: its angle is the angle between the two directions.
    cos = (a * b).sum(1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
    np.testing.assert_allclose(Rotation.from_matrix(rotation).magnitude(), np.arccos(np.clip(cos, -1, 1)), atol=2e-3)


@pytest.mark.parametrize(("up", "axis"), [("z", (0, 0, 1)), ("y", (0, 1, 0)), ("-y", (0, -1, 0))])
def test_z_up_from(up: str, axis: tuple[int, ...]) -> None:
    rotation = z_up_from(up)
    np.testing.assert_array_equal(rotation @ np.array(axis, dtype=float), [0, 0, 1])
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_z_up_from_rejects_other_axes() -> None:
    with pytest.raises(ValueError, match="up must be"):
        z_up_from("x")
