"""One track: a person or an object in the occupancy map, its motion, its height, and whether it stands still."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from numpy import ndarray

#: From this height a blob is a person (metres): standing or sitting people are taller, chairs are not.
TALL_M = 1.1
#: A lower blob is a person when it has moved this far (metres): a chair is pushed less far.
TRAVELLED_M = 1.0
#: Height measurements kept for each track.
HEIGHTS_KEPT = 60
#: Fewest height measurements that tell a stature: half a second, one step.
HEIGHTS_NEEDED = 6
#: A person is in full view when the blob's bottom is lower than this (metres over the floor),
FEET_M = 0.3
#: it has this much surface (m²),
FULL_BODY_M2 = 0.4
#: and its top is at most this much above the track's height (metres).
GROWTH_M = 0.02
#: A track within this distance (metres) of where it was stands still.
STILL_M = 0.012
#: A track lower than ``TALL_M`` that never stood is an object after it was still for this time (seconds),
LOW_STILL_S = 3.0
#: unless a person of this height (metres over the floor) at most lies there,
LYING_M = 0.6
#: who shows so much surface (m²),
LYING_M2 = 0.4
#: and is so long (metres).
LYING_LENGTH_M = 1.0
#: Nobody sinks faster than this (m/s): they fall; what is lower all at once is another thing, which they stood beside.
FALL_MPS = 5.0
#: Heights err by this (metres).
TOP_ERROR_M = 0.15
#: So is a tall one that has not moved away since before the background was known (seconds). Other tall ones are people.
TALL_STILL_S = 10.0
#: Share of the position's residual that an update corrects.
_POSITION_GAIN = 0.6
#: Share of the velocity's residual that an update corrects.
_VELOCITY_GAIN = 0.25
#: Bound of the estimated speed (m/s): nobody runs faster indoors.
_FASTEST_MPS = 4.0


@dataclasses.dataclass(eq=False)
class Track:
    """A person or an object in the occupancy map.

    Attributes:
        label: tells active tracks apart, 1–254.
        position_m: x and y in the map.
        top_m: slow maximum of the height over the floor (metres).
        start_s, start_m: when and where the track began, or when and where it was last taken for an object.
        predates_background: whether it was there before the background was known.
        number: the person's, from 1; 0 while the track is not certain to be a person.
        last_number: its last number other than 0; it gets this one again.
        is_object: was taken for an object, and has not been a person since.
        area_m2: visible surface now, 0 when hidden.
        length_m: the longer side of its blob as seen from above, when it was last in one of its own.
        now_top_m: height when it was last visible: less than ``top_m`` of who bends, sits or lies.
        has_stood: whether it is a person who was seen to stand, and sank no faster than one since.
        last_seen_s: when it was last visible.
        full_body: whether it has been in view from head to foot.
        alone_s: how long it was visible in a blob of its own.
        anchor_m, still_since_s: where and since when it stands still.
        heights_m: the last ``HEIGHTS_KEPT`` heights of the head, measured while the space above it was visible.
        height_measured_s: when the last one was measured.
    """

    label: int
    position_m: Float[ndarray, "2"]
    top_m: float
    start_s: float
    predates_background: bool
    number: int = 0
    last_number: int = 0
    is_object: bool = False
    velocity_mps: Float[ndarray, "2"] = dataclasses.field(default_factory=lambda: np.zeros(2))
    area_m2: float = 0.0
    length_m: float = 0.0
    now_top_m: float = 0.0
    has_stood: bool = False
    last_seen_s: float = 0.0
    predicted_m: Float[ndarray, "2"] = dataclasses.field(default_factory=lambda: np.zeros(2))
    full_body: bool = False
    alone_s: float = 0.0
    start_m: Float[ndarray, "2"] = dataclasses.field(default_factory=lambda: np.zeros(2))
    anchor_m: Float[ndarray, "2"] = dataclasses.field(default_factory=lambda: np.zeros(2))
    still_since_s: float = 0.0
    heights_m: list[float] = dataclasses.field(default_factory=list)
    height_measured_s: float = -np.inf

    def predict(self, now_s: float) -> None:
        """Predict the position at constant velocity, for 0.3 s at most: an unseen person may have stopped."""
        unseen_s = now_s - self.last_seen_s
        self.predicted_m = self.position_m + self.velocity_mps * min(unseen_s, 0.3)

    def update(
        self, position_m: Float[ndarray, "2"], top_m: float, bottom_m: float, area_m2: float, now_s: float
    ) -> None:
        """Correct the prediction by a measurement."""
        passed_s = max(now_s - self.last_seen_s, 1e-3)
        residual = position_m - self.predicted_m
        self.position_m = self.predicted_m + _POSITION_GAIN * residual
        velocity = self.velocity_mps + _VELOCITY_GAIN * residual / passed_s
        self.velocity_mps = velocity * min(1.0, _FASTEST_MPS / max(float(np.linalg.norm(velocity)), 1e-9))
        # Fast up and slowly down: a person who bends is as tall as before. An object grows more slowly: a person may
        # stand beside it.
        up_s = 1.0 if not self.number and (self.is_object or now_s - self.start_s > 1) else 0.25
        self.top_m += (top_m - self.top_m) * min(1.0, passed_s / (up_s if top_m > self.top_m else 20.0))
        if self.now_top_m - top_m > FALL_MPS * passed_s + TOP_ERROR_M:
            self.has_stood = False
        elif self.number and top_m >= TALL_M:
            self.has_stood = True
        self.area_m2, self.last_seen_s, self.now_top_m = area_m2, now_s, top_m
        self.full_body |= bottom_m < FEET_M and area_m2 > FULL_BODY_M2 and top_m - self.top_m < GROWTH_M
        if np.linalg.norm(position_m - self.anchor_m) > STILL_M:
            self.anchor_m, self.still_since_s = position_m.copy(), now_s

    def add_height(self, top_m: float, now_s: float) -> None:
        """Add a measured height of the head (metres)."""
        self.heights_m = [*self.heights_m[1 - HEIGHTS_KEPT :], top_m]
        self.height_measured_s = now_s

    @property
    def stature_m(self) -> float:
        """The person's stature; NaN before ``HEIGHTS_NEEDED`` measurements.

        An upper quantile of the heights, because people bob while they walk, and bend.
        """
        return float(np.quantile(self.heights_m, 0.75)) if len(self.heights_m) >= HEIGHTS_NEEDED else np.nan

    @property
    def travelled_m(self) -> float:
        """Distance from where the track began."""
        return float(np.linalg.norm(self.position_m - self.start_m))

    def assign_number(self, number: int) -> None:
        """Make the track a person."""
        self.number = self.last_number = number
        self.is_object, self.has_stood = False, self.has_stood or self.now_top_m >= TALL_M

    def check_static(self, now_s: float) -> None:
        """Take a track that has been still for long for an object, until it moves.

        Not a tall one that appeared while the background was known, nor who stood before: they are people who stand,
        sit or lie still.
        """
        lies = self.now_top_m < LYING_M and self.area_m2 > LYING_M2 and self.length_m > LYING_LENGTH_M
        if self.top_m < TALL_M and self.number and (self.has_stood or (lies and not self.predates_background)):
            return
        if self.top_m < TALL_M:
            limit_s = LOW_STILL_S
        elif self.predates_background and self.travelled_m < TRAVELLED_M:
            limit_s = TALL_STILL_S
        else:
            return
        if not self.is_object and now_s - self.still_since_s > limit_s:
            self.number, self.is_object = 0, True
            self.start_s, self.start_m = now_s, self.position_m.copy()
