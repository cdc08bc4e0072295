"""Scenarios of people who stand, sit, lie, fall or touch each other, and hardly move."""

from __future__ import annotations

import dataclasses
from typing import Literal, TypeAlias, get_args

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation, Slerp

from depthmocap.evaluate.scenarios import Stage, random_actor, sway
from depthmocap.geometry import rotation_between
from depthmocap.synth.body.bones import POSTURE_INDEX, heading, turn_posture
from depthmocap.synth.body.mesh import BodyModel
from depthmocap.synth.motion.limits import bone_axis
from depthmocap.synth.motion.perform import Motion
from depthmocap.synth.motion.seat import seated
from depthmocap.synth.motion.stroll import Stop, stroll
from depthmocap.synth.people.bodies import random_phenotype
from depthmocap.synth.people.garments import DressedBody, clothe
from depthmocap.synth.people.wardrobe import random_clothes

Act: TypeAlias = Literal[
    "lies down",
    "falls",
    "sits on the floor",
    "lies still",
    "stands still",
    "infant",
    "apart 1 m",
    "apart 0.6 m",
    "embrace",
    "wheelchair",
    "in bed",
    "close up",
    "carried",
]
ACTS: tuple[Act, ...] = get_args(Act)
#: Length of the acts (seconds);
_SECONDS = 14.0
#: of those in which somebody keeps still (seconds).
_STILL_SECONDS = 180.0
#: Acts that one camera alone sees, whose place nobody knows.
ONE_CAMERA: tuple[Act, ...] = ("close up", "carried")
#: How far a wheelchair rolls (metres).
_ROLLS_M = 1.2
#: Frame sets per second while somebody keeps still.
STILL_RATE_HZ = 3.0
#: Postures: a time (seconds), the posture, and the place of the middle (x, y in metres).
_Keys: TypeAlias = list[tuple[float | int, Float[ndarray, "20 3"], tuple[float, float]]]


@dataclasses.dataclass(frozen=True)
class PostureScenario:
    """One or two people in the middle of the room from the start."""

    act: Act
    chair_pushed_s: tuple[float, float] | None = None

    @property
    def still(self) -> bool:
        """Whether nothing but a slight sway happens for long."""
        return self.act in ("lies still", "stands still")

    @property
    def seconds(self) -> float:
        return _STILL_SECONDS if self.still else _SECONDS

    def actors(self, rng: np.random.Generator) -> list[DressedBody]:
        if self.act == "infant":
            phenotype = dataclasses.replace(random_phenotype(rng), age=float(rng.uniform(0.0, 0.06)))
            return [clothe(BodyModel.load().shape(phenotype), random_clothes(rng, False, phenotype.gender), rng)]
        count = 2 if self.act.startswith("apart") or self.act == "embrace" else 1
        return [random_actor(rng) for _ in range(count)]

    def trajectories(self, rng: np.random.Generator, stage: Stage) -> list[Motion]:
        if self.act == "embrace":
            return _embrace(rng, stage)
        if self.act.startswith("apart"):
            gap, azimuth = (1.0 if self.act == "apart 1 m" else 0.6), rng.uniform(-np.pi, np.pi)
            places = [side * gap / 2 * np.array([np.cos(azimuth), np.sin(azimuth)]) for side in (-1, 1)]
            return [
                sway(rng, _standing(actor, place, stage.times_s))
                for actor, place in zip(stage.actors, places, strict=True)
            ]
        (actor,) = stage.actors
        x, y = rng.uniform(-0.4, 0.4, 2)
        standing = _standing(actor, np.array([x, y]), stage.times_s)
        if self.act == "stands still":
            return [sway(rng, standing)]
        if self.act == "close up":
            return [sway(rng, standing)]
        if self.act == "carried":
            stops = [Stop(x, y, 1.0), Stop(x + 0.7, y, 1.0), Stop(x, y + 0.5, 1.0), Stop(x, y)]
            return [sway(rng, stroll(actor, stops, 1.0, 0.8, stage.times_s))]
        yaw = rng.uniform(-np.pi, np.pi)
        if self.act == "in bed":
            yaw = np.pi / 2 * int(rng.integers(4)) + rng.normal(0, 0.05)
        upright = turn_posture(standing.postures[0][None], yaw)[0]
        on_seat = seated(standing.postures[0], rng)
        sits, lies = turn_posture(_on_floor(on_seat)[None], yaw)[0], _lying(upright, rng)
        on_seat = turn_posture(on_seat[None], yaw)[0]
        ahead = Rotation.from_rotvec([0, 0, heading(on_seat[None])[0]]).apply([0.0, -_ROLLS_M / 2, 0.0])
        start, end = (x - ahead[0], y - ahead[1]), (x + ahead[0], y + ahead[1])
        keys: dict[Act, _Keys] = {
            "lies still": [(0.0, lies, (x, y))],
            "infant": [(0.0, lies, (x, y))],
            "in bed": [(0.0, lies, (x, y))],
            "wheelchair": [(0, on_seat, start), (4, on_seat, start), (8, on_seat, end)],
            "sits on the floor": [(0, upright, (x, y)), (3, upright, (x, y)), (5, sits, (x, y))],
            "falls": [(0, upright, (x, y)), (4, upright, (x, y)), (4.7, lies, (x, y))],
            "lies down": [
                (0, upright, (x, y)), (2, upright, (x, y)), (4, sits, (x, y)), (6, lies, (x, y)), (10, lies, (x, y)),
                (12, sits, (x, y)), (13.5, upright, (x, y)),
            ],
        }  # fmt: skip
        return [sway(rng, _between(actor, keys[self.act], stage.times_s))]


def _standing(actor: DressedBody, place: Float[ndarray, "2"], times_s: Float[ndarray, " n"]) -> Motion:
    x, y = place.tolist()
    return stroll(actor, [Stop(x, y), Stop(x + 0.5, y)], float(times_s[-1]) + 10, 1.0, times_s)


def _embrace(rng: np.random.Generator, stage: Stage) -> list[Motion]:
    """Two who walk to each other, stand breast to breast for some seconds, and part."""
    motions = []
    for side, actor in zip((-1, 1), stage.actors, strict=True):
        stops = [Stop(side * 1.5, 0.0), Stop(side * 0.16, 0.0, 3.0), Stop(side * 1.4, 0.3)]
        motions.append(sway(rng, stroll(actor, stops, 1.5, 1.0, stage.times_s)))
    return motions


def _on_floor(posture: Float[ndarray, "20 3"]) -> Float[ndarray, "20 3"]:
    """A seated posture with the legs stretched out on the floor."""
    out = posture.copy()
    pelvis = Rotation.from_rotvec(posture[POSTURE_INDEX["pelvis"]])
    for side in "RL":
        out[POSTURE_INDEX[f"shin.{side}"]] = [0.15, 0.0, 0.0]
        thigh = pelvis * Rotation.from_rotvec(posture[POSTURE_INDEX[f"thigh.{side}"]])
        leg = thigh.apply(bone_axis(f"thigh.{side}"))
        level = Rotation.from_matrix(rotation_between(leg, leg * [1, 1, 0]))
        out[POSTURE_INDEX[f"thigh.{side}"]] = (pelvis.inv() * level * thigh).as_rotvec()
    return out


def _lying(upright: Float[ndarray, "20 3"], rng: np.random.Generator) -> Float[ndarray, "20 3"]:
    """The posture laid on its back, front or side."""
    pelvis = Rotation.from_rotvec(upright[0])
    sideways = Rotation.from_euler("z", rng.choice([0.0, np.pi / 2, np.pi, -np.pi / 2]))
    out = upright.copy()
    out[0] = (Rotation.from_euler("x", -np.pi / 2) * sideways * pelvis).as_rotvec()
    return out


def _between(actor: DressedBody, keys: _Keys, times_s: Float[ndarray, " n"]) -> Motion:
    """From posture to posture, with the lowest point always on the floor."""
    at = np.array([time for time, _, _ in keys], float)
    times = np.clip(times_s, at[0], at[-1])
    key_postures = np.stack([posture for _, posture, _ in keys])
    if len(keys) == 1:
        postures = np.repeat(key_postures, len(times_s), 0)
    else:
        bones = [Slerp(at, Rotation.from_rotvec(key_postures[:, k]))(times).as_rotvec() for k in range(20)]
        postures = np.stack(bones, 1)
    offsets = np.zeros((len(times_s), 3))
    known: dict[bytes, Float[ndarray, "3"]] = {}
    for i, posture in enumerate(postures):
        key = posture.tobytes()
        if key not in known:
            person = actor.pose(posture)
            known[key] = np.array([*person.joints[3, :2], person.lowest_m])
        x, y = (np.interp(times[i], at, [place[axis] for _, _, place in keys]) for axis in (0, 1))
        offsets[i] = [x, y, 0.0] - known[key]
    return Motion(times_s, postures, offsets)
