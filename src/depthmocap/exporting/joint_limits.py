"""How far people's joints turn: local rotations away from the T pose are brought back into ranges.

A rotation is divided into a swing of the bone's axis and a twist about it. Ranges are those of textbooks (American
Academy of Orthopaedic Surgeons; Kapandji), widened by 10° to 20° for supple people, and where one of our bones stands
for several joints: an upper arm is shoulder and shoulder blade together. Knees and elbows do not bend backwards.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS, PARENTS
from depthmocap.exporting.bone_rotations import REST

_ALONG: dict[str, tuple[float, float, float]] = {joint: direction for joint, (direction, _) in REST.items()}
_UP, _DOWN, _RIGHT = (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0)
#: Of each bone, by the joint that it starts at: its axis in the T pose (of limbs on the right), the largest swing and
#: the largest twist to either side (degrees).
_RANGES = {
    "Spine": (_ALONG["Spine1"], 75.0, 50.0), "Spine1": (_ALONG["Spine2"], 60.0, 50.0), "Spine2": (_UP, 70.0, 60.0),
    "Neck": (_ALONG["Head"], 70.0, 70.0), "Head": (_UP, 60.0, 60.0),
    "Shoulder": (_RIGHT, 150.0, 150.0), "Elbow": (_RIGHT, 165.0, 110.0), "Hand": (_RIGHT, 90.0, 50.0),
    "Hip": (_DOWN, 145.0, 70.0), "Knee": (_DOWN, 165.0, 40.0), "Foot": (_DOWN, 75.0, 55.0),
}  # fmt: skip
#: Directions in which a hinge bends, of the T pose: of an elbow to the front, of a knee to the back.
_BENDS = {"Elbow": (0.0, 0.0, 1.0), "Knee": (0.0, 0.0, -1.0)}
#: How far a hinge bends the other way (radians).
_BACKWARDS_RAD = np.deg2rad(15.0)
#: Rounding errors (radians).
_SLACK = 1e-6
#: More is no hinge that bends backwards, but one whose bone is turned about itself.
_TURNED_RAD = np.deg2rad(90.0)

#: Elements of a matrix whose differences from its transpose are twice its turn.
_ROWS, _COLUMNS = [2, 0, 1], [1, 2, 0]
_AXES, _BEND_TO = np.zeros((len(JOINTS), 3)), np.zeros((len(JOINTS), 3))
_SWING, _TWIST = np.full(len(JOINTS), np.inf), np.full(len(JOINTS), np.inf)
for _joint, _parent in PARENTS.items():
    _limb = _joint if _parent is None or _joint in _RANGES else _joint[1:]
    if _parent is not None:
        _axis, _swing, _twist = _RANGES[_limb]
        _mirror = [-1.0 if _joint[0] == "L" else 1.0, 1.0, 1.0]
        _AXES[JOINT_INDEX[_joint]] = np.array(_axis) * _mirror / np.linalg.norm(_axis)
        _SWING[JOINT_INDEX[_joint]], _TWIST[JOINT_INDEX[_joint]] = np.deg2rad(_swing), np.deg2rad(_twist)
        _BEND_TO[JOINT_INDEX[_joint]] = _BENDS.get(_limb, (0.0, 0.0, 0.0))


def beyond_limits(bones: Int[ndarray, " k"], local: Float[ndarray, "t k 3 3"]) -> Bool[ndarray, "t k"]:
    """Which rotations of bones, by the numbers of the joints that they start at, in their parents' frames, are out of
    people's range; those that are unknown (NaN) are not."""
    twist, swing, bend = _angles(bones, local)
    return (np.abs(twist) > _TWIST[bones] + _SLACK) | (swing > _SWING[bones] + _SLACK) | _backwards(bend)


def within_limits(bones: Int[ndarray, " k"], local: Float[ndarray, "t k 3 3"]) -> Float[ndarray, "t k 3 3"]:
    """The same rotations brought into people's range; those that are in it, or unknown, stay as they are."""
    which = np.nonzero(beyond_limits(bones, local))
    if not len(which[0]):
        return local
    result, numbers = local.copy(), bones[which[1]]
    twist, _, bend = (angles[which] for angles in _angles(bones, local))
    about = Rotation.from_rotvec(twist[:, None] * _AXES[numbers])
    kept = Rotation.from_rotvec(np.clip(twist, -_TWIST[numbers], _TWIST[numbers])[:, None] * _AXES[numbers])
    swings = (Rotation.from_matrix(local[which]) * about.inv()).as_rotvec()
    size = np.linalg.norm(swings, axis=-1)
    swings *= (np.minimum(size, _SWING[numbers]) / np.maximum(size, 1e-9))[:, None]
    hinge = np.cross(_AXES[numbers], _BEND_TO[numbers])
    forwards = np.where(_backwards(bend), -bend - _BACKWARDS_RAD, 0.0)[:, None] * hinge
    result[which] = (Rotation.from_rotvec(forwards) * Rotation.from_rotvec(swings) * kept).as_matrix()
    return result


def _angles(bones: Int[ndarray, " k"], local: Float[ndarray, "t k 3 3"]) -> tuple[ndarray, ndarray, ndarray]:
    """Twist, swing and, of hinges, bend (radians)."""
    axes = _AXES[bones]
    # Of the quaternion (w, v) the twist about an axis a is 2 atan2(v·a, w); v is a fourth of the turns by w.
    turns = (local - np.swapaxes(local, -1, -2))[..., _ROWS, _COLUMNS]
    trace = local[..., 0, 0] + local[..., 1, 1] + local[..., 2, 2]
    twist = 2 * np.arctan2((turns * axes).sum(-1), np.maximum(1 + trace, 1e-9))
    pointed = (local @ axes[:, :, None])[..., 0]
    along = (pointed * axes).sum(-1)
    return twist, np.arccos(np.clip(along, -1, 1)), np.arctan2((pointed * _BEND_TO[bones]).sum(-1), along)


def _backwards(bend: Float[ndarray, "*n"]) -> Bool[ndarray, "*n"]:
    return np.asarray((bend < -_BACKWARDS_RAD - _SLACK) & (bend > -_TURNED_RAD))
