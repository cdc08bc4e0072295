"""The voting network: its symmetries, its ONNX form, and what the packaged one makes of people."""

import dataclasses

import numpy as np
import pytest

from depthmocap.body.skeleton import JOINTS, MIRROR
from depthmocap.errors import InputError
from depthmocap.pose.cloud import LabelledCloud, merge_views
from depthmocap.pose.estimators import load_estimator
from depthmocap.pose.labelled_view import LabelledView
from depthmocap.pose.parts import ARMS, LEGS, MIRRORED, body_frame, network_inputs, part_statistics
from depthmocap.pose.votes import VotesEstimator
from depthmocap.synth.sample import Recipe, Sampler

pytest.importorskip("torch")
pytest.importorskip("onnx")

import torch
from onnx import TensorProto, helper

from depthmocap.train.train_votes import augment, export_votes, tilt
from depthmocap.train.votes_network import VotesNet


@pytest.fixture(scope="module")
def samples(body_model):
    draw = Sampler(Recipe("open", "test", views=3, sensors=("kinect2",)), seed=9)
    return [draw(i) for i in range(8)]


def cloud_of(sample, views=3):
    return merge_views([LabelledView(view, view.labels) for view in sample.views[:views]])


def parts_of(samples):
    return np.stack([part_statistics(cloud_of(sample)) for sample in samples])


def small_network():
    torch.manual_seed(0)
    network = VotesNet(32, 1, 2).eval()
    # As after some training: a new one compares no cameras.
    for layer in (network.others.out, network.within.out, network.within.each[-1]):
        assert isinstance(layer, torch.nn.Linear)
        layer.reset_parameters()
    return network


def test_order_and_absence_of_cameras_make_no_difference(samples):
    parts = parts_of(samples)
    x = torch.from_numpy(network_inputs(parts, body_frame(parts))[0])
    network = small_network()
    with torch.no_grad():
        joints, sure = network(x)
        assert joints.shape == (8, 18, 3)
        assert sure.shape == (8, 18)
        padded = torch.cat([torch.zeros_like(x[:, :1]), x.flip(1)], 1)
        for ours, theirs in zip(network(padded), (joints, sure), strict=True):
            torch.testing.assert_close(ours, theirs, atol=1e-5, rtol=1e-5)


def test_gradient_reaches_every_parameter(samples):
    parts = parts_of(samples)
    parts[:, :, 0] = 0  # a region that nobody sees, whose parameters serve too
    parts[0, 0, 43:] = parts[0, 0, :18]  # joints that a camera tells
    network = small_network().train()
    joints, sure = network(torch.from_numpy(network_inputs(parts, body_frame(parts))[0]))
    (joints.square().sum() + sure.square().sum()).backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().sum() > 0, name


@pytest.mark.slow
def test_onnx_gives_the_same(samples, tmp_path):
    network = small_network()
    estimator = VotesEstimator(export_votes(network, tmp_path / "votes.onnx"))
    for views in (1, 3):
        cloud = cloud_of(samples[0], views)
        parts = part_statistics(cloud)
        frame = body_frame(parts)
        with torch.no_grad():
            truth, sure = network(torch.from_numpy(network_inputs(parts, frame)[0])[None])
        joints, confidence = estimator(cloud)
        np.testing.assert_allclose(joints, frame.to_world(truth[0].numpy()), atol=2e-3)
        np.testing.assert_allclose(confidence, torch.sigmoid(sure[0]).numpy(), atol=2e-3)


def test_augmented_samples_keep_a_camera_and_mirror_joints_with_regions(samples):
    parts = np.repeat(parts_of(samples), 40, axis=0)
    joints = np.repeat(np.stack([sample.joints for sample in samples]).astype(np.float64), 40, axis=0)
    rng = np.random.default_rng(0)
    changed, moved_joints = augment(rng, parts, joints)
    cameras = (changed[..., 0] > 0).any(-1).sum(1)
    assert set(np.unique(cameras)) == {1, 2, 3}
    mirrored = ~np.all(np.isclose(moved_joints, joints), axis=(1, 2))
    assert 0.4 < mirrored.mean() < 0.6
    np.testing.assert_allclose(moved_joints[mirrored], (joints * [1, -1, 1])[mirrored][:, MIRROR])
    # A region of one side has the other one's points, but where a camera mistakes the sides.
    observed = changed[..., 0] > 0
    counts = np.where(mirrored[:, None, None], parts[..., MIRRORED, 0], parts[..., 0])
    same = (changed[..., 0] == counts) | ~observed
    assert 0.9 < same.mean() < 1
    for limb in (ARMS, LEGS):  # all of a limb, or none of it
        wrong = (~same & limb).any(-1)
        assert 0.01 < wrong[cameras > 1].mean() < 0.1
        exchanged = np.where(mirrored[:, None, None], parts[..., 0], parts[..., MIRRORED, 0])
        assert ((changed[..., 0] == exchanged) | ~observed)[wrong][:, limb].all()
    assert same[cameras == 1].all()  # where nothing tells otherwise
    # Regions stay with their joints, whatever was moved.
    centre = changed[..., 4:7].sum((1, 2)) / (changed[..., 0] > 0).sum((1, 2))[:, None]
    assert np.abs(centre - moved_joints.mean(1)).max() < 1.0


def test_tilted_samples_are_the_same_bodies(samples):
    parts = np.repeat(parts_of(samples), 40, axis=0)
    joints = np.repeat(np.stack([sample.joints for sample in samples]).astype(np.float64), 40, axis=0)
    changed, turned = tilt(np.random.default_rng(0), parts, joints)
    some = ~np.isclose(turned, joints).all((1, 2))
    assert 0.05 < some.mean() < 0.16
    np.testing.assert_allclose(changed[~some], parts[~some], atol=1e-5)
    np.testing.assert_allclose(turned.mean(1), joints.mean(1), atol=1e-9)
    # Distances of joints from what the cameras saw, and along the rays, are what they were.
    between, before = (p[..., 4:7][:, :, :, None] - j[:, None, None] for p, j in ((changed, turned), (parts, joints)))
    observed = (parts[..., 0] > 0)[..., None] & np.ones(18, bool)
    for result, expected in (
        (np.linalg.norm(between, axis=-1), np.linalg.norm(before, axis=-1)),
        ((between * changed[..., None, 13:16]).sum(-1), (before * parts[..., None, 13:16]).sum(-1)),
    ):
        np.testing.assert_allclose(result[observed], expected[observed], atol=1e-4)
    assert (np.abs((turned - joints)[some]).max((1, 2)) > 0.1).mean() > 0.8


@pytest.mark.parametrize("labels", ["true"])
def test_packaged_network_finds_people(samples, labels):
    votes = load_estimator("votes")
    errors, sure = [], []
    for sample in samples:
        joints, confidence = votes(cloud_of(sample))
        errors.append(np.linalg.norm(joints - sample.joints, axis=1))
        sure.append(confidence)
    assert np.mean(errors) < 0.06
    assert np.mean(np.array(errors) < 0.1) > 0.85
    assert 0.7 < np.mean(sure) <= 1


@pytest.mark.parametrize("up", ["y", "-y"])
def test_worlds_with_another_axis_up(samples, up):
    """The same people in a world turned on its side."""
    from depthmocap.geometry import z_up_from

    votes, turn = load_estimator("votes"), z_up_from(up)  # z-up from theirs
    cloud = cloud_of(samples[0])
    cameras = []
    for camera in cloud.cameras:
        pose = camera.world_from_camera.copy()
        pose[:3] = turn.T @ pose[:3]
        cameras.append(dataclasses.replace(camera, world_from_camera=pose))
    points = (cloud.points_world @ turn).astype(np.float32)
    turned = dataclasses.replace(cloud, points_world=points, cameras=tuple(cameras))
    np.testing.assert_allclose(votes(turned, up)[0] @ turn.T, votes(cloud)[0], atol=1e-3)


def test_nobody_gives_gaps():
    empty = LabelledCloud(np.zeros((0, 3), "f4"), np.zeros(0, "u1"), np.zeros(0, "f4"))
    joints, confidence = load_estimator("votes")(empty)
    assert joints.shape == (len(JOINTS), 3)
    assert np.isnan(joints).all()
    assert not confidence.any()


def test_files_that_are_no_voting_network(tmp_path):
    path = tmp_path / "votes.onnx"
    path.write_bytes(b"nothing")
    with pytest.raises(InputError, match="not a readable"):
        VotesEstimator(path)
    from depthmocap.classify.classifier import Classifier

    with pytest.raises(InputError, match="not a voting network"):
        VotesEstimator(Classifier().path)


@pytest.mark.parametrize(
    ("shape", "spoil", "message"),
    [
        (["n", "views", 43, 16], (b"", b""), "reads 43 parts, and this version has 61"),
        (["n"], (b"", b""), "reads 0 parts"),
        (["n", "views", 61, 16], (b"sure", b"s\xffre"), "not a readable ONNX network"),
    ],
)
def test_a_network_of_an_earlier_version_or_spoilt_is_refused(tmp_path, shape, spoil, message):
    parts = helper.make_tensor_value_info("parts", TensorProto.FLOAT, shape)
    outputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in ("joints", "sure")]
    nodes = [helper.make_node("Identity", ["parts"], [output.name]) for output in outputs]
    model = helper.make_model(
        helper.make_graph(nodes, "early", [parts], outputs), ir_version=8, opset_imports=[helper.make_opsetid("", 18)]
    )
    (tmp_path / "votes.onnx").write_bytes(model.SerializeToString().replace(*spoil))
    with pytest.raises(InputError, match=message):
        VotesEstimator(tmp_path / "votes.onnx")
