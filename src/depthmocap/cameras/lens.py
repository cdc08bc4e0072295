"""Lens models of SDKs that this project does not have, and pictures that an SDK mirrors."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.geometry import DepthCamera

#: Tangent of half the diagonal field of view of a camera with 75° × 65°.
NARROW_FOV_TAN = 1.0


def five_coefficients(
    coefficients: Float[ndarray, "8"], fov_tan: float = NARROW_FOV_TAN
) -> tuple[float, float, float, float, float]:
    """The lens model k1, k2, p1, p2, k3 that is nearest to OpenCV's rational model.

    The radial factor is fitted by least squares over radii that are weighted by their number of pixels. The tangential
    part stays the same.

    Args:
        coefficients: k1, k2, p1, p2, k3, k4, k5, k6 of the rational model.
        fov_tan: tangent of half the field of view over which the models shall agree.
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients.tolist()
    if not (k4 or k5 or k6):
        return k1, k2, p1, p2, k3
    r2 = np.linspace(0, fov_tan, 200) ** 2
    factor = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    powers = np.stack([r2, r2**2, r2**3], 1)
    weight = r2[:, None] ** 0.75  # displacement is radius × factor, and pixels grow with the radius
    a, b, c = np.linalg.lstsq(powers * weight, (factor - 1) * weight[:, 0], rcond=None)[0].tolist()
    return a, b, p1, p2, c


def unmirrored(camera: DepthCamera) -> DepthCamera:
    """The camera of the picture that is flipped from left to right."""
    k1, k2, p1, p2, k3 = camera.distortion
    return dataclasses.replace(camera, cx=camera.width - 1 - camera.cx, distortion=(k1, k2, p1, -p2, k3))
