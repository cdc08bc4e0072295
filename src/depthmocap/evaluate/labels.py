"""``depthmocap evaluate labels``: pictures and numbers of a body-part classifier."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from depthmocap.body.regions import REGION_COUNT, REGION_NAMES, UNLABELLED
from depthmocap.classify.classifier import Classifier
from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.network_devices import NetworkSettings, networks_on
from depthmocap.core.output import atomic_write, check_outputs, write_file
from depthmocap.core.settings import check_seed
from depthmocap.errors import InputError, missing_extra
from depthmocap.evaluate.evaluation_report import JsonOutput
from depthmocap.evaluate.label_charts import LabelExample, label_grid, region_bars, reliability_diagram
from depthmocap.evaluate.label_measures import LEAST_PIXELS, PARTS, BorderAccuracy, Calibration, PartSwaps
from depthmocap.frames import FrameSet, View
from depthmocap.report.charts import confusion_picture
from depthmocap.report.metrics import PixelAccuracy
from depthmocap.report.page import ReportFigure, ReportSection, ReportTable, write_report


@dataclasses.dataclass(frozen=True)
class LabelsEvaluation(NetworkSettings, JsonOutput):
    """Confusion matrix, accuracy of every region, swapped limbs and calibration of a classifier's labels.

    Attributes:
        out: folder for report.html and its pictures.
        data: root of UBC3V or of a set of its layout; without it one of the project's own test sets is made.
        subset: and split: of the data.
        split: which part of the data.
        bench: name of the test set that is made.
        postures: folder of motion capture clips, or a pool made of them, for it; without it the packaged prior.
        samples: postures at most.
        views: cameras a posture of a set that is made.
        weights: a classifier.onnx of your own, the paper's network included.
        pictures: views shown as depth, truth and prediction.
        workers: processes that make pictures.
    """

    out: Path
    data: Path | None = None
    subset: str = "hard-pose"
    split: str = "test"
    bench: str = "seen"
    postures: Path | None = None
    samples: int = 200
    views: int = 3
    seed: int = 1
    weights: Path | None = None
    pictures: int = 6
    workers: int = 1

    def __post_init__(self) -> None:
        check_outputs({"--json": self.json}, {"what --weights names": self.weights})


@dataclasses.dataclass(eq=False)
class LabelQuality:
    """What is counted over views, in the network's windows, on the person's pixels whose region is known."""

    accuracy: PixelAccuracy = dataclasses.field(default_factory=PixelAccuracy)
    swaps: PartSwaps = dataclasses.field(default_factory=PartSwaps)
    borders: BorderAccuracy = dataclasses.field(default_factory=BorderAccuracy)
    calibration: Calibration = dataclasses.field(default_factory=Calibration)
    #: Views whose mask holds nobody.
    empty: int = 0

    def add(self, classifier: Classifier, views: list[View]) -> list[LabelExample]:
        """Label and count views with masks and labels; returns them for pictures."""
        masks = [view.mask for view in views if view.mask is not None]
        examples: list[LabelExample] = []
        for view, mask, result in zip(views, masks, classifier.label_masks(views, masks), strict=True):
            assert view.labels is not None
            if result.window is None or result.window_prediction is None:
                self.empty += 1
                continue
            examples.append((view.depth_m, mask, view.labels, result.prediction.labels))
            truth = result.window.labels_from_image(view.labels, UNLABELLED)
            # All of the person counts, also what the window leaves out as stray: it goes without a label.
            inside = result.window.labels_from_image((mask & (view.depth_m > 0)).astype(np.uint8)) > 0
            inside &= (truth >= 1) & (truth <= REGION_COUNT)
            true, predicted = truth[inside], result.window_prediction.labels[inside]
            self.accuracy.add(true, predicted)
            self.swaps.add(true, predicted)
            self.borders.add(truth, result.window_prediction.labels, inside)
            self.calibration.add(result.window_prediction.confidence[inside], true == predicted)
        return examples

    def numbers(self) -> dict[str, Any]:
        """All of it as JSON can hold it; shares are 0–1."""
        accuracy, swaps = self.accuracy, self.swaps
        regions = zip(REGION_NAMES[1:], accuracy.per_class_accuracy, strict=True)
        return {
            "views": swaps.views, "views_without_a_person": self.empty, "pixels": accuracy.pixels,
            "pixel_accuracy": accuracy.pixel_accuracy, "class_accuracy": accuracy.class_accuracy,
            "per_class_accuracy": {name: None if np.isnan(share) else float(share) for name, share in regions},
            "side_swap": accuracy.side_swap,
            "swapped_per_1000_views": swaps.per_1000_views,
            "swaps": {
                part: {"shown": int(shown), "swapped": int(swapped)}
                for part, shown, swapped in zip(PARTS, swaps.shown, swaps.swapped, strict=True)
            },
            "borders": [
                {"pixels_from_a_border": name, "share": share, "right": right}
                for name, share, right in self.borders.rows
            ],
            "calibration_error": self.calibration.error,
            "calibration": [
                {"pixels": n, "probability": probability, "right": right}
                for n, probability, right in self.calibration.rows
            ],
            "confusion": accuracy.confusion.tolist(),
        }  # fmt: skip


def _frames(settings: LabelsEvaluation) -> Iterator[FrameSet]:
    if settings.data is not None:
        from depthmocap.datasets.ubc3v import iterate

        yield from iterate(settings.data, settings.subset, settings.split, settings.samples)
        return
    try:
        from depthmocap.synth.sample import BENCH
        from depthmocap.synth.writing.stream import stream
    except ModuleNotFoundError as error:
        raise missing_extra(error.name or "anny", "train") from None
    if settings.bench not in BENCH:
        raise InputError(f"--bench is one of {', '.join(map(repr, BENCH))}, got {settings.bench!r}")
    recipe = dataclasses.replace(BENCH[settings.bench], postures=settings.postures, views=settings.views)
    for index, sample in stream(recipe, settings.seed, 0, settings.samples, settings.workers):
        yield FrameSet(index, sample.views, sample.joints)


@locks_outputs(folder="out", files=("json",))
def evaluate_labels(settings: LabelsEvaluation, console: Console | None = None) -> dict[str, Any]:
    """Label the data, write the report and return its numbers.

    Raises:
        InputError: data or weights that cannot be read, or nothing labelled in them.
    """
    check_seed(settings.seed)
    if settings.samples < 1 or settings.pictures < 1:
        raise InputError(f"--samples and --pictures must be at least 1, got {settings.samples}, {settings.pictures}")
    console = console or Terminal(stderr=True)
    with networks_on(settings.device):
        classifier = Classifier(settings.weights)
    quality, shown = LabelQuality(), []
    with Progress(console=console) as progress:
        for frame in progress.track(_frames(settings), settings.samples, description="labels"):
            views = [view for view in frame.views if view.mask is not None and view.labels is not None]
            # One view a sample, another camera each time.
            examples = quality.add(classifier, views)
            if examples and len(shown) < settings.pictures:
                shown.append(examples[len(shown) % len(examples)])
    if not quality.swaps.views:
        raise InputError(f"{settings.data or settings.bench}: no view has a labelled person")
    data = f"bench, {settings.bench}" if settings.data is None else f"{settings.subset}/{settings.split}"
    numbers = {
        "data": data if settings.data is None else str(settings.data / data), "seed": settings.seed,
        "network": classifier.network, "weights": str(classifier.path), **quality.numbers(),
    }  # fmt: skip
    _write(settings.out, data, quality, numbers, shown)
    settings.write_numbers(numbers)
    table = Table(title=f"{data}: {numbers['views']} views, network {classifier.network}")
    table.add_column("measure")
    table.add_column("value", justify="right")
    for name, value in _summary(numbers):
        table.add_row(name, value)
    console.print(table)
    console.print(f"{settings.out / 'report.html'}", style="bold")
    return numbers


def _summary(numbers: dict[str, Any]) -> list[tuple[str, str]]:
    return [
        ("pixel accuracy", f"{numbers['pixel_accuracy']:.1%}"),
        ("mean class accuracy", f"{numbers['class_accuracy']:.1%}"),
        ("pixels on the other side", f"{numbers['side_swap']:.2%}"),
        ("views with a swapped limb or torso, of 1,000", f"{numbers['swapped_per_1000_views']:.1f}"),
        ("calibration error (points)", f"{numbers['calibration_error'] * 100:.1f}"),
    ]


def _write(out: Path, data: str, quality: LabelQuality, numbers: dict[str, Any], shown: list[LabelExample]) -> None:
    charts = {
        "confusion": (confusion_picture(quality.accuracy.confusion), "Predicted regions of each true region."),
        "regions": (region_bars(quality.accuracy.per_class_accuracy), "Pixels of each region labelled right."),
        "calibration": (reliability_diagram(quality.calibration), "How far probabilities can be believed."),
    }
    for name in (*charts, "examples", "report"):  # of an earlier time, should this one be cut off
        (out / f"{name}.{'html' if name == 'report' else 'png'}").unlink(missing_ok=True)
    for name, (chart, _) in charts.items():
        write_file(out / f"{name}.png", chart)
    grid = label_grid(shown)
    _write_png(out / "examples.png", grid)
    swaps = [
        (part, swap["shown"], swap["swapped"], 1000 * swap["swapped"] / max(swap["shown"], 1))
        for part, swap in numbers["swaps"].items()
    ]
    borders = [(band["pixels_from_a_border"], 100 * band["share"], 100 * band["right"]) for band in numbers["borders"]]
    sections = [
        ReportSection(
            "Numbers",
            (f"Data: {data}, {numbers['views']} views. Network: {numbers['network']}, `{numbers['weights']}`. "
             "Counted on the person's labelled pixels in the network's window.",),
            (ReportTable(("measure", "value"), _summary(numbers)),),
        ),
        ReportSection("Examples", ("Depth, true regions, predicted regions.",), figures=(ReportFigure(grid),)),
        *(
            ReportSection(heading, figures=(ReportFigure(*charts[name], chart=True),))
            for heading, name in (("Confusion", "confusion"), ("Regions", "regions"), ("Calibration", "calibration"))
        ),
        ReportSection(
            "Borders",
            ("Pixels by their distance from the nearest border between two true regions, in pixels of the window.",),
            (ReportTable(("distance", "of all pixels (%)", "labelled right (%)"), borders, decimals=1),),
        ),
        ReportSection(
            "Swaps",
            (f"A part of at least {LEAST_PIXELS} labelled pixels in a window is swapped where more than half of them "
             "are given regions of the opposite part.",),
            (ReportTable(("part", "views", "swapped", "of 1,000"), swaps, decimals=1),),
        ),
    ]  # fmt: skip
    write_report(out / "report.html", f"Labels of {data}", sections)


def _write_png(path: Path, picture: np.ndarray) -> None:
    from PIL import Image

    with atomic_write(path) as unfinished:
        Image.fromarray(picture).save(unfinished, optimize=True)
