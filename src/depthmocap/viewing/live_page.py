"""The page of a running capture: a stream that draws what comes, and controls of the capture."""

from __future__ import annotations

import collections
import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import viser
from jaxtyping import UInt8
from numpy import ndarray

from depthmocap.errors import InputError
from depthmocap.geometry.floor_area import FloorArea
from depthmocap.report.drawing import colour_labels, depth_picture
from depthmocap.streaming.stream_protocol import Sample, Stream, StreamSetup
from depthmocap.text import joined
from depthmocap.viewing.display_colours import confidence_colours, palette_colour
from depthmocap.viewing.live_plots import LivePlots
from depthmocap.viewing.scene_drawing import CloudColours, Colour, SceneDrawing, SkeletonDrawing, Trail
from depthmocap.viewing.viewer_page import Page, as_html, every, plain

#: Most people that are drawn.
MOST_PEOPLE = 8
#: Seconds from one drawing of the cloud and of trails to the next,
CLOUD_S = 0.1
#: of depth pictures,
PICTURES_S = 0.25
#: and of plots and words.
WORDS_S = 0.5
#: For so long (seconds) after a set was left out, because the machine is too slow,
LATE_S = 2.0
#: the page is drawn only so often (seconds),
LATE_DRAWING_S = 0.1
#: and the cloud, which takes most of that.
LATE_CLOUD_S = 0.25
#: Seconds in which stopping must be clicked again.
_ASKED_S = 5.0
#: Longest side of a depth picture on the page (pixels).
_PICTURE_PX = 320
_CLOUD: dict[str, CloudColours] = {"by camera": "camera", "by depth": "depth", "by body part": "body part"}
_POINTS = ("5,000", "15,000", "50,000")
_RED, _AMBER = (235, 60, 60), (250, 170, 50)


@runtime_checkable
class CameraState(Protocol):
    """How a camera does; see ``realtime.status.CameraStatus``."""

    name: str
    state: str
    rate_hz: float
    counts: dict[str, int]


@runtime_checkable
class CaptureControls(Protocol):
    """What the page asks and changes of a capture; see ``realtime.live_controls.LiveControls``."""

    smoothing: str
    people: int

    @property
    def filters(self) -> tuple[str, ...]: ...
    @property
    def poses(self) -> int: ...
    @property
    def dropped(self) -> int: ...
    @property
    def problems(self) -> dict[str, int]: ...
    @property
    def recording(self) -> Path | None: ...
    def statuses(self) -> Sequence[Any]: ...
    def apart_m(self) -> dict[str, float]: ...
    def record(self, name: str) -> None: ...
    def stop_recording(self) -> None: ...
    def smooth(self, name: str) -> None: ...
    def follow(self, people: int) -> None: ...
    def learn_background(self) -> None: ...
    @property
    def moved(self) -> tuple[str, ...]: ...
    def place_anew(self, name: str) -> str: ...
    def mark(self, text: str, timestamp_ns: int | None = None) -> None: ...
    def stop(self) -> None: ...


class LivePage(Stream):
    """The page of a capture. Nothing is drawn while no browser looks on.

    Attributes:
        controls: of the capture; the page begins with them.
        area_m: in which people are followed; by default that of the rig.
    """

    name = "viewer"

    def __init__(self, page: Page) -> None:
        self.page = page
        self.controls: CaptureControls | None = None
        self.area_m: FloorArea = ()
        self._drawing: SceneDrawing | None = None
        self._stamp_ns: int | None = None
        self._stop_asked_s = -_ASKED_S
        self._next_s: dict[str, float] = {}
        self._dropped: int | None = None
        self._late_until_s = 0.0
        self._trails: dict[int, Trail] = {}
        self._moved: tuple[str, ...] = ()

    def start(self, setup: StreamSetup) -> None:
        """Draw what is known before the first sample."""
        server, cameras = self.page.server, setup.rig.cameras
        with server.atomic():
            self._drawing = SceneDrawing(server, cameras, setup.rig.up)
            self._drawing.show_area(self.area_m or setup.rig.area_m)
            up = self._drawing.up_world
            self._people = [SkeletonDrawing(server.scene, f"/people/{i}", up) for i in range(MOST_PEOPLE)]
            self._drawing.look_from(server, self._drawing.floor.position + up, cameras)
            gui = server.gui
            self.tabs = gui.add_tab_group()
            with self.tabs.add_tab("Capture", viser.Icon.ACTIVITY):
                self.status = gui.add_html("")
                if self.controls is not None:
                    self._add_controls(gui, self.controls, setup.rig.names)
                self._add_showing(gui)
                self._plots = LivePlots(gui)
            self._pictures: dict[str, Any] = {}
            self._pictures_tab = self.tabs.add_tab("Cameras", viser.Icon.CAMERA)
            with self._pictures_tab:
                self.pictures = gui.add_dropdown("Depth pictures", ("off", "by depth", "by body part"))
                for camera in cameras:
                    self._add_picture(gui, camera.name)

    def _add_controls(self, gui: viser.GuiApi, controls: CaptureControls, names: Sequence[str]) -> None:
        with gui.add_folder("Record"):
            self.file = gui.add_text("File", "take-1")
            self.record = gui.add_button("Record", icon=viser.Icon.PLAYER_RECORD)
            self.marker = gui.add_text("Marker", "trial 1")
            self.mark_button = gui.add_button("Set marker", icon=viser.Icon.FLAG)
        with gui.add_folder("Capture", expand_by_default=False):
            self.smoothing = gui.add_dropdown("Smoothing", controls.filters, initial_value=controls.smoothing)
            self.count = gui.add_number("People", controls.people, min=1, max=MOST_PEOPLE, step=1)
            self.background = gui.add_button("Learn the empty scene anew")
            self.moved = gui.add_dropdown("Camera", tuple(names) or ("",))
            self.place = gui.add_button("Place the camera anew")
            self.stop = gui.add_button("Stop the capture", color="red", icon=viser.Icon.PLAYER_STOP)
        for handle, call in (
            (self.record, self._record), (self.mark_button, self._mark), (self.background, controls.learn_background),
            (self.smoothing, lambda: controls.smooth(str(self.smoothing.value))),
            (self.count, lambda: controls.follow(int(self.count.value))), (self.stop, self._stop),
            (self.place, lambda: self.page.tell(controls.place_anew(str(self.moved.value)))),
        ):  # fmt: skip
            every(handle, lambda call=call: self._show_errors_of(call))

    def _add_showing(self, gui: viser.GuiApi) -> None:
        assert self._drawing is not None
        drawing = self._drawing
        with gui.add_folder("Show", expand_by_default=False):
            self.cloud = gui.add_dropdown("Room", ("off", *_CLOUD), initial_value="by camera")
            self.points = gui.add_dropdown("Points", _POINTS, initial_value="15,000")
            self.colours = gui.add_dropdown("Skeletons", ("by confidence", "by person"))
            self.trails = gui.add_checkbox("Trails", True)
            self.frusta = gui.add_checkbox("Cameras", True)
        every(self.frusta, lambda: setattr(drawing.cameras, "visible", bool(self.frusta.value)))

    def _add_picture(self, gui: viser.GuiApi, name: str) -> None:
        self._pictures[name] = gui.add_image(np.zeros((2, 2, 3), np.uint8), label=plain(name), visible=False)

    def _show_errors_of(self, call: Any) -> None:
        with self.page.errors_shown():
            call()

    def _record(self) -> None:
        assert self.controls is not None
        if self.controls.recording is not None:
            self.controls.stop_recording()
            self.file.value = following(self.file.value)
        else:
            self.controls.record(self.file.value)
        self._show_recording()

    def _mark(self) -> None:
        assert self.controls is not None
        if not self.marker.value.strip():
            raise InputError("write what the marker says")
        self.controls.mark(self.marker.value, self._stamp_ns)
        self.page.tell(f"marked: {self.marker.value}")
        self.marker.value = following(self.marker.value)

    def _stop(self) -> None:
        assert self.controls is not None
        now_s = time.monotonic()
        if now_s - self._stop_asked_s > _ASKED_S:
            self._stop_asked_s = now_s
            self.stop.label = "Click again to stop"
        else:
            self.stop.label = "Stopping"
            self.controls.stop()

    def _show_recording(self) -> None:
        label = "Record" if self.controls is None or self.controls.recording is None else "Stop recording"
        if self.record.label != label:
            self.record.label, self.record.color = label, "red" if label != "Record" else None

    def _is_due(self, what: str, every_s: float) -> bool:
        now_s = time.monotonic()
        if now_s < self._next_s.get(what, 0.0):
            return False
        self._next_s[what] = now_s + every_s
        return True

    def _is_late(self) -> bool:
        """Whether sets were left out just now: what the page takes of the machine is then missing elsewhere."""
        if self.controls is None:
            return False
        now_s, dropped = time.monotonic(), self.controls.dropped
        if self._dropped is not None and dropped > self._dropped:
            self._late_until_s = now_s + LATE_S
        self._dropped = dropped
        return now_s < self._late_until_s

    def send(self, sample: Sample) -> None:
        """Draw a sample, for the browsers that look on."""
        assert self._drawing is not None
        now_ns = time.monotonic_ns()
        self._plots.add(now_ns * 1e-9, (now_ns - sample.monotonic_ns) * 1e-6, self._poses())
        self._stamp_ns = sample.result.pose.timestamp_ns
        for number, pose in sample.people.items():
            self._trails.setdefault(number, Trail()).add(pose.joints, pose.timestamp_ns)
        for number in [number for number in self._trails if number not in sample.people]:
            del self._trails[number]
        late = self._is_late()
        if not self.page.server.get_clients() or (late and not self._is_due("all", LATE_DRAWING_S)):
            return
        with self.page.server.atomic():
            self._draw_people(sample, self._is_due("trails", CLOUD_S))
            if self._is_due("cloud", LATE_CLOUD_S if late else CLOUD_S):
                self._draw_cloud(sample)
            if self._is_due("words", WORDS_S):
                self._plots.show()
                self._show_state(sample)
        if self.pictures.value != "off" and self._is_due("pictures", PICTURES_S):
            self._draw_pictures(sample)

    def close(self) -> None:
        """Tell browsers that the capture has ended."""
        self.status.content = words(["The capture has ended."])
        self.page.server.flush()

    def _poses(self) -> int | None:
        return None if self.controls is None else self.controls.poses

    def _draw_people(self, sample: Sample, with_trails: bool) -> None:
        drawn = list(sample.people.items())[:MOST_PEOPLE]
        for drawing, (number, pose) in zip(self._people, drawn, strict=False):
            flat = palette_colour(number - 1)
            colours = np.broadcast_to(np.array(flat, np.uint8), pose.joints.shape)
            if self.colours.value == "by confidence":
                colours = confidence_colours(pose.confidence)
            drawing.show(pose.joints, colours, f"person {number}" if len(drawn) > 1 else "")
            if with_trails:
                drawing.show_trails(self._trails[number].poses if self.trails.value else (), flat)
        for drawing in self._people[len(drawn) :]:
            drawing.hide()

    def _draw_cloud(self, sample: Sample) -> None:
        assert self._drawing is not None
        colours = _CLOUD.get(str(self.cloud.value))
        if colours is None:
            self._drawing.hide_cloud()
            return
        for view in sample.frames.views:
            self._drawing.cameras.add(view.camera)
        most = int(str(self.points.value).replace(",", "")) if self.points.value in _POINTS else 15_000
        labels = labels_in_views(sample) if colours == "body part" else []
        self._drawing.show_cloud(sample.frames.views, colours, most, labels)

    def _draw_pictures(self, sample: Sample) -> None:
        labels = labels_in_views(sample) if self.pictures.value == "by body part" else []
        for i, view in enumerate(sample.frames.views):
            if view.camera.name not in self._pictures:
                with self._pictures_tab:
                    self._add_picture(self.page.server.gui, view.camera.name)
            step = max(-(-max(view.depth_m.shape) // _PICTURE_PX), 1)
            depth_m = np.ascontiguousarray(view.depth_m[::step, ::step])
            shown = depth_picture(depth_m) if i >= len(labels) else colour_labels(labels[i][::step, ::step], depth_m)
            picture = self._pictures[view.camera.name]
            picture.image, picture.visible = shown, True

    def _show_state(self, sample: Sample) -> None:
        assert self._drawing is not None
        controls = self.controls
        if controls is None:
            self.status.content = words([f"{len(sample.people)} in view"])
            return
        statuses, apart_m = controls.statuses(), controls.apart_m()
        fastest = max((status.rate_hz for status in statuses), default=0.0)
        lines = [self._plots.words(), f"{len(sample.people)} in view · {controls.dropped} sets left out"]
        for status in statuses:
            text, colour = camera_words(status, fastest, apart_m.get(status.name))
            self._drawing.cameras.show_state(status.name, text, colour)
            lines.append(f"{status.name}: {text}")
        if controls.recording is not None:
            lines.append(f"recording {controls.recording}")
        if controls.problems:
            lines.append(joined(list(controls.problems)[-3:], 3))
        self.status.content = words(lines)
        self._show_recording()
        self.smoothing.value, self.count.value = controls.smoothing, controls.people  # sent where they differ
        if controls.moved[:1] != self._moved:  # the choice is the user's until another camera was moved
            self._moved = controls.moved[:1]
            self.moved.value = next(iter(self._moved), self.moved.value)
        if self.stop.label == "Click again to stop" and time.monotonic() - self._stop_asked_s > _ASKED_S:
            self.stop.label = "Stop the capture"


def camera_words(status: CameraState, fastest_hz: float, apart_m: float | None) -> tuple[str, Colour | None]:
    """How a camera does in a few words, and a colour where something is wrong."""
    counts = collections.Counter(status.counts)
    parts = [f"{status.rate_hz:.0f} Hz"] if status.state == "running" else [status.state]
    parts += [f"{counts[key]} {key}" for key in ("late", "missing") if counts[key]]
    if apart_m is not None and np.isfinite(apart_m):
        parts.append(f"{1000 * apart_m:.0f} mm from the others")
    wrong = _RED if status.state != "running" else _AMBER if status.rate_hz < 0.8 * fastest_hz else None
    return ", ".join(parts), wrong


def labels_in_views(sample: Sample) -> list[UInt8[ndarray, "_ _"]]:
    """The body regions of everybody in each view of a sample."""
    merged = [labels.copy() for labels in sample.result.labels]
    for person in sample.result.people:
        for indices, labels in zip(merged, person.labels, strict=False):
            np.copyto(indices, labels, where=labels > 0)
    return merged


def words(lines: Sequence[str]) -> str:
    """Lines of text as HTML."""
    text = "<br>".join(as_html(line, 200) for line in lines if line)
    return f'<div style="padding: 0.4em 1em; font-size: 0.85em; line-height: 1.5">{text}</div>'


def following(name: str) -> str:
    """The next name in a row: "trial 3" after "trial 2", and "trial 2" after "trial"."""
    match = re.search(r"(\d+)$", name)
    return f"{name[: match.start()]}{int(match[1]) + 1}" if match else f"{name} 2"
