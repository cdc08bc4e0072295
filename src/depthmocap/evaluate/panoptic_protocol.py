"""``depthmocap evaluate panoptic``: joints from several Kinect 2 against those of CMU Panoptic's dome.

No protocol is agreed on for its Kinects. Our joints are compared as they are; or the pose stage is fitted to the set's
joints, for each sequence on all others.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console

from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.datasets.panoptic import CONFIDENCE, PanopticSet
from depthmocap.datasets.panoptic_files import MColor
from depthmocap.evaluate.estimated_frames import estimate_frames
from depthmocap.evaluate.evaluation_report import FILES, finish_evaluation
from depthmocap.evaluate.protocol import RealSetEvaluation, Refit, comparable, leave_one_out, measure_estimates


@dataclasses.dataclass(frozen=True)
class PanopticEvaluation(RealSetEvaluation):
    """Accuracy of joints on the frames of CMU Panoptic in which exactly one person is.

    Attributes:
        root: folder of a sequence, or of several.
        kinects: numbers (1-10) of the Kinects to take, by default all that are there.
        refit: "none" compares our joints where they correspond; "ridge" fits the set's, each sequence by all others.
        every: read every so-many-th frame of joints only.
        confidence: the set's joints of less confidence are unknown.
        m_color: whether the calibration's M_color leads from a Kinect's frame to its colour camera, or back: public
            code does not agree.
    """

    root: tyro.conf.Positional[Path]
    kinects: tuple[int, ...] = ()
    refit: Refit = "none"
    confidence: float = CONFIDENCE
    m_color: MColor = "to-colour"


@locks_outputs(files=FILES)
def evaluate_panoptic(settings: PanopticEvaluation, console: Console | None = None) -> dict[str, Any]:
    """Run the evaluation; returns the numbers by name. Frames are independent, nothing is smoothed.

    Raises:
        InputError: when no frame can be evaluated, or there is nothing to fit to.
    """
    console = console or Terminal(stderr=True)
    source = PanopticSet(settings.root, settings.kinects, settings.every, settings.confidence, settings.m_color)
    frames = comparable(estimate_frames(source, *settings.load(), 1, console), settings.refit)
    estimates = leave_one_out(frames, frames.subjects, settings.refit)
    return finish_evaluation(settings, source.name, {source.name: measure_estimates(frames, estimates)}, console)
