"""Who comes into a generated room, and what they do there: stories that people are followed through."""

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

#: Half the room's sides; people come from behind its walls, this far (metres).
HALF_X, HALF_Y = 3.0, 2.9
_OUTSIDE = 0.6
#: People alike in stature differ by at most this, others by at least that; and what they are between (metres).
ALIKE_M, UNLIKE_M, STATURES_M = 0.015, 0.08, (1.5, 1.95)
#: Visitors come no nearer to each other than this, from middle to middle (metres).
_PASSING_M = 0.6
#: Where somebody stands close to the chest, the table and between both (metres): x, y of their middle.
_BESIDE = ((2.2, 1.05), (0.15, 1.82), (2.65, 1.68))


@dataclasses.dataclass(frozen=True, eq=False)
class Stage:
    """Who acts, where the chair stands (x, y), and the moments that are looked at."""

    people: list[DressedBody]
    chair: Float[ndarray, "2"]
    times_s: Float[ndarray, " n"]


@runtime_checkable
class Story(Protocol):
    """People and their ways.

    Attributes:
        seconds: how long it takes.
        pushed_s: the chair is pushed aside between these times; None when nobody does.
    """

    @property
    def seconds(self) -> float: ...

    @property
    def pushed_s(self) -> tuple[float, float] | None: ...

    def cast(self, rng: np.random.Generator) -> list[DressedBody]:
        """The people."""
        ...

    def ways(self, rng: np.random.Generator, stage: Stage) -> list[Motion]:
        """How each of them moves."""
        ...


@dataclasses.dataclass(frozen=True)
class Meeting:
    """The first comes and stands in the middle, then walks about; the second comes by, pushes the chair aside, stands
    beside the first (``apart_m`` from middle to middle), crosses their way, goes, and returns."""

    apart_m: float = 0.5
    seconds: float = 22.0
    pushed_s: tuple[float, float] | None = (7.0, 7.6)

    def cast(self, rng: np.random.Generator) -> list[DressedBody]:
        return [_somebody(rng) for _ in range(2)]

    def ways(self, rng: np.random.Generator, stage: Stage) -> list[Motion]:
        x, y = rng.uniform(-0.2, 0.2, 2)
        first = [
            Stop(-HALF_X - _OUTSIDE, y), Stop(x, y, 7.0), Stop(x + 0.2, y + 1.1, 0.5), Stop(x - 0.9, y - 0.9, 1.0),
            Stop(x, y),
        ]  # fmt: skip
        second = [
            Stop(stage.chair[0] - 0.1, HALF_Y + _OUTSIDE), Stop(stage.chair[0] - 0.45, stage.chair[1] + 0.2, 0.3),
            Stop(x + self.apart_m, y, 1.0), Stop(x - 0.2, y - 1.3, 0.4), Stop(HALF_X + _OUTSIDE, y - 0.5, 1.5),
            Stop(x + 1.0, y - 0.1),
        ]  # fmt: skip
        return [
            stroll(stage.people[0], first, 0.3, rng.uniform(1.0, 1.2), stage.times_s),
            stroll(stage.people[1], second, 3.0, rng.uniform(1.0, 1.2), stage.times_s),
        ]


@dataclasses.dataclass(frozen=True)
class Visits:
    """Everybody comes, one after the other, and goes; when all are away they return in any order.

    Attributes:
        people: so many.
        alike: of nearly the same stature; otherwise clearly different.
        newcomer: the last one comes only when the others return.
    """

    people: int = 2
    alike: bool = False
    newcomer: bool = False
    pushed_s: tuple[float, float] | None = None

    #: From one coming to the next, and how long a visit takes with some time to spare (s).
    _every_s = 4.5
    _visit_s = 10.0

    @property
    def seconds(self) -> float:
        return 2 * (self._visit_s + self._every_s * (self.people - 1))

    def cast(self, rng: np.random.Generator) -> list[DressedBody]:
        people: list[DressedBody] = []
        while len(people) < self.people:
            people.append(_visitor(rng, [stature_m(each) for each in people], self.alike))
        return people

    def ways(self, rng: np.random.Generator, stage: Stage) -> list[Motion]:
        again = stage.times_s >= self.seconds / 2
        while True:
            plans = self._draw_plans(rng)
            places = [
                np.where(again[:, None], two[1].places(stage.times_s), two[0].places(stage.times_s)) for two in plans
            ]
            if all(_apart_m(places[i], places[j]) > _PASSING_M for i in range(self.people) for j in range(i)):
                break
        motions = [
            [visit.motion(one, stage.times_s) for visit in two] for one, two in zip(stage.people, plans, strict=True)
        ]
        if self.newcomer:
            motions[-1][0] = motions[-1][1]
        return [_joined(first, second, again) for first, second in motions]

    def _draw_plans(self, rng: np.random.Generator) -> list[tuple[_Visit, _Visit]]:
        """Two visits of each."""
        # Nobody comes in where others go out.
        gates = rng.permutation([[-HALF_X - _OUTSIDE, 0.1], [HALF_X + _OUTSIDE, -0.4], [1.4, HALF_Y + _OUTSIDE]])
        order, plans = rng.permutation(self.people), []
        for k in range(self.people):
            visits = []
            for start_s in (0.3 + self._every_s * k, self.seconds / 2 + self._every_s * float(order[k])):
                azimuths = 2 * np.pi * k / self.people + rng.uniform(-0.4, 0.4, 2)
                inside = 0.7 * np.stack([np.cos(azimuths), np.sin(azimuths)], 1)
                stops = (
                    _stop(gates[int(rng.integers(1, 3))]),
                    *(_stop(place, float(rng.uniform(0.2, 1.0))) for place in inside),
                    _stop(gates[0]),
                )
                visits.append(_Visit(stops, start_s, float(rng.uniform(1.0, 1.2))))
            plans.append((visits[0], visits[1]))
        return plans


@dataclasses.dataclass(frozen=True)
class _Visit:
    """A walk from stop to stop, begun at a time (s), at a speed (m/s)."""

    stops: tuple[Stop, ...]
    start_s: float
    speed_mps: float

    def places(self, times_s: Float[ndarray, " n"]) -> Float[ndarray, "n 2"]:
        """Where the walker is, about: corners are not rounded."""
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
class Beside:
    """Somebody stands close to a piece of furniture when it begins, sways a little, and walks away later."""

    seconds: float = 20.0
    stands_s: float = 14.0
    pushed_s: tuple[float, float] | None = None

    def cast(self, rng: np.random.Generator) -> list[DressedBody]:
        return [_visitor(rng, [], False)]

    def ways(self, rng: np.random.Generator, stage: Stage) -> list[Motion]:
        x, y = _BESIDE[int(rng.integers(len(_BESIDE)))]
        stops = [Stop(x, y), _stop(rng.uniform(-0.4, 0.4, 2), 1.0), Stop(-1.2, -0.3)]
        motion = stroll(stage.people[0], stops, self.stands_s, 1.1, stage.times_s)
        return [_sway(rng, motion)]


@dataclasses.dataclass(frozen=True)
class Empty:
    """Nobody comes: furniture alone."""

    seconds: float = 12.0
    pushed_s: tuple[float, float] | None = None

    def cast(self, rng: np.random.Generator) -> list[DressedBody]:
        return []

    def ways(self, rng: np.random.Generator, stage: Stage) -> list[Motion]:
        return []


def stature_m(dressed: DressedBody) -> float:
    """Height of the body at rest, bare."""
    heights = dressed.body.rest_vertices[:, 2]
    return float(heights.max() - heights.min())


def _somebody(rng: np.random.Generator) -> DressedBody:
    phenotype = random_phenotype(rng, children=False)
    return clothe(BodyModel.load().shape(phenotype), random_clothes(rng, False, phenotype.gender), rng)


def _visitor(rng: np.random.Generator, others_m: list[float], alike: bool) -> DressedBody:
    """Somebody of ordinary stature, like that of all others or unlike each of them."""
    while True:
        phenotype = random_phenotype(rng, children=False)
        body = BodyModel.load().shape(phenotype)
        own_m = float(np.ptp(body.rest_vertices[:, 2]))
        off = np.abs(np.array(others_m) - own_m)
        if STATURES_M[0] < own_m < STATURES_M[1] and bool((off < ALIKE_M if alike else off > UNLIKE_M).all()):
            return clothe(body, random_clothes(rng, False, phenotype.gender), rng)


def _stop(place: Float[ndarray, "2"], stand_s: float = 0.0) -> Stop:
    return Stop(float(place[0]), float(place[1]), stand_s)


def _apart_m(one: Float[ndarray, "n 2"], other: Float[ndarray, "n 2"]) -> float:
    """The least distance of two people while both are in the room."""
    inside = (np.abs(np.stack([one, other])) < (HALF_X, HALF_Y)).all(axis=(0, 2))
    return float(np.linalg.norm(one - other, axis=1).min(initial=np.inf, where=inside))


def _joined(first: Motion, second: Motion, again: Bool[ndarray, " n"]) -> Motion:
    """One motion, and another where ``again`` says so."""
    return Motion(
        first.times_s,
        np.where(again[:, None, None], second.postures, first.postures),
        np.where(again[:, None], second.offsets, first.offsets),
    )


def _sway(rng: np.random.Generator, motion: Motion) -> Motion:
    """Nobody stands like a statue: the middle sways by 6 mm, trunk and head by 1°, arms by 3° (standard deviations),
    over a second or so."""
    rate_hz = (len(motion.times_s) - 1) / (motion.times_s[-1] - motion.times_s[0])

    def slow(*shape: int) -> Float[ndarray, "..."]:
        drawn = gaussian_filter1d(rng.normal(size=(len(motion.times_s), *shape)), 0.5 * rate_hz, axis=0)
        return drawn / drawn.std(0)

    postures, offsets = motion.postures.copy(), motion.offsets.copy()
    offsets[:, :2] += 0.006 * slow(2)
    for name, degrees in (("spine_low", 1), ("head", 1), ("upper_arm.R", 3), ("upper_arm.L", 3)):
        postures[:, POSTURE_INDEX[name]] += np.deg2rad(degrees) * slow(3)
    return Motion(motion.times_s, postures, offsets)
