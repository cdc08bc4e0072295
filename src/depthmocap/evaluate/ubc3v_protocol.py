"""``depthmocap evaluate ubc3v``: the paper's synthetic evaluation (Sec. V-A), with true labels or the network's."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.progress import Progress

from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.datasets.ubc3v import CAMERAS, image_paths, iterate, sections
from depthmocap.errors import InputError
from depthmocap.evaluate.accuracy import AccuracyEvaluation, check_views, measure_accuracy, print_numbers
from depthmocap.evaluate.evaluation_report import FILES, about, write_outputs


@dataclasses.dataclass(frozen=True)
class Ubc3vEvaluation(AccuracyEvaluation):
    """Accuracy of labels and joints on UBC3V, or on a set of the same layout.

    Attributes:
        root: holds hard-pose and its kin.
        views: 1 evaluates every camera alone and averages, 2 every pair, 3 all.
        limit: evaluate the first so many samples only.
    """

    root: tyro.conf.Positional[Path]
    subset: str = "hard-pose"
    split: str = "test"
    views: int = 3
    limit: int | None = None


@locks_outputs(files=FILES)
def evaluate_ubc3v(settings: Ubc3vEvaluation, console: Console | None = None) -> dict[str, Any]:
    """Run the evaluation and return its numbers; samples are independent, nothing is smoothed.

    Raises:
        InputError: when the data or the weights cannot be read, hold no labels, or have fewer cameras than ``views``.
    """
    check_views(settings.views)
    if settings.limit is not None and settings.limit < 1:
        raise InputError(f"--limit must be at least 1, got {settings.limit}")
    console = console or Terminal(stderr=True)
    paths = sections(settings.root, settings.subset, settings.split)
    # Only the folders are counted, so that the error comes at once; without a folder the reader's error says more.
    cameras = max(sum(image_paths(path, name, 0)[0].parent.is_dir() for name in CAMERAS) for path in paths)
    if 0 < cameras < settings.views:
        raise InputError(f"--views must be at most {cameras}, the cameras of {settings.root}, got {settings.views}")
    stages = settings.load()
    problems: list[str] = []
    frames = iterate(settings.root, settings.subset, settings.split, settings.limit, problems=problems)
    with Progress(console=console) as progress:
        title = f"{settings.subset}/{settings.split} ({len(paths)} sections)"
        accuracy = measure_accuracy(progress.track(frames, settings.limit, description=title), settings.views, *stages)
    if accuracy is None:
        raise InputError(f"{settings.root}: no sample of {settings.subset}/{settings.split} has labels and joints")
    numbers = {
        "data": str(settings.root),
        "subset": settings.subset,
        "split": settings.split,
        **accuracy,
        "problems": problems,
    }
    name = f"{settings.subset}/{settings.split}"
    write_outputs(settings, f"UBC3V, {name}", {name: {"about": about(settings), **numbers}}, numbers)
    print_numbers(name, numbers, console)
    return numbers
