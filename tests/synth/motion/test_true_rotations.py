"""True rotations in the convention of files: they point bones where joints are, and elbows bend about their hinge."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.geometry import z_up_from
from depthmocap.synth.body.bones import POSTURE_INDEX
from depthmocap.synth.body.mesh import REST_POSTURE, Body
from depthmocap.synth.motion.true_rotations import true_motion

DIRECTIONS = {
    ("Shoulder", "Elbow"): (1.0, 0.0, 0.0), ("Elbow", "Hand"): (1.0, 0.0, 0.0), ("Hip", "Knee"): (0.0, -1.0, 0.0),
    ("Knee", "Foot"): (0.0, -1.0, 0.0),
}  # fmt: skip


def test_rotations_point_bones_at_joints(default_body: Body) -> None:
    rng = np.random.default_rng(0)
    postures = np.repeat(REST_POSTURE[None], 8, 0) + rng.uniform(-0.4, 0.4, (8, *REST_POSTURE.shape))
    motion = true_motion(default_body, postures)
    posed = default_body.pose(postures[3]).joints @ z_up_from("y")
    np.testing.assert_allclose(motion.joints[3], posed, atol=1e-5)
    for side, sign in (("R", -1.0), ("L", 1.0)):
        for (start, end), direction in DIRECTIONS.items():
            bone = motion.joints[:, JOINT_INDEX[side + end]] - motion.joints[:, JOINT_INDEX[side + start]]
            turned = motion.rotations[:, JOINT_INDEX[side + start]] @ (np.array(direction) * [sign, 1, 1])
            np.testing.assert_allclose(turned, bone / np.linalg.norm(bone, axis=-1, keepdims=True), atol=1e-5)
    pelvis = np.array([[0.5, 1.0, 0.2]] * 8)
    moved = true_motion(default_body, postures, pelvis)
    np.testing.assert_allclose(moved.joints[:, JOINT_INDEX["Hip"]], pelvis, atol=1e-9)
    np.testing.assert_allclose(np.diff(moved.joints - motion.joints, axis=1), 0, atol=1e-9)


def test_elbows_are_hinges_whatever_the_clip_says(default_body: Body) -> None:
    postures = np.repeat(REST_POSTURE[None], 6, 0)
    straight = true_motion(default_body, postures)
    # The elbow is bent in the rest pose: the forearm turned about the upper arm's hinge.
    upper, fore = (straight.rotations[0, JOINT_INDEX[name]] for name in ("LShoulder", "LElbow"))
    turn = Rotation.from_matrix(upper.T @ fore).as_rotvec(degrees=True)
    np.testing.assert_allclose(turn / np.linalg.norm(turn), [0, -1, 0], atol=0.01)
    # A clip whose upper arm is turned about itself, and the forearm back: the same joints and the same truth.
    bone = default_body.rest_heads[default_body.model.joint_bones]
    axis = bone[JOINT_INDEX["LElbow"]] - bone[JOINT_INDEX["LShoulder"]]
    about = 0.5 * axis / np.linalg.norm(axis)
    postures[:, POSTURE_INDEX["upper_arm.L"]] = about
    postures[:, POSTURE_INDEX["forearm.L"]] = -about
    other = true_motion(default_body, postures)
    np.testing.assert_allclose(other.joints, straight.joints, atol=1e-6)
    np.testing.assert_allclose(other.rotations[0, JOINT_INDEX["LShoulder"]], upper, atol=1e-6)


def test_arms_that_never_bend_have_no_known_twist(default_body: Body) -> None:
    assert np.isnan(true_motion(default_body, REST_POSTURE[None]).rotations[0, JOINT_INDEX["RShoulder"]]).all()
