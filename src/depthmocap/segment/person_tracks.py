"""Tracking of people by the centres that a network votes for: they keep their number in any posture."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from depthmocap.kernels.people_votes import assign_votes, densest_vote
from depthmocap.segment.departed import AWAY_S, HIDDEN_S, Departed, alike, match_place, match_stature, may_match

#: Votes within this distance of a centre are for it (metres): a centre is known to some 10 cm, from limbs to 30 cm.
REACH_M = 0.55
#: New centres are looked for with this reach (metres): two who touch stand about so far apart.
NEW_REACH_M = 0.3
#: So many places are tried for a new centre.
PLACES = 100
#: So many new centres are looked for in one set.
NEW_CENTRES = 40
#: A new centre needs this much surface (m²): a head and shoulders at any distance,
NEW_M2 = 0.05
#: and must be this far from all others (metres); nearer votes belong to the other person's limbs.
APART_M = 0.3
#: Votes with less surface than this (m²)
PART_M2 = 0.1
#: and within this distance of a centre (metres) are for limbs of that person.
PART_M = 0.9
#: Two heaps of votes are one if they are nowhere between their middles lower than this share of the lower middle,
VALLEY = 0.6
#: counted this far on both sides of each place (metres).
VALLEY_M = 0.08
#: A track with less surface than this (m²) is not seen.
SEEN_M2 = 0.01
#: A track becomes a person when it was seen in so many sets
SETS_NEEDED = 3
#: over at least this time (seconds),
CERTAIN_S = 0.1
#: if the network's certainty of its samples is on average at least this, by the surface (m²): furniture that is taken
#: for people mostly shows little.
CERTAINTY_M2, CERTAINTY = (0.05, 0.3), (0.9, 0.6)
#: One set is enough for a body of which so much is seen (m²), with this certainty.
AT_ONCE_M2, AT_ONCE_CERTAINTY = 0.5, 0.8
#: The time over which certainty is averaged (seconds).
CERTAINTY_S = 0.2
#: Of what has moved so far (metres) less certainty will do, because furniture stays where it is,
MOVED_M, MOVED_CERTAINTY = 0.25, 0.4
#: and of what is mostly (this share of its surface) where the scene was seen empty,
BEFORE, BEFORE_CERTAINTY = 0.7, 0.35
#: and less still of what is both.
MOVED_BEFORE_CERTAINTY = 0.12
#: A track unseen for this time ends (seconds); one that is no person yet ends sooner.
GONE_S, UNBORN_S = 1.0, 0.3
#: So does one that is seen, but shows less than this (m²) with less certainty than this: a chair that was pushed.
UNSURE_M2, UNSURE_CERTAINTY = 0.2, 0.2
#: What appears this near to somebody (metres) may be a limb that votes for itself: it needs this time (seconds) and
#: this surface (m²) to be another person.
BESIDE_M, BESIDE_S, BESIDE_M2 = 1.3, 0.6, 0.3
#: Two tracks nearer to each other than this (metres) are one person, if the younger is no older than this (seconds)
SAME_M, SAME_S = 0.3, 1.0
#: or if they were never farther apart for this time (seconds): two people who embrace are farther apart.
DOUBLE_S = 0.5
#: Share of the residual by which an update corrects position and velocity.
POSITION_GAIN, VELOCITY_GAIN = 0.6, 0.2
#: Motion is predicted for no longer than this (seconds): an unseen person may have stopped.
PREDICT_S = 0.3
#: Bound of the speed (m/s): nobody runs faster indoors.
FASTEST_MPS = 4.0
#: Statures are measured so far apart in time (seconds),
MEASURE_S = 0.06
#: and kept, up to so many; from so many on they tell, and from so many on they are measured only so often (seconds).
STATURES_KEPT, STATURES_NEEDED, STATURES_ENOUGH, MEASURE_AGAIN_S = 60, 6, 30, 0.4
#: Only who is so high (metres), shows so many samples, and has the middle of the trunk at these shares of the height
#: stands upright;
LEAST_STATURE_M, LEAST_POINTS, MIDDLE = 1.0, 60, (0.5, 0.75)
#: so far above the head (metres) nothing may be: it would cut the head off.
CLEARANCE_M = 0.1
#: While others are away, a new track waits for its stature before it gets a number, but no longer than this (seconds).
RECOGNISE_S = 1.9
#: So long it waits for its stature where somebody was hidden nearby whose stature is known.
PLACE_S = 0.7


@dataclasses.dataclass(eq=False)
class PersonTrack:
    """Somebody, or something that resembles a person.

    Attributes:
        label: tells active tracks apart, 1–254.
        centre_m: the middle of the trunk in the world.
        number: from 1; 0 while it is not certain to be a person.
        area_m2: visible surface now, 0 when hidden.
        certainty: average probability of the samples, over the last ``CERTAINTY_S``.
        probability: the same of all views that see the person, also of those that take them for something else.
        before: average share of the surface that is where the scene was seen empty.
        start_m: where the track began.
        apart_s: when no older track was nearer than ``SAME_M`` last.
        born_alone: whether nobody was known near where it began: it is nobody's part.
        sets, missed_sets: in how many sets it was seen, and in how many it has been hidden since.
        statures_m: measured while the person was upright and in full view.
        sure_s: when it last showed much, or something certain.
        perhaps: in the set in which it got a new number: numbers of people as tall, who are away.
    """

    label: int
    centre_m: Float[ndarray, "3"]
    start_s: float
    number: int = 0
    last_seen_s: float = 0.0
    area_m2: float = 0.0
    certainty: float = 0.0
    probability: float = 0.0
    before: float = 0.0
    sets: int = 0
    missed_sets: int = 0
    apart_s: float = np.nan
    born_alone: bool = True
    start_m: Float[ndarray, "3"] = dataclasses.field(default_factory=lambda: np.zeros(3))
    velocity_mps: Float[ndarray, "3"] = dataclasses.field(default_factory=lambda: np.zeros(3))
    predicted_m: Float[ndarray, "3"] = dataclasses.field(default_factory=lambda: np.zeros(3))
    statures_m: list[float] = dataclasses.field(default_factory=list)
    measured_s: float = -np.inf
    perhaps: tuple[int, ...] = ()
    sure_s: float = 0.0

    def predict(self, now_s: float) -> None:
        """Predict the centre at constant velocity."""
        self.predicted_m = self.centre_m + self.velocity_mps * min(now_s - self.last_seen_s, PREDICT_S)

    def update(
        self, centre_m: Float[ndarray, "3"], area_m2: float, certainty: float, before: float, now_s: float
    ) -> None:
        """Correct the prediction by a measurement."""
        passed_s = max(now_s - self.last_seen_s, 1e-3)
        residual = centre_m - self.predicted_m
        self.centre_m = self.predicted_m + POSITION_GAIN * residual
        # The first measurement corrects where the track began, which was no motion.
        velocity = self.velocity_mps + (VELOCITY_GAIN * residual / passed_s if self.sets else 0.0)
        self.velocity_mps = velocity * min(1.0, FASTEST_MPS / max(float(np.linalg.norm(velocity)), 1e-9))
        share = 1.0 if not self.sets else min(1.0, passed_s / CERTAINTY_S)
        self.certainty += share * (certainty - self.certainty)
        self.before += share * (before - self.before)
        self.area_m2, self.last_seen_s = area_m2, now_s
        if area_m2 > UNSURE_M2 or self.certainty > UNSURE_CERTAINTY:
            self.sure_s = now_s
        self.sets, self.missed_sets = self.sets + 1, 0

    def add_probability(self, probability: float) -> None:
        """Lower the certainty where other views contradict."""
        self.probability += (1.0 if self.sets <= 1 else 0.4) * (probability - self.probability)
        self.certainty = min(self.certainty, self.probability)

    def add_stature(self, stature_m: float, now_s: float) -> None:
        """Add a measured stature (metres)."""
        self.statures_m = [*self.statures_m[1 - STATURES_KEPT :], stature_m]
        self.measured_s = now_s

    @property
    def stature_m(self) -> float:
        """An upper quantile of the measured statures, because people bob and bend; NaN before there are enough."""
        if len(self.statures_m) < STATURES_NEEDED:
            return np.nan
        return float(np.quantile(self.statures_m, 0.75))


@dataclasses.dataclass(frozen=True, eq=False)
class Votes:
    """Samples of all cameras that show people.

    Attributes:
        places: what each votes for: the centre of its person in the world (metres).
        points: where each is (metres).
        areas_m2: its surface.
        certainties: the network's probability that it shows a person.
        before: whether it is where the scene was seen empty.
    """

    places: Float[ndarray, "n 3"]
    points: Float[ndarray, "n 3"]
    areas_m2: Float[ndarray, " n"]
    certainties: Float[ndarray, " n"]
    before: Bool[ndarray, " n"]


class PersonTracker:
    """Tracks of people. Labels 1–254 tell the active tracks apart, and are used again; numbers belong to one person."""

    def __init__(self) -> None:
        self.active: list[PersonTrack] = []
        self._departed: list[Departed] = []
        #: Who was told of without certainty: known again by the place alone, and waited for by nobody.
        self._unsure: list[Departed] = []
        self._last_number = 0

    def update(
        self, votes: Votes, now_s: float, probability: Callable[[Float[ndarray, "n 3"]], float] | None = None
    ) -> Int[ndarray, " n"]:
        """Follow everybody into the next set; the label of each vote's track, 0 for none.

        Args:
            probability: that points (metres) show a person, in all views that see them; it decides who becomes a
                person, instead of the certainty of the votes alone.
        """
        for track in self.active:
            track.predict(now_s)
            track.perhaps = ()
        centres = np.array([track.predicted_m for track in self.active], np.float32).reshape(-1, 3)
        owners, sums, centres = _cluster(votes, centres)
        taken = {track.label for track in self.active}
        free = (label for label in range(1, 255) if label not in taken)
        for centre, label in zip(centres[len(self.active) :], free, strict=False):
            self.active.append(
                PersonTrack(
                    label,
                    centre.astype(float),
                    now_s,
                    last_seen_s=now_s,
                    sure_s=now_s,
                    predicted_m=centre.astype(float),
                    start_m=centre.astype(float),
                    apart_s=now_s - 1e-6,
                    born_alone=all(
                        np.linalg.norm(centre - other.centre_m) > BESIDE_M for other in self.active if other.number
                    ),
                )
            )
        # Probable samples count more: the rim of a person is never certain.
        weights = votes.areas_m2 * votes.certainties
        certainties = _means(votes.certainties, weights, owners, len(centres))
        before = _means(votes.before, votes.areas_m2, owners, len(centres))
        for k, track in enumerate(self.active):
            track.area_m2, track.missed_sets = 0.0, track.missed_sets + 1
            if sums[k, 0] > SEEN_M2:
                area = float(sums[k, 0])
                track.update(sums[k, 1:] / sums[k, 0], area, float(certainties[k]), float(before[k]), now_s)
        labels = np.array([0, *(track.label for track in self.active)])[
            np.where(owners < len(self.active), owners, -1) + 1
        ]
        self._end(votes, now_s)
        for track in self.active:
            if not track.number and track.area_m2 > 0:
                if probability is not None:
                    track.add_probability(probability(votes.points[labels == track.label]))
                self._identify(track, now_s)
        active = np.zeros(256, labels.dtype)
        for track in self.active:
            active[track.label] = track.label
        return active[labels]

    def _end(self, votes: Votes, now_s: float) -> None:
        """End tracks that are gone, and young ones that are a part of another."""
        kept: list[PersonTrack] = []
        for track in sorted(self.active, key=lambda track: (track.number == 0, track.start_s)):
            unseen_s = now_s - track.last_seen_s
            if not any(_is_same(track, other, votes) for other in kept):
                track.apart_s = now_s
            same = track.apart_s < now_s and (now_s - track.start_s < SAME_S or now_s - track.apart_s > DOUBLE_S)
            unsure = track.last_seen_s - track.sure_s > GONE_S and np.isnan(track.stature_m)
            gone = unseen_s > GONE_S if track.number else unseen_s > UNBORN_S and track.missed_sets > 1
            if track.number and unsure:
                self._unsure.append(Departed(track.number, np.nan, 0.0, track.centre_m, now_s))
                continue
            if gone or same:
                if track.number and (track.born_alone or not same):
                    stature = track.stature_m
                    least = max(track.statures_m, default=0.0)
                    self._departed.append(Departed(track.number, stature, least, track.centre_m, track.last_seen_s))
            else:
                kept.append(track)
        self.active = kept
        self._departed = [away for away in self._departed if now_s - away.last_seen_s < AWAY_S]
        self._unsure = [away for away in self._unsure if now_s - away.last_seen_s < HIDDEN_S]

    def _identify(self, track: PersonTrack, now_s: float) -> None:
        """Give a track a number once it is certain to be a person."""
        age_s = now_s - track.start_s
        moved = float(np.linalg.norm(track.centre_m - track.start_m)) > MOVED_M and age_s > CERTAINTY_S
        if track.before > BEFORE:
            needed = MOVED_BEFORE_CERTAINTY if moved else BEFORE_CERTAINTY
        else:
            needed = MOVED_CERTAINTY if moved else float(np.interp(track.area_m2, CERTAINTY_M2, CERTAINTY))
        if not track.born_alone and (age_s < BESIDE_S or track.area_m2 < BESIDE_M2):
            return
        at_once = track.area_m2 > AT_ONCE_M2 and track.certainty > AT_ONCE_CERTAINTY
        if ((track.sets < SETS_NEEDED or age_s < CERTAIN_S) and not at_once) or track.certainty < needed:
            return
        match = match_place([*self._departed, *self._unsure], track.centre_m, track.stature_m, now_s)
        if match is not None and np.isnan(track.stature_m) and match.stature_m > 0 and age_s < PLACE_S:
            return  # somebody else may come in where another has just left
        if match is None:
            match = match_stature(self._departed, track.stature_m)
            if match is None and age_s < RECOGNISE_S and may_match(self._departed, track.stature_m):
                return
        if match is None:
            self._last_number += 1
            track.number = self._last_number
            track.perhaps = alike(self._departed, track.stature_m)
        else:
            (self._departed if match in self._departed else self._unsure).remove(match)
            track.number = match.number


def _is_same(track: PersonTrack, older: PersonTrack, votes: Votes) -> bool:
    """Whether a track seems to be of the same person as an older one."""
    distance = np.linalg.norm(track.centre_m - older.centre_m)
    if distance < SAME_M or track.born_alone or distance > PART_M or not track.area_m2 or not older.area_m2:
        return bool(distance < SAME_M)
    return _one_heap(votes, older.centre_m, track.centre_m)


def _means(
    values: Float[ndarray, " n"] | Bool[ndarray, " n"],
    weights: Float[ndarray, " n"],
    owners: Int[ndarray, " n"],
    count: int,
) -> Float[ndarray, " k"]:
    """The weighted mean of each owner's values, 0 for who has none."""
    owned = owners >= 0
    sums = np.bincount(owners[owned], weights[owned], count)
    return np.bincount(owners[owned], (weights * values)[owned], count) / np.maximum(sums, 1e-9)


def _cluster(
    votes: Votes, centres: Float[ndarray, "k 3"]
) -> tuple[Int[ndarray, " n"], Float[ndarray, "m 4"], Float[ndarray, "m 3"]]:
    """The owner of each vote (-1 for none), the sums of each owner (m², m² · place), and all centres: the predicted
    ones, then new ones."""
    places, areas = votes.places, votes.areas_m2
    owners = np.full(len(places), -1)
    sums = np.zeros((len(centres), 4))
    for _ in range(2 if len(centres) else 0):
        assign_votes(places, areas, centres, REACH_M, owners, sums)
        moved = sums[:, 1:] / np.maximum(sums[:, :1], 1e-9)
        centres = np.where(sums[:, :1] > SEEN_M2, moved, centres).astype(np.float32)
    # Votes are the same for all samples of a cell; what is left may be somebody new.
    left = owners.copy()
    for _ in range(NEW_CENTRES):
        centre = np.zeros(3)
        area = densest_vote(places, areas, left, PLACES, NEW_REACH_M, centre)
        if area < NEW_M2:
            break
        near = (np.linalg.norm(places - centre, axis=1) < NEW_REACH_M) & (left < 0)
        if not near.any():
            break
        distances = np.linalg.norm(centres - centre, axis=1)
        nearest = int(distances.argmin()) if len(centres) else -1
        limb = nearest >= 0 and (
            distances[nearest] < APART_M
            or (distances[nearest] < PART_M and (area < PART_M2 or _one_heap(votes, centres[nearest], centre)))
        )
        if limb:
            left[near] = nearest
        else:
            centres = np.concatenate([centres, centre[None].astype(np.float32)])
            left[near] = len(centres) - 1
    if not len(centres):
        return owners, np.zeros((0, 4)), centres
    sums = np.zeros((len(centres), 4))
    assign_votes(places, areas, centres, REACH_M, owners, sums)
    # Few votes that are farther off are for limbs.
    far = np.empty(len(places), np.int64)
    assign_votes(places, areas, centres, PART_M, far, np.empty_like(sums))
    owners = np.where(owners < 0, np.where(left >= 0, left, far), owners)
    return owners, sums, centres


def _one_heap(votes: Votes, one: Float[ndarray, "3"], other: Float[ndarray, "3"]) -> bool:
    """Whether the votes about two centres have no valley between them: those for one person, who lies perhaps."""
    line = other - one
    length = float(np.linalg.norm(line))
    along = (votes.places - one) @ (line / length)
    aside = np.linalg.norm(votes.places - one - along[:, None] * (line / length), axis=1)
    places = np.linspace(0, length, 9)
    kernel = np.abs(along[:, None] - places) < VALLEY_M
    heights = (votes.areas_m2[:, None] * (kernel & (aside < REACH_M)[:, None])).sum(0)
    return bool(heights[1:-1].min() > VALLEY * min(heights[0], heights[-1]))


def measure_statures(
    tracks: Sequence[PersonTrack],
    votes: Votes,
    labels: Int[ndarray, " n"],
    floor_from_world: Float[ndarray, "4 4"],
    is_open: Callable[[Float[ndarray, "3"]], bool],
    highest: Callable[[int, Float[ndarray, "3"]], Float[ndarray, "3"]],
    now_s: float,
) -> None:
    """Measure everybody who stands upright: from the floor to the highest point, if nothing cuts the head off.

    Args:
        is_open: whether a place (metres) is in view and nothing is there or before it.
        highest: the highest point (metres) of a label about the highest sample: samples are some centimetres apart.
    """
    up, floor_m = floor_from_world[2, :3], -floor_from_world[2, 3]
    for track in tracks:
        wait_s = MEASURE_S if len(track.statures_m) < STATURES_ENOUGH else MEASURE_AGAIN_S
        if now_s - track.measured_s < wait_s or not track.area_m2:
            continue
        own = np.flatnonzero(labels == track.label)
        if len(own) < LEAST_POINTS:
            continue
        heights = votes.points[own] @ up - floor_m
        sample = np.argpartition(heights, -3)[-3]
        top_m = float(heights[sample])
        middle_m = float(track.centre_m @ up) - floor_m
        upright = top_m > LEAST_STATURE_M and MIDDLE[0] < middle_m / top_m < MIDDLE[1]
        if upright:
            top = highest(track.label, votes.points[own[sample]])
            if is_open(top + CLEARANCE_M * up):
                track.add_stature(float(top @ up) - floor_m, now_s)
