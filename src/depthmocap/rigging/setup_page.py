"""The page of cameras that are being set up: their pictures, what is wrong, the floor, and how well they are placed."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import viser

from depthmocap.cameras.registry import DeviceText, device_text
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera
from depthmocap.report.drawing import depth_picture
from depthmocap.rigging.floor_picture import floor_picture
from depthmocap.rigging.rig_session import RigState
from depthmocap.viewing.display_colours import palette_colour
from depthmocap.viewing.live_page import words
from depthmocap.viewing.scene_drawing import SceneDrawing
from depthmocap.viewing.viewer_page import Page, as_html, every, plain

#: Longest side of a picture on the page (pixels), and points of the cloud.
_PICTURE_PX, _POINTS = 320, 15_000
#: Seconds from one drawing of the cloud to the next.
_CLOUD_S = 0.5
_GRADES = {"good": "#6bd48a", "fair": "#ffd166", "poor": "#ff6b6b"}


class SetupPage:
    """The page, drawn by the thread that calls :meth:`show`.

    Attributes:
        taken: set when the user takes the rig as it is.
        wanted: cameras with other names and modes, as the user asked; None if they did not.
    """

    def __init__(self, page: Page, specs: Sequence[str]) -> None:
        """``specs``: the cameras as the user named them."""
        self.page, self.taken = page, threading.Event()
        self.wanted: tuple[str, ...] | None = None
        self._specs = tuple(specs)
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
            self.fields: list[tuple[str, DeviceText, Any, Any]] = []
            self._cameras_tab = self.tabs.add_tab("Cameras", viser.Icon.CAMERA)
            with self._cameras_tab:
                self._add_devices(gui)

    def _add_devices(self, gui: viser.GuiApi) -> None:
        devices = [(spec, device) for spec in self._specs if (device := device_text(spec)) is not None]
        if not devices:
            return
        with gui.add_folder("Names and modes", expand_by_default=False):
            for spec, device in devices:
                name = gui.add_text(plain(device.device), device.name)
                mode = gui.add_text("mode", device.mode, hint="such as mode=nfov&fps=15 or size=848x480")
                self.fields.append((spec, device, name, mode))
            self.apply = gui.add_button("Open them so")
        every(self.apply, self._apply)

    def _apply(self) -> None:
        changed = {
            spec: device.renamed(str(name.value).strip(), str(mode.value).strip())
            for spec, device, name, mode in self.fields
        }
        self.wanted = tuple(changed.get(spec, spec) for spec in self._specs)

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
