"""``depthmocap run``: a recording in, a folder of skeletons, measurements and pictures out."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import platform
import time
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from jaxtyping import Float
from numpy import ndarray
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from depthmocap.body.skeleton import JOINTS
from depthmocap.capture.open import open_recording
from depthmocap.capture.recording import Recording
from depthmocap.classify.runtime import Classifier
from depthmocap.console import Terminal
from depthmocap.ending import finishing
from depthmocap.errors import InputError
from depthmocap.export import CsvWriter, write_bvh, write_trc
from depthmocap.export.files import PeopleFiles, remove_results
from depthmocap.frames import FrameSet, FrameSource, Pose
from depthmocap.geometry import check_placed, load_rig
from depthmocap.offline_report import Pictures, write_run_report
from depthmocap.output import write_json
from depthmocap.owning import owns
from depthmocap.people.segmenter import PeopleSegmenter
from depthmocap.pipeline import STAGES, Pipeline, Result
from depthmocap.pose.agreement import Agreement
from depthmocap.pose.estimate import load_estimator
from depthmocap.pose.track import AUTO, Bones, Smoothing, load_filter
from depthmocap.report.metrics import joint_metrics
from depthmocap.text import cameras, joined


@dataclasses.dataclass(frozen=True)
class RunSettings:
    """Motion capture of a recording.

    Attributes:
        recording: a recording folder (rig.json and 16-bit PNGs per camera), an MCAP file or a section of UBC3V.
        rig: a rig.json that tells where the cameras stand, such as ``depthmocap calibrate`` writes, instead of what the
            recording says.
        out: folder for pose.csv, pose.trc, pose.bvh, summary.json and report.html.
        segment: "auto" finds the person in a static scene; "none" takes every valid pixel.
        people: follow up to so many; with more than one, each has a folder ``person-N`` besides, and the files of
            ``out`` are of the one who was followed first.
        smooth: a filter over time. "average" is the paper's weighted average of the last frames, "fixed-lag" waits for
            later ones; "auto" is "kalman" for recordings and "none" for UBC3V sections, whose frames do not follow
            each other.
        lag_frames: that "fixed-lag" waits for.
        bridge_s: how long "kalman" and "fixed-lag" go on with a joint that is missing (s); 0 leaves gaps.
        bones: "steady" gives bones constant lengths, learnt on the run; "free" leaves them as estimated, as does
            "none" for --smooth.
        weights: a classifier.onnx of your own.
        estimator: of the joints: votes, ridge (the paper's), or a file that ``train pose`` wrote.
        report: draw report.html and the animated preview.
    """

    recording: tyro.conf.Positional[Path]
    out: Path
    rig: Path | None = None
    segment: Literal["auto", "none"] = "auto"
    people: int = 1
    smooth: Smoothing = "auto"
    lag_frames: int = 4
    bridge_s: float = 0.0
    bones: Bones = "steady"
    weights: Path | None = None
    estimator: str = "votes"
    report: bool = True


def open_source(path: Path | str, rig: Path | None = None) -> FrameSource:
    """A recording folder, an MCAP file or a UBC3V section, told apart by what they hold and by the name. ``rig`` is a
    rig.json that tells where the cameras of a recording stand, instead of what it says.

    Raises:
        InputError: when the path is neither, or the rig is not one of its cameras.
    """
    path = Path(path)
    if (path / "images" / "depthRender").is_dir() or (path / "groundtruth.mat").is_file():
        from depthmocap.datasets.ubc3v import Section

        if rig is not None:
            raise InputError("--rig is for recordings: a section of UBC3V tells its cameras' places frame by frame")
        return Section(path)
    return open_recording(path, None if rig is None else load_rig(rig))


def load_pipeline(
    source: FrameSource | Path | str,
    segment: Literal["auto", "none"] = "auto",
    smooth: Smoothing = "auto",
    weights: Path | None = None,
    estimator: str = "votes",
    *,
    lag_frames: int = 4,
    bridge_s: float = 0.0,
    bones: Bones = "steady",
    people: int = 1,
) -> Pipeline:
    """The pipeline for a source, its background learnt, with the packaged weights or your own (see RunSettings).

    Raises:
        InputError: when the recording or the weights cannot be read.
    """
    source = open_source(source) if isinstance(source, Path | str) else source
    if isinstance(source, Recording):
        check_placed(source.rig.cameras)
    if smooth == "auto":
        from depthmocap.datasets.ubc3v import Section

        smooth = "none" if isinstance(source, Section) else AUTO
    if smooth == "none" and bridge_s:
        raise InputError("gaps are bridged by the filters kalman and fixed-lag, not without one")
    smoothing = None if smooth == "none" else load_filter(smooth, lag_frames, bridge_s, bones)
    return Pipeline(
        Classifier(weights),
        load_estimator(estimator),
        PeopleSegmenter.from_recording(source, segment, people),
        source.up,
        smoothing,
    )


@owns(folder="out")
def run(settings: RunSettings, console: Console | None = None) -> dict[str, Any]:
    """Process a recording and write everything; returns the summary. Ctrl-C keeps what was done until then.

    Raises:
        InputError: when the recording cannot be read, or no frame of it shows a person.
    """
    with contextlib.ExitStack() as last:
        return _run(settings, console or Terminal(stderr=True), last)


def _run(settings: RunSettings, console: Console, last: contextlib.ExitStack) -> dict[str, Any]:
    source = open_source(settings.recording, settings.rig)
    with console.status("reading the background and the weights"):
        pipeline = load_pipeline(
            source, settings.segment, settings.smooth, settings.weights, settings.estimator,
            lag_frames=settings.lag_frames, bridge_s=settings.bridge_s, bones=settings.bones, people=settings.people,
        )  # fmt: skip
        # The first frame ever compiles the inner loops, which would be taken for the machine's speed.
        for frames in source:
            pipeline(frames)
            break
        pipeline.reset()
    pictures = Pictures(len(source), source.up) if settings.report else None

    rows: list[tuple[Pose, Float[ndarray, "18 3"], dict[str, float]]] = []
    delivered: dict[str, int] = dict.fromkeys(source.rig.names, 0) if isinstance(source, Recording) else {}
    interrupted = False
    agreement = Agreement()
    misplaced: list[str] = []
    # Frames whose pose a filter that waits has not given yet.
    waiting: collections.deque[tuple[FrameSet, Result, dict[str, float]]] = collections.deque()
    delay = pipeline.smoothing.delay_frames if pipeline.smoothing else 0
    columns = (
        TextColumn("capturing"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        TextColumn("{task.fields[rate]}"),
    )  # fmt: skip
    remove_results(settings.out)
    everybody = PeopleFiles(settings.out, source.up)
    with CsvWriter(settings.out / "pose.csv") as csv, everybody, Progress(*columns, console=console) as progress:
        task = progress.add_task("capturing", total=len(source), rate="")
        recent_ms: collections.deque[float] = collections.deque(maxlen=30)

        def finished(pose: Pose) -> None:
            with finishing():
                frames, result, milliseconds = waiting.popleft()
                csv.write(pose)
                truth = frames.true_joints if frames.true_joints is not None else np.full((len(JOINTS), 3), np.nan)
                rows.append((pose, truth, milliseconds))
                if pictures is not None:
                    pictures.add(frames, dataclasses.replace(result, pose=pose))

        try:
            before = time.perf_counter()
            for frames in source:
                read_ms = (time.perf_counter() - before) * 1e3
                result = pipeline(frames)
                waiting.append((frames, result, {"read": read_ms, **result.milliseconds}))
                misplaced += agreement(result.cloud)
                if settings.people > 1:
                    everybody.write({person.number: person.pose for person in result.people}, delay)
                if len(waiting) > delay:
                    finished(result.pose)
                for view in frames.views:
                    delivered[view.camera.name] = delivered.get(view.camera.name, 0) + 1
                recent_ms.append(read_ms + sum(result.milliseconds.values()))
                progress.update(task, advance=1, rate=f"{1e3 / np.mean(recent_ms):.0f} frames/s")
                before = time.perf_counter()
        except KeyboardInterrupt:
            interrupted = True
        last.enter_context(finishing())
        if interrupted:
            console.print(f"stopped after {len(rows)} of {len(source)} frames; writing what was done")
        everybody.finish(pipeline.finish_people())
        for pose in pipeline.finish():
            # An interruption may have come between the filter and this list.
            if waiting and waiting[0][0].timestamp_ns == pose.timestamp_ns:
                finished(pose)

    poses, truths, times = [row[0] for row in rows], [row[1] for row in rows], [row[2] for row in rows]
    misplaced += agreement.finish()
    problems = [
        *dict.fromkeys(misplaced), *getattr(source, "problems", []), *getattr(pipeline.segment, "problems", []),
    ]  # fmt: skip
    if interrupted and not poses:
        raise KeyboardInterrupt
    if not poses or all(np.isnan(pose.joints).all() for pose in poses):
        hint = joined(problems) or _way_out(source, settings.segment)
        raise InputError(f"{settings.recording}: no person was found in any of {len(poses)} frames: {hint}")
    write_trc(settings.out / "pose.trc", poses, source.up)
    held = []
    try:
        held = write_bvh(settings.out / "pose.bvh", poses, source.up)
    except InputError as error:  # everything else is whole
        problems.append(f"no pose.bvh: {error}")
    summary = _summary(settings, poses, truths, times, delivered, held, problems)
    if settings.people > 1:
        summary["frames_by_person"] = {str(number): count for number, count in sorted(everybody.poses.items())}
    summary["cameras_apart_cm"] = {name: 100 * apart_m for name, apart_m in agreement.apart_m().items()}
    summary |= {"interrupted": interrupted, "smoothing": pipeline.smoothing.describe() if pipeline.smoothing else None}
    write_json(settings.out / "summary.json", summary)
    if pictures is not None:
        with console.status("drawing the report"):
            write_run_report(settings.out, summary, pictures, np.stack(truths), np.stack([p.joints for p in poses]))
    _tell(summary, settings.out, console)
    return summary


def _way_out(source: FrameSource, segment: Literal["auto", "none"]) -> str:
    """What may help where nobody is found and nothing else is wrong."""
    ways = ["see that the cameras stand where the rig says (world_from_camera is no inverse) and that its up is right"]
    if segment == "auto" and isinstance(source, Recording):
        unknown = [name for name in source.rig.names if source.background(name) is None]
        ways += [f"give the empty scene of {cameras(unknown)} (background.png)"] if unknown else []
        ways += ["try --segment none if there is no room around the person"]
    return ", or ".join(ways)


def _few(problems: list[str], most: int = 4) -> list[str]:
    """The first of many problems, and how many more there are."""
    return problems if len(problems) <= most else [*problems[:most], f"And {len(problems) - most} more of this kind."]


def _tell(summary: dict[str, Any], out: Path, console: Console) -> None:
    """What came of it, and what was wrong."""
    gaps = f", {summary['gaps']} without a person" if summary["gaps"] else ""
    console.print(f"{summary['frames']} frames{gaps}; written to {out}")
    for problem in _few(summary["problems"]):
        console.print(f"  {problem}")


def _recorded_rate(poses: list[Pose]) -> float:
    """Frames a second of the recording itself, by its median interval."""
    intervals = np.diff([pose.timestamp_ns for pose in poses])
    return float(1e9 / np.median(intervals)) if len(intervals) and np.median(intervals) > 0 else 30.0


def _summary(
    settings: RunSettings,
    poses: list[Pose],
    truths: list[Float[ndarray, "18 3"]],
    times: list[dict[str, float]],
    delivered: dict[str, int],
    held: list[int],
    problems: list[str],
) -> dict[str, Any]:
    from depthmocap import __version__

    joints = np.stack([pose.joints for pose in poses])
    gaps = np.flatnonzero(np.isnan(joints).all((1, 2)))
    per_frame = np.array([sum(row.values()) for row in times])
    summary: dict[str, Any] = {
        "recording": str(settings.recording),
        "first_timestamp_ns": poses[0].timestamp_ns,
        "version": __version__,
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
        "frames": len(poses),
        "gaps": len(gaps),
        "gap_frames": gaps.tolist(),
        "bvh_held_frames": held,
        "recorded_frames_per_second": _recorded_rate(poses),
        "frames_by_camera": delivered,
        "frames_per_second": float(1e3 / per_frame.mean()),
        "ms_per_frame": {"p50": float(np.median(per_frame)), "p95": float(np.quantile(per_frame, 0.95))},
        "ms_per_stage": {
            stage: {
                "p50": float(np.median([row[stage] for row in times])),
                "p95": float(np.quantile([row[stage] for row in times], 0.95)),
            }
            for stage in ("read", *STAGES)
        },
        "mean_confidence": float(np.mean([pose.confidence.mean() for pose in poses])),
        "problems": problems,
    }
    if not np.isnan(np.stack(truths)).all():
        metrics = joint_metrics(joints, np.stack(truths))
        summary["error"] = {
            "mean_joint_error_cm": metrics.mean_joint_error_cm,
            "within_10cm": metrics.within_10cm,
            "per_joint_error_cm": metrics.per_joint_error_cm,
            "joints_with_truth": metrics.observed,
            "joints_missing": metrics.missing,
        }
    return summary
