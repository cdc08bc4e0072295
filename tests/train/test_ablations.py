"""What each ingredient of training is worth: that each run lacks what it says, and what is measured."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from rich.console import Console

torch = pytest.importorskip("torch")
pytest.importorskip("safetensors")

from safetensors.torch import save_file  # noqa: E402

from depthmocap.errors import InputError  # noqa: E402
from depthmocap.synth.body.mesh import BodyModel  # noqa: E402
from depthmocap.train import ablations  # noqa: E402
from depthmocap.train import train_classifier as train  # noqa: E402
from depthmocap.train.ablations import ABLATIONS, AblationTraining, train_ablations  # noqa: E402
from depthmocap.train.batches import Ingredient, WindowSource, training_batches  # noqa: E402
from depthmocap.train.checkpoints import load_weights  # noqa: E402
from depthmocap.train.classifier_settings import ClassifierTraining  # noqa: E402
from depthmocap.train.networks import FastNet  # noqa: E402
from depthmocap.train.train_classifier import make_network, train_classifier  # noqa: E402

QUIET = Console(quiet=True)


def source(*without: Ingredient) -> WindowSource:
    return WindowSource("fast", "synth", "open", None, 3, without)


def network(*without: Ingredient) -> FastNet:
    made = make_network(ClassifierTraining(Path("x"), without=without))
    assert isinstance(made, FastNet)
    return made


def test_networks_lack_what_they_shall() -> None:
    full = network()
    assert any(isinstance(each, torch.nn.BatchNorm2d) for each in full.modules())
    bare = network("norm")
    assert not any(isinstance(each, torch.nn.BatchNorm2d) for each in bare.modules())
    assert all(each.bias is not None for each in bare.down.modules() if isinstance(each, torch.nn.Conv2d))
    assert network("width").widths == tuple(width // 2 for width in full.widths)
    x = torch.zeros(1, *FastNet.input_shape)
    x[:, 1, 50:60, 40:60] = 1
    for each in (bare, network("width")):
        probabilities, joints = each.eval()(x)
        assert probabilities.shape == (5 * 10, 4, 44) and joints.shape == (1, 18, 4)
    with pytest.raises(InputError, match="--without is for our networks"):
        make_network(ClassifierTraining(Path("x"), network="paper", without=("norm",)))


def test_pictures_lack_what_they_shall(body_model: BodyModel) -> None:
    def pictures(*without: Ingredient) -> list:
        data = source(*without).train()
        return [data[i] for i in range(6)]

    ingredients: tuple[Ingredient, ...] = ("clothes", "errors", "spoiling", "variation")
    full = pictures()
    bare, exact, spared, recorded = (pictures(each) for each in ingredients)
    # Whatever lacks is another picture ...
    for others in (bare, exact, spared, recorded):
        assert any(
            a.inputs.shape != b.inputs.shape or (a.inputs != b.inputs).any() for a, b in zip(full, others, strict=True)
        )
    # ... bare people have no clothes before their background, well segmented ones nothing in their mask that is not
    # theirs, and exact depth has no holes within the mask of a view.
    assert sum((each.labels == 0).sum() for each in spared) < sum((each.labels == 0).sum() for each in full)
    alone = pictures("clothes", "spoiling")
    assert sum((each.labels == 0).sum() for each in alone) == 0
    smooth, rough = (
        np.mean([np.abs(np.diff(each.inputs[0], axis=1))[(each.inputs[1][:, 1:] > 0)].mean() for each in some])
        for some in (pictures("clothes", "spoiling", "errors"), alone)
    )
    assert smooth < rough
    for whole, half in zip(spared, pictures("spoiling", "resolution"), strict=True):
        for row, column in ((0, 0), (1, 0), (0, 1), (1, 1)):
            np.testing.assert_array_equal(half.inputs[:, row::2, column::2], whole.inputs[:, ::2, ::2])
        np.testing.assert_array_equal(half.labels, whole.labels)
    # Validation is the same for all.
    for a, b in zip(source().valid(2), source("clothes", "errors", "norm").valid(2), strict=True):
        np.testing.assert_array_equal(a.inputs, b.inputs)


@pytest.mark.parametrize("network", ["fast", "paper"])
def test_runs_of_every_seed_are_validated_on_the_same_pictures(body_model: BodyModel, network) -> None:
    first, second = (WindowSource(network, "synth", "hard", None, seed) for seed in (1, 2))
    for a, b in zip(first.valid(3), second.valid(3), strict=True):
        np.testing.assert_array_equal(a.inputs, b.inputs)
    assert not np.array_equal(first.train()[0].labels, second.train()[0].labels)


def test_without_mirror_images_every_picture_is_shown_once(body_model: BodyModel) -> None:
    data = source("clothes", "spoiling").train()
    few = [data[i] for i in range(8)]

    def shown(mirror: bool) -> int:
        windows = iter([few] * 400)
        return sum(len(batch.labels) for batch in training_batches(windows, 16, 0, mirror))

    assert shown(False) == 8 * 400
    assert shown(True) > 1.5 * 8 * 400


@pytest.mark.slow
def test_a_short_run_lacks_and_resumes(body_model: BodyModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(train, "_CALIBRATION", 2)
    settings = ClassifierTraining(
        tmp_path, images=16, batch=2, valid_every=1000, valid_images=1, workers=0, without=("norm", "width", "mirror")
    )
    train_classifier(settings)
    made = network("norm", "width")
    load_weights(made, tmp_path / "classifier.safetensors")
    assert json.loads((tmp_path / "settings.json").read_text())["without"] == ["norm", "width", "mirror"]


def quick_training(runs: list[ClassifierTraining]):
    """Stands for training, which has tests of its own."""

    def train(settings: ClassifierTraining) -> Path:
        runs.append(settings)
        torch.manual_seed(len(runs))
        made = make_network(settings)
        settings.out.mkdir(parents=True)
        save_file(made.state_dict(), settings.out / "classifier.safetensors")
        path = settings.out / "classifier.onnx"
        path.touch()
        return path

    return train


def test_the_table(body_model: BodyModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs: list[ClassifierTraining] = []
    monkeypatch.setattr(ablations, "train_classifier", quick_training(runs))
    settings = AblationTraining(tmp_path / "run", images=300, valid_images=1, workers=0)
    found = train_ablations(dataclasses.replace(settings, only=("full", "norm", "curriculum")), QUIET)
    assert [(run.subset, run.images, run.without) for run in runs] == [
        ("open", 300, ()), ("open", 300, ("norm",)), ("easy", 100, ()), ("inter", 100, ()), ("open", 100, ()),
    ]  # fmt: skip
    assert [run.start and run.start.parent.name for run in runs[2:]] == [None, "easy", "inter"]
    assert list(found["runs"]) == ["full", "norm", "curriculum"]

    runs.clear()
    printed = Console(record=True, width=200, file=io.StringIO())
    found = train_ablations(settings, printed)
    assert [run.without for run in runs] == [(each,) for each in get_args(Ingredient) if each != "norm"]
    assert tuple(found["runs"]) == ABLATIONS
    assert json.loads((settings.out / "table.json").read_text()) == json.loads(json.dumps(found))
    for row in found["runs"].values():
        assert 0 <= row["pixel_accuracy"] <= 1 and row["joint_error_cm"] > 1
    text = printed.export_text()
    assert "no batch normalisation" in text and "300 pictures each, measured on 1 windows" in text
    assert "no mirror images" in (settings.out / "report.html").read_text()
    with pytest.raises(InputError, match=r"holds ablations with --images 300: use the same, or another --out"):
        train_ablations(dataclasses.replace(settings, images=400), QUIET)


@pytest.mark.parametrize("change", [{"images": 10}, {"valid_images": 0}, {"only": ()}])
def test_settings_that_cannot_be(change: dict, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--images must be at least 100"):
        train_ablations(dataclasses.replace(AblationTraining(tmp_path), **change), QUIET)
