"""``depthmocap train ablations``: what each ingredient of our classifier's training is worth, on an equal budget."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any, Literal, get_args

from rich.console import Console
from rich.table import Table

from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.output import write_json
from depthmocap.core.settings import check_seed, claim_folder
from depthmocap.errors import InputError
from depthmocap.report.page import ReportSection, ReportTable, write_report
from depthmocap.synth.sample import Subset
from depthmocap.train.batches import Ingredient, WindowSource
from depthmocap.train.checkpoints import load_weights
from depthmocap.train.classifier_settings import ClassifierTraining
from depthmocap.train.networks import FastNet
from depthmocap.train.train_classifier import (
    evaluate_windows,
    make_network,
    train_classifier,
)

#: The full training; without one ingredient; and by a curriculum, a third of the budget on each subset.
Ablation = Literal["full", Ingredient, "curriculum"]
ABLATIONS: tuple[Ablation, ...] = ("full", *get_args(Ingredient), "curriculum")
_NAMES: dict[Ablation, str] = {
    "full": "everything", "norm": "no batch normalisation", "width": "half the channels", "clothes": "bare people",
    "errors": "exact depth", "spoiling": "nothing hides or clings, perfect masks", "mirror": "no mirror images",
    "variation": "postures as recorded", "resolution": "half the resolution",
    "curriculum": "curriculum: easy, inter, open",
}  # fmt: skip
_CURRICULUM: tuple[Subset, ...] = ("easy", "inter", "open")


@dataclasses.dataclass(frozen=True)
class AblationTraining:
    """Our classifier trained without one ingredient after the other. Run again, it goes on where it was stopped.

    Attributes:
        out: folder for table.json, report.html and a folder of every run.
        images: pictures of every run.
        postures: folder of motion capture clips, or a pool made of them; without it the packaged prior.
        only: which runs to make.
        valid_images: pictures that all are measured on.
        workers: processes that make pictures; 0 makes them between steps.
        bfloat16: multiply in half precision; by default where the device has instructions for it.
    """

    out: Path
    images: int = 10_000
    postures: Path | None = None
    only: tuple[Ablation, ...] = ABLATIONS
    valid_images: int = 320
    seed: int = 0
    workers: int = 1
    device: str = "cpu"
    bfloat16: bool | None = None

    def training(self, ablation: Ablation, stage: int = 0) -> ClassifierTraining:
        """The run of an ablation, or a stage of the curriculum's."""
        curriculum = ablation == "curriculum"
        folder = self.out / ablation
        before = folder / _CURRICULUM[stage - 1] / "classifier.safetensors" if curriculum and stage else None
        return ClassifierTraining(
            folder / _CURRICULUM[stage] if curriculum else folder, postures=self.postures,
            subset=_CURRICULUM[stage] if curriculum else "open",
            images=self.images // len(_CURRICULUM) if curriculum else self.images, average=0.99, start=before,
            seed=self.seed + (stage if curriculum else 0), workers=self.workers, valid_every=self.images + 1,
            valid_images=1, device=self.device, bfloat16=self.bfloat16,
            without=() if ablation in ("full", "curriculum") else (ablation,),
        )  # fmt: skip


@locks_outputs(folder="out")
def train_ablations(settings: AblationTraining, console: Console | None = None) -> dict[str, Any]:
    """Train and measure what is not there yet; returns what table.json holds.

    Raises:
        InputError: settings that cannot be, postures that cannot be read, or a folder that holds other runs.
    """
    check_seed(settings.seed)
    if settings.images < 100 or settings.valid_images < 1 or not settings.only:
        raise InputError(
            "--images must be at least 100, --valid-images at least 1, and --only name a run; got "
            f"{settings.images}, {settings.valid_images}, {settings.only}"
        )
    console = console or Terminal(stderr=True)
    claim_folder(settings.out, settings, "ablations", ("out", "workers", "device", "only"))
    source = WindowSource("fast", "synth", "open", settings.postures, settings.seed)
    valid = source.valid(settings.valid_images)
    table: dict[str, Any] = {"images": settings.images, "valid_images": settings.valid_images, "runs": {}}
    for ablation in ABLATIONS:
        last = settings.training(ablation, len(_CURRICULUM) - 1)
        measured = last.out / "measured.json"
        if ablation in settings.only and not measured.exists():
            for stage in range(len(_CURRICULUM) if ablation == "curriculum" else 1):
                training = settings.training(ablation, stage)
                if not (training.out / "classifier.onnx").exists():
                    console.print(f"{_NAMES[ablation]}: {training.images:,} pictures of {training.subset}")
                    train_classifier(training)
            network = make_network(last)
            assert isinstance(network, FastNet)
            load_weights(network, last.out / "classifier.safetensors")
            run_source = dataclasses.replace(source, without=last.without)
            windows = [run_source.at_resolution(window) for window in valid]
            accuracy, joint_m = evaluate_windows(network.to(settings.device), windows, settings.device)
            row = {
                "pixel_accuracy": accuracy.pixel_accuracy, "class_accuracy": accuracy.class_accuracy,
                "joint_error_cm": joint_m * 100,
            }  # fmt: skip
            write_json(measured, row)
        if measured.exists():
            table["runs"][ablation] = json.loads(measured.read_text(encoding="utf-8"))
            write_json(settings.out / "table.json", table)
    rows = _rows(table["runs"])
    printed = Table(*_HEADER, title=_title(settings))
    for row in rows:
        printed.add_row(*row)
    console.print(printed)
    section = ReportSection(_title(settings), (), (ReportTable(_HEADER, rows),))
    write_report(settings.out / "report.html", "What each ingredient is worth", [section])
    return table


_HEADER = ("training", "pixels", "regions (mean)", "joints of one view")


def _title(settings: AblationTraining) -> str:
    return f"{settings.images:,} pictures each, measured on {settings.valid_images} windows of validation clips"


def _rows(runs: dict[str, dict[str, float]]) -> list[list[str]]:
    """Accuracies (%) and joint errors, with the difference from the full training where there is one."""
    columns = (("pixel_accuracy", 100, " %"), ("class_accuracy", 100, " %"), ("joint_error_cm", 1, " cm"))
    full = runs.get("full")
    rows = []
    for ablation in ABLATIONS:
        if ablation not in runs:
            continue
        cells = []
        for name, scale, unit in columns:
            value = runs[ablation][name] * scale
            off = "" if full is None or ablation == "full" else f" ({value - full[name] * scale:+.1f})"
            cells.append(f"{value:.1f}{unit}{off}")
        rows.append([_NAMES[ablation], *cells])
    return rows
