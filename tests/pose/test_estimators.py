import dataclasses

import numpy as np
import pytest

from depthmocap.body.regions import REGION
from depthmocap.body.regions import REGION_NAMES as NAMES
from depthmocap.body.skeleton import JOINT_INDEX, JOINTS, MIRROR
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera
from depthmocap.pose.cloud import LabelledCloud
from depthmocap.pose.estimators import JOINT_REGIONS, UNOBSERVED_CONFIDENCE, RidgeEstimator, load_estimator
from depthmocap.pose.features import FEATURE_COUNT
from depthmocap.pose.ridge import RidgeBank, RidgePose


def make_model(views=0):
    """Puts every joint ``views`` metres above the centre of the cloud, whatever the features."""
    zeros = np.zeros((FEATURE_COUNT, 54), np.float32)
    bias = np.tile(np.array([0, 0, views], np.float32), 18)
    return RidgePose(zeros[:, 0], zeros[:, 0] + 1, zeros, bias, 1.0, views=views)


RIDGE = RidgeEstimator(RidgeBank((make_model(),)))


def make_cloud(counts, weight=1.0):
    labels = np.repeat([REGION[name] for name in counts], list(counts.values())).astype(np.uint8)
    points = np.random.default_rng(0).standard_normal((len(labels), 3)).astype(np.float32)
    return LabelledCloud(points, labels, np.full(len(labels), weight, np.float32))


def test_table_names_every_joint_and_is_symmetric():
    def mirrored(name):
        return name[:-1] + {"R": "L", "L": "R"}[name[-1]] if name[-2:] in (" R", " L") else name

    assert tuple(sorted(JOINT_REGIONS)) == tuple(sorted(JOINTS))
    assert set().union(*JOINT_REGIONS.values()) == set(NAMES[1:])
    for joint, twin in zip(JOINTS, np.array(JOINTS)[MIRROR], strict=True):
        assert {mirrored(name) for name in JOINT_REGIONS[joint]} == set(JOINT_REGIONS[twin])


@pytest.mark.parametrize("up", ["z", "y", "-y"])
def test_joints_are_in_the_world(up):
    cloud = make_cloud({"belly R": 200, "hand R": 100})
    joints, _ = RidgeEstimator(RidgeBank((make_model(1), make_model(2))))(cloud, up)
    above = {"z": [0, 0, 1], "y": [0, 1, 0], "-y": [0, -1, 0]}[up]
    np.testing.assert_allclose(joints, np.tile(np.median(cloud.points_world, axis=0) + above, (18, 1)), atol=1e-6)


def test_regressor_is_that_of_the_cameras_that_saw_something():
    cloud = make_cloud({"belly R": 200, "hand R": 100})
    camera = DepthCamera("a", 64, 64, 60.0, 60.0, 32.0, 32.0)
    bank = RidgeBank((make_model(1), make_model(2), make_model(3)))
    for sizes, height in (((200, 100), 2), ((0, 300, 0), 1), ((50, 50, 100, 100), 3)):
        observed = dataclasses.replace(cloud, view_sizes=sizes, cameras=(camera,) * len(sizes))
        joints, _ = RidgeEstimator(bank)(observed)
        np.testing.assert_allclose(joints[:, 2] - np.median(cloud.points_world, axis=0)[2], height, atol=1e-6)


@pytest.mark.parametrize(
    ("source", "message"), [("spline", "votes, ridge"), ("no.npz", "not found"), ("no.onnx", "not found")]
)
def test_estimators_that_do_not_exist(source, message):
    with pytest.raises(InputError, match=message):
        load_estimator(source)


def test_confidence_follows_what_was_seen():
    _, confidence = RIDGE(make_cloud({"hand R": 500, "face R": 50}))
    assert confidence[JOINT_INDEX["RHand"]] == 1
    assert confidence[JOINT_INDEX["Head"]] == pytest.approx(0.5)
    assert confidence[JOINT_INDEX["LHand"]] == UNOBSERVED_CONFIDENCE
    _, unsure = RIDGE(make_cloud({"hand R": 500, "face R": 50}, weight=0.5))
    assert unsure[JOINT_INDEX["RHand"]] == pytest.approx(0.5)
    assert unsure[JOINT_INDEX["Head"]] == pytest.approx(0.25)


@pytest.mark.parametrize("count", [0, 49])
def test_hardly_any_points_give_no_joints(count):
    joints, confidence = RIDGE(make_cloud({"hand R": count}))
    assert np.isnan(joints).all()
    assert not confidence.any()
