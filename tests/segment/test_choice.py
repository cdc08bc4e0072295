"""Who is followed: in an area, and the subject before others."""

import dataclasses

import numpy as np
import pytest

from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera
from depthmocap.geometry.transforms import look_at
from depthmocap.segment.choice import Choice, Follower, middle_of, place_on_floor


def camera(eye, target):
    eye, target = np.array(eye, float), np.array(target, float)
    return DepthCamera("c", 64, 48, 60.0, 60.0, 31.5, 23.5, world_from_camera=look_at(eye, target))


CAMERAS = [camera([3, 0, 1], [0, 0, 1]), camera([0, 3, 1.5], [0, 0, 1])]


@dataclasses.dataclass
class Track:
    number: int
    area_m2: float
    centre_m: np.ndarray


def track(number, x, y, area_m2=0.5):
    return Track(number, area_m2, np.array([x, y, 1.0]))


def followed(follower, tracks, most=1):
    return [each.number for each in follower(tracks, most, lambda each: each.centre_m, CAMERAS)]


TRACKS = [track(1, 1.5, 1.0, 0.4), track(2, 0.1, 0.0, 0.3), track(3, -2.0, 0.0, 0.9), track(0, 0.0, 0.0, 2.0)]


@pytest.mark.parametrize(("subject", "first"), [("largest", 3), ("middle", 2), ("first", 1), (2, 2), (3, 3)])
def test_the_subject_is_followed_first(subject, first):
    assert followed(Follower(Choice(subject), "z"), TRACKS) == [first]
    assert followed(Follower(Choice(subject), "z"), TRACKS, 3)[0] == first


def test_who_is_followed_stays_so_until_they_leave():
    follower = Follower(Choice("middle"), "z")
    assert followed(follower, TRACKS) == [2]
    assert followed(follower, [track(2, 2.0, 2.0), track(1, 0.0, 0.0)]) == [2]
    assert followed(follower, [track(1, 0.0, 0.0)]) == [1]


def test_a_number_is_waited_for_and_then_takes_the_place():
    follower = Follower(Choice(3), "z")
    assert followed(follower, [track(1, 0.0, 0.0)]) == []
    assert followed(follower, [track(1, 0.0, 0.0), track(3, 1.0, 0.0)]) == [3]
    follower = Follower(Choice(3), "z")
    assert followed(follower, [track(1, 0.0, 0.0), track(2, 0.0, 0.0)], 2) == [1, 2]
    assert followed(follower, [track(1, 0, 0), track(2, 0, 0), track(3, 1, 0)], 2)[-1] == 3
    assert followed(follower, [track(1, 0, 0), track(2, 0, 0), track(3, 1, 0)], 2)[0] == 3


def test_who_is_outside_the_area_is_nobody():
    choice = Choice(area=(0.0, -1.0, 2.0, -1.0, 2.0, 2.0, 0.0, 2.0))
    assert sorted(followed(Follower(choice, "z"), TRACKS, 5)) == [1, 2]
    follower = Follower(choice, "z")
    assert followed(follower, [track(1, 1.0, 0.0)]) == [1]
    assert followed(follower, [track(1, 3.0, 0.0), track(2, 1.0, 0.0)]) == []  # stepped out for a moment
    assert followed(follower, [track(1, 1.0, 0.0), track(2, 1.0, 0.0)]) == [1]


def test_the_area_lies_on_the_floor_of_rigs_whose_y_is_up():
    assert place_on_floor(np.array([1.0, 2.0, 3.0]), "y").tolist() == [1, 3]
    follower = Follower(Choice(area=(0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0)), "-y")
    inside, outside = Track(1, 1.0, np.array([0.5, -1.0, 0.5])), Track(2, 1.0, np.array([0.5, 0.5, -1.0]))
    assert followed(follower, [inside, outside], 2) == [1]


def test_the_middle_is_what_all_cameras_look_at():
    np.testing.assert_allclose(middle_of(CAMERAS), [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(middle_of(CAMERAS[:1]), [0.5, 0, 1], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"area": (0.0, 0.0, 1.0, 0.0)}, "at least three corners"),
        ({"area": (0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 2.0)}, "at least three corners"),
        ({"area": (0.0, 0.0, 1.0, 0.0, 2.0, 0.0)}, "enclose nothing"),
        ({"area": (0.0, 0.0, 1.0, 0.0, np.nan, 1.0)}, "numbers of metres"),
        ({"subject": 0}, "--subject"),
    ],
)
def test_choices_that_cannot_be(change, message):
    with pytest.raises(InputError, match=message):
        Choice(**change)


def test_an_area_needs_cameras_that_stand_somewhere():
    nowhere = [dataclasses.replace(CAMERAS[0], world_from_camera=np.eye(4))]
    follower = Follower(Choice(area=(0.0, 0.0, 1.0, 0.0, 1.0, 1.0)), "z")
    with pytest.raises(InputError, match="does not tell where its cameras stand"):
        follower(TRACKS, 1, lambda each: each.centre_m, nowhere)
    assert Follower(Choice(), "z")(TRACKS, 1, lambda each: each.centre_m, nowhere)
