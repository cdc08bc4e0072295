"""The next set is looked at while the joints of this one are made."""

from __future__ import annotations

import itertools
import threading
from typing import Any

import pytest
from camera_simulator import SimulatedCamera, Simulation
from fakes import Board, FakeClassifier, FakeEstimator

from depthmocap.calibration.rig_watch import RigWatch
from depthmocap.cameras.source import DepthFrame
from depthmocap.frames import FrameSet
from depthmocap.offline.pipeline import Pipeline
from depthmocap.pose.cloud import LabelledCloud
from depthmocap.realtime.live_capture import LiveCapture
from depthmocap.realtime.look_ahead import LookAhead
from depthmocap.realtime.sync import SyncSettings
from depthmocap.segment.people_segmenter import PeopleSegmenter

RATE = 20.0


class Timed(Pipeline):
    """Takes a while for each half, and keeps in which order they began and ended."""

    def __init__(
        self, virtual: Any, label_s: float, estimate_s: float, fails_at: int = -1, spared_share: float = 1.0
    ) -> None:
        super().__init__(FakeClassifier(), FakeEstimator(), PeopleSegmenter({}, mode="none"), "z")
        self.events: list[tuple[str, int]] = []
        self.threads: set[int] = set()
        self.spared: list[bool] = []
        self._virtual, self._fails_at = virtual, fails_at
        self._seconds, self._spared_share = (label_s, estimate_s), spared_share

    def label(self, frames: Any, sparing: bool = False) -> Any:
        self.threads.add(threading.get_ident())
        self.spared.append(sparing)
        self.events.append(("label", frames.timestamp_ns))
        if sum(what == "label" for what, _ in self.events) == self._fails_at:
            raise RuntimeError("the network is gone")
        self._virtual.sleep(self._seconds[0] * (self._spared_share if sparing else 1.0))
        self.events.append(("labelled", frames.timestamp_ns))
        return super().label(frames, sparing)

    def estimate(self, labelled: Any) -> Any:
        self.events.append(("estimate", labelled.frames.timestamp_ns))
        self._virtual.sleep(self._seconds[1])
        self.events.append(("estimated", labelled.frames.timestamp_ns))
        return super().estimate(labelled)


def capture_of(virtual: Any, pipeline: Pipeline, seconds: float, overlap: bool) -> LiveCapture:
    simulation = Simulation(Board(2), RATE, seconds)
    sources = [SimulatedCamera(simulation, name, virtual.monotonic_ns()) for name in simulation.scene.rig.names]
    return LiveCapture(sources, None, pipeline, SyncSettings(RATE), False, overlap=overlap)


def test_halves_overlap_and_poses_keep_their_order(virtual: Any) -> None:
    poses = {}
    for overlap in (False, True):
        pipeline = Timed(virtual, 0.04, 0.03)
        with capture_of(virtual, pipeline, 2.0, overlap) as capture:
            stamps = [live.pose.timestamp_ns for live in capture]
        assert all(a < b for a, b in itertools.pairwise(stamps))
        for what in ("label", "labelled", "estimate", "estimated"):  # each half takes sets in order, none twice
            of_half = [stamp for kind, stamp in pipeline.events if kind == what]
            assert of_half == stamps
        assert len(pipeline.threads) == 1 and threading.get_ident() not in pipeline.threads
        poses[overlap] = len(stamps)
        assert len(stamps) + capture.dropped == pytest.approx(40, abs=1)
    # One after the other, a set takes 70 ms of the 50 that there are; overlapped, none is left out.
    assert poses[True] >= 39 and poses[False] < 32


def test_late_it_labels_fewer_views_and_compares_cameras_by_sets_that_are_labelled_whole(
    virtual: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    watched: list[int] = []

    def watch(self: RigWatch, frames: FrameSet, cloud: LabelledCloud | None) -> list[str]:
        if cloud is not None:
            watched.append(frames.timestamp_ns)
        return []

    monkeypatch.setattr(RigWatch, "__call__", watch)
    pipeline = Timed(virtual, 0.06, 0.01, spared_share=0.5)  # of the 50 ms that there are
    with capture_of(virtual, pipeline, 6.0, overlap=True) as capture:
        stamps = [live.pose.timestamp_ns for live in capture]
    late = pipeline.spared.index(True)
    assert late < 5
    whole = [i for i, spared in enumerate(pipeline.spared) if not spared]
    assert whole[:late] == list(range(late)) and all(b - a == 24 for a, b in itertools.pairwise(whole[late:]))
    assert watched == [stamps[i] for i in whole]
    assert capture.dropped < 4  # without it there were twenty

    quick = Timed(virtual, 0.04, 0.03)
    with capture_of(virtual, quick, 2.0, overlap=True) as capture:
        assert len(list(capture)) >= 39
    assert not any(quick.spared)


def test_a_slow_consumer_gets_the_newest_set(virtual: Any) -> None:
    ages_s, pipeline = [], Timed(virtual, 0.01, 0.01)
    with capture_of(virtual, pipeline, 10.0, overlap=True) as capture:
        for live in capture:
            ages_s.append(virtual.monotonic() - live.synced.timestamp_ns * 1e-9)
            virtual.sleep(0.42)
    assert max(ages_s[2:-1]) < 2 / RATE  # after the last one no newer comes
    assert not any(pipeline.spared)  # it is not the machine that is late


def test_every_frame_is_recorded_while_sets_are_left_out(virtual: Any) -> None:
    class Recorder:
        def __init__(self) -> None:
            self.frames: list[tuple[str, int]] = []

        def write(self, frame: DepthFrame) -> None:
            self.frames.append((frame.camera, frame.timestamp_ns))

    recorder = Recorder()
    capture = capture_of(virtual, Timed(virtual, 0.12, 0.1), 2.0, overlap=True)
    capture.reader.recorder = recorder
    with capture:
        poses = sum(1 for _ in capture)
    assert poses < 20 and capture.dropped > 20
    assert len(set(recorder.frames)) == len(recorder.frames) == 80


def test_an_error_of_the_first_half_comes_after_the_poses_before_it(virtual: Any) -> None:
    for overlap in (False, True):
        pipeline, poses = Timed(virtual, 0.01, 0.01, fails_at=5), []
        with (
            pytest.raises(RuntimeError, match="the network is gone"),
            capture_of(virtual, pipeline, 2.0, overlap) as capture,
        ):
            poses.extend(capture)
        assert len(poses) == 4
        assert not any(thread.name == "look ahead" and thread.is_alive() for thread in threading.enumerate())


def test_changes_are_made_between_two_sets(virtual: Any) -> None:
    pipeline = Timed(virtual, 0.02, 0.02)
    with capture_of(virtual, pipeline, 2.0, overlap=True) as capture:
        for i, _ in enumerate(capture):
            if i == 5:
                capture.before_next_set(lambda: pipeline.events.append(("change", 0)))
            if i == 10:
                break
        count = len(pipeline.events)
    place = pipeline.events.index(("change", 0))
    begun, ended = (sum(kind == what for kind, _ in pipeline.events[:place]) for what in ("label", "estimated"))
    assert begun == ended == 7  # nothing was under way
    assert len(pipeline.events) == count  # whoever leaves has waited for what was


def test_calls_are_made_when_asked_for_and_not_before() -> None:
    calls = itertools.count()
    with LookAhead(lambda: next(calls)) as ahead:
        for i in range(3):
            ahead.begin()
            assert ahead.result() == i
    assert next(calls) == 3 and ahead.leaving


def test_it_is_left_while_it_waits_for_what_does_not_come() -> None:
    begun = threading.Event()

    def wait() -> None:
        begun.set()
        while not ahead.leaving:
            pass

    ahead = LookAhead(wait)
    with ahead:
        ahead.begin()
        assert begun.wait(10)
