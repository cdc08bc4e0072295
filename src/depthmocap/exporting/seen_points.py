"""How head, hands and feet are turned, by points of the skin that were measured beside their joints.

Of each of these bones, the rotation that is likeliest by both: the guess from joints, whose error is some angle, and
the points, whose errors are some centimetres from where :class:`LandmarkModel` has them on the bone.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.landmarks import LANDMARKS, POINT_ROWS
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.exporting.landmark_model import LandmarkModel
from depthmocap.exporting.learnt_rotations import nearest_rotations

#: Error of a point beside its joint along an axis (m, standard deviation).
_SPREAD_M = 0.03
#: Error of what joints tell of a bone's rotation (radians, standard deviation).
_GUESS_RAD = {"Head": 0.35, "RHand": 0.6, "LHand": 0.6, "RFoot": 0.35, "LFoot": 0.35}

_BONES = np.array([JOINT_INDEX[name] for name in _GUESS_RAD])
_PRIOR = np.array([1 / (2 * rad**2) for rad in _GUESS_RAD.values()])[:, None, None]
#: Of each of the bones (row), 1 / m² for the points that are on it.
_WEIGHTS = np.array([[LANDMARKS[row].bone == name for row in POINT_ROWS] for name in _GUESS_RAD]) / _SPREAD_M**2
_HEAD = JOINT_INDEX["Head"]
_NECK = JOINT_INDEX["Neck"]


def turned_by_points(
    likely: Float[ndarray, "t 18 3 3"], beside: Float[ndarray, "t 18 3"], offsets: Float[ndarray, "18 3"]
) -> Float[ndarray, "t 18 3 3"]:
    """Likely rotations in the world, with those of head, hands and feet by points, too; the neck is turned half as much
    as the head.

    Args:
        beside: each of ``POINTS`` from its joint (m, Y up), NaN where it is not known.
        offsets: of the rest skeleton, which tell where points are on bones.
    """
    places = LandmarkModel.load().offsets_m(offsets)[POINT_ROWS]
    evidence = np.einsum("bp,tpi,pj->tbij", _WEIGHTS, np.nan_to_num(beside), places)
    likely = likely.copy()
    before = likely[:, _HEAD].copy()
    likely[:, _BONES] = nearest_rotations(evidence + _PRIOR * likely[:, _BONES])
    turn = likely[:, _HEAD] @ np.swapaxes(before, -1, -2)
    likely[:, _NECK] = nearest_rotations(turn + np.eye(3)) @ likely[:, _NECK]
    return likely
