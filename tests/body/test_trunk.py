"""The front of a trunk, from joints."""

from __future__ import annotations

import numpy as np

from depthmocap.body.skeleton import JOINT_INDEX, MIRROR
from depthmocap.body.trunk import front_of_trunk


def _standing() -> np.ndarray:
    """Somebody who stands and faces -y, their left at +x."""
    joints = np.zeros((18, 3))
    joints[JOINT_INDEX["Neck"]] = [0, 0, 1.5]
    joints[JOINT_INDEX["Hip"]] = [0, 0, 1.0]
    for name, place in (("Shoulder", [0.2, 0, 1.4]), ("Hip", [0.1, 0, 1.0])):
        for side, sign in (("L", 1), ("R", -1)):
            joints[JOINT_INDEX[side + name]] = np.multiply(place, [sign, 1, 1])
    return joints


def test_the_front_is_at_right_angles_to_spine_and_shoulders() -> None:
    joints = _standing()
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    fronts = front_of_trunk(np.stack([joints, joints @ turn.T, joints[MIRROR]]))
    np.testing.assert_allclose(fronts[0], [0, -1, 0], atol=1e-9)
    np.testing.assert_allclose(fronts[1], turn @ [0, -1, 0], atol=1e-9)
    np.testing.assert_allclose(fronts[2], [0, 1, 0], atol=1e-9)


def test_no_front_without_its_joints() -> None:
    unknown, flat = _standing(), _standing()
    unknown[JOINT_INDEX["LHip"]] = np.nan
    flat[JOINT_INDEX["Neck"]] = flat[JOINT_INDEX["Hip"]]
    assert np.isnan(front_of_trunk(np.stack([unknown, flat]))).all()
