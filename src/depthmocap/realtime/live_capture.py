"""Live motion capture: takes sources and gives poses, with the least delay that the machine allows."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import queue
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float, UInt16
from numpy import ndarray

from depthmocap.calibration.camera_replacement import Replacement, place_anew
from depthmocap.calibration.rig_watch import RigWatch
from depthmocap.cameras.playback_clock import PlaybackClock
from depthmocap.cameras.registry import make_sources
from depthmocap.cameras.source import DepthSource
from depthmocap.core.cores import usable_cores
from depthmocap.errors import InputError, missing_extra
from depthmocap.frames import FrameSet, FrameSource, Pose
from depthmocap.geometry import DepthCamera, Rig, check_extrinsics, load_rig
from depthmocap.offline.pipeline import LabelledSet, Pipeline, Result, mix_up_lines, warm_up
from depthmocap.offline.pipeline_settings import PipelineSettings, load_pipeline
from depthmocap.realtime.ingest import frame_set
from depthmocap.realtime.look_ahead import LookAhead
from depthmocap.realtime.mcap_recorder import McapRecorder
from depthmocap.realtime.status import CameraStatus, RunStatistics
from depthmocap.realtime.sync import SyncedSet, SyncSettings
from depthmocap.realtime.synced_reader import SyncedReader
from depthmocap.recordings.open_recording import open_recording, packaged_recording
from depthmocap.streaming.outlets import Outlets
from depthmocap.streaming.stream_protocol import Marker, Stream, StreamSetup

#: If making the pipeline takes longer (seconds), a message says so.
SLOW_S = 2.0
#: Where so many sets in a row were there before anybody was free for them, the machine is late: people are labelled in
#: some of the views that see them, in other ones in the next set,
_BEHIND = 3
#: for so long (seconds) after it was late last.
_SPARING_S = 10.0
#: One of so many sets is labelled whole all the same: by these the cameras are compared.
WHOLE_EVERY = 24
#: A consumer who is back within this (seconds) gets a set that was begun meanwhile.
_QUICK_S = 0.03
#: Frames over which the difference to a recording's clock is taken.
_FIRST_FRAMES = 300
#: Makes a pipeline for a source of frames or backgrounds, as ``load_pipeline`` does.
PipelineMaker: TypeAlias = Callable[[FrameSource], Pipeline]


@dataclasses.dataclass(frozen=True, eq=False)
class LivePose:
    """A pose, the frames from which it was estimated, and the milliseconds from the last arrival to the pose."""

    pose: Pose
    synced: SyncedSet
    result: Result
    latency_ms: float


@dataclasses.dataclass(frozen=True, eq=False)
class _LabelledSet:
    """A set on its way; ``whole`` if people are labelled in all views that see them."""

    synced: SyncedSet
    people: LabelledSet
    whole: bool


class BackgroundSource(FrameSource):
    """A source of backgrounds without frames: what is known of the empty scenes before the first frame."""

    def __init__(self, rig: Rig, backgrounds: dict[str, Float[ndarray, "_ _"]]) -> None:
        self.up, self.area_m, self.camera_names, self._backgrounds = rig.up, rig.area_m, rig.names, backgrounds

    def background(self, name: str) -> Float[ndarray, "h w"] | None:
        """Depth of the empty scene in metres; None if the camera's source does not know it."""
        return self._backgrounds.get(name)

    def __len__(self) -> int:
        return 0

    def __getitem__(self, index: int) -> FrameSet:
        raise IndexError("there are no frames")


class LiveCapture:
    """A running motion capture; a context manager, and an iterator of :class:`LivePose`.

    If the machine is too slow, it labels people in fewer views of a set; if that does not help, it leaves out sets and
    does not lag behind.
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
        streams: Iterable[Stream | str] = (),
        overlap: bool | None = None,
    ) -> None:
        """
        Args:
            rig: the poses of the cameras; by default the sources' own.
            pipeline: makes poses from sets; by default one is made for the backgrounds that the sources know. Others
                are learnt while it runs.
            sync: how frames form sets (:class:`SyncedReader`).
            measure_rate: whether the rate of sets is measured from the cameras.
            make_pipeline: makes the default pipeline.
            tell: is called with a line about steps that take long, and what streams tell.
            streams: get every result as soon as it is known: streams of your own, or addresses such as
                "osc://127.0.0.1:9000". A slow or failing one never holds up the capture.
            overlap: look for people in the next set while the joints of this one are made; by default where there is
                more than one core.

        Raises:
            InputError: when the address of a stream is wrong, or what it needs is not installed.
        """
        self._tell, self._seconds = tell, 0.0
        self._timer: threading.Timer | None = None
        self._sources, self._pipeline, self._make_pipeline = list(sources), pipeline, make_pipeline
        self.reader = SyncedReader(sources, rig, sync, measure_rate)
        self.statistics = RunStatistics()
        self._outlets = Outlets(streams, self.reader.problems.add)
        #: Adds to a time of ``time.monotonic_ns`` to give nanoseconds since 1970.
        self.unix_minus_monotonic_ns = time.time_ns() - time.monotonic_ns()
        #: Number of sets of which people were labelled in some of the views only, because the machine was late.
        self.labelled_in_part = 0
        #: Number of sets without a pose, because they came while the pipeline was prepared.
        self.sets_before_ready = 0
        self.up = rig.up if rig else (sources[0].up if sources else "z")
        self.area_m = rig.area_m if rig else (sources[0].area_m if sources else ())
        self._recorded_minus: list[int] = []
        self._rig_watch = RigWatch(self.up, explain=True)
        self._sparing_until_s, self._spared, self._held_s = 0.0, 0, 0.0
        self._between_sets: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._overlap = usable_cores() > 1 if overlap is None else overlap

    @property
    def recorded_minus_timestamp_ns(self) -> int | None:
        """What is added to the timestamps of poses for the times at which a recording has their frames: of the file
        that is recorded meanwhile, and of recordings that are played as cameras; None before the first pose."""
        return int(np.median(self._recorded_minus)) if self._recorded_minus else None

    @property
    def pipeline(self) -> Pipeline | None:
        """The pipeline that makes poses from sets; None until the first set."""
        return self._pipeline

    def __enter__(self) -> LiveCapture:
        """Compile the pipeline, so that no frame waits for it later, and open the cameras.

        Raises:
            InputError: when no pipeline can be made, no camera can be opened, or their poses are unknown.
        """
        people = 1 if self._pipeline is None else self._pipeline.segment.people
        if self._pipeline is None:
            slow = "making ready for poses; on a machine that is new to it this takes minutes, because it is compiled"
            with announce_if_slow(slow, self._tell):
                people = compile_pipeline(self._make_pipeline).segment.people
        self.reader.start(self._tell)
        try:
            check_extrinsics(self.reader.cameras.values())
        except InputError:
            self.__exit__()
            raise
        self._outlets.start(StreamSetup(self.rig, people, self._tell, self.reader.problems.add))
        return self

    def __exit__(self, *failure: object) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self.reader.stop()
        self._outlets.close()

    def stop(self) -> None:
        """End the iteration, from any thread."""
        self.reader.stop()

    def stop_after(self, seconds: float) -> None:
        """End the iteration this long after the capture is ready for poses, or from now if no set comes."""
        self._seconds = seconds
        self._start_timer()

    def _start_timer(self) -> None:
        # A timer, because without frames the loop does not run and cannot check the time.
        self._timer = threading.Timer(self._seconds, self.stop)
        self._timer.daemon = True
        self._timer.start()

    def before_next_set(self, call: Callable[[], None]) -> None:
        """Call a function in the iterating thread when no set is being processed, before the next one or the one after;
        from any thread. So a pipeline is changed between two sets."""
        self._between_sets.put(call)

    def mark(self, text: str) -> None:
        """Send a marker, such as "trial 3", to the streams that take markers, with the present time."""
        now_ns = time.monotonic_ns()
        self._outlets.mark(Marker(text, now_ns + self.unix_minus_monotonic_ns, now_ns))

    @property
    def problems(self) -> dict[str, int]:
        """Messages for the user, one line each, and how often each occurred."""
        return self.reader.problems.counts()

    @property
    def dropped(self) -> int:
        """Number of sets that were left out because the machine was too slow."""
        return self.reader.dropped

    def raw_backgrounds(self) -> dict[str, UInt16[ndarray, "_ _"]]:
        """Raw depth of the empty scene, by camera, for the sources that know it."""
        opened = self.reader.cameras
        backgrounds = {source.name: source.raw_background for source in self._sources if source.name in opened}
        return {name: raw for name, raw in backgrounds.items() if raw is not None}

    @property
    def cameras(self) -> dict[str, DepthCamera]:
        """The cameras that were opened and not removed, by name."""
        return self.reader.cameras

    @property
    def rig(self) -> Rig:
        """The same, with the world in which they stand."""
        return Rig(tuple(self.reader.cameras.values()), self.up, self.area_m)

    def apart_m(self) -> dict[str, float]:
        """How far apart the cameras see the person (metres), by the extrinsics check."""
        return self._rig_watch.distances_m()

    @property
    def moved(self) -> tuple[str, ...]:
        """Cameras that were moved while it ran and not placed anew, the last one first."""
        return self._rig_watch.moved

    def find_place(self, name: str) -> Replacement:
        """Where a camera stands by the joints of the last minute, or since it was moved; from any thread. It takes a
        second. :meth:`place` goes on with it.

        Raises:
            InputError: when there is no such camera, or too little of a person was seen.
        """
        return place_anew(name, self.cameras, self._rig_watch.moments(name), np.random.default_rng(0))

    def place(self, camera: DepthCamera) -> None:
        """Take a camera's pose for its own before the next set; from any thread."""

        def change() -> None:
            self.reader.place(camera)
            self._rig_watch.placed_anew(camera.name)

        self.before_next_set(change)

    def statuses(self) -> list[CameraStatus]:
        """The current status of every camera."""
        return self.reader.statuses()

    def __iter__(self) -> Iterator[LivePose]:
        ahead: LookAhead[_LabelledSet | None]

        def label_next() -> _LabelledSet | None:
            synced = next(sets, None)
            return None if synced is None or ahead.leaving else self._label(synced)

        sets = self.reader.sets(lambda: ahead.leaving)
        ahead = LookAhead(label_next)
        if self._pipeline is None:
            if (first := next(sets, None)) is None:
                return
            self._pipeline = self._make_warm_pipeline(frame_set(first, self.reader.cameras))
            self.reader.problems.update(self._pipeline.segment.problems)
            self.sets_before_ready = self.reader.reset_dropped() + 1
        with ahead:
            ahead.begin()
            while (labelled := ahead.result()) is not None:
                # A consumer who takes long gets the newest set then, not one that was begun long before.
                early = self._overlap and self._held_s < _QUICK_S and self._between_sets.empty()
                if early:
                    ahead.begin()
                pose = self._estimate(labelled)
                given_s = time.monotonic()
                yield pose
                self._held_s = time.monotonic() - given_s
                if not early:
                    while not self._between_sets.empty():
                        self._between_sets.get()()
                    ahead.begin()
        self.reader.problems.update(self._rig_watch.finish())

    def _label(self, synced: SyncedSet) -> _LabelledSet:
        """The first half of a set's way, while the set before is on the second."""
        assert self._pipeline is not None
        sparing = self._is_sparing()
        self._spared = self._spared + 1 if sparing else 0
        whole = not sparing or self._spared % WHOLE_EVERY == 0
        self.labelled_in_part += not whole
        frames = frame_set(synced, self.reader.cameras)
        return _LabelledSet(synced, self._pipeline.label(frames, sparing=not whole), whole)

    def _is_sparing(self) -> bool:
        """Whether the machine is late, or was just now; where the consumer takes long it is not the machine."""
        now_s = time.monotonic()
        if self.reader.behind >= _BEHIND and self._held_s < _QUICK_S:
            self._sparing_until_s = now_s + _SPARING_S
        return now_s < self._sparing_until_s

    def _estimate(self, labelled: _LabelledSet) -> LivePose:
        """The second half: the pose, which streams get first of all."""
        assert self._pipeline is not None
        synced, frames = labelled.synced, labelled.people.frames
        result = self._pipeline.estimate(labelled.people)
        self._send(result, frames)
        arrival_ns = max(frame.arrival_ns for frame in synced.frames.values())
        latency_ms = (time.monotonic_ns() - arrival_ns) * 1e-6
        self.reader.problems.update(self._rig_watch(frames, result.cloud if labelled.whole else None))
        self.reader.problems.update(mix_up_lines(result))
        if len(self._recorded_minus) < _FIRST_FRAMES:
            self._recorded_minus += [
                McapRecorder.recorded_ns(frame, self.unix_minus_monotonic_ns) - synced.times_ns[name]
                for name, frame in synced.frames.items()
            ]
        return count_pose(self.statistics, LivePose(result.pose, synced, result, latency_ms))

    def _send(self, result: Result, frames: FrameSet) -> None:
        """Hand a result to the streams, unless a filter that waits has no pose yet that is final."""
        assert self._pipeline is not None
        delay = self._pipeline.smoothing.delay_frames if self._pipeline.smoothing else 0
        if self.statistics.poses >= delay:
            exposed_ns = result.pose.timestamp_ns
            self._outlets.send(result, frames, exposed_ns + self.unix_minus_monotonic_ns, exposed_ns)

    def _make_warm_pipeline(self, frames: FrameSet) -> Pipeline:
        """Make the default pipeline and warm it up with the first set."""
        cameras = self.reader.cameras
        raw = {name: raw for name, raw in self.raw_backgrounds().items() if name in cameras}
        backgrounds = {name: cameras[name].to_metres(raw_depth) for name, raw_depth in raw.items()}
        scenes = BackgroundSource(self.rig, backgrounds)
        if self._timer is not None:
            self._timer.cancel()
        pipeline = warm_up(self._make_pipeline(scenes), frames)
        for line in pipeline.devices.lines():
            self._tell(line)
        if self._timer is not None:
            self._start_timer()
        return pipeline


@contextlib.contextmanager
def announce_if_slow(line: str, tell: Callable[[str], None]) -> Iterator[None]:
    """Call ``tell`` with the line if the body takes long."""
    timer = threading.Timer(SLOW_S, lambda: tell(line))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def compile_pipeline(make_pipeline: PipelineMaker) -> Pipeline:
    """Compile the inner loops by running a pipeline on a set of the packaged recording, which has a person and a
    background; gives that pipeline. Otherwise the first person in front of the cameras would wait for the
    compilation."""
    recording = open_recording(packaged_recording())
    pipeline = make_pipeline(recording)
    pipeline(recording[0])
    return pipeline


def count_pose(statistics: RunStatistics, live: LivePose) -> LivePose:
    """Count a pose in the statistics of a run, and give it."""
    visible = bool(live.pose.confidence.max() > 0)
    present = tuple(person.number for person in live.result.people)
    statistics.add(live.result.milliseconds, live.latency_ms, live.synced.skew_ns * 1e-6, visible, present)
    return live


def live(
    *sources: str | Path | DepthSource,
    rig: Rig | Path | None = None,
    viewer: int | None = None,
    streams: Iterable[Stream | str] = (),
    settings: PipelineSettings | None = None,
    **changes: Any,
) -> Iterator[Result]:
    """Results while cameras deliver, set by set; recordings play at their own speed.

    Sets are left out if the machine is too slow; :class:`RecordedCapture` leaves out none of a recording.

    Args:
        sources: cameras as ``depthmocap record`` names them, recordings, or your own sources.
        rig: the poses of the cameras, or the path of a rig.json; recordings have their own.
        viewer: port of a page on this machine that shows it in the browser, http://localhost:PORT.
        streams: get every result, too: addresses as ``--stream`` takes them, or streams of your own.
        settings: of the pipeline, by default the usual ones.
        changes: single settings that differ, as in ``live("recording", people=2)``.

    Raises:
        InputError: when a source or an address of a stream is not what it says, no camera can be opened, or the port is
            taken.
    """
    playback_clock = PlaybackClock(1.0)
    opened_sources: list[DepthSource] = []
    for source in sources:
        opened_sources += [source] if isinstance(source, DepthSource) else make_sources([str(source)], playback_clock)
    rig = load_rig(rig) if isinstance(rig, Path) else rig
    make_pipeline = functools.partial(load_pipeline, settings=settings or PipelineSettings(), **changes)
    with contextlib.ExitStack() as stack:
        pages = [] if viewer is None else [_page(viewer, stack)]
        capture = LiveCapture(opened_sources, rig, make_pipeline=make_pipeline, streams=[*pages, *streams])
        for live_pose in stack.enter_context(capture):
            yield live_pose.result


def _page(port: int, stack: contextlib.ExitStack) -> Stream:
    """A page that shows a capture, served until the stack ends."""
    try:
        from depthmocap.viewing.live_page import LivePage
        from depthmocap.viewing.viewer_page import Page
    except ModuleNotFoundError:
        raise missing_extra("viser", "view") from None
    return LivePage(stack.enter_context(Page("127.0.0.1", port, "depthmocap")))
