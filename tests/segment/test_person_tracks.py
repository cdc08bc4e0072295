"""Tracks of people from votes alone: clouds of points that vote for centres, in virtual time."""

import dataclasses

import numpy as np
import pytest

from depthmocap.segment.person_tracks import PersonTracker, measure_statures
from depthmocap.segment.vote_clusters import Votes

RATE = 15


def person(rng, x, y, lying=False, spread=0.1, certainty=0.95, area=0.5, stature=1.7, before=False):
    """Points of a body about a place on the floor, and their votes for its centre."""
    count = 300
    heights = rng.uniform(0, stature, count)
    heights[:4], heights[4:8] = 0, stature
    across = rng.normal(0, 0.1, (count, 2))
    points = np.concatenate([across, heights[:, None]], 1)
    if lying:
        points = np.stack([heights - 0.85, across[:, 0], 0.1 + 0.05 * across[:, 1]], 1)
    centre = np.array([x, y, 0.15 if lying else 0.57 * stature])
    points += [x, y, 0]
    votes = centre + rng.normal(0, spread, (count, 3))
    return Votes(
        votes.astype(np.float32), points.astype(np.float32), np.full(count, area / count, np.float32),
        np.full(count, certainty, np.float32), np.full(count, before, np.bool_),
    )  # fmt: skip


def joined(*votes):
    names = [field.name for field in dataclasses.fields(Votes)]
    return Votes(*(np.concatenate([getattr(each, name) for each in votes]) for name in names))


NOTHING, NOWHERE = np.zeros(0, np.float32), np.zeros((0, 3), np.float32)
NOBODY = Votes(NOWHERE, NOWHERE, NOTHING, NOTHING, np.zeros(0, np.bool_))


def numbers(tracker):
    return sorted(track.number for track in tracker.active if track.number)


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def test_who_lies_or_stands_still_for_minutes_keeps_one_number(rng):
    tracker = PersonTracker()
    for i in range(RATE * 180):
        tracker.update(joined(person(rng, 0.0, 0.0, lying=True), person(rng, 1.5, 0.0)), i / RATE)
        if i >= 4:
            assert numbers(tracker) == [1, 2]


@pytest.mark.parametrize("gap", [1.0, 0.6])
def test_two_close_to_each_other_from_the_start_are_two_within_a_third_of_a_second(rng, gap):
    tracker = PersonTracker()
    for i in range(30):
        votes = joined(person(rng, -gap / 2, 0.0), person(rng, gap / 2, 0.0))
        labels = tracker.update(votes, i / RATE)
        if i / RATE > 0.3:
            assert numbers(tracker) == [1, 2]
            first, second = labels[:300], labels[300:]
            majority = np.bincount(first).argmax(), np.bincount(second).argmax()
            assert majority[0] != majority[1]
            assert (first == majority[0]).mean() > 0.95


def test_two_who_cross_keep_their_numbers(rng):
    tracker, where, first = PersonTracker(), {}, 0
    for i in range(45):
        x = -1.5 + i / 15
        tracker.update(joined(person(rng, x, -0.2), person(rng, -x, 0.25)), i / RATE)
        where = {track.number: track.centre_m for track in tracker.active}
        if i == 10:
            first = min(where, key=lambda number: where[number][0])
    assert sorted(where) == [1, 2]
    assert where[first][0] > 1.0


def test_what_the_network_is_not_certain_of_gets_no_number(rng):
    tracker = PersonTracker()
    for i in range(60):
        tracker.update(person(rng, 0.0, 0.0, certainty=0.55), i / RATE)
    assert numbers(tracker) == []


@pytest.mark.parametrize(("area", "certainty", "known"), [(0.6, 0.65, 1), (0.2, 0.65, 0), (0.2, 0.8, 1)])
def test_what_shows_little_needs_more_certainty(rng, area, certainty, known):
    tracker = PersonTracker()
    for i in range(RATE):
        tracker.update(person(rng, 0.0, 0.0, area=area, certainty=certainty), i / RATE)
    assert len(numbers(tracker)) == known


@pytest.mark.parametrize(("certainty", "speed_mps", "known"), [(0.4, 0, 1), (0.3, 0, 0), (0.3, 1, 1), (0.1, 1, 0)])
def test_where_the_scene_was_seen_empty_less_certainty_will_do(rng, certainty, speed_mps, known):
    tracker = PersonTracker()
    for i in range(RATE):
        tracker.update(person(rng, speed_mps * i / RATE, 0.0, certainty=certainty, before=True), i / RATE)
    assert len(numbers(tracker)) == known


def test_two_tracks_of_one_person_become_one(rng):
    tracker = PersonTracker()
    for i in range(RATE * 3):
        gap = 0.6 if i < RATE else 0.15  # an outstretched limb that votes for itself at first
        tracker.update(joined(person(rng, 0.0, 0.0), person(rng, gap, 0.0, area=0.3)), i / RATE)
        assert len(numbers(tracker)) <= 2
    assert numbers(tracker) == [1]


def test_a_limb_that_votes_for_itself_is_nobody(rng):
    tracker = PersonTracker()
    for i in range(RATE * 3):
        votes = [person(rng, 0.0, 0.0, lying=True, area=1.0)]
        if i > RATE:
            votes.append(person(rng, 0.65, 0.0, lying=True, area=0.2, spread=0.05))
        tracker.update(joined(*votes), i / RATE)
        assert numbers(tracker) in ([], [1])


def test_who_comes_to_somebody_is_another_person(rng):
    tracker = PersonTracker()
    for i in range(RATE * 3):
        votes = [person(rng, 0.0, 0.0)]
        if i > RATE:
            votes.append(person(rng, 0.8, 0.0))
        tracker.update(joined(*votes), i / RATE)
    assert numbers(tracker) == [1, 2]


def test_who_is_hidden_for_seconds_is_known_by_the_place(rng):
    tracker = PersonTracker()
    for i in range(RATE * 6):
        hidden = 2.0 < i / RATE < 4.5
        votes = NOBODY if hidden else person(rng, 0.2 * i / RATE, 0.0)
        tracker.update(votes, i / RATE)
    assert numbers(tracker) == [1]


def test_who_returns_is_known_by_stature_and_others_are_not(rng):
    tracker, seen, now = PersonTracker(), [], 0.0
    for stature in (1.8, None, 1.6, None, 1.8):
        for _ in range(RATE * 5):
            now += 1 / RATE
            votes = NOBODY if stature is None else person(rng, 0.0, 0.0, stature=stature, area=0.8)
            labels = tracker.update(votes, now)
            measure_statures(tracker.active, votes, labels, np.eye(4), lambda _: True, lambda _, place: place, now)
        if stature:
            seen += numbers(tracker)
    assert seen == [1, 2, 1]


def test_nobody_is_measured_whose_head_may_be_cut_off(rng):
    tracker = PersonTracker()
    for i in range(RATE):
        votes = person(rng, 0.0, 0.0)
        labels = tracker.update(votes, i / RATE)
        measure_statures(
            tracker.active, votes, labels, np.eye(4), lambda place: place[2] < 1.7, lambda _, place: place, i / RATE
        )
    assert np.isnan(tracker.active[0].stature_m)


@pytest.mark.parametrize(("moves", "stands"), [(0.3, 0.08), (0.4, 0.28)])
def test_a_thing_that_moved_and_stands_again_is_nobody_soon(rng, moves, stands):
    tracker, now_s = PersonTracker(), 0.0
    for i in range(RATE * 4):
        moving, now_s = i < RATE, i / RATE
        certainty = moves if moving else stands
        votes = person(rng, min(now_s, 1.0), 0.0, certainty=certainty, area=0.12, before=True)
        tracker.update(joined(votes, person(rng, -2.0, 0.0)), now_s)
        if i == RATE:
            assert len(numbers(tracker)) == 2
    assert numbers(tracker) == [1]
    tracker.update(joined(person(rng, 1.0, 0.0, area=0.8), person(rng, -2.0, 0.0)), now_s + 0.1)
    assert not tracker._departed  # nobody is waited for


def test_twenty_people_have_twenty_numbers_and_keep_them(rng):
    tracker, where = PersonTracker(), {}
    for i in range(RATE * 2):
        votes = [person(rng, 1.2 * (k % 5), 1.2 * (k // 5)) for k in range(20)]
        tracker.update(joined(*votes), i / RATE)
        if i == RATE:
            where = {track.number: track.centre_m.copy() for track in tracker.active}
    assert numbers(tracker) == list(range(1, 21))
    assert all(np.linalg.norm(track.centre_m - where[track.number]) < 0.3 for track in tracker.active)


def test_memory_is_bounded_when_people_come_and_go_for_long(rng):
    tracker = PersonTracker()
    now = 0.0
    for visit in range(60):
        for _ in range(8):
            now += 1 / RATE
            tracker.update(person(rng, 3.0 * (visit % 2), 0.0), now)
        for _ in range(2):
            now += 2.5
            tracker.update(NOBODY, now)
    assert len(tracker.active) == 0
    assert len(tracker._departed) <= 13
