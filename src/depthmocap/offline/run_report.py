"""The pictures and the page that ``depthmocap run`` leaves behind."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from depthmocap.exporting.summary import Summary, problem_lines, unsure_lines
from depthmocap.frames import FrameSet
from depthmocap.geometry.transforms import z_up_from
from depthmocap.offline.pipeline import Result
from depthmocap.report.charts import joint_error_bars, precision_curve
from depthmocap.report.drawing import animation, cloud_picture, labelled_depth_strip
from depthmocap.report.metrics import joint_metrics
from depthmocap.report.page import ReportFigure, ReportSection, ReportTable, write_report
from depthmocap.text import offset_lines

#: Frames of the preview, at most.
_PREVIEW = 60
#: Stills of the report, at most.
_STILLS = 3
#: Points of a preview picture.
_PREVIEW_POINTS = 12_000


@dataclasses.dataclass(frozen=True, eq=False)
class _Moment:
    """What the preview shows of one frame; points are in the Z-up world."""

    points: Float[ndarray, "n 3"]
    labels: UInt8[ndarray, "n"]
    joints: Float[ndarray, "18 3"]
    true_joints: Float[ndarray, "18 3"] | None


class Pictures:
    """Keeps what the report draws while frames go by: a few stills, and thinned clouds for an animation."""

    def __init__(self, frames: int, up: str) -> None:
        self._up = up
        self.every = max(1, -(-frames // _PREVIEW))
        stills = np.linspace(0, frames, _STILLS + 2)[1:-1].astype(int)
        self._still_frames = set(stills.tolist())
        self._index = 0
        self.stills: list[tuple[int, ndarray, ndarray]] = []
        self._moments: list[_Moment] = []

    def add(self, frames: FrameSet, result: Result) -> None:
        """Take what is wanted of one frame."""
        index, self._index = self._index, self._index + 1
        if not len(result.cloud):
            return
        cloud, joints = result.cloud, result.pose.joints
        if index % self.every == 0:
            thin = slice(None, None, max(1, len(cloud) // _PREVIEW_POINTS))
            self._moments.append(_Moment(cloud.points_world[thin], cloud.labels[thin], joints, frames.true_joints))
        if index in self._still_frames:
            views = [dataclasses.replace(v, mask=m) for v, m in zip(frames.views, result.masks, strict=True)]
            strip = labelled_depth_strip(views, list(result.labels))
            picture = cloud_picture(
                cloud.points_world, cloud.labels, joints, frames.true_joints, self._up, size=(960, 560)
            )
            self.stills.append((index, strip, picture))

    def preview(self) -> list[UInt8[ndarray, "h w 3"]]:
        """Pictures of the animation, all of one box of the world that holds the person throughout."""
        if not self._moments:
            return []
        turn = z_up_from(self._up).T
        lows, highs = [], []
        for moment in self._moments:
            points = moment.points.astype(np.float64) @ turn
            lows.append(np.quantile(points, 0.005, axis=0))
            highs.append(np.quantile(points, 0.995, axis=0))
        bounds = np.stack([np.min(lows, 0) - 0.15, np.max(highs, 0) + 0.15])
        return [
            cloud_picture(
                moment.points, moment.labels, moment.joints, moment.true_joints, self._up,
                size=(640, 360), bounds_m=bounds,
            )
            for moment in self._moments
        ]  # fmt: skip


def write_run_report(
    out: Path,
    summary: Summary,
    pictures: Pictures,
    truths: Float[ndarray, "t 18 3"],
    estimates: Float[ndarray, "t 18 3"],
) -> None:
    """Write report.html and preview.webp into ``out``."""
    sections = [_overview(summary)]
    preview = pictures.preview()
    if preview:
        animation(preview, (summary["recorded_frames_per_second"] or 30.0) / pictures.every, out / "preview.webp")
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
    if summary["error"] is not None:
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


def _overview(summary: Summary) -> ReportSection:
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
        f"Recording: `{summary['sources'][0]}`. Machine: {summary['machine']}. depthmocap {summary['version']}.",
    ]
    facts += [*offset_lines(summary["time_offsets_s"]), *unsure_lines(summary)]
    if summary["problems"]:
        facts.append("Noticed:\n" + "\n".join(problem_lines(summary["problems"])))
    return ReportSection("Overview", tuple(facts), tables=(stages, cameras))
