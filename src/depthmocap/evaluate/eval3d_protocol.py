"""``depthmocap evaluate eval``: mean average precision at 10 cm on EVAL, every person by a fit to the others."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console

from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.datasets.eval3d import Eval, Mask, joint_table
from depthmocap.evaluate.estimated_frames import estimate_frames
from depthmocap.evaluate.evaluation_report import FILES, finish_evaluation
from depthmocap.evaluate.protocol import RealSetEvaluation, Refit, comparable, leave_one_out, measure_estimates


@dataclasses.dataclass(frozen=True)
class EvalEvaluation(RealSetEvaluation):
    """Accuracy of joints on EVAL. The pose stage is fitted to EVAL's joints, for each person on all others.

    Attributes:
        root: folder with seq_*.bin.
        names: JSON file that names joint ids, such as {"0": "Head"}; a name that is one of ours ties the two joints.
        refit: "ridge" fits EVAL's joints; "none" takes ours where --names ties them.
        mask: "background" finds the person by what stands still in a sequence; "box" takes what is near the true
            joints; "all" every valid pixel.
    """

    root: tyro.conf.Positional[Path]
    names: Path | None = None
    refit: Refit = "ridge"
    mask: Mask = "background"


@locks_outputs(files=FILES)
def evaluate_eval(settings: EvalEvaluation, console: Console | None = None) -> dict[str, Any]:
    """Run the evaluation; returns the numbers by name. Frames are independent, nothing is smoothed.

    Raises:
        InputError: when files are missing or damaged, or hold nothing to fit to or to test.
    """
    console = console or Terminal(stderr=True)
    names = joint_table(settings.names) if settings.names is not None else None
    source = Eval(settings.root, names, settings.mask)
    frames = comparable(estimate_frames(source, *settings.load(), settings.every, console), settings.refit)
    estimates = leave_one_out(frames, frames.subjects, settings.refit)
    return finish_evaluation(settings, "EVAL", {"EVAL": measure_estimates(frames, estimates)}, console)
