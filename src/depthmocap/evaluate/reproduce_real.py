"""The real sets' part of ``depthmocap reproduce``: Table III and the figures of Berkeley MHAD, and labels on EVAL."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray
from rich.console import Console

from depthmocap.body.skeleton import JOINTS
from depthmocap.classify.classifier import Classifier
from depthmocap.datasets.annotated import AnnotatedFrame, AnnotatedSet, PassedOn
from depthmocap.datasets.eval3d import Eval
from depthmocap.datasets.mhad import ACTIONS, MHAD_CORRESPONDENCE, MhadSet
from depthmocap.errors import InputError
from depthmocap.evaluate.evaluation_report import report_sections
from depthmocap.evaluate.mhad_protocol import MhadResults, measure_mhad
from depthmocap.evaluate.reproduce_ubc3v import pose_rows
from depthmocap.geometry import z_up_from
from depthmocap.pose.cloud import LabelledCloud, merge_views
from depthmocap.pose.estimators import load_estimator
from depthmocap.pose.labelled_view import label_people
from depthmocap.report.drawing import cloud_picture, labelled_depth_strip
from depthmocap.report.page import ReportFigure, ReportSection, ReportTable
from depthmocap.text import joined

#: Table III: error (cm), its deviation, share within 10 cm (%), by subjects and by actions.
PAPER_MICHEL = {
    "OpenNI": (5.45, 4.62, 86.3, 5.29, 4.95, 87.3),
    "Michel et al.": (3.93, 2.73, 96.3, 4.18, 3.31, 94.4),
    "the paper": (3.39, 1.12, 96.8, 2.78, 1.5, 98.1),
}
#: Mean joint error (cm) and share within 10 cm (%) over 35 joints (Sec. V-B).
PAPER_MHAD = (5.01, 93.0)
_MICHEL_NOTE = (
    "Neither Michel et al. nor the paper name the joints they compare: ours are a choice (`evaluate mhad "
    "--joint-table`). The deviation is over single joints, and in brackets over the means of frames."
)


@dataclasses.dataclass(frozen=True)
class RealPart:
    """What is read and shown.

    Attributes:
        every: read every ``every``-th frame only.
        weights: of the network; None for the packaged ones.
        estimator: of the joints.
        pictures: columns of the figures.
    """

    root: Path
    every: int
    weights: Path | None
    estimator: str
    pictures: int


class _FirstFrames(PassedOn):
    """A set that passes the frames of another set on and keeps the first frame of each action with its index."""

    def __init__(self, source: MhadSet, count: int) -> None:
        super().__init__(source)
        self._count = count
        self.frames: dict[str, tuple[int, AnnotatedFrame]] = {}

    def __iter__(self) -> Iterator[AnnotatedFrame]:
        for i, frame in enumerate(self._source):
            if len(self.frames) < self._count:
                self.frames.setdefault(frame.action, (i, frame))
            yield frame


def reproduce_mhad(part: RealPart, console: Console) -> tuple[list[ReportSection], dict[str, Any]]:
    """Sections of the page, and the numbers by protocol.

    Raises:
        InputError: see ``measure_mhad``.
    """
    source = _FirstFrames(MhadSet(part.root, every=part.every), part.pictures)
    classifier = Classifier(part.weights)
    results = measure_mhad(source, load_estimator(part.estimator), classifier, console=console)
    numbers = results.numbers
    main = "35 joints"
    rows = pose_rows(f"{main}, leave one subject out", PAPER_MHAD, numbers[main])
    for name, result in numbers.items():
        if name != main and not name.startswith("Michel"):
            rows += pose_rows(name, (None, None), result)
    sections = [
        ReportSection("Table III: Berkeley MHAD, Michel's joints", (_MICHEL_NOTE,), (_michel_table(numbers),)),
        ReportSection(
            "Berkeley MHAD",
            tables=(ReportTable(("", "the paper", "ours"), rows),),
            figures=_mhad_figures(source, results, classifier),
        ),
    ]
    measured = report_sections({main: numbers[main]})
    sections += [dataclasses.replace(result, heading=f"MHAD: {result.heading}") for result in measured]
    return sections, numbers


def _michel_table(numbers: dict[str, Any]) -> ReportTable:
    measures = ("mean (cm)", "std", "acc (%)")
    header = ["", *(f"{words}: {what}" for words in ("subjects", "actions") for what in measures)]
    rows = [[name, *(f"{value:g}" for value in values)] for name, values in PAPER_MICHEL.items()]
    ours = ["ours"]
    for words in ("subjects", "actions"):
        result = numbers.get(f"Michel's joints, {words}")
        ours += ["–"] * 3 if result is None else [
            f"{result['mean_joint_error_cm']:.2f}",
            f"{result['deviation_cm']:.2f} ({result['deviation_of_frames_cm']:.2f})",
            f"{result['within_10cm'] * 100:.1f}",
        ]  # fmt: skip
    return ReportTable(header, [*rows, ours])


def _mhad_figures(source: _FirstFrames, results: MhadResults, classifier: Classifier) -> list[ReportFigure]:
    """Labels of the kept frames, and the true skeleton in blue beside the estimate in red, as the paper draws them."""
    z_up = z_up_from(source.up).T
    set_joint = {ours: joint for joint, ours in MHAD_CORRESPONDENCE.items()}
    columns = [results.frames.joints.index(set_joint[joint]) for joint in JOINTS]
    figures = []
    for action, (i, frame) in source.frames.items():
        strip, cloud = _labelled(frame, classifier)
        words = f"{frame.subject}, {ACTIONS.get(action, action)}"
        figures.append(ReportFigure(strip, f"{words}: depth, and the network's regions."))
        picture = cloud_picture(
            cloud.points_world @ z_up.astype(np.float32), cloud.labels, results.estimates[i][columns],
            results.frames.truths[i][columns],
        )  # fmt: skip
        figures.append(ReportFigure(picture, f"{words}: truth blue, estimate red."))
    return figures


def _labelled(frame: AnnotatedFrame, classifier: Classifier) -> tuple[UInt8[ndarray, "h w 3"], LabelledCloud]:
    labelled = label_people(frame.views, classifier)
    return labelled_depth_strip(frame.views, [view.labels for view in labelled]), merge_views(labelled)


def reproduce_eval(part: RealPart, console: Console) -> tuple[list[ReportSection], dict[str, Any]]:
    """The first frames of some sequences with the network's labels.

    Raises:
        InputError: when no frame can be shown.
    """
    source: AnnotatedSet = Eval(part.root)
    classifier = Classifier(part.weights)
    figures: dict[tuple[str, str], ReportFigure] = {}
    for frame in source:
        key = (frame.subject, frame.action)
        if key not in figures and frame.views:
            strip, _ = _labelled(frame, classifier)
            figures[key] = ReportFigure(strip, f"{', '.join(key)}: depth, and the network's regions.")
        if len(figures) == part.pictures:
            break
    if not figures:
        raise InputError(f"{part.root}: no frame can be shown: {joined(source.problems)}")
    console.print(f"EVAL: {len(figures)} sequences shown")
    words = "The paper shows labels only, and gives no numbers; `evaluate eval` measures joints."
    return [ReportSection("EVAL", (words,), figures=tuple(figures.values()))], {"sequences": len(figures)}
