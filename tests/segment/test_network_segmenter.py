"""People found by the packaged network: rendered people in rooms, without an empty scene."""

import dataclasses

import numpy as np
import pytest

from depthmocap.classify.classifier import packaged_weights
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, FrameSource, View
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.segment.depth_grid import DepthGrid
from depthmocap.segment.load_segmenter import load_segmenter
from depthmocap.segment.network_segmenter import NetworkSegmenter, is_open
from depthmocap.segment.people_detector import DetectedPeople, PeopleDetector, limits_at, person_mask
from depthmocap.segment.people_segmenter import PeopleSegmenter, PersonMasks
from depthmocap.segment.person_by_network import PersonByNetwork
from depthmocap.segment.static_scene import PersonSegmenter

RATE = 10


def camera(name: str, azimuth: float, distance: float = 2.6) -> DepthCamera:
    eye = np.array([distance * np.sin(azimuth), -distance * np.cos(azimuth), 1.6])
    return DepthCamera(name, 256, 212, 182.0, 182.0, 127.5, 105.5, look_at(eye, np.array([0.0, 0.0, 0.8])))


@pytest.fixture(scope="module")
def dressed():
    pytest.importorskip("torch")
    from depthmocap.synth.people.bodies import random_dressed_body

    return random_dressed_body(np.random.default_rng(4), "easy")


def lying(posture: np.ndarray) -> np.ndarray:
    out = posture.copy()
    out[0] = [-np.pi / 2, 0.0, 0.0]
    return out


def shown(dressed, cameras, posture, index, at=(0.0, 0.0), others=()):
    """A frame set of the person in an otherwise empty room, and the true masks."""
    from depthmocap.synth.render import render_person
    from depthmocap.synth.scenes.room import Box, Room, render_room, table

    room = Room(Box((-3.0, -3.0, 0.0), (3.0, 3.0, 2.8)), table((1.6, -0.6), (2.4, 0.6), 0.74))
    rng, views, masks = np.random.default_rng(index), [], []
    people = [(posture, at), *others]
    for each in cameras:
        depth = render_room(room, each)
        own = []
        for where, (x, y) in people:
            person = dressed.pose(where)
            person = person.moved(np.eye(3), np.array([x, y, -person.lowest_m]))
            rendering = render_person(person, each, depth)
            own = [mask & ~rendering.person for mask in own] + [rendering.person & (rendering.depth_m < depth)]
            depth = rendering.depth_m
        noisy = np.where(depth > 0, depth + rng.normal(0, 0.004, depth.shape), 0).astype(np.float32)
        views.append(View(each, noisy))
        masks.append(own)
    return FrameSet(index * 10**9 // RATE, tuple(views)), [tuple(own[k] for own in masks) for k in range(len(people))]


def overlap(found, true) -> float:
    both = sum((a & b).sum() for a, b in zip(found, true, strict=True))
    return both / sum((a | b).sum() for a, b in zip(found, true, strict=True))


@pytest.mark.parametrize("posture", ["standing", "lying"])
@pytest.mark.parametrize("count", [1, 3])
def test_somebody_who_never_moves_is_found_at_once_without_an_empty_scene(dressed, posture, count):
    from depthmocap.synth.body.mesh import REST_POSTURE

    cameras = [camera(f"cam{i}", 2.1 * i + 0.4) for i in range(count)]
    segment = NetworkSegmenter({}, people=2, background=False)
    for i in range(5):
        frames, masks = shown(dressed, cameras, REST_POSTURE if posture == "standing" else lying(REST_POSTURE), i)
        people = list(segment(frames))
        if i >= 3:
            assert people[0].number == 1
            assert max(overlap(person.masks, masks[0]) for person in people) > 0.65


def test_two_close_together_from_the_start_are_two(dressed):
    from depthmocap.synth.body.mesh import REST_POSTURE

    cameras = [camera(f"cam{i}", 2.1 * i + 0.4) for i in range(3)]
    segment, masks = NetworkSegmenter({}, people=3), []
    people: list[PersonMasks] = []
    for i in range(6):
        frames, masks = shown(dressed, cameras, REST_POSTURE, i, (-0.5, 0.1), [(REST_POSTURE, (0.5, -0.1))])
        people = list(segment(frames))
    assert sorted(person.number for person in people) == [1, 2]
    for true in masks:
        assert max(overlap(person.masks, true) for person in people) > 0.75


def test_what_a_camera_showed_stands_while_it_is_left_out(dressed, monkeypatch):
    from depthmocap.synth.body.mesh import REST_POSTURE

    looked_at: list[str] = []
    look = NetworkSegmenter._detect
    monkeypatch.setattr(
        NetworkSegmenter, "_detect",
        lambda self, view, *others: looked_at.append(view.camera.name) or look(self, view, *others),
    )  # fmt: skip
    segment = NetworkSegmenter({}, people=1)
    cameras = [camera("cam0", 0.4), camera("cam1", 2.4)]
    sets = [shown(dressed, cameras, REST_POSTURE, i)[0] for i in range(5)]
    (before,) = [segment(frames) for frames in sets[:4]][-1]
    looked_at.clear()
    (after,) = segment.find(sets[4], {"cam1"})
    assert looked_at == ["cam0"] and after.number == before.number
    np.testing.assert_array_equal(after.masks[1], before.masks[1])
    assert (after.masks[0] != before.masks[0]).any()  # which has noise
    looked_at.clear()
    (much_later,) = segment.find(dataclasses.replace(sets[4], timestamp_ns=10**9), {"cam1"})
    assert sorted(looked_at) == ["cam0", "cam1"] and much_later.number == before.number


def test_who_keeps_still_is_never_learnt_as_background(dressed):
    from depthmocap.synth.body.mesh import REST_POSTURE

    cameras = [camera("cam0", 0.4), camera("cam1", 2.4)]
    segment = NetworkSegmenter({}, people=1)
    frames, masks = shown(dressed, cameras, lying(REST_POSTURE), 0)
    people: list[PersonMasks] = []
    for i in range(0, 60 * RATE, 4):  # for a minute
        people = list(segment(dataclasses.replace(frames, timestamp_ns=i * 10**9 // RATE)))
    assert [person.number for person in people] == [1]
    (person,) = people
    assert overlap(person.masks, masks[0]) > 0.75


def test_where_the_empty_scene_is_known_the_network_looks_at_a_part_and_finds_the_same(dressed):
    from depthmocap.synth.body.mesh import REST_POSTURE

    each = camera("cam0", 0.4, 2.9)
    frames, masks = shown(dressed, [each], REST_POSTURE, 0)
    gone = [View(view.camera, np.where(masks[0][i], 0, view.depth_m)) for i, view in enumerate(frames.views)]
    grid, detector = DepthGrid(each), PeopleDetector()
    limit_m = np.where(gone[0].depth_m > 0, gone[0].depth_m - 0.05, 20.0).astype(np.float32)
    limits_m = limits_at(grid, limit_m)
    whole = detector(grid, frames.views[0].depth_m, limits_m)
    part = detector(grid, frames.views[0].depth_m, limits_m, last=whole)
    assert (part.outputs != whole.outputs).any((0,)).mean() < 0.85  # it looked at less than the picture
    both = (person_mask(part) & person_mask(whole)).sum()
    assert both / (person_mask(part) | person_mask(whole)).sum() > 0.95
    nobody = detector(grid, gone[0].depth_m, limits_m, last=dataclasses.replace(whole, indices=whole.indices[:0]))
    np.testing.assert_array_equal(nobody.outputs, whole.outputs)  # nothing changed, so nothing was looked at


def test_the_rest_of_a_body_before_the_known_empty_scene_is_its_owners_where_the_network_is_unsure(monkeypatch):
    def half(self, cells):
        outputs = np.full((7, *cells.shape[1:]), -9.0, np.float32)
        person = (cells[0] > 0) & (cells[1] < 0.2)  # nearer than 2.6 m
        outputs[:4, person] = -4.0
        outputs[:4, :44][:, person[:44]] = 4.0
        outputs[4:] = 0.0
        outputs[5] = (30 - np.arange(cells.shape[1]))[:, None] * 2.0 / 62  # all vote for one height
        return outputs

    monkeypatch.setattr(PeopleDetector, "_run", half)
    each = DepthCamera("cam0", 256, 212, 182.0, 182.0, 127.5, 105.5)
    empty_m = np.full((212, 256), 4.0, np.float32)
    true = np.zeros(empty_m.shape, np.bool_)
    true[10:200, 105:151] = True  # 2.1 m high, of which the network is sure of 1.3 m
    view = View(each, np.where(true, np.float32(2.0), empty_m))
    (person,) = NetworkSegmenter({"cam0": empty_m})(FrameSet(0, (view,)))
    assert overlap(person.masks, [true]) > 0.95


def test_a_camera_on_its_side_finds_as_much(dressed):
    from depthmocap.synth.body.mesh import REST_POSTURE

    upright = camera("cam0", 0.4)
    frames, masks = shown(dressed, [upright], REST_POSTURE, 0)
    turned = frames.views[0].turned(1)
    segment = NetworkSegmenter({}, background=False)
    people: list[PersonMasks] = []
    for i in range(4):
        people = list(segment(FrameSet(i * 10**8, (turned,))))
    (person,) = people
    assert overlap([np.rot90(person.masks[0], -1)], masks[0]) > 0.75


class Still(FrameSource):
    """The same set of frames again and again."""

    def __init__(self, frames: FrameSet) -> None:
        self.frames, self.camera_names = frames, tuple(view.camera.name for view in frames.views)

    def __len__(self) -> int:
        return 50

    def __getitem__(self, index: int) -> FrameSet:
        return dataclasses.replace(self.frames, timestamp_ns=index * 10**8)


def test_who_is_a_part_of_the_estimated_empty_scene_is_found_by_the_network(dressed):
    from depthmocap.synth.body.mesh import REST_POSTURE

    frames, masks = shown(dressed, [camera("cam0", 0.4)], REST_POSTURE, 0)
    (view,), (true,) = frames.views, masks
    assert not PersonSegmenter.from_recording(Still(frames))(view).any()
    segmenter = PersonByNetwork.from_recording(Still(frames))
    assert segmenter.doubtful == {"cam0"} and segmenter.problems == []
    assert overlap([segmenter(view)], true) > 0.75
    known = PersonByNetwork({"cam0": np.full(view.depth_m.shape, 9.0, np.float32)})
    assert known.doubtful == set()  # who is told the empty scene needs no network


def test_an_unplaced_camera_needs_no_floor_and_no_up(dressed):
    """One camera alone, its pose unknown."""
    from depthmocap.synth.body.mesh import REST_POSTURE

    frames, masks = shown(dressed, [camera("cam0", 0.4, 1.4)], REST_POSTURE, 0)
    view = frames.views[0]
    unplaced = View(dataclasses.replace(view.camera, world_from_camera=np.eye(4)), view.depth_m)
    segment = NetworkSegmenter({})
    people: list[PersonMasks] = []
    for i in range(5):
        people = list(segment(FrameSet(i * 10**8, (unplaced,))))
    (person,) = people
    assert overlap(person.masks, masks[0]) > 0.75


def test_nothing_is_found_where_nobody_is_and_in_odd_pictures():
    cameras = [camera("cam0", 0.0)]
    pictures = [
        np.zeros((212, 256), np.float32), np.full((212, 256), 0.3, np.float32), np.full((212, 256), 60.0, np.float32),
        np.random.default_rng(0).uniform(0.5, 6, (212, 256)).astype(np.float32),
    ]  # fmt: skip
    for picture in pictures:
        segment = NetworkSegmenter({}, people=4)
        for i in range(6):
            assert segment(FrameSet(i * 10**8, (View(cameras[0], picture),))) == ()
    assert NetworkSegmenter({})(FrameSet(0, ())) == ()


def test_a_covered_camera_loses_nobody_and_invents_nobody(dressed):
    from depthmocap.synth.body.mesh import REST_POSTURE

    cameras = [camera(f"cam{i}", 2.1 * i + 0.4) for i in range(2)]
    frames, _ = shown(dressed, cameras, REST_POSTURE, 0)
    segment, numbers = NetworkSegmenter({}, people=4), []
    for i in range(40):
        first, second = frames.views
        covered = {1: np.zeros_like(second.depth_m), 2: np.full_like(second.depth_m, 0.3)}.get(i // 10)
        views = (first, second if covered is None else View(second.camera, covered))
        numbers.append([person.number for person in segment(FrameSet(i * 10**8, views))])
    assert all(found == [1] for found in numbers[4:])


def test_nobody_for_an_hour_then_somebody_is_found_at_once(dressed):
    from depthmocap.synth.body.mesh import REST_POSTURE

    room, _ = shown(dressed, [camera("cam0", 0.4)], REST_POSTURE, 0, at=(9.0, 0.0))
    inside, masks = shown(dressed, [camera("cam0", 0.4)], REST_POSTURE, 1)
    segment = NetworkSegmenter({}, people=2)
    for i in range(0, 3600, 20):
        assert segment(dataclasses.replace(room, timestamp_ns=i * 10**9)) == ()
    people: list[PersonMasks] = []
    for i in range(4):
        people = list(segment(dataclasses.replace(inside, timestamp_ns=3600 * 10**9 + i * 10**8)))
    (person,) = people
    assert person.number == 1
    assert overlap(person.masks, masks[0]) > 0.75


def test_views_with_masks_keep_them():
    mask = np.zeros((212, 256), np.bool_)
    mask[50:100, 50:100] = True
    view = View(camera("cam0", 0.0), np.ones((212, 256), np.float32), mask)
    (person,) = NetworkSegmenter({})(FrameSet(0, (view,)))
    assert (person.masks[0] == mask).all()


def test_a_network_of_another_kind_is_refused(tmp_path):
    with pytest.raises(InputError, match="not a network that finds people"):
        PeopleDetector(packaged_weights())
    with pytest.raises(InputError, match="train people"):
        PeopleDetector(tmp_path / "none.onnx")


def test_samples_at_pixels_are_their_samples():
    grid = DepthGrid(camera("cam0", 0.0))
    pixels = np.array([[0.0, 0.0], [255.0, 211.0], [-1.0, 5.0], [256.0, 5.0], [100.4, 50.2]])
    rows, columns = grid.samples_at(pixels)
    assert (rows[2:4] == -1).all() and (columns[2:4] == -1).all()
    for (u, v), row, column in zip(pixels[[0, 1, 4]], rows[[0, 1, 4]], columns[[0, 1, 4]], strict=True):
        assert grid.row_starts[row] <= v < grid.row_starts[row + 1]
        assert grid.column_starts[column] <= u < grid.column_starts[column + 1]


def test_the_ways_of_finding_people(tmp_path):
    from depthmocap.recordings.open_recording import open_recording, packaged_recording

    source = open_recording(packaged_recording())
    assert isinstance(load_segmenter(source, "network"), NetworkSegmenter)
    assert isinstance(load_segmenter(source, "auto"), NetworkSegmenter)
    assert isinstance(load_segmenter(source, "background"), PeopleSegmenter)
    assert isinstance(load_segmenter(source, "none"), PeopleSegmenter)
    with pytest.raises(InputError, match="--people"):
        load_segmenter(source, "auto", 0)


@pytest.mark.parametrize(("place_m", "before_m", "expected"), [(3.0, 6.0, True), (4.5, 6.0, False), (3.0, 2.0, False)])
def test_a_place_is_open_where_a_view_from_not_too_far_shows_what_is_behind_it(place_m, before_m, expected):
    """From far, dark hair shows no depth: a head seems 10 cm lower."""
    grid = DepthGrid(DepthCamera("c", 512, 424, 365.0, 365.0, 255.5, 211.5))
    samples_m = grid.samples(np.full((424, 512), before_m, np.float32))
    nothing = np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, bool)
    view = DetectedPeople(grid, samples_m, -samples_m, *nothing, samples_m, np.zeros((7, *grid.shape), np.float32))
    assert is_open(np.array([0.1, 0.1, place_m]), [view]) == expected
    assert not is_open(np.array([9.0, 0.1, place_m]), [view])
