"""Training: the optimiser, the paper's windows, resuming, what is kept."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")

from quick_training import skip_export  # noqa: E402
from safetensors.torch import load_file, save_file  # noqa: E402

from depthmocap.body.regions import UNLABELLED  # noqa: E402
from depthmocap.classify.classifier import Classifier  # noqa: E402
from depthmocap.errors import InputError  # noqa: E402
from depthmocap.synth.body.mesh import BodyModel  # noqa: E402
from depthmocap.train.batches import WindowSource  # noqa: E402
from depthmocap.train.checkpoints import load_weights  # noqa: E402
from depthmocap.train.classifier_settings import ClassifierTraining  # noqa: E402
from depthmocap.train.networks import FastNet  # noqa: E402
from depthmocap.train.paper_network import PaperNet  # noqa: E402
from depthmocap.train.train_classifier import (  # noqa: E402
    _make_optimiser,
    evaluate_windows,
    joint_loss,
    train_classifier,
)


def test_paper_biases_learn_twice_as_fast() -> None:
    network = PaperNet()
    optimiser = _make_optimiser(network, ClassifierTraining(Path("x"), network="paper", learning_rate=0.5))
    assert isinstance(optimiser, torch.optim.SGD)
    peaks = {id(p): group["peak"] for group in optimiser.param_groups for p in group["params"]}
    for name, parameter in network.named_parameters():
        assert peaks[id(parameter)] == (1.0 if name.endswith("bias") else 0.5)


def test_ours_is_trained_by_adamw() -> None:
    optimiser = _make_optimiser(FastNet(), ClassifierTraining(Path("x")))
    assert isinstance(optimiser, torch.optim.AdamW)
    (group,) = optimiser.param_groups  # the checkpoints of earlier versions have one, too
    assert (group["peak"], group["weight_decay"]) == (2e-3, 0.02)


def test_windows_of_the_papers_kind(body_model: BodyModel) -> None:
    source = WindowSource("paper", "synth", "hard", None, 0)
    windows = source.train(5)
    x, y, _ = windows[2]
    assert x.shape == (2, 250, 250) and y.shape == (250, 250)
    person = x[1] > 0
    assert (y[~person] == 0).all()  # what is not the person is learnt as background
    assert len(np.unique(y[person])) > 8
    assert (y == UNLABELLED).mean() < 0.01
    for array, same in zip((x, y), source.train()[7][:2], strict=True):
        np.testing.assert_array_equal(array, same)
    valid = source.valid(2)
    assert [each.inputs.shape for each in valid] == [(2, 250, 250)] * 2
    assert valid[0].labels.dtype == np.uint8
    assert not (valid[0].labels == source.train()[0].labels).all()


@pytest.mark.slow
def test_the_papers_network_learns_resumes_and_exports(
    body_model: BodyModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = ClassifierTraining(
        tmp_path / "run", network="paper", subset="easy", images=4, batch=2, workers=0, valid_every=2, valid_images=1,
        average=0.0, schedule="constant", learning_rate=0.01, bfloat16=False,
    )  # fmt: skip
    with monkeypatch.context() as patch:
        skip_export(patch)
        train_classifier(settings)
    onnx = train_classifier(dataclasses.replace(settings, images=6))
    rows = [json.loads(line) for line in (settings.out / "history.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == [2, 4, 6]
    assert rows[-1]["loss"] < rows[0]["loss"] < 6
    assert Classifier(onnx, threads=1).network == "paper"
    # Without averaging, what is kept is what was trained, its kernels in half precision.
    state = torch.load(settings.out / "checkpoint.pt", weights_only=True)
    network = PaperNet()
    load_weights(network, settings.out / "classifier.safetensors")
    for name, value in network.state_dict().items():
        torch.testing.assert_close(value, state["network"][name], rtol=1e-3, atol=1e-5)
    (window,) = settings.source.valid(1)
    accuracy, joint_m = evaluate_windows(network, [window])
    assert np.isnan(joint_m)
    assert accuracy.pixels == ((window.inputs[1] > 0) & (window.labels > 0) & (window.labels != UNLABELLED)).sum()
    with pytest.raises(InputError, match="holds a run with --network paper"):
        train_classifier(dataclasses.replace(settings, network="fast", images=8))
    (tmp_path / "run" / "settings.json").unlink()
    with pytest.raises(InputError, match=r"checkpoint\.pt is of another network or optimiser"):
        train_classifier(dataclasses.replace(settings, network="fast", images=8))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"average": 1.0}, "--average must be from 0"),
        ({"momentum": float("nan")}, "--momentum must be from 0"),
        ({"blend": 1.0}, "--blend must be from 0 to less than 1"),
        ({"blend": -0.1}, "--blend must be from 0 to less than 1"),
        ({"blend": 0.5}, "--blend asks for a --start"),
        ({"minutes": float("nan")}, "--minutes must be finite and at least 0"),
        ({"learning_rate": -1.0}, "--learning-rate must be finite and above 0"),
        ({"weight_decay": -1.0}, "--weight-decay must be finite and at least 0"),
        ({"images": 0}, "--images must be finite and at least 1"),
        ({"batch": -8}, "--batch must be finite and at least 1"),
        ({"valid_every": 0}, "--valid-every must be finite and at least 1"),
    ],
)
def test_settings_that_cannot_be(change: dict, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        ClassifierTraining(tmp_path, **change)


@pytest.mark.slow
def test_what_is_kept_is_blended_with_what_it_started_from(
    body_model: BodyModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    skip_export(monkeypatch)
    torch.manual_seed(1)
    started = FastNet()
    state = {k: v + 0.1 if v.is_floating_point() else v for k, v in started.state_dict().items()}
    start = tmp_path / "start.safetensors"
    save_file(state, start)
    settings = ClassifierTraining(
        tmp_path / "run", images=2, batch=2, start=start, valid_images=1, workers=0, average=0.0
    )
    train_classifier(settings)
    kept = load_file(tmp_path / "run" / "classifier.safetensors")
    # Run again, nothing is learnt any more, and what is exported is blended.
    train_classifier(dataclasses.replace(settings, blend=0.25))
    blended = load_file(tmp_path / "run" / "classifier.safetensors")
    for name, now in blended.items():
        if now.is_floating_point():
            expected = 0.75 * kept[name].float() + 0.25 * state[name].float()
            torch.testing.assert_close(now.float(), expected, rtol=2e-3, atol=2e-3)
    assert any((blended[name] != kept[name]).any() for name in kept)


def test_joint_loss() -> None:
    places = torch.full((2, 18, 3), torch.nan)
    places[0, 3], places[1, 5] = torch.tensor([1.0, 0, 0]), torch.tensor([0, 2.0, 0])
    found = torch.zeros(2, 18, 4, requires_grad=True)
    loss = joint_loss(found, places)
    assert loss.item() == pytest.approx(1.5 + 0.01 * 1.5)  # errors of 1 and 2 m where 1 m is expected
    loss.backward()
    assert found.grad is not None and found.grad.isfinite().all()
    assert found.grad[0, 3].tolist() == pytest.approx([-0.5, 0, 0, 0])
    assert found.grad[1, 5].tolist() == pytest.approx([0, -0.5, 0, 0.01 * 0.5 * (1 - 2)])
    assert not found.grad[0, 4].any()
    assert joint_loss(found, torch.full_like(places, torch.nan)).item() == 0


def test_what_is_no_checkpoint_or_no_device_is_told(tmp_path: Path) -> None:
    for device in ("nope", "meta", "cpu:x"):
        with pytest.raises(InputError, match=f"--device {device}"):
            train_classifier(ClassifierTraining(tmp_path / "run", device=device))
    settings = ClassifierTraining(tmp_path / "run")
    checkpoint = settings.out / "checkpoint.pt"
    settings.out.mkdir(exist_ok=True)
    torch.save({"history": "[]", "done": 16, "spent": 1.0}, checkpoint)
    whole = checkpoint.read_bytes()
    for content in (b"", b"PK\x03\x04", whole[: len(whole) // 2]):
        checkpoint.write_bytes(content)
        with pytest.raises(InputError, match="is damaged or no checkpoint"):
            train_classifier(settings)
    for state in ([1], {"history": 9999 * "[", "done": 0, "spent": 0.0}, {"history": "[]", "done": True, "spent": 0.0}):
        torch.save(state, checkpoint)
        with pytest.raises(InputError, match="is damaged or no checkpoint"):
            train_classifier(settings)
    checkpoint.write_bytes(whole)
    with pytest.raises(InputError, match="is of another network or optimiser"):
        train_classifier(settings)
