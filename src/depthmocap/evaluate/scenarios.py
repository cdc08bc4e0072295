"""Scenarios of generated scenes: who is in the room, and along which trajectories they move."""

from __future__ import annotations

import dataclasses
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d

from depthmocap.synth.body.bones import POSTURE_INDEX
from depthmocap.synth.body.mesh import BodyModel
from depthmocap.synth.motion.perform import Motion
from depthmocap.synth.motion.stroll import Stop, stroll
from depthmocap.synth.people.bodies import random_phenotype
from depthmocap.synth.people.garments import DressedBody, clothe
from depthmocap.synth.people.wardrobe import random_clothes

#: Half the length of the room along x, metres.
HALF_X = 3.0
#: Half the length of the room along y, metres.
HALF_Y = 2.9
#: Doors by axis and sign of their wall: from where to where along the wall, metres.
DOORS = {(0, -1): (-0.6, 0.7), (0, 1): (-1.1, 0.1), (1, 1): (0.6, 1.9)}
#: People walk along a corridor this far behind the walls (metres),
_OUTSIDE_M = 0.7
#: and wait there this far beside a door's middle (metres).
_ASIDE_M = 1.5
#: Statures of people who look alike differ by at most this, metres.
ALIKE_M = 0.015
#: Statures of people who look different differ by at least this, metres.
UNLIKE_M = 0.08
#: Range of the statures, metres.
STATURES_M = (1.5, 1.95)
#: Least distance of two visitors, from middle to middle, metres.
_PASSING_M = 0.6
#: Places (x, y in metres) of a person's middle close to the chest, to the table, and between both.
_BESIDE = ((2.2, 1.05), (0.15, 1.82), (2.65, 1.68))


@dataclasses.dataclass(frozen=True, eq=False)
class Stage:
    """What trajectories are planned for.

    Attributes:
        actors: the people.
        chair: where the chair stands (x, y), metres.
        times_s: time of each frame.
    """

    actors: list[DressedBody]
    chair: Float[ndarray, "2"]
    times_s: Float[ndarray, " n"]


@runtime_checkable
class Scenario(Protocol):
    """Actors and their trajectories.

    Attributes:
        seconds: length of the scenario.
        chair_pushed_s: start and end of the time in which somebody pushes the chair aside; None when nobody does.
    """

    @property
    def seconds(self) -> float: ...

    @property
    def chair_pushed_s(self) -> tuple[float, float] | None: ...

    def actors(self, rng: np.random.Generator) -> list[DressedBody]:
        """Draw the people."""
        ...

    def trajectories(self, rng: np.random.Generator, stage: Stage) -> list[Motion]:
        """Draw the motion of each of them."""
        ...


@dataclasses.dataclass(frozen=True)
class Meeting:
    """Two people in the room.

    The first person enters, stands in the middle and then walks about. The second person enters, pushes the chair
    aside, stands beside the first (``apart_m`` from middle to middle), crosses the path of the first, leaves and
    returns.
    """

    apart_m: float = 0.5
    seconds: float = 24.0
    chair_pushed_s: tuple[float, float] | None = (7.0, 7.6)

    def actors(self, rng: np.random.Generator) -> list[DressedBody]:
        return [random_actor(rng) for _ in range(2)]

    def trajectories(self, rng: np.random.Generator, stage: Stage) -> list[Motion]:
        x, y = rng.uniform(-0.2, 0.2, 2)
        first = [
            *_through((0, -1)), Stop(x, y, 7.0), Stop(x + 0.2, y + 1.1, 0.5), Stop(x - 0.9, y - 0.9, 1.0), Stop(x, y),
        ]  # fmt: skip
        second = [
            *_through((1, 1)), Stop(stage.chair[0] - 0.45, stage.chair[1] + 0.2, 0.3), Stop(x + self.apart_m, y, 1.0),
            Stop(x - 0.2, y - 1.3, 0.4), *reversed(_through((0, 1))), *_through((0, 1))[1:], Stop(x + 1.0, y - 0.1),
        ]  # fmt: skip
        return [
            stroll(stage.actors[0], first, 0.3, rng.uniform(1.0, 1.2), stage.times_s),
            stroll(stage.actors[1], second, 1.8, rng.uniform(1.0, 1.2), stage.times_s),
        ]


@dataclasses.dataclass(frozen=True)
class Visits:
    """People enter one after the other and leave. When all have left, they return in random order.

    Attributes:
        people: number of people.
        alike: all have nearly the same stature; otherwise the statures differ clearly.
        newcomer: the last person enters only in the second half.
    """

    people: int = 2
    alike: bool = False
    newcomer: bool = False
    chair_pushed_s: tuple[float, float] | None = None

    #: Time from one entry to the next, seconds.
    _every_s = 4.5
    #: Time that a visit takes, with some to spare, seconds.
    _visit_s = 12.8

    @property
    def seconds(self) -> float:
        return 2 * (self._visit_s + self._every_s * (self.people - 1))

    def actors(self, rng: np.random.Generator) -> list[DressedBody]:
        actors: list[DressedBody] = []
        while len(actors) < self.people:
            actors.append(_random_visitor(rng, [stature_m(actor) for actor in actors], self.alike))
        return actors

    def trajectories(self, rng: np.random.Generator, stage: Stage) -> list[Motion]:
        second_half = stage.times_s >= self.seconds / 2
        while True:
            plans = self._draw_plans(rng)
            places = [
                np.where(second_half[:, None], pair[1].places(stage.times_s), pair[0].places(stage.times_s))
                for pair in plans
            ]
            if all(_apart_m(places[i], places[j]) > _PASSING_M for i in range(self.people) for j in range(i)):
                break
        motions = [
            [visit.motion(actor, stage.times_s) for visit in pair]
            for actor, pair in zip(stage.actors, plans, strict=True)
        ]
        if self.newcomer:
            motions[-1][0] = motions[-1][1]
        return [_joined(first, second, second_half) for first, second in motions]

    def _draw_plans(self, rng: np.random.Generator) -> list[tuple[_Visit, _Visit]]:
        """Two visits of each person."""
        # People never enter through the door by which others leave.
        doors = [list(DOORS)[k] for k in rng.permutation(len(DOORS))]
        order, plans = rng.permutation(self.people), []
        for k in range(self.people):
            visits = []
            for start_s in (0.3 + self._every_s * k, self.seconds / 2 + self._every_s * float(order[k])):
                azimuths = 2 * np.pi * k / self.people + rng.uniform(-0.4, 0.4, 2)
                inside = 0.7 * np.stack([np.cos(azimuths), np.sin(azimuths)], 1)
                stops = (
                    *_through(doors[int(rng.integers(1, 3))]),
                    *(_stop(place, float(rng.uniform(0.2, 1.0))) for place in inside),
                    *reversed(_through(doors[0])),
                )
                visits.append(_Visit(stops, start_s, float(rng.uniform(1.0, 1.2))))
            plans.append((visits[0], visits[1]))
        return plans


@dataclasses.dataclass(frozen=True)
class _Visit:
    """A walk from stop to stop that starts at a time (seconds) and has a speed (m/s)."""

    stops: tuple[Stop, ...]
    start_s: float
    speed_mps: float

    def places(self, times_s: Float[ndarray, " n"]) -> Float[ndarray, "n 2"]:
        """Approximate positions (metres): corners are not rounded."""
        at_s, places = [self.start_s], [(self.stops[0].x, self.stops[0].y)]
        for stop in self.stops[1:]:
            walked_m = np.hypot(stop.x - places[-1][0], stop.y - places[-1][1])
            at_s.append(at_s[-1] + float(walked_m) / self.speed_mps)
            at_s.append(at_s[-1] + stop.stand_s)
            places += [(stop.x, stop.y)] * 2
        return np.stack([np.interp(times_s, at_s, axis) for axis in np.transpose(places)], 1)

    def motion(self, dressed: DressedBody, times_s: Float[ndarray, " n"]) -> Motion:
        return stroll(dressed, self.stops, self.start_s, self.speed_mps, times_s)


@dataclasses.dataclass(frozen=True)
class BesideFurniture:
    """A person stands close to a piece of furniture from the start, sways a little, and walks away later."""

    seconds: float = 20.0
    stands_s: float = 14.0
    chair_pushed_s: tuple[float, float] | None = None

    def actors(self, rng: np.random.Generator) -> list[DressedBody]:
        return [_random_visitor(rng, [], False)]

    def trajectories(self, rng: np.random.Generator, stage: Stage) -> list[Motion]:
        x, y = _BESIDE[int(rng.integers(len(_BESIDE)))]
        stops = [Stop(x, y), _stop(rng.uniform(-0.4, 0.4, 2), 1.0), Stop(-1.2, -0.3)]
        motion = stroll(stage.actors[0], stops, self.stands_s, 1.1, stage.times_s)
        return [sway(rng, motion)]


@dataclasses.dataclass(frozen=True)
class EmptyRoom:
    """Nobody enters the room."""

    seconds: float = 12.0
    chair_pushed_s: tuple[float, float] | None = None

    def actors(self, rng: np.random.Generator) -> list[DressedBody]:
        return []

    def trajectories(self, rng: np.random.Generator, stage: Stage) -> list[Motion]:
        return []


def stature_m(dressed: DressedBody) -> float:
    """Height (metres) of the body in its rest pose, without clothes."""
    heights = dressed.body.rest_vertices[:, 2]
    return float(heights.max() - heights.min())


def random_actor(rng: np.random.Generator) -> DressedBody:
    """An adult of any build and an adult's stature, dressed."""
    return _random_visitor(rng, [], False)


def _random_visitor(rng: np.random.Generator, others_m: list[float], alike: bool) -> DressedBody:
    """A person of ordinary stature: nearly that of all others, or clearly different from each of them."""
    while True:
        phenotype = random_phenotype(rng, children=False)
        body = BodyModel.load().shape(phenotype)
        height_m = float(np.ptp(body.rest_vertices[:, 2]))
        difference_m = np.abs(np.array(others_m) - height_m)
        if STATURES_M[0] < height_m < STATURES_M[1] and bool(
            (difference_m < ALIKE_M if alike else difference_m > UNLIKE_M).all()
        ):
            return clothe(body, random_clothes(rng, False, phenotype.gender), rng)


def _through(door: tuple[int, int]) -> tuple[Stop, Stop]:
    """The way in by a door: from where nobody sees them, beside it in the corridor, to before it."""
    axis, sign = door
    across = sign * ((HALF_X, HALF_Y)[axis] + _OUTSIDE_M)
    middle = float(np.mean(DOORS[door]))
    ends = (middle + _ASIDE_M, middle)
    places = [(across, along) if axis == 0 else (along, across) for along in ends]
    return Stop(*places[0]), Stop(*places[1])


def _stop(place: Float[ndarray, "2"], stand_s: float = 0.0) -> Stop:
    return Stop(float(place[0]), float(place[1]), stand_s)


def _apart_m(one: Float[ndarray, "n 2"], other: Float[ndarray, "n 2"]) -> float:
    """Least distance (metres) of two people while both are in the room."""
    inside = (np.abs(np.stack([one, other])) < (HALF_X, HALF_Y)).all(axis=(0, 2))
    return float(np.linalg.norm(one - other, axis=1).min(initial=np.inf, where=inside))


def _joined(first: Motion, second: Motion, second_half: Bool[ndarray, " n"]) -> Motion:
    """The first motion, and the second one in the second half."""
    return Motion(
        first.times_s,
        np.where(second_half[:, None, None], second.postures, first.postures),
        np.where(second_half[:, None], second.offsets, first.offsets),
    )


def sway(rng: np.random.Generator, motion: Motion) -> Motion:
    """Add sway, because nobody stands still: 6 mm of the middle, 1° of trunk and head, 3° of the arms (standard
    deviations), within about a second."""
    rate_hz = (len(motion.times_s) - 1) / (motion.times_s[-1] - motion.times_s[0])

    def slow(*shape: int) -> Float[ndarray, "..."]:
        drawn = gaussian_filter1d(rng.normal(size=(len(motion.times_s), *shape)), 0.5 * rate_hz, axis=0)
        return drawn / drawn.std(0)

    postures, offsets = motion.postures.copy(), motion.offsets.copy()
    offsets[:, :2] += 0.006 * slow(2)
    for name, degrees in (("spine_low", 1), ("head", 1), ("upper_arm.R", 3), ("upper_arm.L", 3)):
        postures[:, POSTURE_INDEX[name]] += np.deg2rad(degrees) * slow(3)
    return Motion(motion.times_s, postures, offsets)
