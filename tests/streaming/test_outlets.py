"""Streams never hold up a capture, whatever they do."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fakes import Board, fake_pipeline
from samples import EMPTY_RIG, sample_of, standing_pose

import depthmocap
from depthmocap.errors import InputError
from depthmocap.realtime import live_capture
from depthmocap.recordings.recording_writer import RecordingWriter
from depthmocap.streaming import outlets as module
from depthmocap.streaming.outlets import Outlets
from depthmocap.streaming.stream_protocol import Marker, Sample, Stream, StreamSetup

SETUP = StreamSetup(EMPTY_RIG)


class Kept(Stream):
    """Keeps what it is sent; ``before`` is called first."""

    name = "kept"

    def __init__(self, before: Callable[[], object] = lambda: None) -> None:
        self.samples: list[Sample] = []
        self.events: list[str] = []
        self._before = before

    def start(self, setup: StreamSetup) -> None:
        self.events.append("start")

    def send(self, sample: Sample) -> None:
        self._before()
        self.samples.append(sample)

    def mark(self, marker: Marker) -> None:
        self.events.append(marker.text)

    def close(self) -> None:
        self.events.append("close")


def put(outlets: Outlets, number: int) -> None:
    sample = sample_of(standing_pose(number))
    outlets.send(sample.result, sample.frames, number, number)


def test_what_waits_is_sent_before_the_end() -> None:
    kept, told = Kept(), list[str]()
    outlets = Outlets([kept], told.append)
    outlets.start(SETUP)
    put(outlets, 1)
    outlets.mark(Marker("trial 3", 2, 2))
    outlets.close()
    assert [sample.unix_ns for sample in kept.samples] == [1]
    assert sorted(kept.events) == ["close", "start", "trial 3"] and kept.events[-1] == "close"
    assert told == []
    put(outlets, 2)  # nobody is there
    assert len(kept.samples) == 1


def test_a_slow_stream_gets_the_newest_and_nobody_waits_for_it() -> None:
    free, taken = threading.Event(), threading.Event()

    def wait() -> None:
        taken.set()
        free.wait(10)

    kept, told = Kept(wait), list[str]()
    outlets = Outlets([kept], told.append)
    outlets.start(SETUP, at_once=True)
    put(outlets, 0)
    assert taken.wait(10)
    start_s = time.monotonic()
    for i in range(1, 100):
        put(outlets, i)
    assert time.monotonic() - start_s < 1
    free.set()
    outlets.close()
    assert [sample.unix_ns for sample in kept.samples] == [0, 99]
    assert len(told) == 98
    assert set(told) == {"kept takes longer than sets come: it gets the newest, not every one"}


def test_what_a_stream_raises_is_told_once() -> None:
    class Failing(Kept):
        def send(self, sample: Sample) -> None:
            super().send(sample)
            raise OSError(f"nobody is there, {len(self.samples)}")

    failing, told = Failing(), list[str]()
    outlets = Outlets([failing], told.append)
    outlets.start(SETUP)
    for i in range(3):
        put(outlets, i)
        while len(failing.samples) <= i:
            time.sleep(0.001)
    outlets.close()
    assert told == ["kept: nobody is there, 1; the capture goes on"]


def test_a_start_that_fails_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RETRY_S", 0.001)
    started = threading.Event()

    class Late(Kept):
        def start(self, setup: StreamSetup) -> None:
            super().start(setup)
            if len(self.events) < 3:
                raise InputError("the port is taken")
            started.set()

    late, told = Late(), list[str]()
    outlets = Outlets([late], told.append)
    outlets.start(SETUP)
    assert started.wait(10)
    put(outlets, 7)
    outlets.close()
    assert late.events == ["start", "start", "start", "close"] and len(late.samples) == 1
    assert told == ["kept: the port is taken; the capture goes on"]
    with pytest.raises(InputError, match="the port is taken"):
        Outlets([Late()], told.append).start(SETUP, at_once=True)


def test_one_that_hangs_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CLOSE_S", 0.05)
    for_ever = threading.Event()
    outlets = Outlets([Kept(for_ever.wait), kept := Kept()], print)
    outlets.start(SETUP)
    put(outlets, 1)
    outlets.close()
    assert kept.events == ["start", "close"]
    for_ever.set()


def test_somebody_whom_a_filter_goes_on_with_keeps_the_number() -> None:
    kept = Kept()
    outlets = Outlets([kept], print)
    outlets.start(SETUP)
    two, nobody = sample_of(standing_pose(1), standing_pose(1, 1.0)), sample_of()
    bridged = sample_of(standing_pose(2)).result
    for result in (two.result, dataclasses.replace(bridged, people=()), nobody.result):
        count = len(kept.samples)
        outlets.send(result, two.frames, 0, 0)
        while len(kept.samples) == count:
            time.sleep(0.001)
    outlets.close()
    assert [list(sample.people) for sample in kept.samples] == [[1, 2], [1], []]


@pytest.mark.parametrize("people", [1, 2])
def test_a_capture_sends_whole_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, people: int) -> None:
    monkeypatch.setattr(live_capture, "load_pipeline", lambda *arguments, **others: fake_pipeline(people=people))
    scene, path = Board(2), tmp_path / "recording"
    with RecordingWriter(path, scene.rig) as writer:
        for i in range(12):
            frames = {name: scene.depth(name, i * 0.04) for name in scene.rig.names}
            writer.write(1_700_000_000_000_000_000 + i * 40_000_000, frames)
    kept = Kept()
    day_ns = time.time_ns()
    results = list(depthmocap.live(path, streams=[kept], people=people))
    assert kept.events == ["start", "close"]
    by_time = {result.pose.timestamp_ns: result for result in results}
    assert kept.samples and all(sample.result is by_time[sample.monotonic_ns] for sample in kept.samples)
    assert all(list(sample.people) == [1] for sample in kept.samples)
    assert any(len(sample.frames.views) == 2 for sample in kept.samples)  # a busy machine may leave one out
    np.testing.assert_array_equal(kept.samples[-1].people[1].joints, results[-1].people[0].pose.joints)
    ages_s = [(sample.unix_ns - day_ns) * 1e-9 for sample in kept.samples]
    assert ages_s == sorted(ages_s) and -1 < ages_s[0] < 60
