"""``depthmocap train curriculum``: the paper's experiment with its network (Sec. IV-A, Table II), scaled down.

Net 1 learns from easy pictures, Net 2 goes on from it with inter, Net 3 from that with hard ones; a control learns from
hard ones alone, with as many iterations as all three together. Each is measured on all three validation sets.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.table import Table

from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.output import write_json
from depthmocap.core.settings import check_seed, claim_folder
from depthmocap.errors import InputError
from depthmocap.report.charts import loss_curves
from depthmocap.report.page import ReportFigure, ReportSection, ReportTable, write_report
from depthmocap.synth.sample import Subset
from depthmocap.train.batches import WindowSource
from depthmocap.train.checkpoints import load_weights
from depthmocap.train.classifier_settings import ClassifierTraining, Optimiser
from depthmocap.train.networks import NETWORKS
from depthmocap.train.train_classifier import evaluate_windows, train_classifier
from depthmocap.train.training_run import check_device

_SUBSETS: tuple[Subset, ...] = ("easy", "inter", "hard")
#: Pictures an iteration.
PAPER_BATCH = 8
_CONTROL = "from scratch"
#: Learning rates that stay as they are; the paper tells none.
_RATES: dict[Optimiser, float] = {"sgd": 0.03, "adamw": 3e-4}
#: Validations in the course of a stage.
_POINTS = 20


@dataclasses.dataclass(frozen=True)
class _Stage:
    """A network of the experiment: what it learns from, from which network it starts, and of each validation set the
    accuracies (%) before and after that the paper reports."""

    name: str
    subset: Subset
    iterations: int
    start: str | None
    paper: dict[str, tuple[int | None, int | None]]


STAGES = (
    _Stage("net 1", "easy", 250_000, None, {"easy": (0, 87)}),
    _Stage("net 2", "inter", 150_000, "net 1", {"easy": (87, 87), "inter": (78, 82)}),
    _Stage("net 3", "hard", 88_000, "net 2", {"easy": (87, 85), "inter": (82, 79), "hard": (73, 81)}),
    # "did not go above 50 %", with other budgets
    _Stage(_CONTROL, "hard", 250_000 + 150_000 + 88_000, None, {"hard": (None, 50)}),
)


@dataclasses.dataclass(frozen=True)
class CurriculumTraining:
    """The paper's curriculum against training on hard pictures alone. Run again, it goes on where it was stopped.

    Attributes:
        out: folder for table.json, report.html and a folder of every optimiser's networks.
        scale: iterations as a share of the paper's 250, 150 and 88 thousand, 8 pictures each.
        data: "synth" makes exact pictures of UBC3V's sensor on the fly; a folder is read as a UBC3V root.
        postures: folder of motion capture clips, or a pool made of them; without it the packaged prior.
        optimisers: sgd, as in the paper (with momentum 0.9 and no batch norm), adamw, or both.
        learning_rate: of all of them; by default 0.03 of SGD and 3e-4 of AdamW. It stays as it is.
        control: also train on hard pictures from scratch.
        valid_images: pictures of each validation set.
        workers: processes that make pictures; 0 makes them between steps.
        bfloat16: multiply in half precision; by default where the device has instructions for it.
    """

    out: Path
    scale: float = 0.005
    data: str = "synth"
    postures: Path | None = None
    optimisers: tuple[Optimiser, ...] = ("sgd",)
    learning_rate: float | None = None
    control: bool = True
    valid_images: int = 300
    seed: int = 0
    workers: int = 1
    device: str = "cpu"
    bfloat16: bool | None = None

    @property
    def stages(self) -> tuple[_Stage, ...]:
        """The networks to train, in order."""
        return STAGES if self.control else STAGES[:-1]

    def iterations(self, stage: _Stage) -> int:
        """The scaled number of a stage's iterations."""
        return max(round(stage.iterations * self.scale), 1)

    def source(self, subset: Subset) -> WindowSource:
        """Pictures of a subset."""
        return WindowSource("paper", self.data, subset, self.postures, self.seed)

    def training(self, optimiser: Optimiser, stage: _Stage) -> ClassifierTraining:
        """The run of a stage."""
        images = self.iterations(stage) * PAPER_BATCH
        return ClassifierTraining(
            self._folder(optimiser, stage.name), data=self.data, postures=self.postures, subset=stage.subset,
            network="paper", images=images, batch=PAPER_BATCH, optimiser=optimiser, schedule="constant", average=0.0,
            learning_rate=_RATES[optimiser] if self.learning_rate is None else self.learning_rate,
            start=None if stage.start is None else self._folder(optimiser, stage.start) / "classifier.safetensors",
            seed=self.seed, workers=self.workers, device=self.device, bfloat16=self.bfloat16,
            valid_every=max(images // _POINTS, PAPER_BATCH), valid_images=min(self.valid_images, 100),
        )  # fmt: skip

    def _folder(self, optimiser: Optimiser, name: str) -> Path:
        return self.out / optimiser / name.replace(" ", "_")


@locks_outputs(folder="out")
def train_curriculum(settings: CurriculumTraining, console: Console | None = None) -> dict[str, Any]:
    """Train and measure what is not there yet; returns what table.json holds.

    Raises:
        InputError: settings that cannot be, data that cannot be read, or a folder that holds another experiment.
    """
    check_seed(settings.seed)
    if not 0 < settings.scale <= 1 or settings.valid_images < 1 or not settings.optimisers:
        raise InputError(
            "--scale must be above 0 and at most 1, --valid-images at least 1, --optimisers one or two; got "
            f"{settings.scale}, {settings.valid_images}, {settings.optimisers}"
        )
    console = console or Terminal(stderr=True)
    # Where and how fast it runs, and what is added to it, make no other experiment.
    claim_folder(settings.out, settings, "a curriculum", ("out", "workers", "device", "optimisers", "control"))
    table: dict[str, Any] = {
        "scale": settings.scale, "pictures_an_iteration": PAPER_BATCH, "measure": "mean class accuracy, and of pixels",
        "paper": {stage.name: stage.paper for stage in STAGES}, "optimisers": {},
    }  # fmt: skip
    for optimiser in settings.optimisers:
        measured: dict[str, Any] = {}
        untrained = _measure(settings, optimiser, None)
        for stage in settings.stages:
            training = settings.training(optimiser, stage)
            if not (training.out / "classifier.onnx").exists():
                console.print(f"{optimiser}, {stage.name}: {settings.iterations(stage):,} iterations on {stage.subset}")
                train_classifier(training)
            measured[stage.name] = {
                "trained_on": stage.subset, "iterations": settings.iterations(stage),
                "iterations_in_the_paper": stage.iterations if stage.name != _CONTROL else None,
                "learning_rate": training.learning_rate,
                "start": untrained if stage.start is None else measured[stage.start]["end"],
                "end": _measure(settings, optimiser, stage),
            }  # fmt: skip
        table["optimisers"][optimiser] = measured
        write_json(settings.out / "table.json", table)
    _print(table, console)
    _write_report(settings, table)
    return table


def _measure(settings: CurriculumTraining, optimiser: Optimiser, stage: _Stage | None) -> dict[str, dict[str, float]]:
    """Accuracies of a stage's network on the validation sets, None for the network before training; kept in a file."""
    name = "untrained" if stage is None else stage.name
    folder = settings.out / optimiser
    path = folder / f"{name.replace(' ', '_')}.json"
    if path.exists():
        return json.loads(path.read_text(encoding="utf-8"))
    torch.manual_seed(settings.seed)  # as training does before it makes the network
    network = NETWORKS["paper"]()
    if stage is not None:
        load_weights(network, settings.training(optimiser, stage).out / "classifier.safetensors")
    check_device(settings.device)
    network.to(settings.device)
    accuracies = {}
    for subset in _SUBSETS:
        accuracy, _ = evaluate_windows(network, settings.source(subset).valid(settings.valid_images), settings.device)
        accuracies[subset] = {"class_accuracy": accuracy.class_accuracy, "pixel_accuracy": accuracy.pixel_accuracy}
    write_json(path, accuracies)
    return accuracies


def _cell(start: int | float | None, end: int | float | None) -> str:
    return " → ".join("–" if share is None else f"{share:.0f}" for share in (start, end))


def _rows(measured: dict[str, Any]) -> list[list[str]]:
    """Of every network and set: mean class accuracy (%) before → after, and the paper's."""
    rows = []
    for stage in STAGES:
        if stage.name not in measured:
            continue
        row = [f"{stage.name} ({stage.subset})", f"{measured[stage.name]['iterations']:,}"]
        for subset in _SUBSETS:
            start, end = (measured[stage.name][when][subset]["class_accuracy"] * 100 for when in ("start", "end"))
            row += [_cell(start, end), _cell(*stage.paper[subset]) if subset in stage.paper else "–"]
        rows.append(row)
    return rows


_HEADER = ("network", "steps", *(text for subset in _SUBSETS for text in (subset, "paper")))


def _verdict(measured: dict[str, Any]) -> str:
    """Whether the curriculum's advantage appears."""
    if _CONTROL not in measured:
        return ""
    curriculum, control = (measured[name]["end"]["hard"]["class_accuracy"] * 100 for name in (STAGES[2].name, _CONTROL))
    return (
        f"On hard: {curriculum:.1f} % by the curriculum, {control:.1f} % from scratch with the same iterations, "
        f"{curriculum - control:+.1f} points (paper: 81 and at most 50)."
    )


def _caption(table: dict[str, Any]) -> str:
    return (
        f"Mean class accuracy (%) on the validation sets, before → after. Iterations are {table['scale']:g} of the "
        "paper's, so that its values are no expectation."
    )


def _print(table: dict[str, Any], console: Console) -> None:
    for optimiser, measured in table["optimisers"].items():
        printed = Table(*_HEADER, title=f"{optimiser}. {_caption(table)}")
        for row in _rows(measured):
            printed.add_row(*row)
        console.print(printed)
        console.print(_verdict(measured))


def _write_report(settings: CurriculumTraining, table: dict[str, Any]) -> None:
    sections = []
    for optimiser, measured in table["optimisers"].items():
        rates = {network["learning_rate"] for network in measured.values()}
        text = f"{_caption(table)} Learning rate {', '.join(f'{rate:g}' for rate in rates)}, held."
        figures = []
        for names, title in (
            ([stage.name for stage in STAGES[:3]], "The curriculum: every network against its own pictures."),
            ([_CONTROL], "From scratch on hard."),
        ):
            history = _history(settings, optimiser, [name for name in names if name in measured])
            if history:
                figures.append(ReportFigure(loss_curves(history), title, chart=True))
        sections.append(
            ReportSection(
                f"With {optimiser}",
                tuple(network for network in (text, _verdict(measured)) if network),
                (ReportTable(_HEADER, _rows(measured)),),
                figures,
            )
        )
    write_report(settings.out / "report.html", "The paper's curriculum", sections)


def _history(settings: CurriculumTraining, optimiser: Optimiser, names: list[str]) -> list[dict[str, int | float]]:
    """The runs' histories behind one another, the values of each under its name."""
    rows, before = [], 0
    for stage in (stage for stage in STAGES if stage.name in names):
        path = settings.training(optimiser, stage).out / "history.jsonl"
        run_rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []
        rows += [
            {
                "step": (before + row["step"]) // PAPER_BATCH, f"{stage.name} loss": row["loss"],
                f"{stage.name} class accuracy": row["valid_class_accuracy"],
            }
            for row in run_rows
        ]  # fmt: skip
        before += settings.iterations(stage) * PAPER_BATCH
    return rows
