"""Lens models of SDKs that this project does not have, and pictures that an SDK mirrors."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.geometry import DepthCamera

#: Half the diagonal field of view (tangent) of a camera of 75° × 65°.
NARROW = 1.0


def five_coefficients(eight: Float[ndarray, "8"], field: float = NARROW) -> tuple[float, float, float, float, float]:
    """k1, k2, p1, p2, k3 nearest to OpenCV's rational lens model (k1, k2, p1, p2, k3, k4, k5, k6) over half the field
    of view, which is given as its tangent.

    Least squares of the radial factor at radii weighted by the pixels there; the tangential part is the same.
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = eight.tolist()
    if not (k4 or k5 or k6):
        return k1, k2, p1, p2, k3
    r2 = np.linspace(0, field, 200) ** 2
    factor = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    powers = np.stack([r2, r2**2, r2**3], 1)
    weight = r2[:, None] ** 0.75  # displacement is radius × factor, and pixels grow with the radius
    a, b, c = np.linalg.lstsq(powers * weight, (factor - 1) * weight[:, 0], rcond=None)[0].tolist()
    return a, b, p1, p2, c


def unmirrored(camera: DepthCamera) -> DepthCamera:
    """The camera whose picture is the other's, turned left to right."""
    k1, k2, p1, p2, k3 = camera.distortion
    return dataclasses.replace(camera, cx=camera.width - 1 - camera.cx, distortion=(k1, k2, p1, -p2, k3))
