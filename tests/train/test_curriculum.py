"""The paper's experiment: which network goes on from which, what is measured, resuming."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path

import pytest
from rich.console import Console

torch = pytest.importorskip("torch")
pytest.importorskip("safetensors")

from safetensors.torch import save_file  # noqa: E402

from depthmocap.errors import InputError  # noqa: E402
from depthmocap.synth.body.mesh import BodyModel  # noqa: E402
from depthmocap.train import curriculum  # noqa: E402
from depthmocap.train.checkpoints import load_weights  # noqa: E402
from depthmocap.train.classifier_settings import ClassifierTraining  # noqa: E402
from depthmocap.train.curriculum import STAGES, CurriculumTraining, train_curriculum  # noqa: E402
from depthmocap.train.paper_network import PaperNet  # noqa: E402

QUIET = Console(quiet=True)
#: The label that the quick training favours, by subset, so that networks can be told apart.
FAVOURED = {"easy": 2, "inter": 6, "hard": 20}


def quick_training(runs: list[ClassifierTraining]):
    """Stands for training, which has tests of its own: moves the network it is given towards one label."""

    def train(settings: ClassifierTraining) -> Path:
        runs.append(settings)
        network = PaperNet()
        if settings.start is not None:
            load_weights(network, settings.start)
        with torch.no_grad():
            for name, parameter in network.named_parameters():
                if name != "up1.bias":
                    parameter.zero_()
            assert network.up1.bias is not None
            network.up1.bias[FAVOURED[settings.subset or "open"]] += 1 if settings.start is None else 5
        settings.out.mkdir(parents=True)
        save_file(network.state_dict(), settings.out / "classifier.safetensors")
        row = {"step": settings.images, "loss": 1.0, "valid_class_accuracy": 0.5}
        (settings.out / "history.jsonl").write_text(json.dumps(row) + "\n")
        path = settings.out / "classifier.onnx"
        path.touch()
        return path

    return train


def test_the_experiment(body_model: BodyModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs: list[ClassifierTraining] = []
    monkeypatch.setattr(curriculum, "train_classifier", quick_training(runs))
    settings = CurriculumTraining(tmp_path / "run", scale=1e-4, valid_images=1, workers=0)
    found = train_curriculum(dataclasses.replace(settings, control=False), QUIET)
    # The order, the budgets, and who starts from whom.
    assert [(run.subset, run.images) for run in runs] == [("easy", 25 * 8), ("inter", 15 * 8), ("hard", 9 * 8)]
    assert [run.start and run.start.parent.name for run in runs] == [None, "net_1", "net_2"]
    for run in runs:
        assert (run.network, run.optimiser, run.schedule, run.average, run.batch) == ("paper", "sgd", "constant", 0, 8)
    networks = found["optimisers"]["sgd"]
    assert networks["net 2"]["start"] == networks["net 1"]["end"]
    assert networks["net 3"]["start"] == networks["net 2"]["end"]
    # All three sets are measured, and the networks give what they were taught.
    for network in networks.values():
        for when in ("start", "end"):
            assert set(network[when]) == {"easy", "inter", "hard"}
            assert all(0 <= share <= 1 for each in network[when].values() for share in each.values())
    assert networks["net 1"]["end"] != networks["net 2"]["end"]

    # Run again with the control, only that is trained, on as many pictures as the three.
    runs.clear()
    found = train_curriculum(settings, QUIET)
    assert [(run.subset, run.images, run.start) for run in runs] == [("hard", 49 * 8, None)]
    assert found["optimisers"]["sgd"]["net 3"] == networks["net 3"]
    runs.clear()
    printed = Console(record=True, width=200, quiet=False, file=io.StringIO())
    assert json.loads(json.dumps(train_curriculum(settings, printed))) == json.loads(
        (settings.out / "table.json").read_text()
    )
    assert not runs
    text = printed.export_text()
    assert "from scratch (hard)" in text and "78 → 82" in text and "points (paper: 81 and at most 50)" in text
    report = (settings.out / "report.html").read_text()
    assert report.count("<img") == 2 and "0.0001 of the paper" in report

    with pytest.raises(InputError, match=r"holds a curriculum with --scale 0\.0001: use the same, or another --out"):
        train_curriculum(dataclasses.replace(settings, scale=2e-4), QUIET)


def test_budgets_are_the_papers() -> None:
    assert [(stage.subset, stage.iterations) for stage in STAGES] == [
        ("easy", 250_000), ("inter", 150_000), ("hard", 88_000), ("hard", 488_000),
    ]  # fmt: skip
    assert CurriculumTraining(Path("x"), scale=1.0).training("sgd", STAGES[1]).images == 1_200_000
    assert CurriculumTraining(Path("x")).training("adamw", STAGES[0]).learning_rate == 3e-4


@pytest.mark.parametrize("change", [{"scale": 0.0}, {"scale": 1.5}, {"valid_images": 0}, {"optimisers": ()}])
def test_settings_that_cannot_be(change: dict, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--scale must be above 0"):
        train_curriculum(dataclasses.replace(CurriculumTraining(tmp_path), **change), QUIET)
