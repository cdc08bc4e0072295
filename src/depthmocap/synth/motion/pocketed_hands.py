"""Effects of clothes on postures: hands in pockets, and arms that thick sleeves keep off the trunk."""

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
from depthmocap.synth.motion.touch import Arm, default_body_surface, perpendicular

PocketKind = Literal["jacket", "front", "trousers", "seat"]


@dataclasses.dataclass(frozen=True)
class _Pocket:
    """A pocket on the right side of the default body, in the rest frame (left, backwards, up).

    Attributes:
        aside_m: range to the right of the middle, metres.
        up_m: range above the hip root, metres.
        facing: approximate normal of the skin.
        fingers: direction of the fingers.
        elbow: ranges of the elbow's direction: outwards, backwards, downwards.
    """

    aside_m: tuple[float, float]
    up_m: tuple[float, float]
    facing: tuple[float, float, float]
    fingers: tuple[float, float, float]
    elbow: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]


#: Pockets of jackets are slanted or level in front of the hips; a front pocket in front of the belly takes both hands.
_POCKETS: dict[PocketKind, _Pocket] = {
    "jacket": _Pocket(
        (0.07, 0.2), (-0.04, 0.13), (-0.5, -0.85, 0.0), (0.6, -0.45, -0.6), ((0.4, 1.3), (0.2, 1.2), (0.1, 0.7))
    ),
    "front": _Pocket(
        (0.05, 0.13), (0.0, 0.13), (0.0, -1.0, 0.0), (1.0, -0.1, -0.2), ((0.6, 1.4), (0.0, 0.7), (0.3, 0.8))
    ),
    "trousers": _Pocket(
        (0.1, 0.22), (-0.12, 0.0), (-0.75, -0.65, 0.0), (0.2, -0.2, -1.0), ((0.2, 1.1), (0.3, 1.2), (0.0, 0.4))
    ),
    "seat": _Pocket(
        (0.04, 0.15), (-0.1, 0.02), (-0.1, 1.0, 0.0), (0.15, 0.1, -1.0), ((0.3, 1.2), (0.5, 1.2), (0.0, 0.4))
    ),
}
#: Regions of the skin beneath pockets.
_POCKET_REGIONS = ("belly", "lower back", "thigh")
#: Least cosine between the skin's normal and ``_Pocket.facing``.
_LEAST_COSINE = 0.75
#: Share of people who put both hands in pockets, of those with a hand in a pocket.
_BOTH_SHARE = 0.85
#: Share of these with both hands in pockets of one kind.
_SAME_KIND_SHARE = 0.9
#: Largest number of points of a pocket that are tried for a hand.
_TRIES = 6
#: Distance from the wrist to the middle of the palm (metres).
_PALM_M = 0.085
#: Least and greatest height of the wrist above the clothes (metres).
_WRIST_HEIGHT_M = (0.015, 0.035)
#: Largest rotation of a hand about its axis to lie flat (radians).
_LARGEST_ROLL_RAD = 1.2


@dataclasses.dataclass(frozen=True, eq=False)
class PocketedHand:
    """A hand in a pocket: the subject's side, and the normal of the skin beneath (world)."""

    side: Literal["R", "L"]
    kind: PocketKind
    normal: Float[ndarray, "3"]


@functools.cache
def _pocket_faces(kind: PocketKind) -> Int[ndarray, "f"]:
    """Triangles of the skin beneath a pocket of the right side."""
    skin, pocket = default_body_surface(), _POCKETS[kind]
    regions = [i for i, name in enumerate(REGION_NAMES) if name.removesuffix(" R") in _POCKET_REGIONS]
    hip = skin.body.rest_heads[skin.pelvis, 2]
    aside, up = -skin.points[:, 0], skin.points[:, 2] - hip
    is_pocket = np.isin(skin.body.model.face_regions, regions) & (
        skin.normals @ unit(np.array(pocket.facing)) > _LEAST_COSINE
    )
    is_pocket &= (aside > pocket.aside_m[0]) & (aside < pocket.aside_m[1])
    return np.flatnonzero(is_pocket & (up > pocket.up_m[0]) & (up < pocket.up_m[1]))


@functools.cache
def _palm_normal(side: str) -> Float[ndarray, "3"]:
    """Normal of the palm in the rest pose."""
    skin = default_body_surface()
    model, heads = skin.body.model, skin.body.rest_heads
    index, little = (heads[model.bone_names.index(f"finger{k}-1.{side}")] for k in (2, 5))
    out = unit(np.cross(skin.fingers[side], index - little))
    return out if side == "L" else -out


def hands_in_pockets(
    posture: Float[ndarray, "20 3"], kinds: Sequence[PocketKind], bulk_m: float, rng: np.random.Generator
) -> tuple[Float[ndarray, "20 3"], tuple[PocketedHand, ...]]:
    """The posture with one or both hands in pockets within reach, and the hands in pockets.

    Args:
        kinds: available pockets.
        bulk_m: thickness of the clothes beneath the hands.
    """
    sides: list[Literal["R", "L"]] = ["R", "L"] if rng.random() < 0.5 else ["L", "R"]
    kind = kinds[int(rng.integers(len(kinds)))]
    hands: list[PocketedHand] = []
    for side in sides[: 2 if rng.random() < _BOTH_SHARE else 1]:
        if hands and rng.random() > _SAME_KIND_SHARE:
            kind = kinds[int(rng.integers(len(kinds)))]
        for _ in range(_TRIES):
            result = _reach_pocket(posture, side, kind, bulk_m, rng)
            if result is not None:
                posture, hand = result
                hands.append(hand)
                break
    return posture, tuple(hands)


def _reach_pocket(
    posture: Float[ndarray, "20 3"], side: Literal["R", "L"], kind: PocketKind, bulk_m: float, rng: np.random.Generator
) -> tuple[Float[ndarray, "20 3"], PocketedHand] | None:
    skin, pocket = default_body_surface(), _POCKETS[kind]
    mirror = np.array([1.0, 1, 1]) if side == "R" else np.array([-1.0, 1, 1])
    world, transforms = world_rotations(posture), skin.body.bone_transforms(posture)
    face = int(rng.choice(_pocket_faces(kind)))
    # Pockets are defined on the right side; the body is symmetric, so the left side uses the left bone.
    names = skin.body.model.bone_names
    name = names[skin.bones[face]]
    bone = names.index(name[:-1] + side) if name.endswith((".R", ".L")) else int(skin.bones[face])
    turn = transforms.rotations[bone].astype(float)
    normal = unit(turn @ (mirror * skin.normals[face]))
    point = turn @ (mirror * skin.points[face]) + transforms.offsets[bone]
    pelvis = world[POSTURE_INDEX["pelvis"]]
    fingers = pelvis @ (mirror * (np.array(pocket.fingers) + rng.normal(0, 0.15, 3)))
    fingers = unit(perpendicular(fingers, normal))
    target = point + normal * (rng.uniform(*_WRIST_HEIGHT_M) + bulk_m) - fingers * _PALM_M
    arm = Arm.reaching(transforms, skin, side, target)
    low, high = np.array(pocket.elbow).T
    # Rightwards and downwards are negative.
    elbow_direction = pelvis @ (mirror * np.array([-1.0, 1, -1]) * rng.uniform(low, high))
    if arm is None or not arm.bend(world, elbow_direction):
        return None
    forearm, hand = arm.bones[1:]
    direction = unit(world[hand] @ skin.fingers[side])
    world[hand] = rotation_between(direction, fingers + 0.35 * direction) @ world[hand]
    # The hand rolls until the palm faces the body; the forearm takes half of the roll.
    direction, palm = unit(world[hand] @ skin.fingers[side]), world[hand] @ _palm_normal(side)
    flat = perpendicular(-normal, direction)
    angle = np.arctan2(np.cross(palm, flat) @ direction, palm @ flat)
    angle = float(np.clip(angle, -_LARGEST_ROLL_RAD, _LARGEST_ROLL_RAD))
    along = unit(world[forearm] @ skin.forearms[side])
    world[forearm] = Rotation.from_rotvec(0.5 * angle * along).as_matrix() @ world[forearm]
    world[hand] = Rotation.from_rotvec(angle * direction).as_matrix() @ world[hand]
    result = arm.apply(posture, world)
    return (result, PocketedHand(side, kind, normal)) if within_limits(result[None])[0] else None


def hold_arms_off_trunk(posture: Float[ndarray, "20 3"], bulk_m: float) -> Float[ndarray, "20 3"]:
    """The posture with hanging arms held off the trunk by thick sleeves, by about twice ``bulk_m`` at the elbow."""
    world = world_rotations(posture)
    trunk = world[POSTURE_INDEX["spine_up"]]
    out = posture.copy()
    for side, sign in (("R", -1.0), ("L", 1.0)):
        index = POSTURE_INDEX[f"upper_arm.{side}"]
        along = trunk.T @ world[index] @ unit(np.array([sign * 0.66, 0, -0.75]))
        # 1 for an arm that hangs straight down, 0 from 45° on.
        close = np.clip((-along[2] - 0.7) / 0.25, 0, 1) * np.clip(1.5 - 2 * sign * along[0], 0, 1)
        turn = trunk @ Rotation.from_rotvec([0, -sign * close * min(2 * bulk_m / 0.27, 0.5), 0]).as_matrix() @ trunk.T
        parent = world[POSTURE_INDEX[f"clavicle.{side}"]]
        out[index] = Rotation.from_matrix(parent.T @ turn @ world[index]).as_rotvec()
    return out
