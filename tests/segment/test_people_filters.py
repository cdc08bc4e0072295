"""Everybody who is followed has a filter of their own, for as long as it remembers them."""

import numpy as np
import pytest

from depthmocap.classify.classifier import ViewPrediction
from depthmocap.frames import FrameSet, Pose, View
from depthmocap.geometry import DepthCamera
from depthmocap.offline.pipeline import Pipeline, mix_up_lines
from depthmocap.segment.people_segmenter import PersonMasks
from depthmocap.smooth.filters import FILTERS, FilterName, load_filter
from depthmocap.smooth.fixed_lag import FixedLag, FixedLagSettings
from depthmocap.smooth.kalman import Kalman
from depthmocap.smooth.pose_filter import MAX_GAP_S

RATE, LAG = 10, 3
CAMERA = DepthCamera("a", 4, 3, 5.0, 5.0, 1.5, 1.0)


class Numbers:
    """Gives the people that it is told, whatever is in the views."""

    def __init__(self) -> None:
        self.people, self.problems = 2, []
        self.present: tuple[int, ...] = ()

    def __call__(self, frames: FrameSet) -> tuple[PersonMasks, ...]:
        return tuple(PersonMasks(number, (np.ones((3, 4), bool),)) for number in self.present)

    def reset(self) -> None:
        pass


class Touching(Numbers):
    """Two who touch."""

    def __call__(self, frames: FrameSet) -> tuple[PersonMasks, ...]:
        masks = (np.ones((3, 4), bool),)
        return PersonMasks(1, masks, (2,), 0.25), PersonMasks(2, masks, (1,), 0.25)


class Anywhere:
    """Labels nothing, and takes all joints to be in one place."""

    def label_views(self, views, masks, up=None):
        nothing = ViewPrediction(np.zeros((3, 4), np.uint8), np.zeros((3, 4), np.float32), np.full((18, 4), np.nan))
        return [nothing for _ in masks]

    def __call__(self, cloud, up="z"):
        return np.zeros((18, 3)), np.ones(18)


def test_every_pose_is_final_once_and_filters_of_who_has_gone_are_put_away() -> None:
    segment = Numbers()
    pipeline = Pipeline(Anywhere(), Anywhere(), segment, "z", FixedLag(FixedLagSettings(LAG)))
    given: dict[int, list[int]] = {}
    final: dict[int, list[Pose]] = {}
    most = 0
    for i in range(12 * RATE):
        # Person 1 comes and goes every three seconds; each of the others is there for less than the filter waits.
        first = (1,) if i // (3 * RATE) % 2 == 0 else ()
        segment.present = (*first, 2 + i // 2) if i < 11 * RATE else ()
        stamp = i * 10**9 // RATE
        for number in segment.present:
            given.setdefault(number, []).append(stamp)
        result = pipeline(FrameSet(stamp, (View(CAMERA, np.ones((3, 4), np.float32)),)))
        most = max(most, len(pipeline._filters))
        for number, own in result.final.items():
            final.setdefault(number, []).extend(own)
    for number, own in pipeline.finish_people().items():
        final.setdefault(number, []).extend(own)
    assert {number: [pose.timestamp_ns for pose in own] for number, own in final.items()} == given
    assert most <= 2 + MAX_GAP_S * RATE


class Moving(Anywhere):
    """Gives each person whom it is asked about in turn joints that move, or none."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(0)

    def __call__(self, cloud, up="z"):
        joints = self.rng.normal(0, 0.05, (18, 3)) + np.linspace(0, 1, 18)[:, None]
        return (np.full((18, 3), np.nan), np.zeros(18)) if self.rng.random() < 0.1 else (joints, np.full(18, 0.8))


#: Who is there, the one who is followed first, and in how many sets: who comes first goes and comes back.
SCRIPT = (((), 3), ((1, 2), 20), ((2, 1), 4), ((1, 2), 4), ((2,), 9), ((2, 1), 5), ((), 8), ((3, 2), 8))


def smoothed_people(name: FilterName, alone: bool) -> tuple[list[Pose], dict[int, list[Pose]]]:
    """The poses of the one who is followed and of everybody; ``alone``: nobody shares a filter."""
    segment, moving = Numbers(), Moving()
    pipeline = Pipeline(moving, moving, segment, "z", load_filter(name, LAG))
    followed, own = list[Pose](), dict[int, list[Pose]]()

    def add(final: dict[int, list[Pose]]) -> None:
        for number, poses in final.items():
            own.setdefault(number, []).extend(poses)

    for i, present in enumerate(present for present, count in SCRIPT for _ in range(count)):
        segment.present = present
        if alone:
            pipeline._begun = pipeline.smoothing
        result = pipeline(FrameSet(i * 10**9 // RATE, (View(CAMERA, np.ones((3, 4), np.float32)),)))
        followed.append(result.pose)
        add(result.final)
    followed += pipeline.finish()
    add(pipeline.finish_people())
    return followed, own


@pytest.mark.parametrize("name", FILTERS)
def test_a_filter_that_two_share_gives_what_two_give(name: FilterName) -> None:
    followed, own = smoothed_people(name, alone=False)
    of_alone, own_alone = smoothed_people(name, alone=True)
    assert own.keys() == own_alone.keys() == {1, 2, 3}
    for poses, others in ((followed, of_alone), *((own[number], own_alone[number]) for number in own)):
        assert [pose.timestamp_ns for pose in poses] == [pose.timestamp_ns for pose in others]
        for pose, other in zip(poses, others, strict=True):
            np.testing.assert_array_equal(pose.joints, other.joints)
            np.testing.assert_array_equal(pose.confidence, other.confidence)


def test_who_is_followed_from_the_start_is_smoothed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    calls, filtered = list[int](), Kalman.__call__
    monkeypatch.setattr(Kalman, "__call__", lambda self, pose: (calls.append(1), filtered(self, pose))[1])
    segment = Numbers()
    segment.present = (1, 2)
    pipeline = Pipeline(Anywhere(), Anywhere(), segment, "z", load_filter("kalman"))
    for i in range(5):
        pipeline(FrameSet(i * 10**9 // RATE, (View(CAMERA, np.ones((3, 4), np.float32)),)))
    assert len(calls) == 2 * 5


def test_who_cannot_be_told_apart_is_said_and_less_confident() -> None:
    segment = Touching()
    result = Pipeline(Anywhere(), Anywhere(), segment)(FrameSet(0, (View(CAMERA, np.ones((3, 4), np.float32)),)))
    assert mix_up_lines(result) == [
        "people 1 and 2 could not be told apart: they touched, or are as tall, and may be each other"
    ]
    assert [person.mistakable for person in result.people] == [(2,), (1,)]
    assert (result.pose.confidence == 0.75).all()
