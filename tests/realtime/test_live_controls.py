"""A capture is changed while it runs: recordings, filters, people, the empty scene, markers; and by a page."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fakes import Board, fake_pipeline

from depthmocap.cameras.playback_clock import PlaybackClock
from depthmocap.cameras.registry import make_sources
from depthmocap.cli import main
from depthmocap.errors import InputError
from depthmocap.exporting.stored_result import read_result
from depthmocap.frames import Pose
from depthmocap.offline.pipeline_settings import PipelineSettings
from depthmocap.realtime import live_capture as live_module
from depthmocap.realtime import live_command as command
from depthmocap.realtime.live_capture import LiveCapture
from depthmocap.realtime.live_command import LiveSettings, run_live
from depthmocap.realtime.live_controls import LiveControls
from depthmocap.realtime.take_recording import TakeRecording
from depthmocap.recordings.open_recording import open_recording
from depthmocap.recordings.recording_writer import RecordingWriter

SETS = 50


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two seconds of a board."""
    for module in (live_module, command):
        monkeypatch.setattr(module, "load_pipeline", lambda *arguments, **others: fake_pipeline())
    scene, path = Board(2), tmp_path / "recording"
    with RecordingWriter(path, scene.rig) as writer:
        for i in range(SETS):
            frames = {name: scene.depth(name, i * 0.04) for name in scene.rig.names}
            writer.write(1_700_000_000_000_000_000 + i * 40_000_000, frames)
    return path


@pytest.fixture
def capture(recording: Path) -> Iterator[LiveCapture]:
    """A capture of it in real time."""
    sources = make_sources([str(recording)], PlaybackClock(1.0))
    with LiveCapture(sources, make_pipeline=live_module.load_pipeline) as running:
        yield running


def controls_of(capture: LiveCapture, folder: Path) -> tuple[LiveControls, TakeRecording, list[Pose]]:
    held: list[Pose] = []
    recording = TakeRecording(capture)
    settings = PipelineSettings(segment="none")
    return LiveControls(capture, settings, recording, folder, lambda poses, more: held.extend(poses)), recording, held


def test_takes_are_recorded_one_after_the_other(capture: LiveCapture, tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    controls, recording, _ = controls_of(capture, tmp_path)
    with recording:
        for i, _ in enumerate(capture):
            if i == 2:
                controls.record("walk")
                assert controls.recording == tmp_path / "walk.mcap"
                with pytest.raises(InputError, match="stop it first"):
                    controls.record("other")
            if i == 12:
                controls.stop_recording()
                controls.stop_recording()  # once is enough
                with pytest.raises(InputError, match="there already"):
                    controls.record("walk.mcap")
                for name in ("", "../walk", "a/b", "nul", ".hidden"):
                    with pytest.raises(InputError, match="cannot be a file's name"):
                        controls.record(name)
            if i == 14:
                controls.record("sit")
            if i == 20:
                controls.stop()
    assert recording.written == [tmp_path / "walk.mcap", tmp_path / "sit.mcap"] and controls.recording is None
    for path in recording.written:
        made = open_recording(path)
        assert made.complete and len(made) > 2


def test_filters_and_people_change_between_sets(capture: LiveCapture, tmp_path: Path) -> None:
    controls, _, held = controls_of(capture, tmp_path)
    before = None
    for i, _ in enumerate(capture):
        assert capture.pipeline is not None
        if i == 2:
            controls.smooth("fixed-lag")
            controls.follow(2)
            controls.learn_background()
            controls.mark("trial 3")
            before = capture.pipeline.segment
        if i == 4:
            assert capture.pipeline.smoothing is not None and capture.pipeline.smoothing.delay_frames == 4
            assert capture.pipeline.segment is not before and capture.pipeline.segment.people == 2
            assert (controls.smoothing, controls.people) == ("fixed-lag", 2)
        if i == 10:
            controls.smooth("none")
        if i == 12:
            assert capture.pipeline.smoothing is None and len(held) == 4
            controls.stop()
    assert [marker.text for marker in controls.markers] == ["trial 3"] and controls.poses > 12
    for wrong in (lambda: controls.smooth("magic"), lambda: controls.follow(0)):
        with pytest.raises(InputError):
            wrong()


def test_a_page_beside_the_capture(recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("viser")
    from viewer_client import ViewerClient
    from websockets.exceptions import ConnectionClosed

    from depthmocap.viewing.live_page import LivePage

    opened, out = list[LivePage](), tmp_path / "out"
    original = command._open_page

    def open_page(*arguments: Any) -> LivePage:
        opened.append(original(*arguments))
        return opened[0]

    def browse() -> None:
        while not opened or not hasattr(opened[0], "stop"):
            time.sleep(0.01)
        page = opened[0]
        with ViewerClient(page.page) as client:
            while page._stamp_ns is None:
                client.read()
            client.set(page.mark_button, True)
            while page.marker.value == "trial 1":
                client.read()
            client.set(page.stop, True)
            client.set(page.stop, True)
            with contextlib.suppress(ConnectionClosed):
                while True:
                    client.read()

    monkeypatch.setattr(command, "_open_page", open_page)
    browser = threading.Thread(target=browse, daemon=True)
    browser.start()
    settings = LiveSettings((str(recording),), out=out, realtime=True, view=True, open=False, port=0)
    summary = run_live(settings).summary
    browser.join(10)
    assert 0 < summary["frames"] < SETS
    stored = read_result(out)
    (marker,) = stored.markers
    stamps = stored.people[0].table.stamps_ns
    assert marker.text == "trial 1" and marker.timestamp_ns in stamps
    assert np.isfinite(stored.people[0].table.joints).any()


def test_a_recording_at_full_speed_has_no_page(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("viser")
    assert main(["live", str(recording), "--view", "--port", "0", "--no-open"]) == 2
    assert "--view needs --realtime" in capsys.readouterr().err
