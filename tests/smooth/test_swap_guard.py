"""Left and right keep their places."""

import numpy as np
import pytest

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS, MIRROR
from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.smooth.swap_guard import SwapGuard, SwapGuardSettings, limb_joints

FPS = 30
CONFIDENCE = np.linspace(0.1, 0.9, len(JOINTS))


def walker(frames=60):
    """A body whose sides are 30 cm apart; legs and arms swing against each other."""
    joints = np.zeros((frames, len(JOINTS), 3))
    joints[:, :, 2] = np.linspace(0, 1.7, len(JOINTS))
    swing = 0.2 * np.sin(2 * np.pi * np.arange(frames) / FPS)
    for name, i in JOINT_INDEX.items():
        if MIRROR[i] != i:
            side = 1 if name[0] == "L" else -1
            joints[:, i, 0] = 0.15 * side
            joints[:, i, 1] = side * swing
            joints[:, i, 2] = joints[:, min(i, MIRROR[i]), 2]
    return joints


def guarded(joints, settings=None, guard=None):
    guard = guard or SwapGuard(settings)
    return [guard(Pose(round(i / FPS * 1e9), frame, CONFIDENCE)) for i, frame in enumerate(joints)]


def swapped(joints, frames, limbs=("legs", "arms")):
    joints = joints.copy()
    for limb in limbs:
        order = np.where(limb_joints(limb), MIRROR, np.arange(len(JOINTS)))
        joints[frames] = joints[frames][:, order]
    return joints


def test_limbs():
    assert limb_joints("legs").sum() == limb_joints("arms").sum() == 6
    assert limb_joints("legs")[JOINT_INDEX["LFoot"]] and not limb_joints("legs")[JOINT_INDEX["LHand"]]


def test_good_sides_are_left_alone():
    joints = walker()
    for pose, frame in zip(guarded(joints), joints, strict=True):
        np.testing.assert_array_equal(pose.joints, frame)
        np.testing.assert_array_equal(pose.confidence, CONFIDENCE)


@pytest.mark.parametrize("limbs", [("legs",), ("arms",), ("legs", "arms")])
def test_a_flip_is_undone_with_its_confidence(limbs):
    joints = walker()
    poses = guarded(swapped(joints, slice(20, 28), limbs))
    np.testing.assert_array_equal(np.stack([pose.joints for pose in poses]), joints)
    flipped = np.isin(np.arange(18), np.flatnonzero(np.any([limb_joints(limb) for limb in limbs], axis=0)))
    np.testing.assert_array_equal(poses[22].confidence, np.where(flipped, CONFIDENCE[MIRROR], CONFIDENCE))
    np.testing.assert_array_equal(poses[30].confidence, CONFIDENCE)


def test_a_wrong_start_is_corrected_after_the_stated_time():
    joints = walker()
    corrected = np.stack(
        [pose.joints for pose in guarded(swapped(joints, slice(0, 5)), SwapGuardSettings(limit_s=0.5))]
    )
    wrong = np.abs(corrected - joints).max((1, 2)) > 0.01
    assert np.flatnonzero(wrong).tolist() == list(range(wrong.sum()))
    assert 5 + 14 <= wrong.sum() <= 5 + 16


def test_a_wrong_start_is_corrected_among_other_flips():
    joints = walker(90)
    spoilt = swapped(swapped(joints, slice(0, 5)), slice(9, 90, 8), ("legs",))
    corrected = np.stack([pose.joints for pose in guarded(spoilt)])
    assert np.abs(corrected - joints)[40:].max() < 0.01


def test_a_pause_or_another_recording_forgets():
    joints = walker(10)
    guard = SwapGuard()
    guarded(joints, guard=guard)
    late = Pose(10_000_000_000, joints[0][MIRROR], CONFIDENCE)
    np.testing.assert_array_equal(guard(late).joints, joints[0][MIRROR])
    guarded(joints, guard=guard)  # time goes back
    np.testing.assert_array_equal(guard(Pose(0, joints[0][MIRROR], CONFIDENCE)).joints, joints[0][MIRROR])


def test_missing_joints_do_not_decide():
    joints = walker()
    joints[10, limb_joints("legs")] = np.nan
    flipped = swapped(joints, slice(11, 13))
    flipped[11:13, JOINT_INDEX["LFoot"]] = np.nan
    corrected = guarded(flipped)
    assert np.isnan(corrected[10].joints[limb_joints("legs")]).all()
    # The one that is missing was the right foot.
    assert np.isnan(corrected[11].joints[JOINT_INDEX["RFoot"]]).all()
    np.testing.assert_array_equal(corrected[11].joints[JOINT_INDEX["LKnee"]], joints[11, JOINT_INDEX["LKnee"]])


def test_bad_settings():
    with pytest.raises(InputError, match="ratio"):
        SwapGuardSettings(ratio=1.5)
