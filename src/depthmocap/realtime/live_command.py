"""``depthmocap live``: motion capture of cameras, or of a recording in their place, with a dashboard."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import tyro
from rich.console import Console
from rich.live import Live

from depthmocap.cameras.playback_clock import PlaybackClock
from depthmocap.cameras.registry import make_sources
from depthmocap.core.console import Terminal
from depthmocap.core.interrupts import deferred_interrupts
from depthmocap.core.key_presses import key_presses
from depthmocap.core.locks import locks_outputs
from depthmocap.core.settings import check_above_0, check_at_least
from depthmocap.errors import InputError, missing_extra
from depthmocap.exporting.edits import Edits, TakeMarker, write_edits
from depthmocap.exporting.export_command import write_more_formats
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.result_files import PeopleFiles, PoseFiles, remove_results
from depthmocap.exporting.run_result import RunResult
from depthmocap.exporting.stored_result import read_result
from depthmocap.exporting.summary import Summary, Take, problem_lines, unsure_lines
from depthmocap.frames import Pose
from depthmocap.geometry import load_rig
from depthmocap.geometry.depth_camera import time_offsets_s
from depthmocap.offline.pipeline_settings import RIG_AREA, PipelineSettings, load_pipeline
from depthmocap.realtime.dashboard import draw_dashboard
from depthmocap.realtime.live_capture import LiveCapture
from depthmocap.realtime.live_controls import LiveControls
from depthmocap.realtime.recorded_capture import RecordedCapture
from depthmocap.realtime.status import CameraStatus
from depthmocap.realtime.sync import SyncSettings
from depthmocap.realtime.take_recording import TakeRecording
from depthmocap.recordings.mcap_writer import check_name
from depthmocap.recordings.open_recording import open_recording
from depthmocap.streaming.stream_protocol import Stream
from depthmocap.text import joined, offset_lines

if TYPE_CHECKING:
    from depthmocap.viewing.live_page import LivePage
    from depthmocap.viewing.viewer_page import Page

#: Seconds from one drawing of the dashboard to the next.
DRAW_S = 0.25
#: The key in the terminal that places the camera anew that was moved last.
PLACE_KEY = "p"


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
        stream: send every result to another program as soon as it is known: osc://HOST:PORT, vmc://HOST:PORT, or
            ws://HOST:PORT and foxglove://HOST:PORT of this machine (0.0.0.0 lets others connect), or lsl://NAME (Lab
            Streaming Layer, whose ports are open on all interfaces). May be given several times.
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
    view: bool = False
    host: str = "127.0.0.1"
    port: int = 8080
    open: bool = True


@locks_outputs(folder="out")
def run_live(settings: LiveSettings, console: Console | None = None, served: Page | None = None) -> RunResult:
    """Run until the end, ``seconds`` or Ctrl-C, and write all results.

    Args:
        served: a page that is served already and empty, for --view.

    Raises:
        InputError: when a setting is out of range, a source is not what it says, no camera can be opened, or no set
            came at all.
    """
    console = console or Terminal(stderr=True)
    _check_settings(settings)
    take = Take("live", settings.sources, "z", settings)
    with contextlib.ExitStack() as stack:
        page = _open_page(settings, stack, served) if settings.view else None
        capture = _make_capture(settings, console, () if page is None else (page,))
        files: PoseFiles | None = None
        people_files: PeopleFiles | None = None
        recording: TakeRecording | None = None
        controls: LiveControls | None = None
        markers: Sequence[TakeMarker] = ()

        def write_held(poses: Sequence[Pose], of_people: Mapping[int, Sequence[Pose]]) -> None:
            for pose in poses:
                if files is not None:
                    files.write(pose)
            if people_files is not None:
                people_files.write(of_people)

        if isinstance(capture, LiveCapture):
            recording = TakeRecording(capture)
            folder = settings.record.parent if settings.record else settings.out or Path()
            controls = LiveControls(capture, settings, recording, folder, write_held, settings.rig)
            markers = controls.markers
            if page is not None:
                page.controls = controls
        stack.enter_context(capture)
        if recording is not None and isinstance(capture, LiveCapture):
            stack.enter_context(recording)
            stack.callback(capture.stop)  # before a file is closed, into which cameras write
            if settings.record is not None:
                recording.begin(settings.record)
        if page is not None and served is None:
            _tell_page(page, settings.open, console)
        if settings.out is not None:
            remove_results(settings.out)
        take.up = capture.up
        if capture.area_m and not settings.area:
            console.print(f"• {RIG_AREA}")
        files = stack.enter_context(PoseFiles(settings.out, take))
        if settings.out is not None and (settings.people > 1 or page is not None):
            people_files = stack.enter_context(PeopleFiles(settings.out, take))
        if settings.seconds is not None and isinstance(capture, LiveCapture):
            capture.stop_after(settings.seconds)
        if controls is not None and stack.enter_context(key_presses(functools.partial(_press, controls, console))):
            console.print(f"• {PLACE_KEY} places a camera anew that was moved while it ran")
        _write_poses(capture, take, files, people_files, settings.seconds, console)
    _check_any_poses(capture)
    _report(files.summary, settings.out, recording.written if recording is not None else (), console)
    if settings.out is not None:
        _write_further(settings, settings.out, markers, console)
    return RunResult(settings.out, files.summary)


def _write_further(settings: LiveSettings, out: Path, markers: Sequence[TakeMarker], console: Console) -> None:
    """Write the files that are made of whole takes: further formats, and the markers."""
    for problem in write_more_formats(settings, out, markers):
        console.print(f"• {problem}")
    _write_markers(out, markers)


def _tell_page(page: LivePage, opens: bool, console: Console) -> None:
    console.print(f"• open {page.page.url} in a browser")
    if opens:
        page.page.open_browser()


def _press(controls: LiveControls, console: Console, key: str) -> None:
    """Do what a key asks for."""
    if key.lower() != PLACE_KEY:
        return
    if not controls.moved:
        console.print("• no camera was moved that is not placed anew")
        return
    try:
        console.print(f"• {controls.place_anew(controls.moved[0])}")
    except InputError as error:
        console.print(f"• {error}")


def _check_settings(settings: LiveSettings) -> None:
    if not settings.sources:
        raise InputError("name at least one camera or recording: depthmocap cameras lists cameras")
    if settings.seconds is not None and not settings.seconds > 0:
        raise InputError(f"--seconds must be positive, got {settings.seconds}")
    check_above_0({"--rate-hz": settings.rate_hz})
    check_at_least(0, {"--wait-ms": settings.wait_ms})
    if settings.record is not None:
        check_name("--record", settings.record)


def _check_any_poses(capture: LiveCapture | RecordedCapture) -> None:
    if capture.statistics.poses:
        return
    problems = joined(capture.problems, 3)
    if capture.sets_before_ready:
        raise InputError(
            f"no set of frames came once it was ready for poses, and {capture.sets_before_ready} before; on a new "
            f"machine that takes longest: try again{problems and f' ({problems})'}"
        )
    raise InputError(f"no set of frames came: {problems or 'are the cameras running?'}")


def _open_page(settings: LiveSettings, stack: contextlib.ExitStack, served: Page | None) -> LivePage:
    """The page of --view, served until the stack ends.

    Raises:
        InputError: when it cannot be served, or viser is not installed.
    """
    try:
        from depthmocap.viewing.live_page import LivePage
        from depthmocap.viewing.viewer_page import Page
    except ModuleNotFoundError:
        raise missing_extra("viser", "view") from None
    page = LivePage(served or stack.enter_context(Page(settings.host, settings.port, "depthmocap live")))
    page.area_m = tuple(zip(settings.area[::2], settings.area[1::2], strict=True))
    return page


def _make_capture(settings: LiveSettings, console: Console, viewers: Sequence[Stream]) -> LiveCapture | RecordedCapture:
    """``viewers`` get every result, as the streams of the settings do."""
    make_pipeline = functools.partial(load_pipeline, settings=settings)
    rig = load_rig(settings.rig) if settings.rig else None
    sync = SyncSettings(settings.rate_hz or 30.0, settings.wait_ms, triggered=settings.triggered)

    def tell(line: str) -> None:
        console.print(f"• {line}")

    if not settings.realtime and len(settings.sources) == 1 and Path(settings.sources[0]).exists():
        with console.status("reading the background and the weights"):
            recording = open_recording(Path(settings.sources[0]), rig)
            sync = dataclasses.replace(sync, rate_hz=settings.rate_hz or 1e9 / recording.period_ns)
            if settings.stream or viewers:
                option = "--stream" if settings.stream else "--view"
                raise InputError(f"{option} needs --realtime: played as fast as it goes, a recording is not live")
            if settings.record is not None:
                raise InputError("--record needs --realtime: played as fast as it goes, a recording is only read")
            replay = RecordedCapture(recording, sync, make_pipeline)
        for line in replay.pipeline.devices.lines():
            tell(line)
        return replay
    sources = make_sources(settings.sources, PlaybackClock(1.0), tell)
    streams = (*settings.stream, *viewers)
    return LiveCapture(sources, rig, None, sync, settings.rate_hz is None, make_pipeline, tell, streams)


def _write_poses(
    capture: LiveCapture | RecordedCapture,
    take: Take,
    files: PoseFiles,
    people_files: PeopleFiles | None,
    seconds: float | None,
    console: Console,
) -> None:
    """Write poses until the end."""
    start_s = drawn_s = time.monotonic()
    interrupted, poses_taken = False, 0
    watched = console.is_terminal or console.is_jupyter  # a file would get nothing of it
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
                if watched and now - drawn_s >= DRAW_S:
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
    capture: LiveCapture | RecordedCapture,
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
        "sets_labelled_in_part": capture.labelled_in_part,
        "sets_before_ready": capture.sets_before_ready,
        "smoothing": smoothing.describe() if smoothing else None,
        "devices": capture.pipeline.devices.running if capture.pipeline else {},
        "cameras": cameras,
        "frames_by_camera": {name: status["counts"].get("used", 0) for name, status in cameras.items()},
        "time_offsets_s": time_offsets_s(capture.cameras.values()),
        "recorded_minus_timestamp_ns": capture.recorded_minus_timestamp_ns,
        "cameras_apart_cm": {name: 100 * apart_m for name, apart_m in capture.apart_m().items()},
        "problems": {**capture.problems, **dict.fromkeys(people_files.problems if people_files else (), 1)},
    }


def _write_markers(out: Path, markers: Sequence[TakeMarker]) -> None:
    if markers:
        digest = read_result(out, edited=False).edits.digest
        write_edits(out, Edits(digest, markers=tuple(markers)))


def _report(summary: Summary, out: Path | None, recorded: Sequence[Path], console: Console) -> None:
    latency = summary["latency_ms"] or {"p50": float("nan"), "p95": float("nan")}
    console.print(
        f"{summary['frames']} poses in {summary['seconds']:.1f} s ({summary['frames_per_second']:.1f} a second), "
        f"{summary['sets_dropped']} sets dropped, {summary['sets_before_ready']} before it was ready; "
        f"latency {latency['p50']:.0f} ms (p95 {latency['p95']:.0f} ms)"
    )
    for line in [
        *offset_lines(summary["time_offsets_s"]),
        *(unsure_lines(summary) if out else []),
        *problem_lines(summary["problems"]),
    ]:
        console.print(f"• {line}")
    for path in (*([] if out is None else [out]), *recorded):
        console.print(f"written to {path}")
