"""UBC3V's part of ``depthmocap reproduce``: Table II, and labels and joints on the hard-pose test set."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress

from depthmocap.classify.classifier import Classifier
from depthmocap.datasets.ubc3v import iterate
from depthmocap.errors import InputError
from depthmocap.evaluate.accuracy import Labels, measure_accuracy
from depthmocap.evaluate.evaluation_report import report_sections
from depthmocap.evaluate.label_charts import LabelExample, label_grid
from depthmocap.evaluate.labels import LabelQuality
from depthmocap.pose.estimators import load_estimator
from depthmocap.report.page import Cell, ReportFigure, ReportSection, ReportTable

SUBSETS = ("easy", "inter", "hard")
#: Table II: pixels labelled right (%) on the validation sets, at the start and the end of each network's training.
PAPER_LABELS: dict[int, dict[str, tuple[float, float]]] = {
    1: {"easy": (0.0, 87.0)},
    2: {"easy": (87.0, 87.0), "inter": (78.0, 82.0)},
    3: {"easy": (87.0, 85.0), "inter": (82.0, 79.0), "hard": (73.0, 81.0)},
}
#: Share of the test set's pixels that Net 3 labels right (%); mean joint error (cm) and share within 10 cm (%) with
#: true labels and with Net 3's (Sec. V-A).
PAPER_TEST_PIXELS = 80.6
PAPER_TRUE, PAPER_NETWORK = (2.44, 99.1), (5.64, 88.7)


@dataclasses.dataclass(frozen=True)
class Ubc3vPart:
    """What is read and shown.

    Attributes:
        nets: weights by network (1–3), None where not given.
        estimator: of the joints.
        limit: most samples of each part.
        pictures: views in the figure.
    """

    root: Path
    nets: Mapping[int, Path | None]
    estimator: str
    limit: int | None
    pictures: int


def reproduce_ubc3v(part: Ubc3vPart, console: Console) -> tuple[list[ReportSection], dict[str, Any]]:
    """Sections of the page, and all numbers. What is missing of one table does not keep the other from being made.

    Raises:
        InputError: when neither table can be made.
    """
    shares, missing = _label_shares(part, console)
    table = {f"net {net}, {subset}-pose": share for (net, subset), share in shares.items()}
    sections = [ReportSection("Table II: the curriculum's networks", missing, (_label_table(shares),))]
    numbers: dict[str, Any] = {"table_2": table, "missing": missing}
    try:
        more, results = _test_set(part, console)
    except InputError as error:
        if not shares:
            raise
        return [*sections, ReportSection("UBC3V, hard-pose test", (str(error),))], numbers
    return sections + more, numbers | results


def _test_set(part: Ubc3vPart, console: Console) -> tuple[list[ReportSection], dict[str, Any]]:
    classifier = Classifier(part.nets[3])
    labels, examples = label_quality(part, "hard", "test", classifier, console, part.pictures)
    poses: dict[str, Any] = {}
    kinds: dict[Labels, str] = {"true": "true labels", "network": "the network's labels"}
    for kind, words in kinds.items():
        frames = iterate(part.root, "hard-pose", "test", part.limit)
        with Progress(console=console) as progress:
            tracked = progress.track(frames, part.limit, description=f"joints, {words}")
            network = classifier if kind == "network" else None
            result = measure_accuracy(tracked, 3, load_estimator(part.estimator, kind), network)
        if result is None:
            raise InputError(f"{part.root}: no sample of hard-pose/test has labels and joints")
        poses[words] = result
    rows = [
        ["pixels labelled right (%); the paper: Net 3", PAPER_TEST_PIXELS, labels.accuracy.pixel_accuracy * 100],
        *pose_rows("true labels", PAPER_TRUE, poses["true labels"]),
        *pose_rows("the network's labels; the paper: Net 3", PAPER_NETWORK, poses["the network's labels"]),
    ]
    grid = ReportFigure(label_grid(examples), "Depth, true regions, and the network's.")
    table = ReportTable(("", "the paper", "ours"), rows)
    sections = [
        ReportSection("UBC3V, hard-pose test", tables=(table,), figures=(grid,)),
        *(dataclasses.replace(section, heading=f"UBC3V: {section.heading}") for section in report_sections(poses)),
    ]
    return sections, {"test_pixel_accuracy": labels.accuracy.pixel_accuracy, "joints": poses}


def pose_rows(words: str, paper: tuple[float | None, float | None], ours: Mapping[str, Any]) -> list[list[Cell]]:
    """Mean error and share within 10 cm, the paper's and ours."""
    return [
        [f"mean joint error (cm), {words}", paper[0], ours["mean_joint_error_cm"]],
        [f"joints within 10 cm (%), {words}", paper[1], ours["within_10cm"] * 100],
    ]


def _label_shares(part: Ubc3vPart, console: Console) -> tuple[dict[tuple[int, str], float], list[str]]:
    """Share of pixels labelled right by network and validation set, and what is missing for Table II."""
    shares: dict[tuple[int, str], float] = {}
    missing = []
    for net, path in part.nets.items():
        if path is None:
            missing.append(f"Net {net} was not given (--net{net}): our row of it is left out.")
            continue
        classifier = Classifier(path)
        # Where the next network starts is where this one ends.
        for subset in dict.fromkeys((*PAPER_LABELS[net], *PAPER_LABELS.get(net + 1, {}))):
            try:
                quality, _ = label_quality(part, subset, "valid", classifier, console)
                shares[net, subset] = quality.accuracy.pixel_accuracy
            except InputError as error:
                missing.append(f"Net {net} on {subset}-pose: {error}")
    return shares, missing


def label_quality(
    part: Ubc3vPart,
    subset: str,
    split: str,
    classifier: Classifier,
    console: Console,
    pictures: int = 0,
) -> tuple[LabelQuality, list[LabelExample]]:
    """How well a network labels a part of UBC3V, and some views of it.

    Raises:
        InputError: when the part is not there, or no view of it has labels.
    """
    quality, examples = LabelQuality(), []
    frames = iterate(part.root, f"{subset}-pose", split, part.limit)
    with Progress(console=console) as progress:
        for frame in progress.track(frames, part.limit, description=f"labels, {subset}-pose {split}"):
            views = [view for view in frame.views if view.mask is not None and view.labels is not None]
            labelled = quality.add(classifier, views)
            if labelled and len(examples) < pictures:
                examples.append(labelled[len(examples) % len(labelled)])
    if not quality.accuracy.pixels:
        raise InputError(f"{part.root}: no view of {subset}-pose/{split} has labels")
    return quality, examples


def _label_table(shares: dict[tuple[int, str], float]) -> ReportTable:
    header = ["", *(f"{subset} {moment}" for subset in SUBSETS for moment in ("start", "end"))]
    rows = []
    for net, paper in PAPER_LABELS.items():
        rows.append([f"Net {net}, the paper", *(x for s in SUBSETS for x in paper.get(s, (None, None)))])
        if not any((net, subset) in shares for subset in SUBSETS):
            continue
        ours: list[str | float | None] = [f"Net {net}, ours"]
        for subset in SUBSETS:
            pair = (shares.get((net - 1, subset)), shares.get((net, subset))) if subset in paper else (None, None)
            ours += [None if share is None else share * 100 for share in pair]
        rows.append(ours)
    caption = "Pixels labelled right (%) on the validation sets, at the start and the end of each network's training."
    return ReportTable(header, rows, caption, decimals=1)
