"""``depthmocap evaluate eval``: mean average precision at 10 cm on EVAL, every person by a fit to the others."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console

from depthmocap.classify.classifier import Classifier
from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.datasets.eval3d import Eval, Mask, joint_table
from depthmocap.evaluate.estimated_frames import estimate_frames
from depthmocap.evaluate.evaluation_report import FILES, Outputs, about, print_results, write_outputs
from depthmocap.evaluate.protocol import Refit, comparable, leave_one_out, measure_estimates
from depthmocap.pose.estimators import load_estimator


@dataclasses.dataclass(frozen=True)
class EvalEvaluation(Outputs):
    """Accuracy of joints on EVAL. The pose stage is fitted to EVAL's joints, for each person on all others.

    Attributes:
        root: folder with seq_*.bin.
        names: JSON file that names joint ids, such as {"0": "Head"}; a name that is one of ours ties the two joints.
        refit: "ridge" fits EVAL's joints; "none" takes ours where --names ties them.
        mask: "background" finds the person by what stands still in a sequence; "box" takes what is near the true
            joints; "all" every valid pixel.
        every: read every so-many-th frame only.
        weights: a classifier.onnx of your own.
        estimator: of our joints: votes, ridge (the paper's), or a file that ``train pose`` wrote.
    """

    root: tyro.conf.Positional[Path]
    names: Path | None = None
    refit: Refit = "ridge"
    mask: Mask = "background"
    every: int = 1
    weights: Path | None = None
    estimator: str = "votes"


@locks_outputs(files=FILES)
def evaluate_eval(settings: EvalEvaluation, console: Console | None = None) -> dict[str, Any]:
    """Run the evaluation; returns the numbers by name. Frames are independent, nothing is smoothed.

    Raises:
        InputError: when files are missing or damaged, or hold nothing to fit to or to test.
    """
    console = console or Terminal(stderr=True)
    names = joint_table(settings.names) if settings.names is not None else None
    source = Eval(settings.root, names, settings.mask)
    frames = estimate_frames(
        source, load_estimator(settings.estimator), Classifier(settings.weights), settings.every, console
    )
    frames = comparable(frames, settings.refit)
    estimates = leave_one_out(frames, frames.subjects, settings.refit)
    results = {"EVAL": {"about": about(settings), **measure_estimates(frames, estimates)}}
    write_outputs(settings, "EVAL", results)
    print_results("EVAL", results, console)
    return results
