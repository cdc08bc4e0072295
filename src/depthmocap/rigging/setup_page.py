"""The page of cameras that are being set up: their pictures, what is wrong, the floor, and how well they are placed."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import viser

from depthmocap.cameras.registry import DeviceText, device_text, find_cameras
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera
from depthmocap.report.drawing import depth_picture
from depthmocap.rigging.floor_picture import floor_picture
from depthmocap.rigging.rig_faults import connection_faults
from depthmocap.rigging.rig_session import RigState
from depthmocap.viewing.display_colours import palette_colour
from depthmocap.viewing.live_page import words
from depthmocap.viewing.scene_drawing import SceneDrawing
from depthmocap.viewing.viewer_page import Page, as_html, every, plain

#: Longest side of a picture on the page (pixels).
_PICTURE_PX = 320
#: Points of the cloud.
_POINTS = 15_000
#: Seconds from one drawing of the cloud to the next.
_CLOUD_S = 0.5
_GRADES = {"good": "#6bd48a", "fair": "#ffd166", "poor": "#ff6b6b"}


@dataclasses.dataclass(frozen=True, eq=False)
class CameraRow:
    """Inputs of one camera: whether it is used, and of a device its name and mode."""

    spec: str
    device: DeviceText | None
    used: Any
    name: Any = None
    mode: Any = None

    def text(self) -> str:
        """The camera as the inputs have it."""
        if self.device is None:
            return self.spec
        return self.device.renamed(str(self.name.value).strip(), str(self.mode.value).strip())


class SetupPage:
    """The page, drawn by the thread that calls :meth:`show`.

    Attributes:
        taken: set when the user takes the rig as it is.
        wanted: other cameras, or the same with other names and modes, as the user asked; None if they did not.
        others: cameras that are known and left out.
    """

    def __init__(self, page: Page, specs: Sequence[str], others: Sequence[str] = ()) -> None:
        """``specs``: the cameras as the user named them."""
        self.page, self.taken = page, threading.Event()
        self.wanted: tuple[str, ...] | None = None
        self.others = tuple(others)
        self._scene: SceneDrawing | None = None
        self._placings, self._cloud_s = 0, 0.0
        gui = page.server.gui
        with page.server.atomic():
            page.server.scene.set_up_direction("+z")
            self.tabs = gui.add_tab_group()
            with self.tabs.add_tab("Set up", viser.Icon.RULER_MEASURE):
                self.status = gui.add_html("")
                self.floor = gui.add_image(np.zeros((2, 2, 3), np.uint8), label="floor", visible=False)
                self.pairs = gui.add_html("")
                self.take = gui.add_button("Take the rig as it is", icon=viser.Icon.CHECK, disabled=True)
            every(self.take, self.taken.set)
            self._pictures: dict[str, Any] = {}
            self.rows: list[CameraRow] = []
            self._cameras_tab = self.tabs.add_tab("Cameras", viser.Icon.CAMERA)
            with self._cameras_tab:
                self._folder = gui.add_folder("Which cameras", expand_by_default=False)
                with self._folder:
                    self.added = gui.add_text("Add", "", hint="such as realsense:SERIAL or left=azure:SERIAL?mode=nfov")
                    self.look = gui.add_button("Look for more")
                    self.apply = gui.add_button("Open them so")
                    for spec in (*specs, *others):
                        self._add_row(gui, spec, spec in specs)
        every(self.look, self._look)
        every(self.apply, self._apply)

    def _add_row(self, gui: viser.GuiApi, spec: str, used: bool) -> None:
        device = device_text(spec)
        shown = gui.add_checkbox(plain(spec if device is None else device.device), used)
        if device is None:
            self.rows.append(CameraRow(spec, None, shown))
            return
        name = gui.add_text("name", device.name)
        mode = gui.add_text("mode", device.mode, hint="such as mode=nfov&fps=15 or size=848x480")
        self.rows.append(CameraRow(spec, device, shown, name, mode))

    def _look(self) -> None:
        """Add what is connected besides, to be ticked."""
        self.page.tell("looking for cameras")
        connected, failures = find_cameras()
        known = {row.device.device for row in self.rows if row.device is not None}
        new = [camera.spec for camera in connected if not camera.problem and camera.spec not in known]
        with self._folder:
            for spec in new:
                self._add_row(self.page.server.gui, spec, False)
        for fault in connection_faults(connected, failures):
            self.page.tell(fault, wrong=True)
        self.page.tell(f"found besides: {', '.join(new) or 'none'}")

    def _apply(self) -> None:
        added = str(self.added.value).strip()
        self.others = tuple(row.text() for row in self.rows if not row.used.value)
        self.wanted = (*(row.text() for row in self.rows if row.used.value), *([added] if added else ()))

    def show(self, state: RigState) -> None:
        """Draw the state, for the browsers that look on."""
        if not self.page.server.get_clients():
            return
        colours = {name: palette_colour(i) for i, name in enumerate(state.cameras)}
        with self.page.server.atomic():
            self.status.content = words(state_lines(state))
            self.pairs.content = _pair_table(state)
            self.take.disabled = state.calibration is None
            if state.drawn is not None:
                self.floor.image, self.floor.visible = floor_picture(state.drawn, colours), True
            self._draw_room(state)
        for name, sight in state.sights.items():
            if name not in self._pictures:
                with self._cameras_tab:
                    self._pictures[name] = self.page.server.gui.add_image(
                        np.zeros((2, 2, 3), np.uint8), label=plain(name)
                    )
            step = max(-(-max(sight.depth_m.shape) // _PICTURE_PX), 1)
            depth_m = np.ascontiguousarray(sight.depth_m[::step, ::step])
            mask = None if sight.mask is None else sight.mask[::step, ::step]
            self._pictures[name].image = depth_picture(depth_m, mask)

    def _draw_room(self, state: RigState) -> None:
        """The cameras where they were placed last, and what they see."""
        if state.calibration is None:
            return
        rig = state.calibration.rig
        if state.placings != self._placings:
            self._placings, first = state.placings, self._scene is None
            self._scene = SceneDrawing(self.page.server, rig.cameras, rig.up)
            if first:
                self._scene.look_from(self.page.server, np.array([0.0, 0.0, 1.0]), rig.cameras)
        now_s = time.monotonic()
        if self._scene is not None and now_s >= self._cloud_s:
            self._cloud_s = now_s + _CLOUD_S
            self._scene.show_cloud(_views(rig.cameras, state), "camera", _POINTS)

    def clear(self) -> None:
        """Take everything off the page, which another begins with."""
        self.page.server.gui.reset()
        self.page.server.scene.reset()


def _views(cameras: Sequence[DepthCamera], state: RigState) -> list[View]:
    return [View(camera, state.sights[camera.name].depth_m) for camera in cameras if camera.name in state.sights]


def state_lines(state: RigState) -> list[str]:
    """The state in words: what to do, what is wrong, and how each camera does."""
    lines = [f"Next: {state.advice}."]
    for status in state.statuses:
        seen, frames = state.seen.get(status.name, (0, 0))
        does = state.faults.get(status.name) or f"{status.rate_hz:.0f} Hz"
        lines.append(f"{status.name}: {does} · the person in {seen} of {frames} frames")
    return [*lines, *state.problems[:4]]


def _pair_table(state: RigState) -> str:
    """Pairs of cameras and how well each is known, as HTML."""
    if state.calibration is None:
        return words(["No two cameras are placed yet."])
    rows = "".join(
        f"<tr><td>{as_html(' – '.join(pair.cameras))}</td><td style='color: {_GRADES[pair.grade]}'>"
        f"± {pair.uncertainty_mm:.1f} mm, {pair.uncertainty_deg:.2f}°: {pair.grade}</td></tr>"
        for pair in state.calibration.pairs
    )
    return f'<div style="padding: 0.4em 1em; font-size: 0.85em"><table>{rows}</table></div>'
