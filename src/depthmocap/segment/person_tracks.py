"""Tracking of people by the centres that a network votes for: they keep their number in any posture."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from depthmocap.segment.departed import AWAY_S, HIDDEN_S, Departed, alike, match_place, match_stature, may_match
from depthmocap.segment.tracking_rules import CLUSTERING, END, MOTION, PERSON, STATURE
from depthmocap.segment.vote_clusters import Votes, are_one_heap, cluster_votes


@dataclasses.dataclass(eq=False)
class PersonTrack:
    """Somebody, or something that resembles a person.

    Attributes:
        label: tells active tracks apart, 1–254.
        centre_m: the middle of the trunk in the world.
        number: from 1; 0 while it is not certain to be a person.
        area_m2: visible surface now, 0 when hidden.
        certainty: average probability of the samples, over the last ``PERSON.averaged_s``.
        probability: the same of all views that see the person, also of those that take them for something else.
        before: average share of the surface that is where the scene was seen empty.
        start_m: where the track began.
        apart_s: when no older track was nearer than ``END.same_m`` last.
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
        self.predicted_m = self.centre_m + self.velocity_mps * min(now_s - self.last_seen_s, MOTION.predict_s)

    def update(
        self, centre_m: Float[ndarray, "3"], area_m2: float, certainty: float, before: float, now_s: float
    ) -> None:
        """Correct the prediction by a measurement."""
        passed_s = max(now_s - self.last_seen_s, 1e-3)
        residual = centre_m - self.predicted_m
        self.centre_m = self.predicted_m + MOTION.position_gain * residual
        # The first measurement corrects where the track began, which was no motion.
        velocity = self.velocity_mps + (MOTION.velocity_gain * residual / passed_s if self.sets else 0.0)
        self.velocity_mps = velocity * min(1.0, MOTION.fastest_mps / max(float(np.linalg.norm(velocity)), 1e-9))
        share = 1.0 if not self.sets else min(1.0, passed_s / PERSON.averaged_s)
        self.certainty += share * (certainty - self.certainty)
        self.before += share * (before - self.before)
        self.area_m2, self.last_seen_s = area_m2, now_s
        if area_m2 > END.unsure_m2 or self.certainty > END.unsure_certainty:
            self.sure_s = now_s
        self.sets, self.missed_sets = self.sets + 1, 0

    def add_probability(self, probability: float) -> None:
        """Lower the certainty where other views contradict."""
        self.probability += (1.0 if self.sets <= 1 else 0.4) * (probability - self.probability)
        self.certainty = min(self.certainty, self.probability)

    def add_stature(self, stature_m: float, now_s: float) -> None:
        """Add a measured stature (metres)."""
        self.statures_m = [*self.statures_m[1 - STATURE.kept :], stature_m]
        self.measured_s = now_s

    @property
    def stature_m(self) -> float:
        """An upper quantile of the measured statures, because people bob and bend; NaN before there are enough."""
        if len(self.statures_m) < STATURE.needed:
            return np.nan
        return float(np.quantile(self.statures_m, 0.75))


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
        owners, sums, centres = cluster_votes(votes, centres)
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
                        np.linalg.norm(centre - other.centre_m) > PERSON.beside_m
                        for other in self.active
                        if other.number
                    ),
                )
            )
        # Probable samples count more: the rim of a person is never certain.
        weights = votes.areas_m2 * votes.certainties
        certainties = _means(votes.certainties, weights, owners, len(centres))
        before = _means(votes.before, votes.areas_m2, owners, len(centres))
        for k, track in enumerate(self.active):
            track.area_m2, track.missed_sets = 0.0, track.missed_sets + 1
            if sums[k, 0] > CLUSTERING.seen_m2:
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
            same = track.apart_s < now_s and (
                now_s - track.start_s < END.same_s or now_s - track.apart_s > END.double_s
            )
            unsure = track.last_seen_s - track.sure_s > END.gone_s and np.isnan(track.stature_m)
            gone = unseen_s > END.gone_s if track.number else unseen_s > END.unborn_s and track.missed_sets > 1
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
        moved = float(np.linalg.norm(track.centre_m - track.start_m)) > PERSON.moved_m and age_s > PERSON.averaged_s
        if track.before > PERSON.before_share:
            needed = PERSON.moved_before_certainty if moved else PERSON.before_certainty
        else:
            needed = (
                PERSON.moved_certainty
                if moved
                else float(np.interp(track.area_m2, PERSON.certainty_m2, PERSON.certainties))
            )
        if not track.born_alone and (age_s < PERSON.beside_s or track.area_m2 < PERSON.beside_m2):
            return
        at_once = track.area_m2 > PERSON.at_once_m2 and track.certainty > PERSON.at_once_certainty
        if ((track.sets < PERSON.sets_needed or age_s < PERSON.certain_s) and not at_once) or track.certainty < needed:
            return
        match = match_place([*self._departed, *self._unsure], track.centre_m, track.stature_m, now_s)
        if match is not None and np.isnan(track.stature_m) and match.stature_m > 0 and age_s < PERSON.hidden_nearby_s:
            return  # somebody else may come in where another has just left
        if match is None:
            match = match_stature(self._departed, track.stature_m)
            if match is None and age_s < PERSON.recognise_s and may_match(self._departed, track.stature_m):
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
    if (
        distance < END.same_m
        or track.born_alone
        or distance > CLUSTERING.limb_m
        or not track.area_m2
        or not older.area_m2
    ):
        return bool(distance < END.same_m)
    return are_one_heap(votes, older.centre_m, track.centre_m)


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
        wait_s = STATURE.every_s if len(track.statures_m) < STATURE.enough else STATURE.again_s
        if now_s - track.measured_s < wait_s or not track.area_m2:
            continue
        samples = np.flatnonzero(labels == track.label)
        if len(samples) < STATURE.least_points:
            continue
        heights = votes.points[samples] @ up - floor_m
        sample = np.argpartition(heights, -3)[-3]
        top_m = float(heights[sample])
        middle_m = float(track.centre_m @ up) - floor_m
        upright = top_m > STATURE.least_m and STATURE.middle_shares[0] < middle_m / top_m < STATURE.middle_shares[1]
        if upright:
            top = highest(track.label, votes.points[samples[sample]])
            if is_open(top + STATURE.clearance_m * up):
                track.add_stature(float(top @ up) - floor_m, now_s)
