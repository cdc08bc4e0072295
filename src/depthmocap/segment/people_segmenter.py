"""People in sets of views: whose pixels are whose, in every camera, set after set."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, FrameSource, View
from depthmocap.geometry import DepthCamera
from depthmocap.kernels.segmentation import paint
from depthmocap.segment.background import Background
from depthmocap.segment.divide import Divider
from depthmocap.segment.floor import find_floor
from depthmocap.segment.occupancy_map import Foreground, Plan
from depthmocap.segment.static_scene import Mode, PersonSegmenter
from depthmocap.segment.tracking import Track, Tracks

#: What is before an unknown background is looked at this near to people (metres).
UNSURE_M = 0.6


@dataclasses.dataclass(frozen=True, eq=False)
class SeenPerson:
    """A person's pixels in every view of a set, and their number, from 1 on, which stays theirs."""

    number: int
    masks: tuple[Bool[ndarray, "_ _"], ...]


class PeopleSegmenter:
    """Marks people in sets of views of cameras that stand still.

    Foreground of all cameras makes blobs on a plan of the floor; blobs of a body's size are followed. An empty scene
    that is not known is learnt while running, and a known one is followed: what stays where it is becomes background,
    but for people. Mode ``"none"`` takes every pixel with depth for one person, and where all views bring their own
    masks those are the answer.

    Attributes:
        people: so many are given at most. One who is followed is followed until gone; the others are those most seen.
        problems: what makes good masks unlikely, one line each, with the way out.
    """

    def __init__(
        self,
        backgrounds_m: Mapping[str, Float[ndarray, "_ _"]],
        up: str = "z",
        mode: Mode = "auto",
        people: int = 1,
        problems: Sequence[str] = (),
    ) -> None:
        """
        Args:
            backgrounds_m: empty scenes, depth in metres by camera name, 0 where not known; of any of the cameras.
            up: the world's up axis.

        Raises:
            InputError: when ``people`` is less than one.
        """
        if people < 1:
            raise InputError(f"--people must be at least 1, got {people}")
        self.mode: Mode = mode
        self.people, self.problems = people, list(problems)
        self._up = up
        self._backgrounds = {
            name: Background((background_m.shape[0], background_m.shape[1]), background_m)
            for name, background_m in backgrounds_m.items()
        }
        self._pool = ThreadPoolExecutor(max_workers=4)
        self._plan: Plan | None = None
        self._cameras: dict[str, DepthCamera] = {}
        self._floor_from_world = np.eye(4)
        self.reset()

    @classmethod
    def from_recording(cls, source: FrameSource, mode: Mode = "auto", people: int = 1) -> PeopleSegmenter:
        """With the empty scenes that a recording brings, or that its frames tell."""
        learnt = PersonSegmenter.from_recording(source, mode)
        return cls(learnt.backgrounds_m, source.up, mode, people, learnt.problems)

    def reset(self) -> None:
        """Forget who was there; backgrounds are kept."""
        self._tracks, self._divider = Tracks(), Divider()
        self._followed: list[int] = []

    def __call__(self, frames: FrameSet) -> tuple[SeenPerson, ...]:
        """The people in a set, the one followed first; nobody gives an empty tuple.

        Raises:
            InputError: when a view is not of the size of its camera's background.
        """
        views = frames.views
        if not views:
            return ()
        if self.mode == "none" or all(view.mask is not None for view in views):
            masks = tuple(view.depth_m > 0 if view.mask is None else view.mask for view in views)
            return (SeenPerson(1, masks),) if any(mask.any() for mask in masks) else ()
        depths = [np.ascontiguousarray(view.depth_m, np.float32) for view in views]
        backgrounds = [self._background(view) for view in views]
        plan = self._plan_of(views)
        now_s = frames.timestamp_ns * 1e-9

        def look(view: View, depth_m: ndarray, background: Background) -> Foreground:
            return plan.foreground(view.camera, depth_m, background.limit_m, not background.learning)

        seen = list(self._pool.map(look, views, depths, backgrounds))
        near = plan.around(self._tracks.expect(now_s), UNSURE_M)
        seen = [view.without_unsure(near) for view in seen]
        blobs = plan.blobs(seen)
        owner, shared = self._tracks.assign(blobs, now_s)
        divided = self._divider.divide(plan, blobs, seen, self._tracks.alive, shared)

        def overlooked(place_m: Float[ndarray, "2"], height_m: float) -> bool:
            return plan.overlooked(views, place_m, height_m)

        self._tracks.update(owner, blobs, divided, not any(view.trusted for view in seen), overlooked, now_s)
        owners = np.concatenate([[0], owner]).astype(np.uint8)
        owners[[each.blob + 1 for each in shared]] = 255
        columns = owners[blobs.labels.ravel()]
        self._divider.remember(plan, seen, columns, self._tracks.alive)

        def finish(view: Foreground, background: Background) -> UInt8[ndarray, "h w"]:
            labels = np.zeros(view.depth_m.shape, np.uint8)
            paint(view.pixels, view.columns, view.levels, columns, self._divider.volume, labels.reshape(-1))
            if background.is_due(frames.timestamp_ns):
                background.look(view.depth_m, self._people_of(labels), frames.timestamp_ns)
            return labels

        painted = list(self._pool.map(finish, seen, backgrounds))
        return tuple(
            SeenPerson(track.number, tuple(labels == track.label for labels in painted)) for track in self._choose()
        )

    def _background(self, view: View) -> Background:
        name, shape = view.camera.name, view.depth_m.shape
        if name not in self._backgrounds:
            self._backgrounds[name] = Background((shape[0], shape[1]))
        background = self._backgrounds[name]
        if background.shape != shape:
            raise InputError(f"camera {name!r}: view of shape {shape}, background {background.shape}")
        return background

    def _plan_of(self, views: Sequence[View]) -> Plan:
        """The plan of all cameras so far; the floor is found once, with the first set."""
        if self._plan is not None and all(view.camera.name in self._cameras for view in views):
            return self._plan
        old = self._plan
        if old is None:
            empty = [self._empty_view(view) for view in views]
            self._floor_from_world = find_floor(empty, self._up)
        self._cameras |= {view.camera.name: view.camera for view in views}
        self._plan = Plan(list(self._cameras.values()), self._floor_from_world)
        if old is not None:
            self._tracks.shift((self._plan.plan_from_world - old.plan_from_world)[:2, 3])
            self._divider = Divider()
        return self._plan

    def _empty_view(self, view: View) -> View:
        """What is known of the empty scene, and what is seen where nothing is."""
        background_m = self._backgrounds[view.camera.name].background_m
        return View(view.camera, np.where(background_m > 0, background_m, view.depth_m).astype(np.float32))

    def _people_of(self, labels: UInt8[ndarray, "h w"]) -> Bool[ndarray, "h w"]:
        """The pixels of everybody who is known to be a person."""
        person = np.zeros(256, np.bool_)
        person[[track.label for track in self._tracks.alive if track.number]] = True
        return person[labels]

    def _choose(self) -> list[Track]:
        """Those who are given: who was followed and is not gone, then who is most seen."""
        people = {track.number: track for track in self._tracks.alive if track.number}
        self._followed = [number for number in self._followed if number in people]
        others = sorted(set(people) - set(self._followed), key=lambda number: -people[number].area_m2)
        self._followed += others[: self.people - len(self._followed)]
        return [people[number] for number in self._followed if people[number].area_m2 > 0]
