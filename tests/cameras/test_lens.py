"""Lens models of other SDKs."""

import numpy as np
import pytest

from depthmocap.cameras.lens import five_coefficients, unmirrored
from depthmocap.geometry import DepthCamera

#: The rational lens of a depth camera as its factory calibrates it: numerator and denominator nearly cancel.
LENS = np.array([0.52, -0.02, 1e-4, -2e-5, 0.006, 0.86, 0.105, 0.0])


def test_five_coefficients_stand_for_eight() -> None:
    """Within half a pixel over the narrow mode's field."""
    k1, k2, p1, p2, k3 = five_coefficients(LENS)
    r = np.linspace(0, 0.95, 100)
    r2 = r * r
    full = (1 + r2 * (0.52 + r2 * (-0.02 + r2 * 0.006))) / (1 + r2 * (0.86 + r2 * 0.105))
    ours = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    assert np.abs(r * (full - ours)).max() * 504 < 0.5
    assert (p1, p2) == (1e-4, -2e-5)
    five = np.array([0.1, -0.05, 0.001, 0.002, 0.01, 0, 0, 0])
    assert five_coefficients(five) == (0.1, -0.05, 0.001, 0.002, 0.01)


def test_a_wide_lens_is_fitted_over_its_own_field() -> None:
    """Within four pixels of the wide mode, where the narrow mode's fit is tens of pixels off."""
    r2 = np.linspace(0, 1.75, 100) ** 2
    full = (1 + r2 * (0.52 + r2 * (-0.02 + r2 * 0.006))) / (1 + r2 * (0.86 + r2 * 0.105))
    off = []
    for field in (1.75, 1.0):
        k1, k2, _, _, k3 = five_coefficients(LENS, field)
        off.append(np.abs(np.sqrt(r2) * (full - 1 - r2 * (k1 + r2 * (k2 + r2 * k3)))).max() * 504)
    assert off[0] < 4
    assert off[1] > 20


def test_a_mirror_of_a_mirror() -> None:
    camera = DepthCamera("a", 64, 48, 60.0, 61.0, 30.0, 22.0, distortion=(0.1, -0.05, 0.001, 0.002, 0.01))
    mirror = unmirrored(camera)
    points = np.random.default_rng(0).uniform((-1, -1, 2), (1, 1, 4), (50, 3))
    expected = camera.project(points)
    seen = mirror.project(points * [-1, 1, 1])
    np.testing.assert_allclose(seen, np.stack([63 - expected[:, 0], expected[:, 1], expected[:, 2]], 1), atol=1e-9)
    again = unmirrored(mirror)
    assert (again.cx, again.distortion) == (camera.cx, pytest.approx(camera.distortion))
