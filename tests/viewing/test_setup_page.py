"""The page of cameras that are being set up."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rig_states import rig_state
from viewer_client import ViewerClient

from depthmocap.cameras.source import ConnectedCamera
from depthmocap.frames import FrameSet
from depthmocap.recordings.open_recording import open_recording
from depthmocap.rigging import setup_page
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
        first, second, _ = shown.rows
        assert (first.name.value, second.name.value, second.mode.value) == ("azure-1", "left", "fps=15")
        client.set(second.name, "right")
        client.set(second.mode, "")
        assert until(lambda: second.mode.value == "")
        client.set(shown.apply, True)
        assert until(lambda: shown.wanted is not None)
    assert shown.wanted == ("azure-1=azure:1", "right=realsense:2", "walk.mcap") and shown.others == ()
    shown.clear()


def test_cameras_are_left_out_found_and_added(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    found = [ConnectedCamera(spec, "", "") for spec in ("azure:1", "azure:3")]
    monkeypatch.setattr(setup_page, "find_cameras", lambda: (found, {"openni": "pip install it"}))
    shown = SetupPage(page, ("azure:1", "walk.mcap"), ("realsense:2",))
    with ViewerClient(page) as client:
        client.set(shown.look, True)
        assert until(lambda: len(shown.rows) == 4)
        used = {row.spec: row.used for row in shown.rows}
        assert {spec: box.value for spec, box in used.items()} == {
            "azure:1": True, "walk.mcap": True, "realsense:2": False, "azure:3": False,
        }  # fmt: skip
        client.set(used["azure:1"], False)
        client.set(used["azure:3"], True)
        client.set(shown.added, " kinect2:4 ")
        assert until(lambda: shown.added.value == " kinect2:4 ")
        client.set(shown.apply, True)
        assert until(lambda: shown.wanted is not None)
    assert shown.wanted == ("walk.mcap", "azure-3=azure:3", "kinect2:4")
    assert shown.others == ("azure-1=azure:1", "realsense-2=realsense:2")
    shown.clear()
