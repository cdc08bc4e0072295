"""``depthmocap evaluate recording``: errors of the whole pipeline, smoothing included, where true joints are known."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track

from depthmocap.core.console import Terminal, progress_text
from depthmocap.core.locks import locks_outputs
from depthmocap.errors import InputError
from depthmocap.evaluate.evaluation_report import FILES, Outputs, finish_evaluation
from depthmocap.offline.pipeline_settings import PipelineSettings, load_pipeline, open_source
from depthmocap.report.metrics import joint_errors_cm, joint_metrics, joint_numbers, reliability
from depthmocap.text import joined


@dataclasses.dataclass(frozen=True)
class RecordingEvaluation(PipelineSettings, Outputs):
    """Accuracy of ``depthmocap run`` on a recording with truth.csv, or a section of UBC3V.

    A filter that waits is measured against the frame that it answers for.

    Attributes:
        recording: the folder.
    """

    recording: tyro.conf.Positional[Path]


@locks_outputs(files=FILES)
def evaluate_recording(settings: RecordingEvaluation, console: Console | None = None) -> dict[str, Any]:
    """Run the pipeline over the frames and measure those with a true joint; returns the numbers by name.

    Raises:
        InputError: when the recording cannot be read, or no frame of it has a true joint.
    """
    console = console or Terminal(stderr=True)
    source = open_source(settings.recording)
    pipeline = load_pipeline(source, settings)
    for line in pipeline.devices.lines():
        console.print(f"  {line}")
    truths, poses, spent_ms = {}, {}, []
    for frames in track(source, progress_text(settings.recording.name), len(source), console=console):
        result = pipeline(frames)
        # A filter with a delay returns the final pose of a frame later.
        poses[result.pose.timestamp_ns] = result.pose
        spent_ms.append(sum(result.milliseconds.values()))
        if frames.true_joints is not None and np.isfinite(frames.true_joints).all(1).any():
            truths[frames.timestamp_ns] = frames.true_joints
    poses |= {pose.timestamp_ns: pose for pose in pipeline.finish()}
    problems = [*source.problems, *pipeline.segment.problems]
    if not truths:
        raise InputError(
            f"{settings.recording}: no frame has a true joint: truth.csv must hold the columns of pose.csv, with the "
            f"frames' timestamp_ns; {joined(problems)}".rstrip("; ")
        )
    truth = np.stack(list(truths.values())).astype(np.float64)
    estimates = np.stack([poses[time_ns].joints for time_ns in truths]).astype(np.float64)
    confidence = np.stack([poses[time_ns].confidence for time_ns in truths]).astype(np.float64)
    name = settings.recording.resolve().name
    numbers = {
        "frames": len(truths),
        "frames_left_out": len(source) - len(truths),
        "frames_without_person": int(np.isnan(estimates).all((1, 2)).sum()),
        **joint_numbers(joint_metrics(estimates, truth), reliability(confidence, joint_errors_cm(estimates, truth))),
        "ms_per_frame": float(np.median(spent_ms)),
        "problems": problems,
    }
    return finish_evaluation(settings, f"Recording {name}", {name: numbers}, console, shown=name)
