"""The pictures and the page that ``depthmocap run`` leaves behind."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.evaluate.charts import joint_error_bars, precision_curve
from depthmocap.evaluate.metrics import joint_metrics
from depthmocap.evaluate.pictures import animation, cloud_picture, labelled_depth_strip
from depthmocap.evaluate.report import ReportFigure, ReportSection, ReportTable, write_report
from depthmocap.frames import FrameSet
from depthmocap.geometry.transforms import z_up_from
from depthmocap.pipeline import Result

#: Frames of the preview and stills of the report, at most.
_PREVIEW, _STILLS = 60, 3


class Pictures:
    """Keeps what the report draws while frames go by: a few stills, and small frames of an animation."""

    def __init__(self, frames: int, up: str) -> None:
        self._up = up
        self._every = max(1, -(-frames // _PREVIEW))
        stills = np.linspace(0, frames, _STILLS + 2)[1:-1].astype(int)
        self._still_frames = set(stills.tolist())
        self._index = 0
        self._bounds: ndarray | None = None
        self.stills: list[tuple[int, ndarray, ndarray]] = []
        self.preview: list[ndarray] = []

    def add(self, frames: FrameSet, result: Result) -> None:
        """Take what is wanted of one frame."""
        index, self._index = self._index, self._index + 1
        due = index in self._still_frames or (
            self._still_frames and index > max(self._still_frames) and not self.stills
        )
        wanted = index % self._every == 0
        if not (due or wanted) or not len(result.cloud):
            return
        joints = result.pose.joints
        if wanted:
            picture = cloud_picture(
                result.cloud.points_world, result.cloud.labels, joints, frames.true_joints, self._up,
                size=(640, 360), bounds_m=self._fixed_bounds(result.cloud.points_world),
            )  # fmt: skip
            self.preview.append(picture)
        if due:
            views = [dataclasses.replace(v, mask=m) for v, m in zip(frames.views, result.masks, strict=True)]
            strip = labelled_depth_strip(views, list(result.labels))
            cloud = cloud_picture(
                result.cloud.points_world, result.cloud.labels, joints, frames.true_joints, self._up, size=(960, 560)
            )
            self.stills.append((index, strip, cloud))

    def _fixed_bounds(self, points: Float[ndarray, "n 3"]) -> Float[ndarray, "2 3"]:
        """A box around where the person was first seen, with room to move, so that the preview does not jump."""
        if self._bounds is None:
            points = points.astype(np.float64) @ z_up_from(self._up).T
            middle, low = np.median(points, 0), np.quantile(points[:, 2], 0.005)
            self._bounds = np.array([[middle[0] - 1.2, middle[1] - 1.2, low - 0.1],
                                     [middle[0] + 1.2, middle[1] + 1.2, low + 2.2]])  # fmt: skip
        return self._bounds


def write_run_report(
    out: Path,
    summary: dict[str, Any],
    pictures: Pictures,
    truths: Float[ndarray, "t 18 3"],
    estimates: Float[ndarray, "t 18 3"],
) -> None:
    """Write report.html and preview.webp into ``out``."""
    sections = [_overview(summary)]
    if pictures.preview:
        animation(pictures.preview, 10.0, out / "preview.webp")
        sections.append(
            ReportSection(
                "In motion",
                ("The labelled cloud of all cameras and the skeleton, from two sides. Red is the estimate, blue the "
                 "truth where it is known.",),
                figures=(ReportFigure((out / "preview.webp").read_bytes()),),
            )
        )  # fmt: skip
    for index, strip, cloud in pictures.stills:
        figures = (
            ReportFigure(strip, "Depth and body-part labels, one column a camera."),
            ReportFigure(cloud, "The merged cloud and the skeleton from two sides."),
        )
        sections.append(ReportSection(f"Frame {index}", figures=figures))
    if "error" in summary:
        metrics = joint_metrics(estimates, truths)
        sections.append(
            ReportSection(
                "Error against the true joints",
                (f"Mean {metrics.mean_joint_error_cm:.2f} cm; {metrics.within_10cm:.1%} of joints within 10 cm.",),
                figures=(
                    ReportFigure(joint_error_bars(metrics), "Mean error per joint, with its deviation.", chart=True),
                    ReportFigure(precision_curve({"estimate": metrics}), "Joints within a distance.", chart=True),
                ),
            )
        )
    write_report(out / "report.html", "Motion capture report", sections)


def _overview(summary: dict[str, Any]) -> ReportSection:
    stages = ReportTable(
        ("stage", "p50 (ms)", "p95 (ms)"),
        tuple((stage, ms["p50"], ms["p95"]) for stage, ms in summary["ms_per_stage"].items()),
        caption="Milliseconds a frame set, all cameras together.",
        decimals=1,
    )
    cameras = ReportTable(("camera", "frames"), tuple(summary["frames_by_camera"].items()))
    facts = [
        f"{summary['frames']} frames at {summary['frames_per_second']:.1f} frames a second, reading included; "
        f"{summary['gaps']} frames without a person.",
        f"Recording: `{summary['recording']}`. Machine: {summary['machine']}. depthmocap {summary['version']}.",
    ]
    if summary["problems"]:
        facts.append("Noticed: " + " ".join(summary["problems"]))
    return ReportSection("Overview", tuple(facts), tables=(stages, cameras))
