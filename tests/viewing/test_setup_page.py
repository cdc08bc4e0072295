"""The page of cameras that are being set up."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rig_states import rig_state
from viewer_client import ViewerClient

from depthmocap.frames import FrameSet
from depthmocap.recordings.open_recording import open_recording
from depthmocap.rigging.setup_page import SetupPage
from depthmocap.viewing.viewer_page import Page


@pytest.fixture(scope="module")
def frames(recording: Path) -> FrameSet:
    return open_recording(recording)[0]


def until(true: Callable[[], bool]) -> bool:
    """Wait for something to become true."""
    end_s = time.monotonic() + 10
    while not true() and time.monotonic() < end_s:
        time.sleep(0.005)
    return true()


def test_what_is_known_is_shown_and_the_rig_can_be_taken(page: Page, frames: FrameSet) -> None:
    shown = SetupPage(page, ("synthetic",))
    shown.show(rig_state(frames, 30.0, 8.0))
    assert not shown.status.content  # nobody looks on
    with ViewerClient(page) as client:
        state = rig_state(frames, 30.0, 8.0, faults={"cam1": "<b>dark</b>"}, calibration=None, drawn=None)
        shown.show(state)
        assert "&lt;b&gt;dark" in shown.status.content and shown.take.disabled and not shown.floor.visible
        shown.show(rig_state(frames, 30.0, 8.0))
        assert "± 30.0 mm, 0.20°: fair" in shown.pairs.content and "cam2: 30 Hz" in shown.status.content
        assert shown.floor.visible and np.asarray(shown.floor.image).any()
        assert set(shown._pictures) == {"cam0", "cam1", "cam2"}
        client.set(shown.take, True)
        assert until(shown.taken.is_set)
    shown.clear()


def test_devices_get_other_names_and_modes(page: Page) -> None:
    shown = SetupPage(page, ("azure:1", "left=realsense:2?fps=15", "walk.mcap"))
    with ViewerClient(page) as client:
        (_, _, first, _), (_, _, second, mode) = shown.fields
        assert (first.value, second.value, mode.value) == ("azure-1", "left", "fps=15")
        client.set(second, "right")
        client.set(mode, "")
        assert until(lambda: mode.value == "")
        client.set(shown.apply, True)
        assert until(lambda: shown.wanted is not None)
    assert shown.wanted == ("azure-1=azure:1", "right=realsense:2", "walk.mcap")
    shown.clear()
