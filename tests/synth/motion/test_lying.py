"""People who lie at rest."""

from __future__ import annotations

import numpy as np

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.synth.body.mesh import Body
from depthmocap.synth.motion.extreme_postures import self_intersects
from depthmocap.synth.motion.limits import within_limits
from depthmocap.synth.motion.lying import lying_posture


def test_people_lie_flat_as_people_can(default_body: Body) -> None:
    rng = np.random.default_rng(2)
    fits, model = 0, default_body.model
    for _ in range(30):
        posture = lying_posture(rng)
        fits += bool(within_limits(posture[None])[0]) and not self_intersects(posture)
        joints = default_body.bone_transforms(posture).heads[model.joint_bones]
        trunk = joints[JOINT_INDEX["Neck"]] - joints[JOINT_INDEX["Hip"]]
        assert trunk[1] > 0.7 * np.linalg.norm(trunk)  # the head towards +Y
        assert np.ptp(joints[:, 2]) < 0.8 < np.ptp(joints[:, 1])
    assert fits >= 28
