"""``depthmocap run``: a recording in, a folder of skeletons, measurements and pictures out."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from jaxtyping import Float
from numpy import ndarray
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from depthmocap.body.skeleton import JOINTS
from depthmocap.calibration.rig_watch import RigWatch
from depthmocap.core.console import Terminal
from depthmocap.core.interrupts import deferred_interrupts
from depthmocap.core.locks import locks_outputs
from depthmocap.errors import InputError
from depthmocap.exporting.export_command import write_more_formats
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.result_files import NO_PERSON, PeopleFiles, PoseFiles, remove_results
from depthmocap.exporting.run_result import RunResult
from depthmocap.exporting.summary import Quantiles, Summary, Take, count_problems, problem_lines, unsure_lines
from depthmocap.frames import FrameSet, FrameSource, Pose
from depthmocap.geometry.depth_camera import time_offsets_s
from depthmocap.offline.pipeline import STAGES, Pipeline, Result, mix_up_lines, warm_up
from depthmocap.offline.pipeline_settings import RIG_AREA, PipelineSettings, load_pipeline, open_source
from depthmocap.offline.run_report import Pictures, write_run_report
from depthmocap.recordings.recording import Recording
from depthmocap.report.metrics import joint_errors_cm, joint_metrics, joint_numbers, reliability
from depthmocap.text import camera_list, joined, offset_lines

#: Frames of each camera that are looked at again if something is wrong.
_SETS_CHECKED = 60


@dataclasses.dataclass(frozen=True)
class RunSettings(PipelineSettings, FileSettings):
    """Motion capture of a recording.

    Where several people are followed, each has a folder ``person-N`` besides, and the files of ``out`` are of the one
    who was followed first.

    Attributes:
        recording: a recording folder (rig.json and 16-bit PNGs per camera), an MCAP file or a section of UBC3V.
        rig: a rig.json that tells where the cameras stand, such as ``depthmocap calibrate`` writes, instead of what the
            recording says.
        out: folder for pose.csv, files of other formats, summary.json and report.html.
        report: draw report.html and the animated preview.
    """

    recording: tyro.conf.Positional[Path]
    out: Path
    rig: Path | None = None
    report: bool = True


@locks_outputs(folder="out")
def run(settings: RunSettings, console: Console | None = None) -> RunResult:
    """Process a recording and write everything. Ctrl-C keeps what was done until then.

    Raises:
        InputError: when the recording cannot be read, or no frame of it shows a person.
    """
    with contextlib.ExitStack() as last:
        return RunResult(settings.out, _run(settings, console or Terminal(stderr=True), last))


def _run(settings: RunSettings, console: Console, last: contextlib.ExitStack) -> Summary:
    source = open_source(settings.recording, settings.rig)
    take = Take("run", [settings.recording], source.up, settings)
    with console.status("reading the background and the weights"):
        pipeline = load_pipeline(source, settings)
        # The first frame ever compiles the inner loops, which would be taken for the machine's speed.
        if (first := next(iter(source), None)) is not None:
            warm_up(pipeline, first)
    for line in pipeline.devices.lines():
        console.print(f"  {line}")
    if source.area_m and not settings.area:
        console.print(f"  {RIG_AREA}")
    pictures = Pictures(len(source), source.up) if settings.report else None
    remove_results(settings.out)
    files, people_files = PoseFiles(settings.out, take), PeopleFiles(settings.out, take)
    capture = _Capture(source, pipeline, files, people_files if settings.people > 1 else None, pictures)
    interrupted = False
    with files, people_files, _progress(console) as progress:
        task = progress.add_task("capturing", total=len(source), rate="")
        recent_ms: collections.deque[float] = collections.deque(maxlen=30)
        try:
            before = time.perf_counter()
            for frames in source:
                read_ms = (time.perf_counter() - before) * 1e3
                take.begin(frames.timestamp_ns)
                recent_ms.append(capture.add(frames, read_ms))
                progress.update(task, advance=1, rate=f"{1e3 / np.mean(recent_ms):.0f} frames/s")
                before = time.perf_counter()
        except KeyboardInterrupt:
            interrupted = True
        last.enter_context(deferred_interrupts())
        if interrupted:
            console.print(f"stopped after {capture.done} of {len(source)} frames; writing what was done")
        people_files.write(pipeline.finish_people())
        capture.finish()
        misplaced = list(dict.fromkeys(capture.misplaced))
        if not interrupted and (misplaced or not capture.seen):
            misplaced = _why_misplaced(source, settings, console) or misplaced
        files.numbers = {
            **capture.numbers(),
            "time_offsets_s": time_offsets_s(source.rig.cameras) if isinstance(source, Recording) else {},
            "interrupted": interrupted,
            "problems": count_problems(
                misplaced, capture.mixed_up, source.problems, pipeline.segment.problems, people_files.problems
            ),
        }
    if interrupted and not capture.done:
        raise KeyboardInterrupt
    summary = files.summary
    if summary["gaps"] == summary["frames"]:
        others = [line for line in problem_lines(summary["problems"]) if line != NO_PERSON]
        hint = joined(others) or _way_out(source, settings)
        raise InputError(f"{settings.recording}: no person was found in any of {summary['frames']} frames: {hint}")
    if pictures is not None:
        with console.status("drawing the report"):
            write_run_report(settings.out, summary, pictures, np.stack(capture.truths), np.stack(capture.joints))
    _tell(summary, settings.out, console)
    for problem in write_more_formats(settings, settings.out):
        console.print(f"  {problem}")
    return summary


def _progress(console: Console) -> Progress:
    columns = (
        TextColumn("capturing"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        TextColumn("{task.fields[rate]}"),
    )  # fmt: skip
    return Progress(*columns, console=console)


class _Capture:
    """A pipeline over the frames of a source: every pose that is final is written, counted and drawn.

    Attributes:
        misplaced: cameras that do not fit the others, a line each.
        mixed_up: people who could not be told apart, a line for each set.
    """

    def __init__(
        self,
        source: FrameSource,
        pipeline: Pipeline,
        files: PoseFiles,
        people_files: PeopleFiles | None,
        pictures: Pictures | None,
    ) -> None:
        """``people_files`` are of several people, who are followed besides."""
        self._pipeline, self._files, self._people_files, self._pictures = pipeline, files, people_files, pictures
        self._delay = pipeline.smoothing.delay_frames if pipeline.smoothing else 0
        #: Frames whose pose a filter that waits has not given yet.
        self._waiting: collections.deque[tuple[FrameSet, Result, dict[str, float]]] = collections.deque()
        self._poses: list[Pose] = []
        self._milliseconds: list[dict[str, float]] = []
        self._by_camera: dict[str, int] = dict.fromkeys(source.camera_names, 0)
        self._by_person: collections.Counter[str] = collections.Counter()
        self._rig_watch = RigWatch(source.up)
        self.truths: list[Float[ndarray, "18 3"]] = []
        self.misplaced: list[str] = []
        self.mixed_up: list[str] = []

    @property
    def done(self) -> int:
        """Frames whose pose is final."""
        return len(self._poses)

    @property
    def seen(self) -> bool:
        """Whether anybody was found."""
        return any(np.isfinite(pose.joints).any() for pose in self._poses)

    @property
    def joints(self) -> list[Float[ndarray, "18 3"]]:
        """Joints of the final poses."""
        return [pose.joints for pose in self._poses]

    def add(self, frames: FrameSet, read_ms: float) -> float:
        """Take the next frames; gives the milliseconds that they took, with those of reading them."""
        result = self._pipeline(frames)
        self._waiting.append((frames, result, {"read": read_ms, **result.milliseconds}))
        self.misplaced += self._rig_watch(frames, result.cloud)
        self.mixed_up += mix_up_lines(result)
        self._by_person.update(str(person.number) for person in result.people)
        if self._people_files is not None:
            self._people_files.write(result.final)
        if len(self._waiting) > self._delay:
            self._add_final(result.pose)
        for view in frames.views:
            self._by_camera[view.camera.name] = self._by_camera.get(view.camera.name, 0) + 1
        return read_ms + sum(result.milliseconds.values())

    def finish(self) -> None:
        """Take the poses that a filter has held back."""
        for pose in self._pipeline.finish():
            # An interruption may have come between the filter and the frames that wait.
            if self._waiting and self._waiting[0][0].timestamp_ns == pose.timestamp_ns:
                self._add_final(pose)
        self.misplaced += self._rig_watch.finish()

    def _add_final(self, pose: Pose) -> None:
        with deferred_interrupts():
            frames, result, milliseconds = self._waiting.popleft()
            self._files.write(pose)
            unknown = np.full((len(JOINTS), 3), np.nan)
            self.truths.append(unknown if frames.true_joints is None else frames.true_joints)
            self._poses.append(pose)
            self._milliseconds.append(milliseconds)
            if self._pictures is not None:
                self._pictures.add(frames, dataclasses.replace(result, pose=pose))

    def numbers(self) -> dict[str, Any]:
        """What the summary tells of the frames: how long they took, whose they were, and how well they fit."""
        smoothing = self._pipeline.smoothing
        return {
            "frames_by_camera": self._by_camera,
            "frames_by_person": dict(self._by_person),
            **_speed(self._milliseconds),
            "smoothing": smoothing.describe() if smoothing else None,
            "devices": self._pipeline.devices.running,
            "cameras_apart_cm": {name: 100 * apart_m for name, apart_m in self._rig_watch.distances_m().items()},
            "error": _error(self._poses, self.truths),
        }


def _why_misplaced(source: FrameSource, settings: RunSettings, console: Console) -> list[str]:
    """Which depth unit, picture or pose is wrong, a line each, where cameras do not fit each other or see nobody."""
    if not isinstance(source, Recording) or settings.weights is not None:
        return []
    from depthmocap.calibration.recording_check import check_recording  # rarely needed

    with contextlib.suppress(InputError):
        segment = "none" if settings.segment == "none" else "auto"
        return check_recording(source, console, _SETS_CHECKED, segment).faults
    return []


def _way_out(source: FrameSource, settings: RunSettings) -> str:
    """What may help where nobody is found and nothing else is wrong."""
    segment = settings.segment
    ways = ["see that people were in the area (--area, or the rig's area_m)"] if settings.area or source.area_m else []
    ways += ["see that the cameras stand where the rig says (world_from_camera is no inverse) and that its up is right"]
    if segment == "background":
        ways.append("take --segment auto, which finds people who hardly move or lie")
    if segment in ("auto", "background") and isinstance(source, Recording):
        unknown = [name for name in source.rig.names if source.background(name) is None]
        ways += [f"give the empty scene of {camera_list(unknown)} (background.png)"] if unknown else []

    if segment != "none":
        ways += ["try --segment none if there is no room around the person"]
    return ", or ".join(ways)


def _few(problems: list[str], most: int = 4) -> list[str]:
    """The first of many problems, and how many more there are."""
    return problems if len(problems) <= most else [*problems[:most], f"And {len(problems) - most} more of this kind."]


def _tell(summary: Summary, out: Path, console: Console) -> None:
    """What came of it, and what was wrong."""
    gaps = f", {summary['gaps']} without a person" if summary["gaps"] else ""
    console.print(f"{summary['frames']} frames{gaps}; written to {out}")
    for line in offset_lines(summary["time_offsets_s"]):
        console.print(f"  {line}")
    for problem in _few([*unsure_lines(summary), *problem_lines(summary["problems"])]):
        console.print(f"  {problem}")


def _speed(times: list[dict[str, float]]) -> dict[str, Any]:
    """How long the frames took, by stage and in all."""
    if not times:
        return {}
    per_frame = np.array([sum(row.values()) for row in times])

    def quantiles(values: Float[ndarray, " t"]) -> Quantiles:
        return {"p50": float(np.median(values)), "p95": float(np.quantile(values, 0.95))}

    return {
        "seconds": float(per_frame.sum() / 1e3),
        "frames_per_second": float(1e3 / per_frame.mean()),
        "ms_per_frame": quantiles(per_frame),
        "ms_per_stage": {stage: quantiles(np.array([row[stage] for row in times])) for stage in ("read", *STAGES)},
    }


def _error(poses: list[Pose], truths: list[Float[ndarray, "18 3"]]) -> dict[str, Any] | None:
    """How far the joints are from the true ones, where these are known."""
    if not poses or np.isnan(np.stack(truths)).all():
        return None
    joints, true = np.stack([pose.joints for pose in poses]), np.stack(truths)
    confidence = np.stack([pose.confidence for pose in poses])
    return joint_numbers(joint_metrics(joints, true), reliability(confidence, joint_errors_cm(joints, true)))
