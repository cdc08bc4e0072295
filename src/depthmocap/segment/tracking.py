"""Tracking of people: they keep their number while they walk, stand, cross each other, leave and return."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from depthmocap.segment.departed import AWAY_S, Departed, match_stature
from depthmocap.segment.occupancy_map import CELL_M, Blobs
from depthmocap.segment.track import TALL_M, TRAVELLED_M, Track

#: Least surface of a person in all cameras together (m²).
LEAST_M2 = 0.05
#: Greatest length of a person's blob (metres).
LONGEST_M = 2.3
#: Greatest height of a person (metres over the floor): with an arm raised.
HIGHEST_M = 2.4
#: Where no background was known, what is higher than this (metres over the floor) is a part of the room: a wall that is
#: seen through a door.
TALLEST_M = 2.1
#: Before the first person a blob is also one if it shows so much surface (m²)
FIRST_PERSON_M2 = 0.2
#: and has moved within its first second (seconds).
FIRST_PERSON_S = 1.0
#: Where no background was known, a tall blob with that much surface is a person after this time (seconds).
UNCERTAIN_S = 0.25
#: A blob matches a track within this distance of the predicted position (metres),
GATE_M = 0.6
#: and within this much more for each second unseen (m/s): walking speed.
GATE_MPS = 1.0
#: Cost of a difference in height, relative to the same distance in position.
HEIGHT_WEIGHT = 0.7
#: Blobs with less surface than this (m²) match no track.
SPECK_M2 = 0.03
#: A person predicted this near to a blob of another track (metres) shares it.
INSIDE_M = 0.3
#: Blobs with less surface than this (m²)
PART_M2 = 0.12
#: and this near to the middle of a person (metres) are parts of them.
PART_M = 0.8
#: A track unseen for this time ends (seconds).
GONE_S = 1.0
#: Time between two height measurements (seconds).
MEASURE_S = 0.09
#: Height above the head that must be visible for a height measurement (metres): nothing then cuts the head off.
CLEARANCE_M = 0.1
#: While others are away, a new track waits for its stature before it gets a number, but no longer than this (seconds).
RECOGNISE_S = 3.0
#: A track that was in a blob of its own for less than this (seconds) may be a piece of the person whose blob it shares.
ALONE_S = 0.4
#: A new track this near to a person (metres) must have been in a blob of its own for ``ALONE_S`` to get a number.
NEAR_M = 0.7


@dataclasses.dataclass(frozen=True)
class SharedBlob:
    """The index of a blob that contains several people, and the labels of their tracks."""

    index: int
    labels: tuple[int, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class BlobPart:
    """One person's part of a shared blob: position, heights of top and bottom (metres), surface (m²)."""

    position_m: Float[ndarray, "2"]
    top_m: float
    bottom_m: float
    area_m2: float


class PeopleTracker:
    """Tracks of people and of objects that may be people.

    Labels 1–254 tell the active tracks apart, and are used again. Numbers belong to one person for good.
    """

    def __init__(self) -> None:
        self.active: list[Track] = []
        self._departed: list[Departed] = []
        self._last_number = 0

    def predict(self, now_s: float) -> list[Float[ndarray, "2"]]:
        """Predict all tracks; the predicted positions of people (metres)."""
        for track in self.active:
            track.predict(now_s)
        return [track.predicted_m for track in self.active if track.number]

    def assign(self, blobs: Blobs, now_s: float) -> tuple[Int[ndarray, " b"], list[SharedBlob]]:
        """Assign blobs to the predicted tracks.

        The assignment minimises the sum of distance and weighted height difference. A person without a blob whose
        predicted position is inside a blob of another track shares it.

        Returns:
            The label of each blob's track, 0 where there is none, and the blobs that several people share.
        """
        labels, shared = np.zeros(len(blobs), np.int64), []
        if not len(blobs) or not self.active:
            return labels, shared
        predicted = np.stack([track.predicted_m for track in self.active])
        gaps = np.linalg.norm(predicted[:, None] - blobs.centres_m[None], axis=2)
        grown = blobs.tops_m[None] - np.array([track.top_m for track in self.active])[:, None]
        sunk = np.array([min(track.now_top_m, track.top_m) for track in self.active])[:, None] - blobs.tops_m[None]
        # A person who was never in full view may become taller; who bends, sits or lies is lower than before by little.
        full_body = np.array([track.full_body for track in self.active])[:, None]
        height_cost = np.maximum(sunk, np.where(full_body, grown, 0)).clip(0)
        gates = np.array([GATE_M + GATE_MPS * min(now_s - track.last_seen_s, GONE_S) for track in self.active])
        # The centre of a wide blob is farther from the people in it.
        cost = np.maximum(gaps - blobs.sizes_m[:, 0] / 4, 0.2 * gaps) + HEIGHT_WEIGHT * np.minimum(height_cost, 1.0)
        cost[(cost > gates[:, None]) | (blobs.areas_m2 < SPECK_M2)] = 1e3
        # A thing does not become the room that is still being learnt.
        things = np.array([not track.number for track in self.active])
        cost[things[:, None] & ((blobs.sizes_m[:, 0] > LONGEST_M) | (blobs.tops_m > HIGHEST_M))] = 1e3
        from scipy.optimize import linear_sum_assignment  # slow to import

        rows, columns = linear_sum_assignment(cost)
        inside: dict[int, list[int]] = {}
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
            if cost[row, column] < 1e3:
                inside.setdefault(column, []).append(row)
        matched = {row for members in inside.values() for row in members}
        for row, track in enumerate(self.active):
            if row in matched:
                continue
            blob = _blob_near(blobs, track.predicted_m)
            if blob in inside and track.number:
                inside[blob].append(row)
        for blob, members in inside.items():
            inside_labels = tuple(self.active[row].label for row in members)
            labels[blob] = inside_labels[0]
            if len(members) > 1:
                shared.append(SharedBlob(blob, inside_labels))
        self._add_parts(blobs, labels)
        return labels, shared

    def shift(self, offset_m: Float[ndarray, "2"]) -> None:
        """Move all positions by an offset (metres): the map has another corner."""
        for track in self.active:
            for position in (track.position_m, track.predicted_m, track.anchor_m, track.start_m):
                position += offset_m

    def _add_parts(self, blobs: Blobs, labels: Int[ndarray, " b"]) -> None:
        """Assign small blobs near a track to it: occlusion cuts hands and feet off."""
        mains = np.flatnonzero(labels)
        if not len(mains):
            return
        for blob in np.flatnonzero((labels == 0) & (blobs.areas_m2 < PART_M2)).tolist():
            reach = np.linalg.norm(blobs.centres_m[mains] - blobs.centres_m[blob], axis=1) - blobs.sizes_m[mains, 0] / 4
            if reach.min() < PART_M:
                labels[blob] = labels[mains[reach.argmin()]]

    def update(
        self,
        labels: Int[ndarray, " b"],
        blobs: Blobs,
        parts: dict[int, BlobPart],
        learning: bool,
        is_visible: Callable[[Float[ndarray, "2"], float], bool],
        now_s: float,
    ) -> None:
        """Update, end and start tracks.

        Args:
            labels: from :meth:`assign`; the labels of new tracks are written into it.
            parts: of tracks in shared blobs, by label.
            learning: whether no camera knows its background yet.
            is_visible: whether a position at a height (metres) is in view.
        """
        for track in self.active:
            indices = np.flatnonzero(labels == track.label)
            track.area_m2 = 0.0
            if track.label in parts:
                part = parts[track.label]
                if part.area_m2 > SPECK_M2:
                    track.update(part.position_m, part.top_m, part.bottom_m, part.area_m2, now_s)
            elif len(indices):
                areas = blobs.areas_m2[indices]
                centre = (blobs.centres_m[indices] * areas[:, None]).sum(0) / areas.sum()
                track.alone_s += now_s - track.last_seen_s
                track.length_m = float(blobs.sizes_m[indices, 0].max())
                top, bottom = float(blobs.tops_m[indices].max()), float(blobs.bottoms_m[indices].min())
                track.update(centre, top, bottom, float(areas.sum()), now_s)
                if now_s - track.height_measured_s >= MEASURE_S and is_visible(centre, top + CLEARANCE_M):
                    track.add_height(top, now_s)
            track.check_static(now_s)
        self._end_duplicates(parts)
        for track in [track for track in self.active if now_s - track.last_seen_s > GONE_S]:
            self.active.remove(track)
            if track.last_number:
                position_m = np.append(track.position_m, 0.0)
                self._departed.append(
                    Departed(track.last_number, track.stature_m, track.top_m, position_m, track.last_seen_s)
                )
        self._departed = [track for track in self._departed if now_s - track.last_seen_s < AWAY_S]
        for blob in np.flatnonzero(labels == 0).tolist():
            if _is_body(blobs, blob):
                labels[blob] = self._start_track(blobs, blob, learning, now_s)
        for track in self.active:
            if not track.number:
                self._identify(track, now_s)

    def _end_duplicates(self, parts: dict[int, BlobPart]) -> None:
        """End tracks that were hardly ever apart from an older one whose blob they share: one body in two pieces."""
        shared = [track for track in self.active if track.label in parts and track.number]
        for track in shared:
            if track.alone_s < ALONE_S and any(other.number < track.number for other in shared):
                self.active.remove(track)

    def _start_track(self, blobs: Blobs, blob: int, predates_background: bool, now_s: float) -> int:
        """Start a track; its label, 0 when all labels are in use."""
        taken = {track.label for track in self.active}
        label = next((label for label in range(1, 255) if label not in taken), 0)
        if label:
            position, top = blobs.centres_m[blob].copy(), float(blobs.tops_m[blob])
            self.active.append(
                Track(
                    label, position, top, now_s, predates_background, area_m2=float(blobs.areas_m2[blob]),
                    now_top_m=top, last_seen_s=now_s, start_m=position.copy(), anchor_m=position.copy(),
                    still_since_s=now_s,
                )
            )  # fmt: skip
        return label

    def _identify(self, track: Track, now_s: float) -> None:
        """Give a track a number once it is certain to be a person."""
        if track.predates_background and track.top_m > TALLEST_M and track.travelled_m < TRAVELLED_M:
            return
        age_s = now_s - track.start_s
        has_moved = track.still_since_s > track.start_s
        if track.is_object:
            certain = has_moved and not track.predates_background
        else:
            certain = not track.predates_background or (age_s >= UNCERTAIN_S and track.area_m2 > FIRST_PERSON_M2)
        tall = track.top_m >= TALL_M and certain
        first_person = (
            not self._last_number
            and not track.is_object
            and track.area_m2 > FIRST_PERSON_M2
            and age_s >= FIRST_PERSON_S
            and has_moved
        )
        if not (tall or first_person or track.travelled_m > TRAVELLED_M):
            return
        if track.last_number:
            track.assign_number(track.last_number)
            return
        near = any(
            other.number and np.linalg.norm(other.position_m - track.position_m) < NEAR_M for other in self.active
        )
        if near and track.alone_s < ALONE_S:
            return
        if self._departed and np.isnan(track.stature_m) and age_s < RECOGNISE_S:
            return
        match = match_stature(self._departed, track.stature_m)
        if match is None:
            self._last_number += 1
            number = self._last_number
        else:
            self._departed.remove(match)
            number = match.number
        track.assign_number(number)


def _is_body(blobs: Blobs, blob: int) -> bool:
    return bool(
        blobs.areas_m2[blob] >= LEAST_M2
        and blobs.sizes_m[blob, 0] <= LONGEST_M
        and blobs.tops_m[blob] <= HIGHEST_M
        and blobs.tops_m[blob] - blobs.bottoms_m[blob] > 0.2
    )


def _blob_near(blobs: Blobs, position_m: Float[ndarray, "2"]) -> int:
    """The index of the blob nearest to a position, -1 where none is within ``INSIDE_M``."""
    reach = int(INSIDE_M / CELL_M)
    x, y = (position_m / CELL_M).astype(int).tolist()
    top, left = max(y - reach, 0), max(x - reach, 0)
    window = blobs.labels[top : y + reach + 1, left : x + reach + 1]
    rows, columns = np.nonzero(window)
    if not len(rows):
        return -1
    nearest = np.argmin((rows + top - y) ** 2 + (columns + left - x) ** 2)
    return int(window[rows[nearest], columns[nearest]]) - 1
