"""synth, train and evaluate, end to end on tiny data."""

import dataclasses
import io
import json

import numpy as np
import pytest
import torch
from quick_training import skip_export, skip_export_of_votes
from rich.console import Console

from depthmocap import InputError
from depthmocap.body.skeleton import JOINTS
from depthmocap.classify.classifier import Classifier
from depthmocap.cli import main
from depthmocap.datasets.ubc3v import Section, sections
from depthmocap.evaluate.accuracy import measure_accuracy
from depthmocap.evaluate.ubc3v_protocol import Ubc3vEvaluation, evaluate_ubc3v
from depthmocap.pose.estimators import load_estimator
from depthmocap.pose.ridge import RidgeBank
from depthmocap.synth.sample import Recipe, Split
from depthmocap.synth.writing.generate import SynthSettings, generate
from depthmocap.train import train_classifier as train
from depthmocap.train import train_votes as votes_train
from depthmocap.train.checkpoints import load_weights
from depthmocap.train.classifier_settings import ClassifierTraining
from depthmocap.train.networks import FastNet
from depthmocap.train.pose_samples import PoseSampleSettings, append_parts, collect, read_samples
from depthmocap.train.train_classifier import train_classifier
from depthmocap.train.train_pose import PoseTraining, train_pose

QUIET = Console(quiet=True)


@pytest.fixture(scope="module")
def root(body_model, tmp_path_factory):
    """A UBC3V root with a few samples of hard-pose to test on."""
    path = tmp_path_factory.mktemp("ubc3v")
    generate(SynthSettings(path, Recipe("hard", "test"), samples=4, seed=3))
    return path


@pytest.fixture(scope="module")
def full_root(root):
    """The same with samples in each split."""
    counts: dict[Split, int] = {"train": 24, "valid": 2}
    for split, count in counts.items():
        generate(SynthSettings(root, Recipe("hard", split), samples=count, seed=3))
    return root


@pytest.mark.slow
def test_synth_writes_what_is_read_back(root):
    (path,) = sections(root, "hard-pose", "test")
    section = Section(path)
    assert len(section) == 4
    frame = section[2]
    assert len(frame.views) == 3
    assert frame.true_joints is not None
    for view in frame.views:
        assert view.mask is not None
        assert view.labels is not None
        distance = np.linalg.norm(view.camera.world_from_camera[:3, 3] - np.median(frame.true_joints, 0))
        assert 1.2 < distance < 4.6
        # The joints lie within the body, so nearly all project into its mask, and just behind what is seen there.
        u, v, z = view.camera.project(frame.true_joints).T
        column, row = np.round(u).astype(int), np.round(v).astype(int)
        seen = (column >= 0) & (column < view.camera.width) & (row >= 0) & (row < view.camera.height)
        inside = view.mask[row[seen], column[seen]]
        assert inside.mean() > 0.8
        behind = z[seen][inside] - view.depth_m[row[seen][inside], column[seen][inside]]
        assert (behind > -0.03).all()


def test_evaluation_on_true_labels(root, tmp_path):
    path = tmp_path / "numbers.json"
    numbers = evaluate_ubc3v(Ubc3vEvaluation(root, labels="true", json=path))
    assert numbers["pixel_accuracy"] == 1.0
    assert numbers["mean_joint_error_cm"] < 6
    assert numbers["within_10cm"] > 0.8
    assert json.loads(path.read_text()).keys() == numbers.keys()
    assert list(numbers["per_joint_error_cm"]) == list(JOINTS)


@pytest.mark.parametrize(("views", "combinations"), [(1, 3), (2, 3), (3, 1)])
def test_evaluation_on_network_labels(root, views, combinations, tmp_path):
    path = tmp_path / "numbers.json"
    status = main(["evaluate", "ubc3v", str(root), "--views", str(views), "--limit", "2", "--json", str(path)])
    assert status == 0
    numbers = json.loads(path.read_text())
    assert numbers["frames"] == 2
    assert numbers["views"] == views
    assert 0.6 < numbers["pixel_accuracy"] <= 1
    assert 0.4 < numbers["class_accuracy"] <= 1
    assert len(numbers["per_class_accuracy"]) == 43
    assert numbers["mean_joint_error_cm"] < 20
    assert numbers["ms_per_frame"] > 0
    assert numbers["joints_missing"] == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"views": 0}, "--views must be at least 1, got 0"),
        ({"views": -1}, "--views must be at least 1, got -1"),
        ({"views": 4}, "--views must be at most 3, the cameras of .*, got 4"),
        ({"limit": 0}, "--limit must be at least 1, got 0"),
        ({"limit": -1}, "--limit must be at least 1, got -1"),
    ],
)
def test_numbers_that_no_evaluation_can_have(root, tmp_path, change, message):
    path = tmp_path / "numbers.json"
    with pytest.raises(InputError, match=message):
        # Of weights that are not there nothing is told: the check comes before any work.
        evaluate_ubc3v(Ubc3vEvaluation(root, **change, weights=tmp_path / "none.onnx", json=path))
    assert not path.exists()


def test_a_camera_may_be_missing_from_a_frame_but_not_from_all(root):
    (path,) = sections(root, "hard-pose", "test")
    frames = [Section(path)[i] for i in range(2)]
    estimator = load_estimator("votes", "true")
    short = [dataclasses.replace(frame, views=frame.views[:2]) for frame in frames]
    found = measure_accuracy([frames[0], short[1]], 3, estimator, None)
    assert found is not None
    assert (found["views"], found["frames"]) == (3, 2)
    with pytest.raises(InputError, match="no sample has 3 views: the data have labels of 2 cameras"):
        measure_accuracy(short, 3, estimator, None)


def test_evaluation_says_what_is_missing(tmp_path, capsys):
    assert main(["evaluate", "ubc3v", str(tmp_path)]) == 2
    assert "hard-pose" in capsys.readouterr().err


@pytest.mark.slow
def test_train_pose_from_a_folder(full_root, tmp_path):
    source = PoseSampleSettings(str(full_root), subset="hard", samples=24, views=(2, 3))
    settings = PoseTraining(tmp_path, source, minutes=0.05)
    network, true, votes = train_pose(settings)
    assert [path.name for path in (network, true, votes)] == ["ridge_network.npz", "ridge_true.npz", "votes.onnx"]
    for path, labels in ((network, "network"), (true, "true")):
        models = RidgeBank.load(path).models
        assert [(model.views, model.labels) for model in models] == [(2, labels), (3, labels)]
    for path in (true, votes):
        numbers = evaluate_ubc3v(Ubc3vEvaluation(full_root, labels="true", estimator=str(path)))
        assert numbers["mean_joint_error_cm"] < 60  # 24 samples teach little, but not nothing


@pytest.mark.slow
def test_the_votes_learn_from_earlier_samples_too(full_root, tmp_path, monkeypatch):
    skip_export_of_votes(monkeypatch)
    source = PoseSampleSettings(str(full_root), subset="hard", samples=24, views=(2,))
    one, two = (
        collect(dataclasses.replace(source, views=views), tmp_path / f"of {views[0]}", QUIET) for views in ((2,), (3,))
    )
    both = append_parts(one, [read_samples(tmp_path / "of 3", PoseSampleSettings(views=()))])
    n = len(one.joints)
    assert both.parts["network"].shape[:2] == (2 * n, 3)
    np.testing.assert_array_equal(both.parts["true"][:n, :2], one.parts["true"])
    assert not both.parts["true"][:n, 2].any()
    np.testing.assert_array_equal(both.parts["network"][n:], two.parts["network"])
    np.testing.assert_array_equal(both.joints[n:], two.joints)
    assert np.isnan(both.landmarks).all()  # of recorded people
    assert both.features is one.features
    settings = PoseTraining(tmp_path / "run", source, "votes", minutes=0.03, earlier=(tmp_path / "of 3",))
    (path,) = train_pose(settings, QUIET)
    assert path.exists()
    with pytest.raises(InputError, match="no samples"):
        train_pose(dataclasses.replace(settings, earlier=(tmp_path / "nothing",)), QUIET)


@pytest.mark.slow
def test_train_pose_in_the_world_from_synth(body_model, tmp_path):
    source = PoseSampleSettings(samples=30, views=(3,), frame="world", workers=0)
    settings = PoseTraining(tmp_path, source, "ridge")
    for path in train_pose(settings):
        assert RidgeBank.load(path).frame == "world"
    before = (tmp_path / "settings.json").read_text()
    with pytest.raises(InputError, match="holds samples with --seed 0: use the same"):
        train_pose(dataclasses.replace(settings, source=dataclasses.replace(source, seed=1)))
    assert (tmp_path / "settings.json").read_text() == before  # of what is there


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"minutes": np.nan}, "--minutes must be finite and above 0"),
        ({"minutes": -1.0}, "--minutes must be finite and above 0"),
        ({"learning_rate": np.inf}, "--learning-rate must be finite and above 0"),
        ({"source": PoseSampleSettings(samples=19)}, "--samples must be at least 20"),
        ({"points_only": True}, "--points-only needs --start"),
    ],
)
def test_pose_training_that_cannot_be(tmp_path, change, message):
    with pytest.raises(InputError, match=message):
        PoseTraining(tmp_path, **change)


@pytest.mark.slow
def test_train_classifier_resumes_and_exports(full_root, tmp_path, monkeypatch):
    settings = ClassifierTraining(
        tmp_path / "run", data=str(full_root), images=32, batch=8, workers=0, valid_every=16, valid_images=4
    )
    with monkeypatch.context() as patch:
        skip_export(patch)
        train_classifier(settings)
    history = (settings.out / "history.jsonl").read_text().splitlines()
    assert [json.loads(row)["step"] for row in history] == [16, 32]
    assert (settings.out / "curves.png").stat().st_size > 0
    before = (settings.out / "settings.json").read_text()
    with pytest.raises(InputError, match="holds a run with --learning-rate None: use the same, or another --out"):
        train_classifier(dataclasses.replace(settings, images=48, learning_rate=0.1))
    assert (settings.out / "settings.json").read_text() == before
    monkeypatch.setattr(train, "_CALIBRATION", 8)
    onnx = train_classifier(dataclasses.replace(settings, images=48))
    history = (settings.out / "history.jsonl").read_text().splitlines()
    assert [json.loads(row)["step"] for row in history] == [16, 32, 48]
    Classifier(onnx.with_name("classifier_int8.onnx"))
    # The weights file holds the same network as the ONNX file.
    network = FastNet()
    load_weights(network, settings.out / "classifier.safetensors")
    windows = torch.rand(1, 3, 192, 192)
    windows[:, 1] = (windows[:, 1] > 0.5).float()
    with torch.no_grad():
        expected = network.eval()(windows)
    found = Classifier(onnx)._network._session.run(None, {"windows": windows.numpy()})
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(np.asarray(ours), theirs.numpy(), atol=0.02 * theirs.abs().max())


@pytest.mark.slow
def test_a_run_that_is_interrupted_loses_no_step(full_root, tmp_path, monkeypatch):
    skip_export(monkeypatch)
    settings = ClassifierTraining(
        tmp_path / "run", data=str(full_root), images=32, batch=8, workers=0, valid_every=32, valid_images=2
    )
    asked = iter(range(100))

    def interrupted(*_):
        if next(asked) == 2:
            raise KeyboardInterrupt
        return False

    with monkeypatch.context() as patch:
        patch.setattr(train, "joint_loss", lambda found, places: found.sum() * int(interrupted()))
        with pytest.raises(KeyboardInterrupt):
            train_classifier(settings)
    assert torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)["done"] == 16
    for name in (".lock", ".checkpoint.part-1.pt"):  # as a kill while it was written leaves
        (settings.out / name).write_bytes(b"half")
    train_classifier(settings)
    assert not [path for path in settings.out.iterdir() if path.name.startswith(".")]
    assert [json.loads(row)["step"] for row in (settings.out / "history.jsonl").read_text().splitlines()] == [32]
    # Begun anew, it leaves nothing of the earlier run beside its own.
    (settings.out / "checkpoint.pt").unlink()
    with pytest.raises(InputError, match="--without is for our networks"):
        train_classifier(dataclasses.replace(settings, network="paper", without=("mirror",)))
    assert [path.name for path in settings.out.iterdir()] == ["settings.json"]
    with pytest.raises(InputError, match="--start must not be a file that training writes"):
        train_classifier(dataclasses.replace(settings, start=settings.out / "classifier.safetensors"))


@pytest.mark.slow
def test_votes_that_are_interrupted_are_kept(full_root, tmp_path, monkeypatch):
    skip_export_of_votes(monkeypatch)
    source = PoseSampleSettings(str(full_root), subset="hard", samples=24, views=(2,))
    settings = PoseTraining(tmp_path / "run", source, "votes", minutes=30.0)
    steps = iter(range(100))
    original = votes_train.augment

    def interrupted(*arguments):
        if next(steps) == 1:
            raise KeyboardInterrupt
        return original(*arguments)

    monkeypatch.setattr(votes_train, "augment", interrupted)
    told = io.StringIO()
    (path,) = train_pose(settings, Console(file=told))
    assert path.exists() and path.with_suffix(".safetensors").exists()
    assert "stopped: what was learnt until now is written" in told.getvalue()
    steps = iter([1])  # at once
    with pytest.raises(KeyboardInterrupt):
        train_pose(dataclasses.replace(settings, out=tmp_path / "none"), QUIET)
    assert not (tmp_path / "none" / "votes.onnx").exists()


def test_train_classifier_on_the_fly(body_model, tmp_path, monkeypatch):
    skip_export(monkeypatch)
    settings = ClassifierTraining(tmp_path, images=2, batch=1, workers=0, valid_every=2, valid_images=1)
    train_classifier(settings)
    row = json.loads((tmp_path / "history.jsonl").read_text())
    assert np.isfinite(row["loss"])


def test_weights_of_another_network_are_refused(tmp_path):
    from safetensors.torch import save_file

    save_file({"nothing": torch.zeros(1)}, tmp_path / "other.safetensors")
    with pytest.raises(InputError, match="weights of this network"):
        load_weights(FastNet(), tmp_path / "other.safetensors")


@pytest.mark.parametrize("command", ["train classifier --out OUT", "train pose --out OUT", "evaluate bench"])
def test_seeds_that_cannot_be(command, tmp_path, capsys):
    assert main([*command.replace("OUT", str(tmp_path / "run")).split(), "--seed", "-1"]) == 2
    assert "--seed must be at least 0, got -1" in capsys.readouterr().err
