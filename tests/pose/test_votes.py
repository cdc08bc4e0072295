"""The voting network: its symmetries, its ONNX form, and what the packaged one makes of people."""

import dataclasses

import numpy as np
import pytest

from depthmocap.body.landmarks import POINT_JOINTS, POINT_ROWS
from depthmocap.body.skeleton import JOINTS, MIRROR
from depthmocap.errors import InputError
from depthmocap.pose import votes as votes_module
from depthmocap.pose.cloud import LabelledCloud, merge_views
from depthmocap.pose.estimators import estimate_pose, load_estimator
from depthmocap.pose.labelled_view import LabelledView
from depthmocap.pose.parts import ARMS, LEGS, MIRRORED, body_frame, network_inputs, part_statistics
from depthmocap.pose.votes import VotesEstimator
from depthmocap.synth.sample import Recipe, Sampler

pytest.importorskip("torch")
pytest.importorskip("onnx")

import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from rich.console import Console

from depthmocap.train import train_votes as train_votes_module
from depthmocap.train.checkpoints import load_weights, save_weights
from depthmocap.train.pose_samples import CollectedSamples
from depthmocap.train.train_votes import VotesTraining, augment, export_votes, tilt, train_votes
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
    assert network.points is not None
    for parameter in network.points.parameters():
        parameter.data += torch.randn_like(parameter) / 10
    return network


def test_cameras_that_see_nobody_are_not_asked_about(samples, monkeypatch):
    estimator, seen = VotesEstimator(), []
    run = votes_module._run
    monkeypatch.setattr(
        votes_module, "_run", lambda session, inputs: (seen.append(inputs.shape), run(session, inputs))[1]
    )
    views = samples[0].views
    nothing = np.zeros_like(views[1].labels)
    parts = [LabelledView(view, nothing if i == 1 else view.labels) for i, view in enumerate(views)]
    joints, confidence = estimator(merge_views(parts))
    (alone, sure) = estimator(merge_views([parts[0], parts[2]]))
    assert [shape[1] for shape in seen] == [2, 2]
    np.testing.assert_allclose(joints, alone, atol=1e-5)
    np.testing.assert_allclose(confidence, sure, atol=1e-5)


def test_order_and_absence_of_cameras_make_no_difference(samples):
    parts = parts_of(samples)
    x = torch.from_numpy(network_inputs(parts, body_frame(parts))[0])
    network = small_network()
    with torch.no_grad():
        told = network(x)
        assert [tuple(output.shape) for output in told] == [(8, 18, 3), (8, 18)] * 2
        padded = torch.cat([torch.zeros_like(x[:, :1]), x.flip(1)], 1)
        for ours, theirs in zip(network(padded), told, strict=True):
            torch.testing.assert_close(ours, theirs, atol=1e-5, rtol=1e-5)


def test_gradient_reaches_every_parameter(samples):
    parts = parts_of(samples)
    parts[:, :, 0] = 0  # a region that nobody sees, whose parameters serve too
    parts[0, 0, 43:] = parts[0, 0, :18]  # joints that a camera tells
    network = small_network().train()
    outputs = network(torch.from_numpy(network_inputs(parts, body_frame(parts))[0]))
    torch.stack([output.square().sum() for output in outputs]).sum().backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        # A softmax does not notice what is added to all: of this one rounding alone is left.
        assert parameter.grad.abs().sum() > 0 or name == "trust.1.bias", name


@pytest.mark.slow
def test_onnx_gives_the_same(samples, tmp_path):
    network = small_network()
    estimator = VotesEstimator(export_votes(network, tmp_path / "votes.onnx"))
    for views in (1, 3):
        cloud = cloud_of(samples[0], views)
        parts = part_statistics(cloud)
        frame = body_frame(parts)
        with torch.no_grad():
            truth, sure, points, points_sure = network(torch.from_numpy(network_inputs(parts, frame)[0])[None])
        told = estimator.with_points(cloud)
        for places, expected in zip(told[::2], (truth, points), strict=True):
            np.testing.assert_allclose(places, frame.to_world(expected[0].numpy()), atol=2e-3)
        for confidence, expected in zip(told[1::2], (sure, points_sure), strict=True):
            np.testing.assert_allclose(confidence, torch.sigmoid(expected[0]).numpy(), atol=2e-3)
        for array, same in zip(estimator(cloud), told, strict=False):
            np.testing.assert_array_equal(array, same)
        pose = estimate_pose(estimator, cloud, "z", 5)
        np.testing.assert_array_equal(pose.points, told[2])


def test_points_change_nothing_of_the_joints(samples):
    parts = parts_of(samples)
    x = torch.from_numpy(network_inputs(parts, body_frame(parts))[0])
    network, without = small_network(), VotesNet(32, 1, 2, points=False).eval()
    state = {k: v for k, v in network.state_dict().items() if not k.startswith("points.")}
    without.load_state_dict(state)
    with torch.no_grad():
        for ours, theirs in zip(network(x), without(x), strict=False):
            torch.testing.assert_close(ours, theirs, atol=0, rtol=0)


def test_a_network_without_points_tells_none(samples, tmp_path):
    parts = helper.make_tensor_value_info("parts", TensorProto.FLOAT, ["n", "views", 61, 16])
    values = {"joints": np.ones((1, 18, 3), np.float32), "sure": np.zeros((1, 18), np.float32)}
    nodes = [
        helper.make_node("Constant", [], [name], value=numpy_helper.from_array(array)) for name, array in values.items()
    ]
    outputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, array.shape) for name, array in values.items()]
    graph = helper.make_graph(nodes, "earlier", [parts], outputs)
    path = tmp_path / "votes.onnx"
    onnx.save(helper.make_model(graph, ir_version=8, opset_imports=[helper.make_opsetid("", 18)]), path)
    estimator, cloud = VotesEstimator(path), cloud_of(samples[0])
    assert not estimator.has_points
    joints, confidence, points, points_confidence = estimator.with_points(cloud)
    assert np.isfinite(joints).all()
    assert (confidence == 0.5).all()
    assert np.isnan(points).all()
    assert not points_confidence.any()
    assert estimate_pose(estimator, cloud, "z", 5).points is None


def test_points_learn_beside_joints_that_stay(samples, tmp_path, monkeypatch):
    monkeypatch.setattr(train_votes_module, "export_votes", lambda network, path: path)
    parts = parts_of(samples)
    collected = CollectedSamples(
        {"network": parts, "true": np.zeros_like(parts)}, np.stack([sample.joints for sample in samples]),
        np.stack([sample.landmarks for sample in samples]), np.arange(8), {},
    )  # fmt: skip
    torch.manual_seed(1)
    start = VotesNet(points=False)
    save_weights(start, tmp_path / "start.safetensors")
    settings = VotesTraining(0.005, start=tmp_path / "start.safetensors", points_only=True)
    train_votes(collected, settings, 0, tmp_path, Console(quiet=True))
    learnt = VotesNet()
    assert load_weights(learnt, tmp_path / "votes.safetensors", "points.")
    load_weights(start, tmp_path / "start.safetensors")
    for name, value in start.state_dict().items():
        assert torch.equal(value, learnt.state_dict()[name]), name
    assert learnt.points is not None
    beside = learnt.points.usual_place.detach().numpy()
    assert 0.1 < np.linalg.norm(beside[0]) < 0.4  # the crown above the head's joint
    assert not load_weights(learnt, tmp_path / "start.safetensors", "points.")
    load_weights(start, tmp_path / "votes.safetensors", "points.")  # of a network that tells none
    recorded = dataclasses.replace(collected, landmarks=np.full_like(collected.landmarks, np.nan))
    with pytest.raises(InputError, match="no sample tells points"):
        train_votes(recorded, settings, 0, tmp_path, Console(quiet=True))


def test_landmarks_come_with_generated_people(samples):
    for sample in samples:
        beside = sample.landmarks[POINT_ROWS] - sample.joints[POINT_JOINTS]
        assert (np.linalg.norm(beside, axis=1) < 0.45).all()


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
