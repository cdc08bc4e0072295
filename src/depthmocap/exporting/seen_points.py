"""How head, hands and feet are turned, by points of the skin that were measured beside their joints.

Of each of these bones, the rotation that is likeliest by both: the guess from joints, whose error is some angle, and
the points, whose errors are some centimetres from where the network mostly has them: where :class:`LandmarkModel` has
them on the bone, and what they are off by on average.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.landmarks import LANDMARKS, POINT_ROWS, POINTS
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.exporting.landmark_model import LandmarkModel
from depthmocap.kernels.nearest_rotation import nearest_rotations

#: How far from their places on their bones points are seen on average (mm, in the bone's axes; of those on the right),
#: and their errors along an axis besides (mm, standard deviation): a network that is unsure tells what lies between.
#: From ``evaluate skeleton --split train --sequences 12 --seed 5``, which tells them as ``points``.
_SEEN_MM = {
    "Crown": ((0, -12, -26), 20), "Nose": ((0, 18, -16), 32), "Ear": ((5, -6, -4), 18), "Asis": ((3, -2, -4), 14),
    "Psis": ((0, 3, 8), 14), "KnuckleIndex": ((10, -7, -9), 19), "KnuckleLittle": ((7, -3, 9), 22),
    "Heel": ((-9, 7, 2), 10), "BigToeBase": ((3, -3, -6), 17), "Toe": ((3, -2, -8), 20),
}  # fmt: skip
#: Error of what joints tell of a bone's rotation (radians, standard deviation).
_GUESS_RAD = {"Head": 0.35, "RHand": 0.6, "LHand": 0.6, "RFoot": 0.35, "LFoot": 0.35}

_OF_POINTS = [_SEEN_MM[name if name in _SEEN_MM else name[1:]] for name in POINTS]
_MIRROR = np.array([[-1.0 if name[0] == "L" else 1.0, 1.0, 1.0] for name in POINTS])
#: The mean error of each of ``POINTS`` in the axes of its bone (m).
MEAN_ERROR_M = np.array([mean for mean, _ in _OF_POINTS]) * _MIRROR / 1000
_SPREAD_M = np.array([spread for _, spread in _OF_POINTS]) / 1000

_BONES = np.array([JOINT_INDEX[name] for name in _GUESS_RAD])
_PRIOR = np.array([1 / (2 * rad**2) for rad in _GUESS_RAD.values()])[:, None, None]
#: Of each of the bones (row), 1 / m² for the points that are on it.
_WEIGHTS = np.array([[LANDMARKS[row].bone == name for row in POINT_ROWS] for name in _GUESS_RAD]) / _SPREAD_M**2
_HEAD = JOINT_INDEX["Head"]
_NECK = JOINT_INDEX["Neck"]
#: All bones that points turn.
TURNED = np.array([*_BONES, _NECK])


def point_places(offsets: Float[ndarray, "18 3"]) -> Float[ndarray, "p 3"]:
    """Where each of ``POINTS`` is seen from its joint, in the frame of its bone (m), on a rest skeleton."""
    return LandmarkModel.load().offsets_m(offsets)[POINT_ROWS] + MEAN_ERROR_M


def turned_by_points(
    likely: Float[ndarray, "t 18 3 3"], beside: Float[ndarray, "t 18 3"], places: Float[ndarray, "p 3"]
) -> Float[ndarray, "t 18 3 3"]:
    """Likely rotations in the world, with those of head, hands and feet by points, too; the neck is turned half as much
    as the head.

    Args:
        beside: each of ``POINTS`` from its joint (m, Y up), NaN where it is not known.
        places: of the points on their bones (:func:`point_places`).
    """
    evidence = np.einsum("bp,tpi,pj->tbij", _WEIGHTS, np.nan_to_num(beside), places)
    likely = likely.copy()
    before = likely[:, _HEAD].copy()
    likely[:, _BONES] = nearest_rotations(evidence + _PRIOR * likely[:, _BONES])
    turn = likely[:, _HEAD] @ np.swapaxes(before, -1, -2)
    likely[:, _NECK] = nearest_rotations(turn + np.eye(3)) @ likely[:, _NECK]
    return likely
