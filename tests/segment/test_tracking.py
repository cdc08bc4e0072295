"""Numbers that people have and keep, on blobs made by hand, in virtual time."""

import numpy as np
import pytest

from depthmocap.segment.occupancy_map import CELL_M, Blobs
from depthmocap.segment.tracking import PeopleTracker

#: Sets a second.
RATE = 6


def blob(x: float, top: float, rng: np.random.Generator, noise_m: float = 0.0, long_m: float = 0.5) -> Blobs:
    """A body of this height and length that is alone at x, its middle measured with noise."""
    labels = np.zeros((100, 100), np.int32)
    labels[int(2 / CELL_M), int(x / CELL_M)] = 1
    centre = np.array([[x, 2.0]]) + rng.normal(0, noise_m, (1, 2))
    return Blobs(labels, np.array([0.6]), centre, np.array([[long_m, 0.4]]), np.array([top]), np.array([0.0]))


def follow(make, seconds: float, learning_s: float = 0.0, rate: int = RATE) -> list[tuple[int, ...]]:
    """The numbers of everybody who is a person, set by set; ``make`` gives the blobs of a time, or None."""
    tracker, seen = PeopleTracker(), []
    nothing = Blobs(np.zeros((100, 100), np.int32), *(np.zeros(shape) for shape in (0, (0, 2), (0, 2), 0, 0)))
    for i in range(round(seconds * rate)):
        now_s = i / rate
        blobs = make(now_s) or nothing
        tracker.predict(now_s)
        owner, _ = tracker.assign(blobs, now_s)
        tracker.update(owner, blobs, {}, now_s < learning_s, lambda place, height: True, now_s)
        seen.append(tuple(track.number for track in tracker.active if track.number))
    return seen


@pytest.mark.parametrize("noise_m", [0.0, 0.003])
def test_who_stands_still_for_minutes_stays_who_they_are(noise_m: float) -> None:
    rng = np.random.default_rng(0)
    assert set(follow(lambda t: blob(1 + min(t, 1.0), 1.75, rng, noise_m), 70)) == {(1,)}


def test_who_sits_low_and_still_is_the_same_when_they_rise() -> None:
    rng = np.random.default_rng(0)
    seen = follow(lambda t: blob(1 + min(t, 1.0) + 0.05 * (t > 80), 1.75 if t < 5 or t > 80 else 0.9, rng), 90)
    assert set(seen) == {(1,)}


def test_who_falls_and_lies_still_stays_who_they_are() -> None:
    rng = np.random.default_rng(0)

    def falls(t: float) -> Blobs:
        share = float(np.clip((t - 3) / 0.7, 0, 1))
        return blob(1 + min(t, 1.0) + 0.9 * share, 1.75 - 1.4 * share, rng, 0.003, 0.5 + share)

    assert set(follow(falls, 60, rate=15)) == {(1,)}
    assert set(follow(falls, 60, learning_s=0.5, rate=15)[15:]) == {(1,)}


@pytest.mark.parametrize(("long_m", "stays"), [(1.6, True), (0.5, False)])
def test_who_lies_from_the_start_where_the_empty_scene_is_known_is_somebody(long_m: float, stays: bool) -> None:
    rng = np.random.default_rng(0)
    seen = follow(lambda t: blob(2 + 0.02 * min(t, 1.0), 0.35, rng, 0.002, long_m), 40)
    assert seen[2 * RATE] == (1,)
    assert seen[-1] == ((1,) if stays else ())


def test_a_chair_that_is_left_when_somebody_is_gone_is_nobody() -> None:
    rng = np.random.default_rng(0)
    seen = follow(lambda t: blob(1 + min(t, 1.0), 1.5 if t < 5 else 0.9, rng), 40, rate=30)
    assert seen[4 * 30] == (1,) and seen[-1] == ()


def test_a_thing_does_not_become_the_whole_room_when_that_is_learnt() -> None:
    rng = np.random.default_rng(0)
    seen = follow(lambda t: blob(1.0 if t < 0.5 else 2.1, 2.2, rng, 0.0, 0.5 if t < 0.5 else 6.0), 3, 2.0, 15)
    assert set(seen) == {()}


def test_who_is_hardly_tall_enough_does_not_get_number_after_number() -> None:
    rng = np.random.default_rng(0)
    seen = follow(lambda t: blob(1 + min(t, 1.0), 1.12 if t % 12 < 1.5 else 1.05, rng, 0.003), 60)
    assert set(seen) <= {(1,), ()}


def test_who_stood_still_until_they_were_background_is_known_by_height_when_they_come_to_light() -> None:
    rng = np.random.default_rng(0)
    seen = follow(lambda t: None if 15 < t < 25 else blob(2.0 + 0.02 * max(t - 25, 0), 1.75, rng), 30, learning_s=2.0)
    assert seen[2 * RATE] == seen[-1] == (1,) and set(seen) == {(1,), ()}


def test_what_stood_there_while_the_room_was_learnt_is_a_thing_until_it_walks_away() -> None:
    rng = np.random.default_rng(0)
    seen = follow(lambda t: blob(1 + 0.5 * max(t - 40, 0), 1.75, rng), 44, learning_s=2.0)
    assert set(seen[15 * RATE : 40 * RATE]) == {()}
    assert seen[2 * RATE] == seen[-1] == (1,)


@pytest.mark.parametrize(("top_m", "known"), [(1.95, True), (2.28, False)])
def test_a_wall_seen_through_a_door_while_the_room_is_learnt_is_nobody(top_m: float, known: bool) -> None:
    rng = np.random.default_rng(0)
    assert any(follow(lambda t: blob(2.0, top_m, rng, 0.02), 8, learning_s=1.0)) == known
    assert any(follow(lambda t: blob(2.0 + np.clip(t - 2, 0, 2), 2.28, rng), 8, learning_s=1.0))
