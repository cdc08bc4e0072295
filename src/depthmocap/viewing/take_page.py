"""The page of a take: controls, and one thread that reads and draws the instant that is shown."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from depthmocap.body.skeleton import JOINTS
from depthmocap.errors import InputError
from depthmocap.exporting.stored_result import StoredResult
from depthmocap.frames import FrameSet
from depthmocap.report.drawing import depth_picture
from depthmocap.viewing.display_colours import BESIDE, TRUTH, confidence_colours, palette_colour
from depthmocap.viewing.scene_drawing import TRAIL_LENGTH, CloudColours, SceneDrawing, SkeletonDrawing
from depthmocap.viewing.take_player import SPEEDS, TakePlayer
from depthmocap.viewing.take_plots import TakePlots
from depthmocap.viewing.viewed_take import ViewedTake, gap_starts, worst_instants
from depthmocap.viewing.viewer_page import Page, as_html, every, plain

#: Most instants drawn in a second.
DRAWS_A_SECOND = 30.0
#: Most people that are drawn at a time.
MOST_PEOPLE = 12
EVERYBODY = "everybody"
_CLOUD: dict[str, CloudColours] = {"by camera": "camera", "by depth": "depth"}
#: Points of the cloud to choose from.
_POINTS = ("10,000", "30,000", "100,000", "300,000")


class TakePage:
    """Controls of a take on a page, and its drawing."""

    def __init__(self, page: Page, take: ViewedTake) -> None:
        self.page, self.take = page, take
        self.player = TakePlayer(take.times_s)
        self._drawn_confidence = take.confidence(None)
        self._worst: list[int] = []
        self._worst_shown = -1
        self._failed = ""
        #: While an instant is drawn, the take stays as it is.
        self._drawing = threading.Lock()
        gui, cameras = page.server.gui, take.rig.cameras if take.rig is not None else ()
        self.drawing = SceneDrawing(page.server, cameras, take.up)
        self.drawing.show_area(take.rig.area_m if take.rig is not None else ())
        up, scene = self.drawing.up_world, page.server.scene
        self._people = [SkeletonDrawing(scene, f"/people/{i}", up) for i in range(MOST_PEOPLE)]
        self._beside = [
            SkeletonDrawing(scene, f"/beside/{i}", up, 0.016) for i in range(MOST_PEOPLE if take.beside else 0)
        ]
        self._truth = SkeletonDrawing(scene, "/truth", up, 0.012)
        self.drawing.look_from(page.server, self._middle(), cameras)
        self.tabs = gui.add_tab_group()
        with self.tabs.add_tab("Play", viser.Icon.PLAYER_PLAY):
            self._add_playing(gui)
            self._add_showing(gui)
            self.plots = TakePlots(gui, take)
        self._pictures: dict[str, Any] = {}
        if take.recording is not None:
            with self.tabs.add_tab("Cameras", viser.Icon.CAMERA):
                self._add_pictures(gui)
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)

    def __enter__(self) -> TakePage:
        self._thread.start()
        return self

    def __exit__(self, *failure: object) -> None:
        self.player.stop()
        self._thread.join(2.0)

    def _middle(self) -> np.ndarray:
        """What browsers look at first: the middle of where people are."""
        joints = [person.table.joints.reshape(-1, 3) for person in self.take.people] or [
            self.take.truth(0, 1).reshape(-1, 3)
        ]
        known = np.concatenate(joints)
        known = known[np.isfinite(known).all(1)]
        return np.median(known, 0) if len(known) else self.drawing.floor.position + self.drawing.up_world

    def _add_playing(self, gui: viser.GuiApi) -> None:
        count = len(self.take)
        self.status = gui.add_html("")
        self.play_button = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY)
        self.slider = gui.add_slider("Frame", 0, max(count - 1, 1), 1, 0)
        self.steps = gui.add_button_group("Step", ("−10", "−1", "+1", "+10"))
        self.jumps = gui.add_button_group("Jump", ("‹ gap", "gap ›", "worst ›"))
        self.speed = gui.add_dropdown("Speed", SPEEDS, initial_value="1×")
        self.loop = gui.add_checkbox("Loop", True)
        self.person = gui.add_dropdown("Person", self._person_choices())
        every(self.play_button, lambda: self._play(not self.player.playing))
        every(self.slider, lambda: self._scrub(int(self.slider.value)))
        every(self.steps, lambda: self.step(int(self.steps.value.replace("−", "-"))))
        every(self.jumps, self._jump)
        every(self.speed, self._set_speed)
        every(self.loop, lambda: setattr(self.player, "loop", bool(self.loop.value)))
        every(self.person, self._choose)
        keys: tuple[tuple[str, Any, Callable[[], None]], ...] = (
            ("Play or stop", "space", lambda: self._play(not self.player.playing)),
            ("Next frame", "arrowright", lambda: self.step(1)),
            ("Previous frame", "arrowleft", lambda: self.step(-1)),
            ("First frame", "home", lambda: self.player.go_to(0)),
            ("Last frame", "end", lambda: self.player.go_to(len(self.take) - 1)),
        )
        for label, key, call in keys:
            gui.add_command(label, hotkey=key).on_trigger(lambda event, call=call: call())

    def _add_showing(self, gui: viser.GuiApi) -> None:
        with gui.add_folder("Show", expand_by_default=False):
            has_room = self.take.recording is not None
            self.cloud = gui.add_dropdown(
                "Room", ("off", *_CLOUD) if has_room else ("off",), initial_value="by camera" if has_room else "off"
            )
            self.points = gui.add_dropdown("Points", _POINTS, initial_value="30,000")
            self.colours = gui.add_dropdown("Skeletons", ("by confidence", "by person", "off"))
            self.trails = gui.add_checkbox("Trails", False)
            self.names = gui.add_checkbox("Names", len(self.take.people) > 1)
            self.truth = gui.add_checkbox("Truth (blue)", True, visible=self.take.has_truth)
            self.beside = gui.add_checkbox("Beside (violet)", True, visible=bool(self.take.beside))
            self.frusta = gui.add_checkbox("Cameras", True, visible=has_room)
            self.floor = gui.add_checkbox("Floor and axes", True)
        for handle in (self.cloud, self.points, self.colours, self.trails, self.names, self.truth, self.beside):
            every(handle, self.player.redraw)
        every(self.frusta, lambda: setattr(self.drawing.cameras, "visible", bool(self.frusta.value)))
        every(self.floor, self._show_floor)
        self.joint = gui.add_dropdown("Plot", JOINTS, initial_value="RHand")
        every(self.joint, self.player.redraw)

    def _add_pictures(self, gui: viser.GuiApi) -> None:
        self.show_pictures = gui.add_checkbox("Depth pictures", False, hint="red near, blue far")
        assert self.take.rig is not None
        for camera in self.take.rig.cameras:
            blank = np.zeros((2, 2, 3), np.uint8)
            self._pictures[camera.name] = gui.add_image(blank, label=plain(camera.name), visible=False)
        every(self.show_pictures, self.player.redraw)

    def _person_choices(self) -> tuple[str, ...]:
        return (EVERYBODY, *(person_choice(person.number, person.label) for person in self.take.people))

    @property
    def chosen(self) -> int | None:
        """The number of the person who was chosen; None for everybody."""
        choices = [person_choice(person.number, person.label) for person in self.take.people]
        return self.take.people[choices.index(self.person.value)].number if self.person.value in choices else None

    def step(self, by: int) -> None:
        """Stop, and show the instant so many further on."""
        self.player.step(by)
        self._show_playing()

    def _play(self, playing: bool) -> None:
        self.player.play(playing)
        self._show_playing()

    def _scrub(self, index: int) -> None:
        if index != self.player.index:
            self.player.go_to(index)

    def _show_playing(self) -> None:
        label = "Stop" if self.player.playing else "Play"
        if self.play_button.label != label:
            self.play_button.label = label

    def _set_speed(self) -> None:
        if self.speed.value in SPEEDS:
            self.player.speed = float(self.speed.value.rstrip("×"))

    def _show_floor(self) -> None:
        self.drawing.floor.visible = self.drawing.axes.visible = bool(self.floor.value)

    def _choose(self) -> None:
        with self._drawing:
            self._choose_person()

    def _choose_person(self) -> None:
        self._drawn_confidence, self._worst = self.take.confidence(self.chosen), []
        self.plots.set_take(self.take, self.chosen)
        self.player.redraw()

    def _jump(self) -> None:
        now, kind = self.player.index, self.jumps.value
        if kind == "worst ›":
            if not self._worst:
                self._worst, self._worst_shown = worst_instants(self._drawn_confidence, self.take.times_s), -1
            if not self._worst:
                self.page.tell("nobody is seen in this take")
                return
            self._worst_shown = (self._worst_shown + 1) % len(self._worst)
            self.player.step(self._worst[self._worst_shown] - now)
        else:
            starts = gap_starts(~np.isnan(self._drawn_confidence))
            later, earlier = starts[starts > now], starts[starts < now]
            nearest = later[:1] if kind == "gap ›" else earlier[-1:]
            if not len(nearest):
                self.page.tell("no gap further on" if kind == "gap ›" else "no gap before")
                return
            self.player.step(int(nearest[0]) - now)
        self._show_playing()

    def change_result(self, result: StoredResult) -> None:
        """Show the result with other corrections, at the same time.

        Raises:
            InputError: when nothing is left of it.
        """
        with self._drawing:
            stamp = int(self.take.stamps_ns[self.player.index])
            self.take.change_result(result)
            self.slider.max = max(len(self.take) - 1, 1)
            if self.person.options != self._person_choices():
                self.person.options = self._person_choices()
            self.player.set_times(self.take.times_s, self.take.index_at(stamp))
            self._choose_person()

    def _run(self) -> None:
        """Draw until the end."""
        drawn, last_s = -1, time.monotonic()
        while not self.player.stopped:
            wanted = self.player.wait(0.5)
            now_s = time.monotonic()
            if self.player.playing:
                self.player.advance(now_s - last_s)
            last_s = now_s
            index = self.player.index
            if (wanted or index != drawn) and not self.player.stopped:
                drawn = index
                self._draw_safely(index)
            if self.player.playing:
                time.sleep(max(1 / DRAWS_A_SECOND - (time.monotonic() - now_s), 0.001))
            else:
                self._show_playing()

    def _draw_safely(self, index: int) -> None:
        """Draw; what cannot be drawn is told once, and the page goes on."""
        try:
            with self._drawing:
                self.draw(min(index, len(self.take) - 1))
        except (InputError, OSError) as error:
            if str(error) != self._failed:
                self._failed = str(error)
                self.page.tell(self._failed, wrong=True)

    def draw(self, index: int) -> None:
        """Draw one instant."""
        take = self.take
        wants_frames = self.cloud.value != "off" or (self._pictures and self.show_pictures.value)
        frames = take.frames(index) if wants_frames else None
        with self.page.server.atomic():
            self._draw_people(index)
            self._draw_room(frames)
            person = next((one for one in take.people if one.number == self.chosen), None)
            self.plots.show(index, str(self.joint.value), person or (take.people[0] if take.people else None))
            if int(self.slider.value) != index:
                self.slider.value = index
            self.status.content = self._status(index)
        self._draw_pictures(frames)

    def _draw_people(self, index: int) -> None:
        take, colouring = self.take, self.colours.value
        for drawings, people, colour in (
            (self._people, take.people, None), (self._beside, take.beside if self.beside.value else (), BESIDE),
        ):  # fmt: skip
            shown = []
            for i, person in enumerate(people):
                pose = person.at(index) if colour or self.chosen in (None, person.number) else None
                if pose is not None and len(shown) < len(drawings) and colouring != "off":
                    shown.append((i, person, *pose))
            for drawing, (i, person, joints, confidence) in zip(drawings, shown, strict=False):
                flat = colour or palette_colour(i)
                colours = np.broadcast_to(np.array(flat, np.uint8), joints.shape)
                if colour is None and colouring == "by confidence":
                    colours = confidence_colours(confidence)
                drawing.show(joints, colours, plain(person.label) if self.names.value and colour is None else "")
                trail = person.series(max(index - TRAIL_LENGTH + 1, 0), index + 1)[0] if self.trails.value else ()
                drawing.show_trails(list(trail), flat)
            for drawing in drawings[len(shown) :]:
                drawing.hide()
        truth = take.truth(index, index + 1)[0]
        if self.truth.value and np.isfinite(truth).any():
            self._truth.show(truth, np.broadcast_to(np.array(TRUTH, np.uint8), truth.shape))
        else:
            self._truth.hide()

    def _draw_room(self, frames: FrameSet | None) -> None:
        colours = _CLOUD.get(str(self.cloud.value))
        if frames is None or colours is None:
            self.drawing.hide_cloud()
        else:
            most = int(str(self.points.value).replace(",", "")) if self.points.value in _POINTS else 30_000
            self.drawing.show_cloud(frames.views, colours, most)

    def _draw_pictures(self, frames: FrameSet | None) -> None:
        views = {view.camera.name: view for view in frames.views} if frames and self._pictures else {}
        for name, picture in self._pictures.items():
            shown = bool(self.show_pictures.value) and name in views
            if shown:
                picture.image = depth_picture(views[name].depth_m)
            if picture.visible != shown:
                picture.visible = shown

    def _status(self, index: int) -> str:
        take = self.take
        rows = []
        for person in take.people[:MOST_PEOPLE]:
            pose = person.at(index)
            seen = f"confidence {pose[1].mean():.2f}, lowest {pose[1].min():.2f}" if pose else "not seen"
            rows.append(f"{as_html(person.label)}: {seen}")
        if take.has_truth and take.people:
            bin_cm = 100 * float(np.nanmin([_apart(person, take, index) for person in take.people], initial=np.inf))
            rows.append(f"from the truth: {bin_cm:.1f} cm" if np.isfinite(bin_cm) else "from the truth: –")
        rows += [as_html(marker.text) for marker in _markers_at(take, index)]
        title = as_html(take.result.name) if take.result is not None and take.result.name else ""
        head = f"<b>{take.times_s[index]:.3f} s</b> of {take.times_s[-1]:.1f} s · frame {index} of {len(take) - 1}"
        lines = "<br>".join([*([f"<b>{title}</b>"] if title else []), head, *rows])
        return f'<div style="padding: 0.4em 1em; font-size: 0.85em; line-height: 1.5">{lines}</div>'


def person_choice(number: int, label: str) -> str:
    """Somebody in a list of people: numbers are unique, names need not be."""
    return plain(label if label == f"person {number}" else f"{number} {label}")


def _apart(person: Any, take: ViewedTake, index: int) -> float:
    """The mean distance (m) of somebody's joints from the true ones; infinite where either is not known."""
    apart = np.linalg.norm(person.series(index, index + 1)[0][0] - take.truth(index, index + 1)[0], axis=-1)
    known = apart[np.isfinite(apart)]
    return float(known.mean()) if len(known) else np.inf


def _markers_at(take: ViewedTake, index: int) -> list[Any]:
    """The last marker up to an instant."""
    stamp = int(take.stamps_ns[index]) + take.period_ns // 2
    markers = take.result.markers if take.result is not None else ()
    return [marker for marker in markers if marker.timestamp_ns <= stamp][-1:]
