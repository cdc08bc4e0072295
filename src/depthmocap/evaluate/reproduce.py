"""``depthmocap reproduce``: the paper's tables II and III and its result figures, from whichever of its sets are there,
with the paper's numbers beside ours."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console

from depthmocap.classify.classifier import Classifier
from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.network_devices import NetworkSettings, networks_on
from depthmocap.core.output import write_json
from depthmocap.core.settings import plain_settings
from depthmocap.errors import InputError
from depthmocap.evaluate.reproduce_real import RealPart, reproduce_eval, reproduce_mhad
from depthmocap.evaluate.reproduce_ubc3v import Ubc3vPart, reproduce_ubc3v
from depthmocap.report.page import ReportSection, write_report
from depthmocap.text import joined

Part = Callable[[Console], tuple[list[ReportSection], dict[str, Any]]]


@dataclasses.dataclass(frozen=True)
class Reproduction(NetworkSettings):
    """The paper's tables and figures from its data sets, as one page.

    Attributes:
        out: folder for report.html and numbers.json.
        ubc3v: root of UBC3V: Table II and the figures of labels and joints on synthetic data.
        mhad: folder of Berkeley MHAD: Table III and the figures of labels and joints on real data.
        eval: folder of EVAL: the figure of labels.
        net1: a classifier.onnx trained on easy-pose, as ``train curriculum`` makes it; without it Table II lacks its
            rows.
        net2: likewise, then trained on inter-pose.
        net3: likewise, then trained on hard-pose. All that is not Table II is made with it, or else with the packaged
            network.
        estimator: of the joints: ridge (the paper's), votes, or a file that ``train pose`` wrote.
        every: of MHAD, read every so-many-th frame only.
        limit: of each part of UBC3V, read the first so many samples only.
        pictures: columns of each figure of labels and skeletons.
    """

    out: Path
    ubc3v: Path | None = None
    mhad: Path | None = None
    eval: Path | None = None
    net1: Path | None = None
    net2: Path | None = None
    net3: Path | None = None
    estimator: str = "ridge"
    every: int = 1
    limit: int | None = None
    pictures: int = 4


@locks_outputs(folder="out")
def reproduce(settings: Reproduction, console: Console | None = None) -> dict[str, Any]:
    """Make the page; returns the numbers by data set. A set that cannot be read is left out, and the page says why.

    Raises:
        InputError: without a data set, or when none of them can be read, or the weights cannot.
    """
    with networks_on(settings.device):
        return _reproduce(settings, console or Terminal(stderr=True))


def _reproduce(settings: Reproduction, console: Console) -> dict[str, Any]:
    parts = _parts(settings)
    if all(part is None for part in parts.values()):
        raise InputError("give at least one data set: --ubc3v, --mhad or --eval with its folder")
    if settings.pictures < 1:
        raise InputError(f"--pictures must be at least 1, got {settings.pictures}")
    for path in (settings.net1, settings.net2, settings.net3):
        if path is not None:
            Classifier(path)  # a wrong file raises before hours are spent
    sections: list[ReportSection] = []
    numbers: dict[str, Any] = {}
    notes: list[str] = []
    for name, part in parts.items():
        if part is None:
            notes.append(f"{name} was not given.")
            continue
        try:
            part_sections, numbers[name] = part(console)
            sections += part_sections
        except InputError as error:
            notes.append(f"{name} is left out: {error}")
            console.print(notes[-1])
    if not sections:
        raise InputError(joined(notes, len(notes)))
    network = settings.net3 or "the packaged one"
    notes.append(f"Network: {network}; joints: {settings.estimator}. Frames are independent, nothing is smoothed.")
    (settings.out / "numbers.json").unlink(missing_ok=True)  # of another report
    write_report(
        settings.out / "report.html",
        "Real-time human motion capture with multiple depth cameras: the paper's results and ours",
        [*sections, ReportSection("How it was measured", notes)],
    )
    document = {"settings": plain_settings(settings), "notes": notes, **numbers}
    write_json(settings.out / "numbers.json", document)
    console.print(f"wrote {settings.out / 'report.html'}")
    return numbers


def _parts(settings: Reproduction) -> dict[str, Part | None]:
    """What to make of each data set; None of those that are not given."""
    nets = {1: settings.net1, 2: settings.net2, 3: settings.net3}

    def real(root: Path) -> RealPart:
        return RealPart(root, settings.every, settings.net3, settings.estimator, settings.pictures)

    parts: dict[str, Part | None] = {"UBC3V": None, "Berkeley MHAD": None, "EVAL": None}
    if settings.ubc3v is not None:
        part = Ubc3vPart(settings.ubc3v, nets, settings.estimator, settings.limit, settings.pictures)
        parts["UBC3V"] = functools.partial(reproduce_ubc3v, part)
    if settings.mhad is not None:
        parts["Berkeley MHAD"] = functools.partial(reproduce_mhad, real(settings.mhad))
    if settings.eval is not None:
        parts["EVAL"] = functools.partial(reproduce_eval, real(settings.eval))
    return parts
