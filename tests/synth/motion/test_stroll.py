import numpy as np
import pytest

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.synth.demo_scene import demo_body
from depthmocap.synth.motion.perform import pose_sequence
from depthmocap.synth.motion.stroll import Stop, stroll

FPS = 20


@pytest.fixture(scope="module")
def walker(body_model):
    return demo_body()


def test_a_walker_passes_its_stops_at_its_speed_and_feet_do_not_slip(walker):
    stops = [Stop(-2.0, 0.0), Stop(0.0, 0.0, 1.5), Stop(0.0, 2.0), Stop(2.0, 2.0)]
    times = np.arange(0, 10, 1 / FPS)
    joints = np.stack([p.joints for p in pose_sequence(walker, stroll(walker, stops, 0.5, 1.2, times))])
    hip = joints[:, JOINT_INDEX["Hip"]]
    for stop in stops:
        assert np.linalg.norm(hip[:, :2] - [stop.x, stop.y], axis=1).min() < 0.25
    np.testing.assert_allclose(hip[0, :2], [-2, 0], atol=0.1)
    np.testing.assert_allclose(hip[-1, :2], [2, 2], atol=0.1)
    speed = np.linalg.norm(np.diff(hip[:, :2], axis=0), axis=1) * FPS
    assert speed.max() < 2.2
    assert (speed < 0.1).sum() / FPS > 1.2  # stands
    lower = np.minimum(joints[:, JOINT_INDEX["LFoot"], 2], joints[:, JOINT_INDEX["RFoot"], 2])
    assert np.ptp(lower) < 0.03  # one foot is always on the floor
    for side in "LR":
        foot = joints[:, JOINT_INDEX[f"{side}Foot"]]
        down = foot[:, 2] < lower.min() + 0.004
        both = down[1:] & down[:-1]
        assert np.linalg.norm(np.diff(foot, axis=0), axis=1)[both].max() < 0.02
    # Walks the way it faces: the shoulders are across the way.
    across = joints[:, JOINT_INDEX["LShoulder"]] - joints[:, JOINT_INDEX["RShoulder"]]
    walking = np.flatnonzero(speed > 0.6)
    ahead = np.diff(hip[:, :2], axis=0)[walking] * FPS / speed[walking, None]
    left = across[walking, :2] / np.linalg.norm(across[walking, :2], axis=1, keepdims=True)
    cross = ahead[:, 0] * left[:, 1] - ahead[:, 1] * left[:, 0]
    assert np.median(cross) > 0.85


def test_bad_strolls_are_refused(walker):
    with pytest.raises(ValueError, match="two stops"):
        stroll(walker, [Stop(0.0, 0.0)], 0.0, 1.0, np.zeros(1))
