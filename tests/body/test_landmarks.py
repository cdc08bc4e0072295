"""The table of surface landmarks."""

from __future__ import annotations

import numpy as np

from depthmocap.body.landmarks import LANDMARK_INDEX, LANDMARK_MIRROR, LANDMARK_NAMES, LANDMARKS
from depthmocap.body.skeleton import JOINTS, PARENTS


def test_names_are_unique_and_no_joints() -> None:
    assert len(set(LANDMARK_NAMES)) == len(LANDMARKS) == 58
    assert not set(LANDMARK_NAMES) & set(JOINTS)


def test_a_landmark_is_seen_from_an_end_of_its_bone_or_of_one_beside_it() -> None:
    for landmark in LANDMARKS:
        ends = {landmark.bone, *(child for child, parent in PARENTS.items() if parent == landmark.bone)}
        assert landmark.joint in ends, landmark


def test_sides_are_mirrored() -> None:
    np.testing.assert_array_equal(LANDMARK_MIRROR[LANDMARK_MIRROR], np.arange(len(LANDMARKS)))
    assert LANDMARK_NAMES[LANDMARK_MIRROR[LANDMARK_INDEX["RHeel"]]] == "LHeel"
    assert LANDMARK_MIRROR[LANDMARK_INDEX["C7"]] == LANDMARK_INDEX["C7"]
