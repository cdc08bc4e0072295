"""People who sit."""

from __future__ import annotations

import numpy as np

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.synth.body.bones import POSTURE_BONES, heading, turn_posture
from depthmocap.synth.body.mesh import REST_POSTURE, Body
from depthmocap.synth.motion.limits import within_limits
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.motion.seat import seated

LEGS = ("pelvis", "thigh", "shin", "foot")


def test_thighs_lie_and_feet_are_below_the_knees(default_body: Body) -> None:
    rng = np.random.default_rng(0)
    raised = crossed = 0
    for _ in range(100):
        joints = default_body.pose(seated(turn_posture(REST_POSTURE, rng.uniform(-3, 3)), rng)).joints
        for side in "RL":
            hip, knee, foot = (joints[JOINT_INDEX[side + name]] for name in ("Hip", "Knee", "Foot"))
            thigh, shin = knee - hip, foot - knee
            # Nearly level; a shin hangs down, or leans out by less than the crossed leg's.
            assert abs(thigh[2]) < 0.6 * np.linalg.norm(thigh)
            raised += thigh[2] > 0.02
            crossed += shin[2] > -0.6 * np.linalg.norm(shin)
            assert shin[2] < 0
        assert joints[JOINT_INDEX["Head"], 2] > joints[JOINT_INDEX["Hip"], 2] + 0.4
    assert 20 < raised < 180
    assert crossed < 40


def test_they_face_as_before_and_keep_trunk_and_arms() -> None:
    prior, rng = PosturePrior.load(), np.random.default_rng(1)
    others = [i for i, name in enumerate(POSTURE_BONES) if name.split(".")[0] not in LEGS]
    facing = []
    for _ in range(50):
        posture, _ = prior.sample(rng)
        found = seated(posture, rng)
        np.testing.assert_array_equal(found[others], posture[others])
        turned = heading(found[None]) - heading(posture[None])
        facing.append(abs((turned + np.pi) % (2 * np.pi) - np.pi).item())
        assert within_limits(found[None])[0] or not within_limits(posture[None])[0]
    assert np.max(facing) < 0.1


def test_the_thighs_point_where_the_body_faces(default_body: Body) -> None:
    rng = np.random.default_rng(2)
    for angle in (-2.0, 0.0, 1.0):
        forwards = np.array([np.sin(angle), -np.cos(angle), 0])
        joints = default_body.pose(seated(turn_posture(REST_POSTURE, angle), rng)).joints
        for side in "RL":
            thigh = joints[JOINT_INDEX[f"{side}Knee"]] - joints[JOINT_INDEX[f"{side}Hip"]]
            assert thigh @ forwards > 0.6 * np.linalg.norm(thigh)
