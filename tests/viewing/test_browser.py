"""A real browser on a real page: it loads, asks nothing of other machines, the skeleton moves, and controls work."""

from __future__ import annotations

import dataclasses
import itertools
import math
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from live_fakes import Controls
from rig_states import rig_state
from samples import sample_of, standing_pose

from depthmocap.geometry import Rig
from depthmocap.recordings.open_recording import open_recording
from depthmocap.streaming.stream_protocol import StreamSetup

pytestmark = pytest.mark.slow
_SOFTWARE = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium without a window; tests are skipped where it, or playwright, is absent."""
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        pytest.skip("no Chromium on this machine")
    api = pytest.importorskip("playwright.sync_api", reason="no playwright to drive Chromium with")
    with api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=chromium, headless=True, args=list(_SOFTWARE))
        yield started
        started.close()


def until(true: Callable[[], bool], seconds: float = 30.0) -> bool:
    """Wait for something to become true."""
    end_s = time.monotonic() + seconds
    while not true() and time.monotonic() < end_s:
        time.sleep(0.05)
    return true()


def moved(page: Any, before: bytes) -> Callable[[], bool]:
    """Whether the picture of the scene differs from an earlier one."""
    return lambda: page.locator("canvas").first.screenshot() != before


def test_a_take_in_a_browser(browser: Any, result: Path) -> None:
    from depthmocap.viewing.take_page import TakePage
    from depthmocap.viewing.viewed_take import open_take
    from depthmocap.viewing.viewer_page import Page

    with Page("127.0.0.1", 0, "depthmocap") as served, TakePage(served, open_take((result,))) as view:
        asked: set[str | None] = set()
        faults: list[str] = []
        page = browser.new_page(viewport={"width": 1200, "height": 800})
        page.on("request", lambda request: asked.add(urlsplit(request.url).hostname))
        page.on("websocket", lambda socket: asked.add(urlsplit(socket.url).hostname))
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto(served.url)
        page.get_by_text("frame 0 of 7").wait_for(timeout=60_000)
        second = browser.new_page(viewport={"width": 400, "height": 300})
        second.goto(served.url)
        assert until(lambda: len(served.server.get_clients()) == 2)

        view.cloud.value = "off"
        view.player.redraw()
        until(lambda: not view.drawing._cloud.visible)
        time.sleep(1.0)
        before = page.locator("canvas").first.screenshot()
        page.get_by_role("button", name="+1", exact=True).click()
        assert until(lambda: view.player.index == 1)
        page.get_by_text("frame 1 of 7").wait_for()
        assert until(moved(page, before))  # the skeleton
        page.keyboard.press("End")
        assert until(lambda: view.player.index == 7)
        page.get_by_role("button", name="Play").click()
        assert until(lambda: view.player.playing)
        second.close()  # which stops nothing
        seen: set[int] = set()
        assert until(lambda: not seen.add(view.player.index) and len(seen) > 3)
        assert not faults
        assert asked - {None, ""} == {"127.0.0.1"}


def test_a_capture_in_a_browser(browser: Any, recording: Path) -> None:
    from depthmocap.viewing.live_page import LivePage
    from depthmocap.viewing.viewer_page import Page

    frames, controls = open_recording(recording)[0], Controls()
    ended = threading.Event()

    def send() -> None:
        """Somebody who walks, at twenty sets a second."""
        for i in itertools.count():
            if ended.wait(0.05):
                return
            sample = sample_of(standing_pose(i * 50_000_000, 0.5 * math.sin(i / 10)), frames=frames)
            live.send(dataclasses.replace(sample, monotonic_ns=time.monotonic_ns()))

    with Page("127.0.0.1", 0, "live") as served:
        live = LivePage(served)
        live.controls = controls
        live.start(StreamSetup(Rig(tuple(view.camera for view in frames.views))))
        sender = threading.Thread(target=send, daemon=True)
        sender.start()
        page, asked = browser.new_page(viewport={"width": 1200, "height": 800}), set[str | None]()
        page.on("request", lambda request: asked.add(urlsplit(request.url).hostname))
        page.goto(served.url)
        page.get_by_text("1 in view").wait_for(timeout=60_000)
        assert until(moved(page, page.locator("canvas").first.screenshot()))
        page.get_by_role("button", name="Set marker").click()
        page.get_by_role("button", name="Record", exact=True).click()
        assert until(lambda: controls.recording == Path("take-1.mcap"))
        assert [text for text, _ in controls.asked] == ["trial 1"]
        page.close()  # and the capture goes on
        stamp = live._stamp_ns
        assert until(lambda: live._stamp_ns != stamp)
        ended.set()
        sender.join(5)
    assert asked - {None, ""} == {"127.0.0.1"}


def test_a_rig_that_is_set_up_in_a_browser(browser: Any, recording: Path) -> None:
    from depthmocap.rigging.setup_page import SetupPage
    from depthmocap.viewing.viewer_page import Page

    frames = open_recording(recording)[0]
    with Page("127.0.0.1", 0, "setup") as served:
        shown = SetupPage(served, ("azure:1", "azure:2"))
        page, asked = browser.new_page(viewport={"width": 1200, "height": 900}), set[str | None]()
        page.on("request", lambda request: asked.add(urlsplit(request.url).hostname))
        page.goto(served.url)
        assert until(lambda: bool(served.server.get_clients()), 60)
        shown.show(rig_state(frames, 30.0, 8.0, calibration=None, drawn=None))
        page.get_by_text("No two cameras are placed yet").wait_for(timeout=60_000)
        shown.show(rig_state(frames, 30.0, 8.0))
        page.get_by_text("± 30.0 mm, 0.20°: fair").wait_for()
        page.get_by_role("button", name="Take the rig as it is").click()
        assert until(shown.taken.is_set)
        page.get_by_role("tab", name="Cameras").click()
        page.get_by_text("Which cameras").click()
        page.get_by_role("button", name="Open them so").click()
        assert until(lambda: shown.wanted == ("azure-1=azure:1", "azure-2=azure:2"))
        assert asked - {None, ""} == {"127.0.0.1"}
        shown.clear()
        assert page.get_by_text("Which cameras").count() == 0 or until(
            lambda: page.get_by_text("Which cameras").count() == 0
        )
