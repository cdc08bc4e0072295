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
from depthmocap.geometry import load_rig, rigid_inverse, save_rig, transform_points
from depthmocap.offline.pipeline_settings import PipelineSettings
from depthmocap.realtime import live_capture as live_module
from depthmocap.realtime import live_command as command
from depthmocap.realtime.ingest import frame_set
from depthmocap.realtime.live_capture import LiveCapture
from depthmocap.realtime.live_command import LiveSettings, run_live
from depthmocap.realtime.live_controls import LiveControls
from depthmocap.realtime.take_recording import TakeRecording
from depthmocap.recordings.open_recording import open_recording
from depthmocap.recordings.recording_writer import RecordingWriter

SETS = 125


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Five seconds of a board."""
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
        if i == 7:
            controls.smooth("none")
        if i == 9:
            assert capture.pipeline.smoothing is None and len(held) == 4
            controls.stop()
    assert [marker.text for marker in controls.markers] == ["trial 3"] and controls.poses > 9
    for wrong in (lambda: controls.smooth("magic"), lambda: controls.follow(0)):
        with pytest.raises(InputError):
            wrong()


def test_a_camera_is_placed_anew_and_its_rig_written_beside(capture: LiveCapture, tmp_path: Path) -> None:
    controls, _, _ = controls_of(capture, tmp_path)
    save_rig(capture.rig, tmp_path / "rig.json")
    before = (tmp_path / "rig.json").read_bytes()
    name, other = capture.rig.names
    rng = np.random.default_rng(0)
    for i in range(100):  # a body of 18 joints that goes here and there, seen 0.3 m aside by the camera that was moved
        body, seen = rng.normal(0, 0.5, 3) + rng.normal(0, 0.3, (18, 3)), {}
        for each in (name, other):
            aside = np.array([0.3 if each == name else 0.0, 0.0, 0.0])
            own = transform_points(rigid_inverse(capture.cameras[each].world_from_camera), body + aside)
            seen[each] = np.concatenate([own, np.full((18, 1), 0.05)], 1)
        capture._rig_watch._kept.append((0.1 * i, seen))
    capture._rig_watch._moved_s[name] = 0.0
    assert controls.moved == (name,)
    start = capture.cameras[name].world_from_camera
    for i, live in enumerate(capture):
        if i == 2:
            told = controls.place_anew(name)
            assert "is placed anew: it had moved by 30." in told and str(tmp_path / "rig-2.json") in told
            assert str(tmp_path / "rig-3.json") in controls.place_anew(name)
        if i == 5:
            moved = {view.camera.name: view.camera for view in frame_set(live.synced, capture.cameras).views}
            step = moved[name].world_from_camera[:3, 3] - start[:3, 3]
            np.testing.assert_allclose(step, [-0.3, 0.0, 0.0], atol=1e-6)
            assert controls.moved == ()
            controls.stop()
    written = load_rig(tmp_path / "rig-2.json")[name].world_from_camera
    np.testing.assert_array_equal(written, capture.cameras[name].world_from_camera)
    assert (tmp_path / "rig.json").read_bytes() == before
    with pytest.raises(InputError, match="there is no camera 'x'"):
        controls.place_anew("x")


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
