"""Rotations that are nearest to matrices."""

import numpy as np
import pytest

from depthmocap.kernels.nearest_rotation import nearest_rotations


def by_singular_values(matrices):
    U, _, Vt = np.linalg.svd(matrices)
    U[..., 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return U @ Vt


@pytest.mark.parametrize("spread", [1e-9, 0.1, 1.0, 30.0])
def test_nearest_rotations_are_those_of_singular_values(spread):
    rng = np.random.default_rng(0)
    matrices = by_singular_values(rng.normal(size=(60, 5, 3, 3))) + spread * rng.normal(size=(60, 5, 3, 3))
    np.testing.assert_allclose(nearest_rotations(matrices), by_singular_values(matrices), atol=1e-9)


def test_a_half_turn_and_unknown_matrices():
    half_turn = np.diag([1.0, -1.0, -1.0])
    rotations = nearest_rotations(np.stack([half_turn, np.full((3, 3), np.nan), np.eye(3)]))
    np.testing.assert_allclose(rotations[[0, 2]], [half_turn, np.eye(3)], atol=1e-12)
    assert np.isnan(rotations[1]).all()
