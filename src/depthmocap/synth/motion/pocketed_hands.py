"""Hands in pockets, and arms that thick sleeves keep off the trunk: what clothes do to postures."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.regions import REGION_NAMES
from depthmocap.geometry.transforms import rotation_between, unit
from depthmocap.synth.body.bones import POSTURE_INDEX, world_rotations
from depthmocap.synth.motion.limits import within_limits
from depthmocap.synth.motion.touch import Arm, across, default_skin

PocketKind = Literal["jacket", "front", "trousers", "seat"]


@dataclasses.dataclass(frozen=True)
class _Place:
    """Where a pocket of the right side is on the default body, in its rest frame (left, backwards, up; metres).

    Attributes:
        aside_m: to the right of the middle; up_m: above the hip root.
        facing: direction that the skin there faces, nearly.
        fingers: where they point.
        elbow: lowest and highest of how far it goes outwards, backwards and down.
    """

    aside_m: tuple[float, float]
    up_m: tuple[float, float]
    facing: tuple[float, float, float]
    fingers: tuple[float, float, float]
    elbow: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]


#: Pockets of jackets slant or lie level before the hips; one pocket before the belly takes both hands.
_PLACES: dict[PocketKind, _Place] = {
    "jacket": _Place(
        (0.07, 0.2), (-0.04, 0.13), (-0.5, -0.85, 0.0), (0.6, -0.45, -0.6), ((0.4, 1.3), (0.2, 1.2), (0.1, 0.7))
    ),
    "front": _Place(
        (0.05, 0.13), (0.0, 0.13), (0.0, -1.0, 0.0), (1.0, -0.1, -0.2), ((0.6, 1.4), (0.0, 0.7), (0.3, 0.8))
    ),
    "trousers": _Place(
        (0.1, 0.22), (-0.12, 0.0), (-0.75, -0.65, 0.0), (0.2, -0.2, -1.0), ((0.2, 1.1), (0.3, 1.2), (0.0, 0.4))
    ),
    "seat": _Place(
        (0.04, 0.15), (-0.1, 0.02), (-0.1, 1.0, 0.0), (0.15, 0.1, -1.0), ((0.3, 1.2), (0.5, 1.2), (0.0, 0.4))
    ),
}
#: The skin that pockets lie on.
_SKIN = ("belly", "lower back", "thigh")
#: Least cosine between the skin's normal and the direction a pocket's skin faces.
_FACING = 0.75
#: Share of people with hands in pockets who try with both, and of those the share with both in pockets of one kind.
_BOTH, _ALIKE = 0.85, 0.9
#: Points of a pocket tried for a hand before it is left as it was.
_TRIES = 6
#: The middle of the palm lies so far beyond the wrist; the wrist so far above the skin, beside what is worn (metres).
_PALM_M, _ABOVE_M = 0.085, (0.015, 0.035)
#: A hand turns about the forearm by no more than this, to lie flat.
_ROLL_RAD = 1.2


@dataclasses.dataclass(frozen=True, eq=False)
class Pocketed:
    """A hand in a pocket: the subject's side, and the direction (world) in which the skin faces there."""

    side: Literal["R", "L"]
    kind: PocketKind
    normal: Float[ndarray, "3"]


@functools.cache
def _faces(kind: PocketKind) -> Int[ndarray, "f"]:
    """The skin's triangles where the right hand's pocket is."""
    skin, place = default_skin(), _PLACES[kind]
    wanted = [i for i, name in enumerate(REGION_NAMES) if name.removesuffix(" R") in _SKIN]
    hip = skin.body.rest_heads[skin.pelvis, 2]
    aside, up = -skin.points[:, 0], skin.points[:, 2] - hip
    chosen = np.isin(skin.body.model.face_regions, wanted) & (skin.normals @ unit(np.array(place.facing)) > _FACING)
    chosen &= (aside > place.aside_m[0]) & (aside < place.aside_m[1])
    return np.flatnonzero(chosen & (up > place.up_m[0]) & (up < place.up_m[1]))


@functools.cache
def _palm(side: str) -> Float[ndarray, "3"]:
    """The direction the palm faces at rest."""
    skin = default_skin()
    model, heads = skin.body.model, skin.body.rest_heads
    index, little = (heads[model.bone_names.index(f"finger{k}-1.{side}")] for k in (2, 5))
    out = unit(np.cross(skin.fingers[side], index - little))
    return out if side == "L" else -out


def hands_in_pockets(
    posture: Float[ndarray, "20 3"], kinds: Sequence[PocketKind], bulk_m: float, rng: np.random.Generator
) -> tuple[Float[ndarray, "20 3"], tuple[Pocketed, ...]]:
    """The posture with one or both hands in pockets, where they reach them, and which hands are.

    Args:
        kinds: what pockets there are.
        bulk_m: thickness of what is worn beneath the hands.
    """
    sides: list[Literal["R", "L"]] = ["R", "L"] if rng.random() < 0.5 else ["L", "R"]
    kind = kinds[int(rng.integers(len(kinds)))]
    found: list[Pocketed] = []
    for side in sides[: 2 if rng.random() < _BOTH else 1]:
        if found and rng.random() > _ALIKE:
            kind = kinds[int(rng.integers(len(kinds)))]
        for _ in range(_TRIES):
            put = _put(posture, side, kind, bulk_m, rng)
            if put is not None:
                posture, pocketed = put
                found.append(pocketed)
                break
    return posture, tuple(found)


def _put(
    posture: Float[ndarray, "20 3"], side: Literal["R", "L"], kind: PocketKind, bulk_m: float, rng: np.random.Generator
) -> tuple[Float[ndarray, "20 3"], Pocketed] | None:
    skin, place = default_skin(), _PLACES[kind]
    mirror = np.array([1.0, 1, 1]) if side == "R" else np.array([-1.0, 1, 1])
    world, moved = world_rotations(posture), skin.body.bone_transforms(posture)
    face = int(rng.choice(_faces(kind)))
    # The body is symmetric: what carries the left side is the left bone of the right one's name.
    names = skin.body.model.bone_names
    name = names[skin.bones[face]]
    bone = names.index(name[:-1] + side) if name.endswith((".R", ".L")) else int(skin.bones[face])
    turn = moved.rotations[bone].astype(float)
    normal = unit(turn @ (mirror * skin.normals[face]))
    point = turn @ (mirror * skin.points[face]) + moved.offsets[bone]
    pelvis = world[POSTURE_INDEX["pelvis"]]
    fingers = pelvis @ (mirror * (np.array(place.fingers) + rng.normal(0, 0.15, 3)))
    fingers = unit(across(fingers, normal))
    target = point + normal * (rng.uniform(*_ABOVE_M) + bulk_m) - fingers * _PALM_M
    arm = Arm.reaching(moved, skin, side, target)
    low, high = np.array(place.elbow).T
    # To the right and down are negative.
    towards = pelvis @ (mirror * np.array([-1.0, 1, -1]) * rng.uniform(low, high))
    if arm is None or not arm.bend(world, towards):
        return None
    forearm, hand = arm.bones[1:]
    now = unit(world[hand] @ skin.fingers[side])
    world[hand] = rotation_between(now, fingers + 0.35 * now) @ world[hand]
    # Flat: the palm faces the body. Half of the turn is the forearm's.
    now, palm = unit(world[hand] @ skin.fingers[side]), world[hand] @ _palm(side)
    flat = across(-normal, now)
    angle = np.arctan2(np.cross(palm, flat) @ now, palm @ flat)
    angle = float(np.clip(angle, -_ROLL_RAD, _ROLL_RAD))
    along = unit(world[forearm] @ skin.forearms[side])
    world[forearm] = Rotation.from_rotvec(0.5 * angle * along).as_matrix() @ world[forearm]
    world[hand] = Rotation.from_rotvec(angle * now).as_matrix() @ world[hand]
    put = arm.taken_over(posture, world)
    return (put, Pocketed(side, kind, normal)) if within_limits(put[None])[0] else None


def arms_off_trunk(posture: Float[ndarray, "20 3"], bulk_m: float) -> Float[ndarray, "20 3"]:
    """Arms that hang by the trunk held off it by thick sleeves, about twice ``bulk_m`` at the elbow."""
    world = world_rotations(posture)
    trunk = world[POSTURE_INDEX["spine_up"]]
    out = posture.copy()
    for side, sign in (("R", -1.0), ("L", 1.0)):
        index = POSTURE_INDEX[f"upper_arm.{side}"]
        along = trunk.T @ world[index] @ unit(np.array([sign * 0.66, 0, -0.75]))
        # How near the arm hangs to the trunk: 1 straight down, 0 from 45° on.
        close = np.clip((-along[2] - 0.7) / 0.25, 0, 1) * np.clip(1.5 - 2 * sign * along[0], 0, 1)
        turn = trunk @ Rotation.from_rotvec([0, -sign * close * min(2 * bulk_m / 0.27, 0.5), 0]).as_matrix() @ trunk.T
        parent = world[POSTURE_INDEX[f"clavicle.{side}"]]
        out[index] = Rotation.from_matrix(parent.T @ turn @ world[index]).as_rotvec()
    return out
