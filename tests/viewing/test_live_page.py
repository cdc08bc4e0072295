"""The page of a capture, with browsers that read, that stall, and that send nonsense."""

from __future__ import annotations

import dataclasses
import time
import types
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from live_fakes import Controls, Status
from samples import sample_of, standing_pose
from viewer_client import ViewerClient

from depthmocap.frames import FrameSet
from depthmocap.geometry import Rig
from depthmocap.recordings.open_recording import open_recording
from depthmocap.streaming.stream_protocol import Sample, StreamSetup
from depthmocap.viewing import live_page as module
from depthmocap.viewing.live_page import (
    CLOUD_S,
    LATE_CLOUD_S,
    LATE_DRAWING_S,
    LivePage,
    camera_words,
    following,
    labels_in_views,
)
from depthmocap.viewing.live_plots import LivePlots
from depthmocap.viewing.viewer_page import Page


def until(true: Callable[[], bool]) -> bool:
    """Wait for something to become true."""
    end_s = time.monotonic() + 10
    while not true() and time.monotonic() < end_s:
        time.sleep(0.005)
    return true()


@pytest.fixture
def frames(recording: Path) -> FrameSet:
    return open_recording(recording)[0]


@pytest.fixture
def live() -> Iterator[LivePage]:
    with Page("127.0.0.1", 0, "live") as page:
        shown = LivePage(page)
        shown.controls = Controls()
        yield shown


def begin(live: LivePage, frames: FrameSet) -> Callable[..., Sample]:
    """Start a page with the cameras of a set; gives what makes its samples."""
    live.start(StreamSetup(Rig(tuple(view.camera for view in frames.views))))

    def sample(number: int, *others: float) -> Sample:
        stamp = number * 33_000_000
        poses = [standing_pose(stamp, x) for x in (0.0, *others)]
        made = sample_of(*poses, frames=frames)
        return dataclasses.replace(made, monotonic_ns=time.monotonic_ns() - 20_000_000)

    return sample


def test_what_comes_is_drawn_while_somebody_looks(live: LivePage, frames: FrameSet) -> None:
    sample = begin(live, frames)
    live.send(sample(0))
    first, second, *_ = live._people
    assert not first._bones.visible  # nobody looks
    with ViewerClient(live.page) as client:
        live.send(sample(1, 1.0))
        assert first._bones.visible and second._bones.visible and first._trails.visible
        assert np.allclose(second._bones.points - first._bones.points, [1.0, 0, 0], atol=1e-6)
        assert live._drawing is not None and 5000 < len(live._drawing._cloud.points) <= 15_000
        assert first._label.text == "person 1" and "2 in view · 3 sets left out" in live.status.content
        assert "cam1: 12 Hz, 4 late" in live.status.content and "camera &lt;b&gt; was lost" in live.status.content
        assert client.read() > 10_000
    live.send(dataclasses.replace(sample(2), people={}))
    live.close()
    assert "has ended" in live.status.content


def test_a_machine_that_is_too_slow_draws_less_often(
    live: LivePage, frames: FrameSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    sample, controls, drawn, clouds_s = begin(live, frames), Controls(), list[int](), list[float]()
    live.controls = controls
    monkeypatch.setattr(live, "_draw_people", lambda sample, trails: drawn.append(len(drawn)))
    monkeypatch.setattr(live, "_draw_cloud", lambda sample: clouds_s.append(now_s))
    now_s = 100.0
    clock = types.SimpleNamespace(monotonic=lambda: now_s, monotonic_ns=time.monotonic_ns)
    monkeypatch.setattr(module, "time", clock)
    with ViewerClient(live.page):
        for i in range(60):
            now_s = 100 + i / 30
            controls.dropped += i == 30
            live.send(sample(i))
    assert len(drawn) - 30 == pytest.approx(1 / LATE_DRAWING_S, abs=1)
    late = sum(cloud_s >= 101 for cloud_s in clouds_s)
    assert len(clouds_s) - late == pytest.approx(1 / CLOUD_S, abs=2) and late <= 1 / LATE_CLOUD_S


def test_the_area_is_drawn_on_the_floor(live: LivePage) -> None:
    corners = ((0.0, 0.0), (2.0, 0.0), (2.0, 3.0))
    live.start(StreamSetup(Rig((), "y", corners)))
    assert live._drawing is not None
    border = live._drawing._area
    assert border.visible and np.allclose(border.points[:, 0, 1], 0.01)  # y is up
    assert np.allclose(border.points[:, 0, [0, 2]], corners) and np.allclose(border.points[2, 1, [0, 2]], corners[0])
    live.area_m = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))  # --area goes before it
    live.start(StreamSetup(Rig((), "y", corners)))
    assert np.allclose(live._drawing._area.points[1, 0], [1.0, 0.01, 0.0])


def test_a_page_of_ones_own_has_no_controls(live: LivePage, frames: FrameSet) -> None:
    live.controls = None
    sample = begin(live, frames)
    with ViewerClient(live.page):
        live.send(sample(0))
    assert "1 in view" in live.status.content and not hasattr(live, "record")
    live.close()


def test_cloud_and_pictures_by_body_part(live: LivePage, frames: FrameSet) -> None:
    sample = begin(live, frames)(0)
    labels = tuple(np.full(view.depth_m.shape, 29, np.uint8) for view in frames.views)
    person = dataclasses.replace(sample.result.people[0], labels=labels)
    none = tuple(np.zeros_like(each) for each in labels)
    sample = dataclasses.replace(sample, result=dataclasses.replace(sample.result, labels=none, people=(person,)))
    assert all((each == 29).all() for each in labels_in_views(sample))
    live.cloud.value, live.pictures.value = "by body part", "by body part"
    with ViewerClient(live.page):
        live.send(sample)
    assert live._drawing is not None
    assert len(np.unique(live._drawing._cloud.colors, axis=0)) == 1
    assert all(picture.visible and max(picture.image.shape) <= 320 for picture in live._pictures.values())


def test_clicks_reach_the_capture(live: LivePage, frames: FrameSet) -> None:
    sample, controls = begin(live, frames), live.controls
    assert isinstance(controls, Controls)
    with ViewerClient(live.page) as client, ViewerClient(live.page):
        live.send(sample(5))
        client.set(live.record, True)
        assert until(lambda: controls.recording == Path("take-1.mcap") and live.record.label == "Stop recording")
        client.set(live.record, True)
        assert until(lambda: controls.recording is None and live.file.value == "take-2")
        client.set(live.file, "bad")
        client.set(live.record, True)
        client.set(live.mark_button, True)
        assert until(lambda: controls.asked == [("trial 1", 5 * 33_000_000)] and live.marker.value == "trial 2")
        client.set(live.smoothing, "one-euro")
        client.set(live.count, 2)
        assert until(lambda: (controls.smoothing, controls.people) == ("one-euro", 2))
        client.set(live.background, True)
        assert until(lambda: "background" in controls.asked)
        controls.moved = ("cam1",)
        live._next_s.clear()
        live.send(sample(8))
        assert live.moved.value == "cam1"  # which was moved
        client.set(live.place, True)
        assert until(lambda: ("place", "cam1") in controls.asked)
        client.set(live.stop, True)
        assert until(lambda: live.stop.label == "Click again to stop") and "stop" not in controls.asked
        client.set(live.stop, True)
        assert until(lambda: "stop" in controls.asked)
    assert controls.recording is None


def test_a_browser_that_stalls_costs_nothing(live: LivePage, frames: FrameSet) -> None:
    sample = begin(live, frames)
    live.points.value = "50,000"
    buffer = live.page.server._websock_server._broadcast_buffer
    with ViewerClient(live.page), ViewerClient(live.page) as reader:  # the first never reads
        live.send(sample(0))
        messages, longest_s = len(buffer.message_from_id), 0.0
        for i in range(1, 25):
            live._next_s.clear()  # everything is drawn every time
            start_s = time.monotonic()
            live.send(sample(i))
            longest_s = max(longest_s, time.monotonic() - start_s)
            assert reader.read() > 0
        assert longest_s < 2.0
        assert len(buffer.message_from_id) < messages + 20  # nothing piles up
        with ViewerClient(live.page) as rude:
            rude.connection.send(b"\x00nonsense")
            assert until(lambda: len(live.page.server.get_clients()) == 2)  # is cut off
        live.send(sample(61))


def test_words_of_cameras() -> None:
    assert camera_words(Status("a"), 30.0, 0.012) == ("30 Hz, 12 mm from the others", None)
    text, colour = camera_words(Status("a", rate_hz=15.0, counts={"missing": 2}), 30.0, None)
    assert text == "15 Hz, 2 missing" and colour is not None
    assert camera_words(Status("a", "no frames"), 30.0, np.nan)[0] == "no frames"


def test_names_in_a_row() -> None:
    assert [following(name) for name in ("trial 3", "take-9", "walk", "")] == ["trial 4", "take-10", "walk 2", " 2"]


def test_rates_and_latencies_of_the_last_minute(live: LivePage) -> None:
    plots = LivePlots(live.page.server.gui)
    assert plots.words() == "measuring the rate"
    for i in range(30 * 90):
        plots.add(1000.0 + i / 30, 20.0 + (i % 30 == 0) * 30, i)
    times_s, rates, latencies_ms = plots.series()
    assert len(times_s) <= 61 and times_s[-1] == 0 and np.allclose(rates, 30)
    assert np.allclose(latencies_ms, [20.0, 50.0])
    assert plots.words() == "30 sets a second, 20 ms after the exposure"


def test_the_end_does_not_wait_for_a_browser_that_stalls() -> None:
    page = Page("127.0.0.1", 0, "live")
    with ViewerClient(page):
        points = np.zeros((200_000, 3), np.float32)
        cloud = page.server.scene.add_point_cloud("/cloud", points, np.zeros(points.shape, np.uint8))
        for i in range(20):
            cloud.points = points + i
            time.sleep(0.02)
        start_s = time.monotonic()
        page.close()
        assert time.monotonic() - start_s < 4  # and not viser's six
