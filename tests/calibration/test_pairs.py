"""Two cameras related by skeletons, in spite of noise, exchanged sides and other people."""

import numpy as np
from walker import errors, stand, track

from depthmocap.body.skeleton import MIRROR
from depthmocap.calibration.pairs import align, estimate_pair

TIMES_S = np.arange(0, 20, 0.25)


def test_exchanged_sides_and_other_people_do_not_matter():
    rng = np.random.default_rng(0)
    one, other = stand(10), stand(130)
    a, b = (track(pose, TIMES_S, rng) for pose in (one, other))
    joints = b.joints.copy()
    joints[::4] = joints[::4][:, MIRROR]  # seen from behind and taken for the front
    joints[1::4] += np.array([0.5, 0.0, 0.7])  # somebody else
    pair = estimate_pair((a.joints, joints), (a.sigma_m, b.sigma_m), rng)
    assert pair is not None
    error_m, error_rad = errors(one @ pair.a_from_b, other, (0.0, 0.0, 1.0))
    assert error_m < 0.01
    assert error_rad < np.deg2rad(0.5)
    assert pair.shared == len(TIMES_S)
    assert 0.4 * len(TIMES_S) <= pair.agreed <= 0.8 * len(TIMES_S)
    plain = align(a.joints.reshape(-1, 3), joints.reshape(-1, 3), np.ones(joints.size // 3))
    assert errors(one @ plain, other, (0.0, 0.0, 1.0))[0] > 0.1  # what least squares alone make of it


def test_joints_of_which_the_network_is_unsure_do_not_count():
    rng = np.random.default_rng(1)
    one, other = stand(0), stand(180)
    a, b = (track(pose, TIMES_S, rng) for pose in (one, other))
    unsure = b.sigma_m.copy()
    unsure[:, 10:] = 1.0
    wrong = b.joints.copy()
    wrong[:, 10:] += 0.4
    pair = estimate_pair((a.joints, wrong), (a.sigma_m, unsure), rng)
    assert pair is not None
    assert errors(one @ pair.a_from_b, other, (0.0, 0.0, 1.0))[0] < 0.02


def test_cameras_that_never_see_the_person_together_are_not_related():
    rng = np.random.default_rng(2)
    a, b = (track(stand(azimuth), TIMES_S, rng) for azimuth in (0, 90))
    early, late = a.joints.copy(), b.joints.copy()
    early[40:], late[:40] = np.nan, np.nan
    assert estimate_pair((early, late), (a.sigma_m, b.sigma_m), rng) is None
