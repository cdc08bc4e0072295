"""Motion capture of cameras as they deliver: sources in, poses out, with the least delay that the machine allows."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from jaxtyping import Float, UInt16
from numpy import ndarray

from depthmocap.cameras.playback_clock import PlaybackClock
from depthmocap.cameras.registry import make_sources
from depthmocap.cameras.source import DepthSource
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, FrameSource, Pose
from depthmocap.geometry import Rig, check_placed, load_rig
from depthmocap.offline.pipeline import Pipeline, Result
from depthmocap.offline.pipeline_settings import PipelineSettings, load_pipeline
from depthmocap.pose.extrinsics_check import Agreement
from depthmocap.realtime.gather import Gatherer
from depthmocap.realtime.ingest import Intake, frame_set, recorded_frames
from depthmocap.realtime.status import Books, CameraStatus, camera_statuses
from depthmocap.realtime.sync import SyncedSet, SyncSettings
from depthmocap.recordings.open_recording import open_recording, packaged_recording
from depthmocap.recordings.recording import Recording

#: Making the pipeline is told of when it takes longer.
SLOW_S = 2.0
#: Makes a pipeline for what brings frames, or knows the empty scenes: ``load_pipeline``, with its settings.
PipelineMaker: TypeAlias = Callable[[FrameSource], Pipeline]


@dataclasses.dataclass(frozen=True, eq=False)
class LivePose:
    """A pose, the frames it was found in, and the milliseconds from the last one's arrival until it was known."""

    pose: Pose
    synced: SyncedSet
    result: Result
    latency_ms: float


class EmptyScenes(FrameSource):
    """What is known of the empty scenes before the first frame, in the form of a recording without frames."""

    def __init__(self, rig: Rig, backgrounds: dict[str, Float[ndarray, "_ _"]]) -> None:
        self.up, self.camera_names, self._backgrounds = rig.up, rig.names, backgrounds

    def background(self, name: str) -> Float[ndarray, "h w"] | None:
        """Depth of the empty scene in metres, where the camera brings it."""
        return self._backgrounds.get(name)

    def __len__(self) -> int:
        return 0

    def __getitem__(self, index: int) -> FrameSet:
        raise IndexError("there are no frames")


class LiveCapture:
    """A running motion capture; a context manager, and an iterator of :class:`LivePose`.

    When the machine is too slow it leaves out sets and never lags behind.
    """

    def __init__(
        self,
        sources: Sequence[DepthSource],
        rig: Rig | None = None,
        pipeline: Pipeline | None = None,
        sync: SyncSettings | None = None,
        measure_rate: bool = True,
        make_pipeline: PipelineMaker = load_pipeline,
        tell: Callable[[str], None] = lambda line: None,
    ) -> None:
        """
        Args:
            rig: where the cameras stand; by default what the sources know.
            pipeline: what makes poses of sets; by default one is made for the empty scenes. Those that the sources do
                not know are learnt while it runs.
            sync: how frames form sets, see :class:`Gatherer`.
            measure_rate: whether the rate of sets follows the cameras.
            make_pipeline: makes the default one.
            tell: takes a line about what takes long.
        """
        self._tell, self._seconds = tell, 0.0
        self._timer: threading.Timer | None = None
        self._sources, self._pipeline, self._make_pipeline = list(sources), pipeline, make_pipeline
        self.gatherer = Gatherer(sources, rig, sync, measure_rate)
        self.books, self._agreement = Books(), Agreement()
        #: Sets that came while the pipeline was made ready, and have no pose.
        self.before_ready = 0
        self.up = rig.up if rig else (sources[0].up if sources else "z")

    @property
    def pipeline(self) -> Pipeline | None:
        """What makes poses of sets; None until the first set."""
        return self._pipeline

    def __enter__(self) -> LiveCapture:
        """Open the cameras, and before that compile what poses need, so that nothing waits for it later.

        Raises:
            InputError: when no pipeline can be made, no camera can be opened, or nobody has told where they stand.
        """
        if self._pipeline is None:
            slow = "making ready for poses; on a machine that is new to it this takes minutes, because it is compiled"
            with _told_if_slow(slow, self._tell):
                rehearse(self._make_pipeline)
        self.gatherer.start(self._tell)
        try:
            check_placed(self.gatherer.cameras.values())
        except InputError:
            self.gatherer.stop()
            raise
        return self

    def __exit__(self, *failure: object) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self.gatherer.stop()

    def stop(self) -> None:
        """End the iteration, from any thread."""
        self.gatherer.stop()

    def stop_after(self, seconds: float) -> None:
        """End the iteration so long after it is ready for poses; after now, if no set comes until then."""
        self._seconds = seconds
        self._start_timer()

    def _start_timer(self) -> None:
        # Cameras that deliver nothing give no occasion to look at the time.
        self._timer = threading.Timer(self._seconds, self.stop)
        self._timer.daemon = True
        self._timer.start()

    @property
    def problems(self) -> dict[str, int]:
        """What a user should know, one line each, and how often it was so."""
        return self.gatherer.problems.told()

    @property
    def dropped(self) -> int:
        """Sets that were left out because the machine was too slow."""
        return self.gatherer.dropped

    def raw_backgrounds(self) -> dict[str, UInt16[ndarray, "_ _"]]:
        """Raw depth of the empty scene, of the cameras that know it."""
        opened = self.gatherer.cameras
        found = {source.name: source.raw_background for source in self._sources if source.name in opened}
        return {name: raw for name, raw in found.items() if raw is not None}

    def apart_m(self) -> dict[str, float]:
        """How far apart cameras see the person (metres): see ``pose.agreement``."""
        return self._agreement.apart_m()

    def statuses(self) -> list[CameraStatus]:
        """Every camera now."""
        return self.gatherer.statuses()

    def __iter__(self) -> Iterator[LivePose]:
        sets = self.gatherer.sets()
        for synced in sets:
            if self._pipeline is None:
                self._pipeline = self._begin(frame_set(synced, self.gatherer.cameras))
                self.before_ready = self.gatherer.forget_dropped() + 1
                continue
            result = self._pipeline(frame_set(synced, self.gatherer.cameras))
            self.gatherer.problems.update(self._agreement(result.cloud))
            last_ns = max(frame.arrival_ns for frame in synced.frames.values())
            latency_ms = (time.monotonic_ns() - last_ns) * 1e-6
            yield _booked(self.books, LivePose(result.pose, synced, result, latency_ms))
        self.gatherer.problems.update(self._agreement.finish())

    def _begin(self, frames: FrameSet) -> Pipeline:
        """The default pipeline, warm; takes the first set for it."""
        cameras = self.gatherer.cameras
        raw = {name: raw for name, raw in self.raw_backgrounds().items() if name in cameras}
        backgrounds = {name: cameras[name].to_metres(each) for name, each in raw.items()}
        scenes = EmptyScenes(Rig(tuple(cameras.values()), self.up), backgrounds)
        if self._timer is not None:
            self._timer.cancel()
        pipeline = warm(self._make_pipeline(scenes), frames)
        if self._timer is not None:
            self._start_timer()
        return pipeline


@contextlib.contextmanager
def _told_if_slow(line: str, tell: Callable[[str], None]) -> Iterator[None]:
    """Tell the line if what is done meanwhile takes long."""
    timer = threading.Timer(SLOW_S, lambda: tell(line))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def rehearse(make_pipeline: PipelineMaker) -> None:
    """Compile the inner loops: a pipeline of this kind takes a set of the packaged recording, where a person is in view
    and the empty scene known. In front of one's own cameras a person may come at any time, and would wait for it."""
    recording = open_recording(packaged_recording())
    make_pipeline(recording)(recording[0])


def warm(pipeline: Pipeline, frames: FrameSet) -> Pipeline:
    """The pipeline after a set that counts for nothing: what is made on first use is made."""
    pipeline(frames)
    pipeline.reset()
    return pipeline


class Replay:
    """A recording through the same stages in its own time, as fast as the machine can; no set is left out.

    It is used like a :class:`LiveCapture`. The latency is that of the pipeline.
    """

    dropped = before_ready = 0

    def __init__(
        self,
        recording: Recording,
        sync: SyncSettings | None = None,
        make_pipeline: PipelineMaker = load_pipeline,
    ) -> None:
        """``make_pipeline`` is given the recording, which brings its background."""
        self.pipeline = make_pipeline(recording)
        self.intake = Intake(sync or SyncSettings(rate_hz=1e9 / recording.period_ns))
        self.books, self._agreement, self.up = Books(), Agreement(), recording.up
        self._recording, self._now_ns = recording, 0
        for camera in recording.rig.cameras:
            if recording.stamps(camera.name):
                self.intake.add_camera(camera)
        self.intake.problems.update([*recording.problems, *self.pipeline.segment.problems])

    def __enter__(self) -> Replay:
        return self

    def __exit__(self, *failure: object) -> None:
        """Nothing is held open."""

    @property
    def problems(self) -> dict[str, int]:
        """What a user should know, one line each, and how often it was so."""
        return self.intake.problems.told()

    def apart_m(self) -> dict[str, float]:
        """How far apart cameras see the person (metres): see ``pose.agreement``."""
        return self._agreement.apart_m()

    def statuses(self) -> list[CameraStatus]:
        """Every camera now."""
        return camera_statuses(self.intake, dict.fromkeys(self.intake.cameras, "running"), self._now_ns)

    def __iter__(self) -> Iterator[LivePose]:
        for synced in self.intake.run(recorded_frames(self._recording, self.intake.problems)):
            self._now_ns = synced.timestamp_ns
            begun = time.perf_counter()
            result = self.pipeline(frame_set(synced, self.intake.cameras))
            latency_ms = (time.perf_counter() - begun) * 1e3
            self.intake.problems.update(self._agreement(result.cloud))
            yield _booked(self.books, LivePose(result.pose, synced, result, latency_ms))
        self.intake.problems.update(self._agreement.finish())


def _booked(books: Books, live: LivePose) -> LivePose:
    seen = bool(live.pose.confidence.max() > 0)
    present = tuple(person.number for person in live.result.people)
    books.add(live.result.milliseconds, live.latency_ms, live.synced.skew_ns * 1e-6, seen, present)
    return live


def live(
    *sources: str | Path | DepthSource,
    rig: Rig | Path | None = None,
    settings: PipelineSettings | None = None,
    **changes: Any,
) -> Iterator[Pose]:
    """Poses of one person as cameras deliver; recordings play at their own speed.

    Sets are left out while the machine is too slow: :class:`Replay` goes through a recording as a whole.

    Args:
        sources: cameras as ``depthmocap record`` names them, recordings, or opened by yourself.
        rig: where the cameras stand, or its rig.json; recordings know.
        settings: of the pipeline, by default the usual ones.
        changes: single settings that differ, as in ``live("recording", smooth="none")``.

    Raises:
        InputError: when a source is not what it says, or no camera can be opened.
    """
    for live_pose in _captured(sources, rig, settings or PipelineSettings(), changes):
        yield live_pose.pose


def live_people(
    *sources: str | Path | DepthSource,
    people: int = 2,
    rig: Rig | Path | None = None,
    settings: PipelineSettings | None = None,
    **changes: Any,
) -> Iterator[dict[int, Pose]]:
    """Poses of up to so many people by their numbers, which stay theirs, set by set; otherwise as :func:`live`.

    Raises:
        InputError: see :func:`live`, or when ``people`` is less than one.
    """
    for live_pose in _captured(sources, rig, settings or PipelineSettings(), {**changes, "people": people}):
        yield {person.number: person.pose for person in live_pose.result.people}


def _captured(
    sources: Sequence[str | Path | DepthSource],
    rig: Rig | Path | None,
    settings: PipelineSettings,
    changes: dict[str, Any],
) -> Iterator[LivePose]:
    """What comes of the sources by the pipeline of these settings."""
    playback_clock = PlaybackClock(1.0)
    opened: list[DepthSource] = []
    for source in sources:
        opened += [source] if isinstance(source, DepthSource) else make_sources([str(source)], playback_clock)
    rig = load_rig(rig) if isinstance(rig, Path) else rig
    make_pipeline = functools.partial(load_pipeline, settings=settings, **changes)
    with LiveCapture(opened, rig, make_pipeline=make_pipeline) as capture:
        yield from capture
