"""``depthmocap live``: motion capture of cameras, or of a recording in their place, with a dashboard."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import time
from pathlib import Path

import tyro
from rich.console import Console
from rich.live import Live

from depthmocap.cameras.playback_clock import PlaybackClock
from depthmocap.cameras.registry import make_sources
from depthmocap.core.console import Terminal
from depthmocap.core.interrupts import deferred_interrupts
from depthmocap.core.locks import locks_outputs
from depthmocap.core.settings import check_above_0, check_at_least
from depthmocap.errors import InputError
from depthmocap.exporting.export_command import write_more_formats
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.result_files import PeopleFiles, PoseFiles, remove_results
from depthmocap.exporting.run_result import RunResult
from depthmocap.exporting.summary import Summary, Take, problem_lines, unsure_lines
from depthmocap.geometry import Rig, load_rig
from depthmocap.offline.pipeline_settings import PipelineSettings, load_pipeline
from depthmocap.realtime.dashboard import draw_dashboard
from depthmocap.realtime.live_capture import LiveCapture, Replay
from depthmocap.realtime.mcap_recorder import McapRecorder
from depthmocap.realtime.status import CameraStatus
from depthmocap.realtime.sync import SyncSettings
from depthmocap.recordings.mcap_writer import McapWriter, check_name
from depthmocap.recordings.open_recording import open_recording
from depthmocap.text import joined

#: Seconds from one drawing of the dashboard to the next.
DRAW_S = 0.25


@dataclasses.dataclass(frozen=True)
class LiveSettings(PipelineSettings, FileSettings):
    """Motion capture of cameras until Ctrl-C, or until the recordings end.

    Where several people are followed, each has a folder ``person-N`` in ``out`` besides.

    Attributes:
        sources: cameras such as realsense:SERIAL or left=azure:SERIAL, each with a mode if you like
            ("azure:SERIAL?mode=nfov&fps=15", "realsense:SERIAL?size=848x480"), recordings, or synthetic.
        rig: a rig.json that tells where the cameras stand; recordings know.
        out: folder for pose.csv, files of other formats and summary.json.
        record: a new MCAP file (.mcap) for every frame as it came.
        realtime: play a recording at its own speed, as if it were cameras; otherwise as fast as the machine can, and
            no set is left out.
        seconds: stop so long after it was ready for poses.
        wait_ms: how long a set waits for a camera that is late.
        rate_hz: sets a second; by default the fastest camera's rate.
        triggered: the cameras expose together, by a wire.
        stream: send every result to another program as soon as it is known: osc://HOST:PORT, vmc://HOST:PORT,
            ws://HOST:PORT (of this machine; 0.0.0.0 lets others connect), lsl://NAME (Lab Streaming Layer, whose ports
            are open on all interfaces). May be given several times.
    """

    sources: tyro.conf.Positional[tuple[str, ...]]
    rig: Path | None = None
    out: Path | None = None
    record: Path | None = None
    realtime: bool = False
    seconds: float | None = None
    wait_ms: float = SyncSettings().wait_ms
    rate_hz: float | None = None
    triggered: bool = False
    stream: tyro.conf.UseAppendAction[tuple[str, ...]] = ()


@locks_outputs(folder="out")
def run_live(settings: LiveSettings, console: Console | None = None) -> RunResult:
    """Run until the end, ``seconds`` or Ctrl-C, and write all results.

    Raises:
        InputError: when a setting is out of range, a source is not what it says, no camera can be opened, or no set
            came at all.
    """
    console = console or Terminal(stderr=True)
    if not settings.sources:
        raise InputError("name at least one camera or recording: depthmocap cameras lists cameras")
    if settings.seconds is not None and not settings.seconds > 0:
        raise InputError(f"--seconds must be positive, got {settings.seconds}")
    check_above_0({"--rate-hz": settings.rate_hz})
    check_at_least(0, {"--wait-ms": settings.wait_ms})
    take = Take("live", settings.sources, "z", settings)
    if settings.record is not None:
        check_name("--record", settings.record)
    with contextlib.ExitStack() as stack:
        capture = stack.enter_context(_make_capture(settings, console))
        if settings.record is not None:
            if isinstance(capture, Replay):
                raise InputError("--record needs --realtime: played as fast as it goes, a recording is only read")
            rig = Rig(tuple(capture.reader.cameras.values()), capture.up)
            backgrounds = {name: raw for name, raw in capture.raw_backgrounds().items() if name in rig.names}
            writer = stack.enter_context(McapWriter(settings.record, rig, backgrounds))
            capture.reader.recorder = McapRecorder(writer, capture.reader.camera)
            stack.callback(capture.stop)  # before the file is closed, into which cameras write
        if settings.out is not None:
            remove_results(settings.out)
        take.up = capture.up
        files = stack.enter_context(PoseFiles(settings.out, take))
        people_files = None
        if settings.out is not None and settings.people > 1:
            people_files = stack.enter_context(PeopleFiles(settings.out, take))
        if settings.seconds is not None and isinstance(capture, LiveCapture):
            capture.stop_after(settings.seconds)
        _write_poses(capture, take, files, people_files, settings.seconds, console)
    if not capture.statistics.poses:
        problems = joined(capture.problems, 3)
        if capture.sets_before_ready:
            raise InputError(
                f"no set of frames came once it was ready for poses, and {capture.sets_before_ready} before; on a new "
                f"machine that takes longest: try again{problems and f' ({problems})'}"
            )
        raise InputError(f"no set of frames came: {problems or 'are the cameras running?'}")
    _report(files.summary, settings, console)
    if settings.out is not None:
        for problem in write_more_formats(settings, settings.out):
            console.print(f"• {problem}")
    return RunResult(settings.out, files.summary)


def _make_capture(settings: LiveSettings, console: Console) -> LiveCapture | Replay:
    make_pipeline = functools.partial(load_pipeline, settings=settings)
    rig = load_rig(settings.rig) if settings.rig else None
    sync = SyncSettings(settings.rate_hz or 30.0, settings.wait_ms, triggered=settings.triggered)
    if not settings.realtime and len(settings.sources) == 1 and Path(settings.sources[0]).exists():
        with console.status("reading the background and the weights"):
            recording = open_recording(Path(settings.sources[0]), rig)
            sync = dataclasses.replace(sync, rate_hz=settings.rate_hz or 1e9 / recording.period_ns)
            if settings.stream:
                raise InputError("--stream needs --realtime: played as fast as it goes, a recording is not live")
            return Replay(recording, sync, make_pipeline)

    def tell(line: str) -> None:
        console.print(f"• {line}")

    sources = make_sources(settings.sources, PlaybackClock(1.0), tell)
    return LiveCapture(sources, rig, None, sync, settings.rate_hz is None, make_pipeline, tell, settings.stream)


def _write_poses(
    capture: LiveCapture | Replay,
    take: Take,
    files: PoseFiles,
    people_files: PeopleFiles | None,
    seconds: float | None,
    console: Console,
) -> None:
    """Write poses until the end."""
    start_s = drawn_s = time.monotonic()
    interrupted, poses_taken = False, 0
    with Live(console=console, auto_refresh=False, transient=True) as screen:
        try:
            for live_pose in capture:
                if not poses_taken:  # the time of preparation does not count
                    start_s = time.monotonic() - live_pose.latency_ms * 1e-3
                poses_taken += 1
                take.begin(live_pose.synced.timestamp_ns)
                assert capture.pipeline is not None
                # The first poses of a filter with delay are not final.
                delay = capture.pipeline.smoothing.delay_frames if capture.pipeline.smoothing else 0
                if poses_taken > delay:
                    files.write(live_pose.pose)
                if people_files is not None:
                    people_files.write(live_pose.result.final)
                now = time.monotonic()
                if now - drawn_s >= DRAW_S:
                    drawn_s = now
                    picture = draw_dashboard(
                        capture.statuses(), capture.statistics, capture.dropped, now - start_s, list(capture.problems)
                    )
                    screen.update(picture, refresh=True)
                if seconds is not None and now - start_s >= seconds:
                    break
        except KeyboardInterrupt:
            interrupted = True
        statuses = capture.statuses()
    with deferred_interrupts():
        _finish_files(capture, files, people_files, statuses, time.monotonic() - start_s, interrupted)


def _finish_files(
    capture: LiveCapture | Replay,
    files: PoseFiles,
    people_files: PeopleFiles | None,
    statuses: list[CameraStatus],
    seconds: float,
    interrupted: bool,
) -> None:
    """Write the poses that filters still hold, and give ``files`` the numbers of the summary."""
    for pose in capture.pipeline.finish() if capture.pipeline else []:
        files.write(pose)
    if people_files is not None and capture.pipeline is not None:
        people_files.write(capture.pipeline.finish_people())
    smoothing = capture.pipeline.smoothing if capture.pipeline else None
    cameras = {status.name: dataclasses.asdict(status) for status in statuses}
    files.numbers = {
        **capture.statistics.summary(),
        "seconds": seconds,
        "frames_per_second": capture.statistics.poses / max(seconds, 1e-9),
        "interrupted": interrupted,
        "sets_dropped": capture.dropped,
        "sets_before_ready": capture.sets_before_ready,
        "smoothing": smoothing.describe() if smoothing else None,
        "cameras": cameras,
        "frames_by_camera": {name: status["counts"].get("used", 0) for name, status in cameras.items()},
        "cameras_apart_cm": {name: 100 * apart_m for name, apart_m in capture.apart_m().items()},
        "problems": {**capture.problems, **dict.fromkeys(people_files.problems if people_files else (), 1)},
    }


def _report(summary: Summary, settings: LiveSettings, console: Console) -> None:
    latency = summary["latency_ms"] or {"p50": float("nan"), "p95": float("nan")}
    console.print(
        f"{summary['frames']} poses in {summary['seconds']:.1f} s ({summary['frames_per_second']:.1f} a second), "
        f"{summary['sets_dropped']} sets dropped, {summary['sets_before_ready']} before it was ready; "
        f"latency {latency['p50']:.0f} ms (p95 {latency['p95']:.0f} ms)"
    )
    for line in [*(unsure_lines(summary) if settings.out else []), *problem_lines(summary["problems"])]:
        console.print(f"• {line}")
    for path in (settings.out, settings.record):
        if path is not None:
            console.print(f"written to {path}")
