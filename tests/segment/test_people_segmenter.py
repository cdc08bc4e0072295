"""People who are blocks, in a room that four cameras see: followed while they cross, touch, go and return."""

import dataclasses
import functools

import numpy as np
import pytest

from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, View
from depthmocap.geometry import DepthCamera, Rig, look_at
from depthmocap.realtime.live_capture import BackgroundSource
from depthmocap.segment.people_segmenter import PeopleSegmenter, PersonMasks
from depthmocap.synth.scenes.room import Box, Room, render_room, table

SHELL = Box((-3.0, -3.0, 0.0), (3.0, 3.0, 3.0))
TABLE = table((-0.5, 2.2), (0.7, 2.8), 0.74)
RATE = 10


def body(x: float, y: float, height: float = 1.75, reach: float = 0.0) -> tuple[Box, ...]:
    """A trunk on two legs, and an arm that reaches towards +x."""
    return (
        Box((x - 0.2, y - 0.12, 0.5 * height), (x + 0.2, y + 0.12, height)),
        *(Box((x + side - 0.07, y - 0.08, 0.0), (x + side + 0.07, y + 0.08, 0.5 * height)) for side in (-0.1, 0.1)),
        *([Box((x + 0.2, y - 0.04, 1.2), (x + 0.2 + reach, y + 0.04, 1.3))] if reach else []),
    )


class Mount:
    """A camera in a corner, and what it sees of the room and of boxes in it; of a box once, as many stand still.

    Attributes:
        room_m: depth of the room.
    """

    def __init__(self, i: int, count: int) -> None:
        azimuth = 2 * np.pi * (i + 0.3) / count
        self._eye = np.array([2.7 * np.sin(azimuth), -2.7 * np.cos(azimuth), 1.9])
        pose = look_at(self._eye, np.array([0.0, 0.0, 0.9]))
        self.camera = DepthCamera(f"cam{i}", 128, 106, 92.0, 92.0, 63.5, 52.5, pose)
        self.room_m = render_room(Room(SHELL, TABLE), self.camera)
        rays = np.concatenate([self.camera.rays, np.ones_like(self.camera.rays[..., :1])], -1) @ pose[:3, :3].T
        self._inverse_rays = np.ascontiguousarray(1 / np.moveaxis(rays, -1, 0).astype(np.float64))
        self.box_m = functools.lru_cache(maxsize=400)(self._box_m)

    def _box_m(self, box: Box) -> np.ndarray:
        """Depth of a box, infinite where it is not: where a ray is inside all three slabs."""
        corners = np.array([box.low, box.high]) - self._eye
        ends = corners[:, :, None, None] * self._inverse_rays
        enter, leave = ends.min(0).max(0), ends.max(0).min(0)
        return np.where((enter > 0) & (enter < leave), enter, np.inf)

    def boxes_m(self, boxes: tuple[Box, ...]) -> np.ndarray:
        """Depth of the nearest box."""
        nothing = np.full(self.room_m.shape, np.inf)
        return functools.reduce(np.minimum, map(self.box_m, boxes), nothing)


@functools.cache
def mounts(count: int) -> list[Mount]:
    return [Mount(i, count) for i in range(count)]


class Scene:
    """Cameras in the corners; pictures with noise, and whose every pixel is."""

    def __init__(self, count: int = 3) -> None:
        self.rng = np.random.default_rng(5)
        self.mounts = mounts(count)
        self.cameras = [mount.camera for mount in self.mounts]
        self.rooms = [mount.room_m for mount in self.mounts]
        self.backgrounds = {
            camera.name: self.noisy(room_m) for camera, room_m in zip(self.cameras, self.rooms, strict=True)
        }

    def noisy(self, depth_m: np.ndarray) -> np.ndarray:
        return (depth_m + self.rng.normal(0, 0.004, depth_m.shape)).astype(np.float32)

    def render(self, index: int, *people: tuple[Box, ...], things: tuple[Box, ...] = ()):
        """A set at an instant, and each person's true masks."""
        views, masks = [], [[] for _ in people]
        for mount in self.mounts:
            depths = [mount.room_m, *(mount.boxes_m(boxes) for boxes in (things, *people))]
            views.append(View(mount.camera, self.noisy(np.min(depths, axis=0))))
            nearest = np.argmin(depths, axis=0)
            for k, own in enumerate(masks):
                own.append(nearest == k + 2)
        return FrameSet(index * 10**9 // RATE, tuple(views)), [tuple(own) for own in masks]


@pytest.fixture
def scene():
    return Scene()


def overlap(found, true) -> float:
    both = sum((a & b).sum() for a, b in zip(found, true, strict=True))
    return both / sum((a | b).sum() for a, b in zip(found, true, strict=True))


def test_two_cross_close_by_and_keep_their_numbers(scene):
    segment = PeopleSegmenter(scene.backgrounds, people=2)
    overlaps, order = [], (0, 1)
    for i in range(30):
        x = -1.5 + 0.1 * i
        frames, masks = scene.render(i, body(x, -0.2), body(-x, 0.3, 1.6))  # 26 cm between the trunks
        first, second = sorted(segment(frames), key=lambda person: person.number)
        assert (first.number, second.number) == (1, 2)
        # Who is first in the first set is open.
        if i == 0 and overlap(first.masks, masks[0]) <= 0.5:
            order = (1, 0)
        overlaps += [overlap(own.masks, masks[k]) for own, k in zip((first, second), order, strict=True)]
    assert min(overlaps) > 0.8
    assert np.mean(overlaps) > 0.9


def test_one_who_is_touched_is_divided_from_the_other(scene):
    segment = PeopleSegmenter(scene.backgrounds, people=2)
    people: tuple[PersonMasks, ...] = ()
    masks: list[tuple[np.ndarray, ...]] = []
    for i in range(24):
        gap = max(1.6 - 0.1 * i, 0.65)  # an arm of 0.3 m reaches the other's trunk in the end
        frames, masks = scene.render(i, body(-gap / 2, 0.0, reach=0.3), body(gap / 2, 0.0))
        people = segment(frames)
    assert len(people) == 2
    for own in people:
        assert max(overlap(own.masks, true) for true in masks) > 0.85


def test_one_is_followed_and_another_does_not_spoil_it(scene):
    segment = PeopleSegmenter(scene.backgrounds)
    for i in range(20):
        frames, masks = scene.render(i, body(0.0, 0.1 + 0.01 * i, 1.6), body(2.0 - 0.1 * i, -0.9, 1.9))
        if i < 2:
            frames, masks = scene.render(i, body(0.0, 0.1, 1.6))
        people = segment(frames)
        assert [person.number for person in people] == [1]
        assert overlap(people[0].masks, masks[0]) > 0.8


def test_who_goes_is_known_again_by_their_height_and_others_are_not(scene):
    segment = PeopleSegmenter(scene.backgrounds, people=3)
    i, seen = 0, []
    people: tuple[PersonMasks, ...] = ()
    for heights in [(1.75,), (), (1.5,), (), (1.75,)]:
        for _ in range(14):
            people = segment(scene.render(i, *(body(-0.8, 0.5, height) for height in heights))[0])
            i += 1
        seen.append([person.number for person in people])
    assert seen == [[1], [], [2], [], [1]]
    segment.reset()
    assert segment(scene.render(0)[0]) == ()


@pytest.mark.parametrize(("heights", "number"), [((1.6, 1.75), 2), ((1.77, 1.775), 3)])
def test_of_several_who_are_away_only_one_who_is_clearly_most_alike_is_taken(scene, heights, number):
    segment = PeopleSegmenter(scene.backgrounds, people=3)
    for i in range(12):
        # The shorter one comes first, so that the numbers are in the order of height.
        here = [body(x, 0.3, height) for x, height in zip((-0.8, 0.8), heights, strict=True)][: 1 + (i > 2)]
        assert len(segment(scene.render(i, *here)[0])) == len(here)
    for i in range(12, 24):
        segment(scene.render(i)[0])
    people: tuple[PersonMasks, ...] = ()
    for i in range(24, 34):
        people = segment(scene.render(i, body(0.0, 0.3, heights[1]))[0])
    assert [person.number for person in people] == [number]


def test_without_a_background_somebody_is_found_at_once_and_the_room_is_learnt(scene):
    segment = PeopleSegmenter({})
    people: tuple[PersonMasks, ...] = ()
    masks: list[tuple[np.ndarray, ...]] = []
    found = []
    for i in range(30):
        frames, masks = scene.render(i, body(-0.6 + 0.02 * i, 0.0))
        people = segment(frames)
        found.append(bool(people) and overlap(people[0].masks, masks[0]) > 0.8)
    assert all(found[4:])
    # Where they stood at first is known as well once they have gone.
    for i in range(30, 60):
        people = segment(scene.render(i)[0])
    assert people == ()
    for i in range(60, 68):  # measured first, because somebody is away
        frames, masks = scene.render(i, body(-0.6, 0.3))
        people = segment(frames)
    assert people and overlap(people[0].masks, masks[0]) > 0.8


def test_one_who_stands_at_furniture_when_it_begins_is_found_and_the_furniture_is_nobody(scene):
    sideboard = (Box((-0.9, 0.3, 0.0), (0.9, 0.8, 0.85)), Box((0.6, 0.4, 0.85), (0.8, 0.6, 1.0)))
    segment, empty = PeopleSegmenter({}, people=3), PeopleSegmenter({}, people=3)
    people: tuple[PersonMasks, ...] = ()
    masks: list[tuple[np.ndarray, ...]] = []
    for i in range(40):
        frames, masks = scene.render(i, body(0.0, 0.15), things=sideboard)
        people = segment(frames)
        if i > 4:
            assert [person.number for person in people] == [1]
        assert empty(scene.render(i, things=sideboard)[0]) == ()
    assert people and overlap(people[0].masks, masks[0]) > 0.75


def test_a_chair_is_nobody_and_becomes_background(scene):
    segment = PeopleSegmenter(scene.backgrounds, people=2)
    chair = (Box((0.8, -0.9, 0.0), (1.25, -0.45, 0.9)),)
    for i in range(10):
        segment(scene.render(i, body(-0.8, 0.5))[0])
    for i in range(10, 70):
        people = segment(scene.render(i, body(-0.8 + 0.01 * i, 0.5), things=chair)[0])
        assert [person.number for person in people] == [1]
    # Beside the chair that is background now, a person's mask is the person.
    frames, masks = scene.render(70, body(0.3, 0.0), things=chair)
    assert overlap(segment(frames)[0].masks, masks[0]) > 0.8


def test_one_camera_whose_place_nobody_knows_and_that_sees_no_floor_is_enough(scene):
    mount = scene.mounts[0]
    camera = dataclasses.replace(mount.camera, world_from_camera=np.eye(4))
    wall = np.full(mount.room_m.shape, 3.0, np.float32)
    across, down = camera.rays[..., 0], camera.rays[..., 1]
    shown = (np.abs(across) < 0.2) & (down > -0.3)
    person = np.where(shown, np.float32(1.2), wall)
    segment = PeopleSegmenter({camera.name: scene.noisy(wall)})
    for i in range(10):
        (found,) = segment(FrameSet(i * 10**9 // RATE, (View(camera, scene.noisy(person)),)))
        assert overlap(found.masks, [shown]) > 0.9


def test_where_no_empty_scene_is_known_live_it_is_said(scene):
    source = BackgroundSource(Rig(tuple(scene.cameras)), {"cam1": scene.rooms[1]})
    (problem,) = PeopleSegmenter.from_recording(source).problems
    assert problem.startswith("cameras 'cam0' and 'cam2': the empty scene is not known") and "auto" in problem
    assert PeopleSegmenter.from_recording(source, "none").problems == []


def test_a_camera_that_joins_later_is_used_from_its_first_set(scene):
    names = [camera.name for camera in scene.cameras]
    segment = PeopleSegmenter({name: scene.backgrounds[name] for name in names[:2]})
    for i in range(12):
        frames, masks = scene.render(i, body(0.02 * i, 0.0))
        views = frames.views if i >= 5 else frames.views[:2]
        people = segment(FrameSet(frames.timestamp_ns, views))
        assert overlap(people[0].masks, masks[0][: len(views)]) > 0.8
        assert people[0].number == 1


def test_masks_that_views_bring_and_mode_none(scene):
    frames, masks = scene.render(0, body(0.0, 0.0))
    given = FrameSet(0, tuple(View(v.camera, v.depth_m, mask) for v, mask in zip(frames.views, masks[0], strict=True)))
    (person,) = PeopleSegmenter({})(given)
    assert all(found is true for found, true in zip(person.masks, masks[0], strict=True))
    (person,) = PeopleSegmenter({}, mode="none")(frames)
    assert all(mask.all() for mask in person.masks)
    assert PeopleSegmenter({})(FrameSet(0, ())) == ()
    dark = FrameSet(0, tuple(View(v.camera, np.zeros_like(v.depth_m)) for v in frames.views))
    assert PeopleSegmenter({})(dark) == PeopleSegmenter({}, mode="none")(dark) == ()


def test_bad_input_is_refused(scene):
    with pytest.raises(InputError, match="--people"):
        PeopleSegmenter({}, people=0)
    with pytest.raises(InputError, match="background"):
        PeopleSegmenter({"cam0": np.ones((4, 4), np.float32)})(scene.render(0)[0])
