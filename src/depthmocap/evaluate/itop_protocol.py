"""``depthmocap evaluate itop``: mean average precision at 10 cm, as the field reports it on ITOP."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console

from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.datasets.itop import PARTS, Itop, Mask, Side
from depthmocap.evaluate.estimated_frames import estimate_frames
from depthmocap.evaluate.evaluation_report import FILES, finish_evaluation
from depthmocap.evaluate.protocol import RealSetEvaluation, Refit, comparable, measure_estimates
from depthmocap.evaluate.refit import fit_joints


@dataclasses.dataclass(frozen=True)
class ItopEvaluation(RealSetEvaluation):
    """Accuracy of joints on the valid frames of ITOP's test split; the pose stage is fitted on its train split.

    Attributes:
        root: folder with ITOP_<view>_<split>_depth_map.h5 and ITOP_<view>_<split>_labels.h5.
        view: "side"; or "top", from where the network never saw people in training.
        refit: "ridge" fits ITOP's joints on its train split; "none" takes our joints as they are.
        mask: "segmentation" is the set's own; "box" takes what is near the true joints, where that is wrong.
    """

    root: tyro.conf.Positional[Path]
    view: Side = "side"
    refit: Refit = "ridge"
    mask: Mask = "segmentation"


@locks_outputs(files=FILES)
def evaluate_itop(settings: ItopEvaluation, console: Console | None = None) -> dict[str, Any]:
    """Run the evaluation; returns the numbers by name. Frames are independent, nothing is smoothed.

    Raises:
        InputError: when files are missing or damaged, or hold nothing to fit to or to test.
    """
    console = console or Terminal(stderr=True)
    # Both are opened before an hour is spent on one of them.
    test = Itop(settings.root, settings.view, "test", settings.mask)
    train = Itop(settings.root, settings.view, "train", settings.mask) if settings.refit == "ridge" else None
    stages = settings.load()
    joint_map = None
    if train is not None:
        joint_map = fit_joints(estimate_frames(train, *stages, settings.every, console))
    frames = comparable(estimate_frames(test, *stages, settings.every, console), settings.refit)
    estimates = frames.mapped() if joint_map is None else joint_map(frames)
    name = f"ITOP {settings.view}"
    return finish_evaluation(settings, name, {name: measure_estimates(frames, estimates, PARTS)}, console)
