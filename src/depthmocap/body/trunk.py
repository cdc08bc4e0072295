"""The trunk's front: the direction that chest and belly face."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX

_HIP, _NECK = JOINT_INDEX["Hip"], JOINT_INDEX["Neck"]
#: Pairs of joints that lie on the subject's left and right, and how much each counts: shoulders are farther apart.
_ACROSS = (
    (JOINT_INDEX["LShoulder"], JOINT_INDEX["RShoulder"], 1.0),
    (JOINT_INDEX["LHip"], JOINT_INDEX["RHip"], 0.5),
)


def front_of_trunk(joints: Float[ndarray, "n 18 3"]) -> Float[ndarray, "n 3"]:
    """Unit vector to the front of each trunk, at right angles to the spine and to the mean line of shoulders and hips;
    NaN where a joint is unknown or no direction is defined.

    Args:
        joints: in any right-handed frame, metres.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        left = sum(share * _unit(joints[:, one] - joints[:, other]) for one, other, share in _ACROSS)
        return _unit(np.cross(left, joints[:, _NECK] - joints[:, _HIP]))


def _unit(vectors: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def trunk_lean(joints: Float[ndarray, "18 3"]) -> float:
    """Angle in the picture from its up direction to that from hips to neck, clockwise, radians from -π to π.

    Args:
        joints: in the camera's frame or the window's: right, down, away from the camera.
    """
    right, down = (joints[_NECK] - joints[_HIP])[:2]
    return float(np.arctan2(right, -down))
