"""Who the blobs on the plan are: people keep their number while they walk, stand, cross each other, go and return."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.optimize import linear_sum_assignment

from depthmocap.segment.occupancy_map import CELL_M, Blobs

#: A body shows at least so much surface (m²) to all cameras together, is no longer or higher than this (metres), and a
#: standing or sitting one is at least so tall. Chairs are not.
LEAST_M2, LONGEST_M, HIGHEST_M, TALL_M = 0.05, 2.3, 2.4, 1.1
#: What is not so tall is a person when it has gone this far (metres): chairs are pushed less far. While nobody has been
#: seen yet, whatever shows so much surface (m²) and has stirred in its first second is one.
WENT_M, STIRRING_M2, STIRRING_S = 1.0, 0.2, 1.0
#: Tall things are people after this time where no background was known (s), if they show as much surface.
DOUBT_S = 0.25
#: A person may be this far from where they are expected (metres), and that much further for each second unseen.
GATE_M, GATE_MPS = 0.6, 1.0
#: A difference in height counts as this much of one in place; less surface than this (m²) is nobody.
HEIGHT_WEIGHT, SPECK_M2 = 0.7, 0.03
#: A person who is expected this near to another's blob (metres) is in it.
INSIDE_M = 0.3
#: Smaller blobs (m²) this near to the middle of somebody (metres) are parts of them.
PART_M2, PART_M = 0.12, 0.8
#: After this time unseen somebody is gone, and this time later forgotten (s).
GONE_S, AWAY_S = 1.0, 60.0
#: Who comes is taken for somebody who is away if they are as tall (metres), and everybody else who is away is less
#: alike by at least the second.
SAME_HEIGHT_M, CLEARLY_M = 0.03, 0.03
#: Heights are measured so often (s), where as much over the head is in view (metres); the last ones count, and a few
#: must have been measured: a step's worth. Somebody who comes while others are away has no number until then, but no
#: longer than this (s).
MEASURE_S, OVER_M, HEIGHTS, LEAST_HEIGHTS, RECOGNISE_S = 0.09, 0.1, 60, 6, 3.0
#: Somebody has been seen from head to foot when their feet were seen, so much surface (m²), and their height does not
#: grow by more than this over what it was (metres).
FEET_M, WHOLE_M2, SETTLED_M = 0.3, 0.4, 0.02
#: What stays within this (metres) for so long (s) is a thing: if it is not tall, and if it was there before the
#: background was known and has not gone anywhere. Others may stand still as long as they like.
STILL_M, LOW_STILL_S, DOUBT_STILL_S = 0.012, 3.0, 10.0
#: Who was seen in a blob of their own for less than this (s) does not divide another's; numbers of those who begin this
#: near to somebody (metres) wait as long.
ALONE_S, NEAR_M = 0.4, 0.7
#: Of what is measured, this share goes into the place, and that into the speed; nobody runs faster (m/s).
_PLACE, _SPEED, _FASTEST_MPS = 0.6, 0.25, 4.0


@dataclasses.dataclass(eq=False)
class Track:
    """Somebody, or something, on the plan (metres, seconds).

    Attributes:
        number: the person's, from 1; 0 while it is not certain that this is a person.
        own_number: the last that they had: theirs whenever they are a person again.
        top_m: how tall they were, as a slow maximum.
        doubted: was there before the background was known.
        settled: was taken for a thing, and has not been a person since; ``born_s`` and ``birth_m`` are of then.
        area_m2: seen now; 0 when hidden.
        whole: has been seen from head to foot.
        alone_s: how long they were seen in a blob of their own.
        heights_m: how high the head was, of late, whenever what is over it was in view.
        measured_s: when that was last.
    """

    label: int
    place_m: Float[ndarray, "2"]
    top_m: float
    born_s: float
    doubted: bool
    number: int = 0
    own_number: int = 0
    settled: bool = False
    velocity_mps: Float[ndarray, "2"] = dataclasses.field(default_factory=lambda: np.zeros(2))
    area_m2: float = 0.0
    seen_s: float = 0.0
    expected_m: Float[ndarray, "2"] = dataclasses.field(default_factory=lambda: np.zeros(2))
    whole: bool = False
    alone_s: float = 0.0
    birth_m: Float[ndarray, "2"] = dataclasses.field(default_factory=lambda: np.zeros(2))
    anchor_m: Float[ndarray, "2"] = dataclasses.field(default_factory=lambda: np.zeros(2))
    still_since_s: float = 0.0
    heights_m: list[float] = dataclasses.field(default_factory=list)
    measured_s: float = -np.inf

    def expect(self, now_s: float) -> None:
        """Where they should be now: on their way, slower and slower while they are unseen."""
        unseen_s = now_s - self.seen_s
        self.expected_m = self.place_m + self.velocity_mps * min(unseen_s, 0.3)

    def see(self, place_m: Float[ndarray, "2"], top_m: float, bottom_m: float, area_m2: float, now_s: float) -> None:
        """Take a measurement."""
        passed_s = max(now_s - self.seen_s, 1e-3)
        off = place_m - self.expected_m
        self.place_m = self.expected_m + _PLACE * off
        velocity = self.velocity_mps + _SPEED * off / passed_s
        self.velocity_mps = velocity * min(1.0, _FASTEST_MPS / max(float(np.linalg.norm(velocity)), 1e-9))
        # Up soon, down slowly: whoever bends down is as tall as before. What was a thing so far may be beside somebody.
        up_s = 1.0 if not self.number and (self.settled or now_s - self.born_s > 1) else 0.25
        self.top_m += (top_m - self.top_m) * min(1.0, passed_s / (up_s if top_m > self.top_m else 20.0))
        self.area_m2, self.seen_s = area_m2, now_s
        self.whole |= bottom_m < FEET_M and area_m2 > WHOLE_M2 and top_m - self.top_m < SETTLED_M
        if np.linalg.norm(place_m - self.anchor_m) > STILL_M:
            self.anchor_m, self.still_since_s = place_m.copy(), now_s

    def measure(self, top_m: float, now_s: float) -> None:
        """Take a height that is known to be that of the head."""
        self.heights_m = [*self.heights_m[1 - HEIGHTS :], top_m]
        self.measured_s = now_s

    @property
    def stature_m(self) -> float:
        """How tall they are; NaN until it was measured for long enough. Who walks bobs, and who bends is less high, so
        it is an upper quantile."""
        return float(np.quantile(self.heights_m, 0.75)) if len(self.heights_m) >= LEAST_HEIGHTS else np.nan

    @property
    def went_m(self) -> float:
        """How far it is from where it was born."""
        return float(np.linalg.norm(self.place_m - self.birth_m))

    def be(self, number: int) -> None:
        """Be somebody."""
        self.number = self.own_number = number
        self.settled = False

    def settle(self, now_s: float) -> None:
        """What has not stirred for long is a thing until it does, but for the tall that came while the room was known:
        people stand still."""
        if self.top_m < TALL_M:
            limit_s = LOW_STILL_S
        elif self.doubted and self.went_m < WENT_M:
            limit_s = DOUBT_STILL_S
        else:
            return
        if not self.settled and now_s - self.still_since_s > limit_s:
            self.number, self.settled = 0, True
            self.born_s, self.birth_m = now_s, self.place_m.copy()


@dataclasses.dataclass(frozen=True)
class Shared:
    """A blob that several people are in, by index, and their tracks' labels."""

    blob: int
    labels: tuple[int, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """What is seen of somebody in a shared blob: place, heights of top and bottom (metres), surface (m²)."""

    place_m: Float[ndarray, "2"]
    top_m: float
    bottom_m: float
    area_m2: float


class Tracks:
    """People, and what may be people. Labels 1–254 tell tracks apart now; numbers tell people apart for good."""

    def __init__(self) -> None:
        self.alive: list[Track] = []
        self._away: list[Track] = []
        self._numbers = 0

    def expect(self, now_s: float) -> list[Float[ndarray, "2"]]:
        """Where everybody should be now; these are people's places (metres)."""
        for track in self.alive:
            track.expect(now_s)
        return [track.expected_m for track in self.alive if track.number]

    def assign(self, blobs: Blobs, now_s: float) -> tuple[Int[ndarray, " b"], list[Shared]]:
        """The label of each blob's track (0: none yet), and the blobs that must be divided; after :meth:`expect`."""
        owner, shared = np.zeros(len(blobs), np.int64), []
        if not len(blobs) or not self.alive:
            return owner, shared
        expected = np.stack([track.expected_m for track in self.alive])
        gaps = np.linalg.norm(expected[:, None] - blobs.centres_m[None], axis=2)
        grown = blobs.tops_m[None] - np.array([track.top_m for track in self.alive])[:, None]
        # Of somebody who was not seen whole yet, more can come into view.
        whole = np.array([track.whole for track in self.alive])[:, None]
        tall = np.where(whole, np.abs(grown), np.maximum(-grown, 0))
        gates = np.array([GATE_M + GATE_MPS * min(now_s - track.seen_s, GONE_S) for track in self.alive])
        # Wider blobs have their middle farther from those who are in them.
        cost = np.maximum(gaps - blobs.sizes_m[:, 0] / 4, 0.2 * gaps) + HEIGHT_WEIGHT * np.minimum(tall, 1.0)
        cost[(cost > gates[:, None]) | (blobs.areas_m2 < SPECK_M2)] = 1e3
        rows, columns = linear_sum_assignment(cost)
        inside: dict[int, list[int]] = {}
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
            if cost[row, column] < 1e3:
                inside.setdefault(column, []).append(row)
        matched = {row for members in inside.values() for row in members}
        for row, track in enumerate(self.alive):
            if row in matched:
                continue
            blob = _blob_near(blobs, track.expected_m)
            if blob in inside and track.number:
                inside[blob].append(row)
        for blob, members in inside.items():
            labels = tuple(self.alive[row].label for row in members)
            owner[blob] = labels[0]
            if len(members) > 1:
                shared.append(Shared(blob, labels))
        self._add_parts(blobs, owner)
        return owner, shared

    def shift(self, offset_m: Float[ndarray, "2"]) -> None:
        """Take another corner of the plan."""
        for track in self.alive:
            for place in (track.place_m, track.expected_m, track.anchor_m, track.birth_m):
                place += offset_m

    def _add_parts(self, blobs: Blobs, owner: Int[ndarray, " b"]) -> None:
        """Give small blobs near somebody to them: occlusion cuts hands and feet off."""
        mains = np.flatnonzero(owner)
        if not len(mains):
            return
        for blob in np.flatnonzero((owner == 0) & (blobs.areas_m2 < PART_M2)).tolist():
            reach = np.linalg.norm(blobs.centres_m[mains] - blobs.centres_m[blob], axis=1) - blobs.sizes_m[mains, 0] / 4
            if reach.min() < PART_M:
                owner[blob] = owner[mains[reach.argmin()]]

    def update(
        self,
        owner: Int[ndarray, " b"],
        blobs: Blobs,
        divided: dict[int, Part],
        learning: bool,
        overlooked: Callable[[Float[ndarray, "2"], float], bool],
        now_s: float,
    ) -> None:
        """See, lose, end and begin tracks.

        Args:
            owner: from :meth:`assign`; new tracks are written into it.
            divided: of tracks in shared blobs, by label.
            learning: no camera knows its background yet.
            overlooked: whether what is over a place at a height is in view.
        """
        for track in self.alive:
            own = np.flatnonzero(owner == track.label)
            track.area_m2 = 0.0
            if track.label in divided:
                part = divided[track.label]
                if part.area_m2 > SPECK_M2:
                    track.see(part.place_m, part.top_m, part.bottom_m, part.area_m2, now_s)
            elif len(own):
                areas = blobs.areas_m2[own]
                centre = (blobs.centres_m[own] * areas[:, None]).sum(0) / areas.sum()
                track.alone_s += now_s - track.seen_s
                top, bottom = float(blobs.tops_m[own].max()), float(blobs.bottoms_m[own].min())
                track.see(centre, top, bottom, float(areas.sum()), now_s)
                if now_s - track.measured_s >= MEASURE_S and overlooked(centre, top + OVER_M):
                    track.measure(top, now_s)
            track.settle(now_s)
        self._end_twins(divided)
        for track in [track for track in self.alive if now_s - track.seen_s > GONE_S]:
            self.alive.remove(track)
            if track.own_number:
                self._away.append(track)
        self._away = [track for track in self._away if now_s - track.seen_s < AWAY_S]
        for blob in np.flatnonzero(owner == 0).tolist():
            if _is_body(blobs, blob):
                owner[blob] = self._begin(blobs, blob, learning, now_s)
        for track in self.alive:
            if not track.number:
                self._recognise(track, now_s)

    def _end_twins(self, divided: dict[int, Part]) -> None:
        """End those who were hardly ever seen apart from an elder whose blob they share: a body in two pieces."""
        shared = [track for track in self.alive if track.label in divided and track.number]
        for track in shared:
            if track.alone_s < ALONE_S and any(other.number < track.number for other in shared):
                self.alive.remove(track)

    def _begin(self, blobs: Blobs, blob: int, doubted: bool, now_s: float) -> int:
        taken = {track.label for track in self.alive}
        label = next((label for label in range(1, 255) if label not in taken), 0)
        if label:
            place, top = blobs.centres_m[blob].copy(), float(blobs.tops_m[blob])
            self.alive.append(
                Track(
                    label, place, top, now_s, doubted, area_m2=float(blobs.areas_m2[blob]), seen_s=now_s,
                    birth_m=place.copy(), anchor_m=place.copy(), still_since_s=now_s,
                )
            )  # fmt: skip
        return label

    def _recognise(self, track: Track, now_s: float) -> None:
        """Give a number to what has shown that it is a person."""
        age_s = now_s - track.born_s
        stirred = track.still_since_s > track.born_s
        if track.settled:
            certain = stirred and not track.doubted
        else:
            certain = not track.doubted or (age_s >= DOUBT_S and track.area_m2 > STIRRING_M2)
        tall = track.top_m >= TALL_M and certain
        stirs = (
            not self._numbers and not track.settled and track.area_m2 > STIRRING_M2 and age_s >= STIRRING_S and stirred
        )
        if not (tall or stirs or track.went_m > WENT_M):
            return
        if track.own_number:
            track.be(track.own_number)
            return
        near = [each for each in self.alive if each.number and np.linalg.norm(each.place_m - track.place_m) < NEAR_M]
        if near and track.alone_s < ALONE_S:
            return
        if self._away and np.isnan(track.stature_m) and age_s < RECOGNISE_S:
            return
        number = self._returned(track.stature_m)
        if not number:
            self._numbers += 1
            number = self._numbers
        track.be(number)

    def _returned(self, stature_m: float) -> int:
        """The number of the one who is away and as tall, who is not away any more then; 0 where nobody is for sure."""
        # Who was never measured is at least as tall as they were seen, and nobody's match.
        off_m = [
            max(away.top_m - stature_m, 0.0) if np.isnan(away.stature_m) else abs(away.stature_m - stature_m)
            for away in self._away
        ]
        order = np.argsort(off_m)
        if not len(order) or np.isnan(stature_m):
            return 0
        best = self._away[order[0]]
        clearly = len(order) == 1 or off_m[order[1]] - off_m[order[0]] >= CLEARLY_M
        if np.isnan(best.stature_m) or off_m[order[0]] > SAME_HEIGHT_M or not clearly:
            return 0
        self._away.remove(best)
        return best.own_number


def _is_body(blobs: Blobs, blob: int) -> bool:
    return bool(
        blobs.areas_m2[blob] >= LEAST_M2
        and blobs.sizes_m[blob, 0] <= LONGEST_M
        and blobs.tops_m[blob] <= HIGHEST_M
        and blobs.tops_m[blob] - blobs.bottoms_m[blob] > 0.2
    )


def _blob_near(blobs: Blobs, place_m: Float[ndarray, "2"]) -> int:
    """The blob of the column nearest to a place, -1 where none is near."""
    reach = int(INSIDE_M / CELL_M)
    x, y = (place_m / CELL_M).astype(int).tolist()
    top, left = max(y - reach, 0), max(x - reach, 0)
    window = blobs.labels[top : y + reach + 1, left : x + reach + 1]
    rows, columns = np.nonzero(window)
    if not len(rows):
        return -1
    nearest = np.argmin((rows + top - y) ** 2 + (columns + left - x) ** 2)
    return int(window[rows[nearest], columns[nearest]]) - 1
