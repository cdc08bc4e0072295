"""Postures that no recording shows: limbs anywhere people can bring them, bodies as they lie, kneel or fly.

Recordings are of people who walk, play and dance. Splits, bridges, somebody curled up on the floor or on their
head are missing, and with them whatever of a limb's place a network could learn. So angles are drawn over the whole
range that people reach (after Boone and Azen, "Normal range of motion of joints in male subjects", J. Bone Joint
Surg. 1979, widened to what gymnasts and contortionists do), postures whose limbs cut through each other are drawn
again, and the body is put on the floor where it stays lying: on a face of its convex hull above which its centre of
mass is.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from depthmocap.geometry.transforms import rotation_between
from depthmocap.synth.body.bones import POSTURE_BONES, POSTURE_INDEX, POSTURE_PARENTS, world_rotations
from depthmocap.synth.motion.limits import bone_axis, within_limits

#: On the floor, where gravity leaves a body; about as upright as the posture was; free in the air, any way up.
Family = Literal["floor", "acrobatic", "air"]
#: How often each is drawn.
FAMILIES: dict[Family, float] = {"floor": 0.45, "acrobatic": 0.35, "air": 0.2}
#: Share of bodies in which each part is drawn anew; the other parts keep the given posture.
_LEGS, _ARMS, _TRUNK = 0.85, 0.6, 0.6
#: Share of the legs drawn anew that are symmetric, as in a bridge, a squat or a crouch.
_SYMMETRIC = 0.3
_TRIES = 12
#: Standard deviation of the tilt of upright bodies, radians: a standing scale is tilted by 45°.
_LEAN_RAD = 0.45

#: Of an adult, in metres: length, radius and share of the mass of each kind of bone's stick.
_STICKS: dict[str, tuple[float, float, float]] = {
    "pelvis": (0.0, 0.11, 0.14), "spine_low": (0.12, 0.12, 0.12), "spine_mid": (0.12, 0.11, 0.12),
    "spine_up": (0.16, 0.12, 0.14), "neck": (0.1, 0.06, 0.02), "head": (0.17, 0.09, 0.06),
    "clavicle": (0.17, 0.06, 0.01), "upper_arm": (0.28, 0.045, 0.025), "forearm": (0.25, 0.035, 0.016),
    "hand": (0.16, 0.03, 0.006), "thigh": (0.42, 0.07, 0.1), "shin": (0.41, 0.05, 0.045), "foot": (0.17, 0.04, 0.014),
}  # fmt: skip
#: A thigh begins so far beside and below the pelvis's middle (metres).
_HIP_M = 0.09, 0.05
#: Points along each stick.
_ALONG = np.array([0.0, 0.35, 0.7, 1.0])
_KINDS = [name.partition(".")[0] for name in POSTURE_BONES]
_TABLE = np.array([_STICKS[kind] for kind in _KINDS])
_AXES = np.stack([bone_axis(name) / np.linalg.norm(bone_axis(name)) for name in POSTURE_BONES])
#: Sticks may overlap by this (metres): flesh gives way.
_SOFT_M = 0.03
#: Directions about a point in which its sphere is sampled for the hull.
_AROUND = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], float)
_AROUND /= np.linalg.norm(_AROUND, axis=1, keepdims=True)


def beyond_recorded(
    posture: Float[ndarray, "20 3"], rng: np.random.Generator, family: Family | None = None
) -> Float[ndarray, "20 3"]:
    """A posture beyond the recorded ones: parts are drawn anew over people's whole range of motion, and the body is
    laid on the floor, thrown into the air, or left about upright, as a family says or by chance."""
    drawn = posture
    for _ in range(_TRIES):
        anew = random_limbs(posture, rng)
        if within_limits(anew[None])[0] and not cuts_itself(anew):
            drawn = anew
            break
    if family is None:
        family = list(FAMILIES)[int(rng.choice(len(FAMILIES), p=list(FAMILIES.values())))]
    if family == "floor":
        return on_floor(drawn, rng)
    if family == "air":
        quaternion = rng.normal(size=4)  # evenly over all rotations
        return _turned(drawn, Rotation.from_quat(quaternion))
    side, lean = rng.uniform(-np.pi, np.pi), abs(rng.normal(0, _LEAN_RAD))
    return _turned(drawn, Rotation.from_rotvec([lean * np.cos(side), lean * np.sin(side), 0]))


def random_limbs(posture: Float[ndarray, "20 3"], rng: np.random.Generator) -> Float[ndarray, "20 3"]:
    """The posture with legs, arms or trunk at angles drawn over the whole range; it may cut through itself."""
    out = posture.copy()
    if rng.random() < _LEGS:
        first = _leg(rng)
        second = first if rng.random() < _SYMMETRIC else _leg(rng)
        for side, leg in (("R", first), ("L", second)):
            for bone, angles in leg.on(side).items():
                out[POSTURE_INDEX[bone]] = angles
    for side in "RL":
        if rng.random() < _ARMS:
            for bone, angles in _arm(rng, side).items():
                out[POSTURE_INDEX[bone]] = angles
    if rng.random() < _TRUNK:
        # Bent forwards, or, as in a bridge, backwards; a third of it each spine bone.
        bend = np.deg2rad(rng.uniform(-100, -20) if rng.random() < 0.3 else rng.uniform(-20, 95))
        sway, twist = np.deg2rad(rng.normal(0, 18)), np.deg2rad(rng.normal(0, 20))
        for bone in ("spine_low", "spine_mid", "spine_up"):
            out[POSTURE_INDEX[bone]] = Rotation.from_euler("XYZ", [bend / 3, sway / 3, twist / 3]).as_rotvec()
        for bone in ("neck", "head"):
            nod, tip, turn = np.deg2rad([rng.uniform(-30, 25), rng.normal(0, 10), rng.uniform(-35, 35)])
            out[POSTURE_INDEX[bone]] = Rotation.from_euler("XYZ", [nod, tip, turn]).as_rotvec()
    return out


@dataclasses.dataclass(frozen=True)
class _Leg:
    """Angles of a leg (radians): lifted forwards, outwards, turned outwards, knee bent, toes up, foot rolled."""

    flexion: float
    abduction: float
    rotation: float
    knee: float
    ankle: float
    roll: float

    def on(self, side: str) -> dict[str, Float[ndarray, "3"]]:
        sign = 1.0 if side == "L" else -1.0
        # A body faces −Y with its left at +X: a turn about +X carries what hangs backwards, one about +Y to its right.
        lifted = Rotation.from_rotvec([-self.flexion, 0, 0])
        apart = Rotation.from_rotvec([0, -sign * self.abduction, 0])
        about = Rotation.from_rotvec([0, 0, sign * self.rotation])
        return {
            f"thigh.{side}": (apart * lifted * about).as_rotvec(),
            f"shin.{side}": np.array([self.knee, 0.0, 0.0]),
            f"foot.{side}": Rotation.from_euler("XY", [-self.ankle, sign * self.roll]).as_rotvec(),
        }


def _leg(rng: np.random.Generator) -> _Leg:
    flexion = rng.uniform(-35, 135)
    # Straight legs are what splits, scales and kicks are made of.
    knee = rng.uniform(0, 12) if rng.random() < 0.4 else rng.uniform(0, 150)
    degrees = (flexion, rng.uniform(-12, 45) if rng.random() < 0.7 else rng.uniform(30, 85),
               rng.normal(0, 22), knee, rng.uniform(-45, 20), rng.normal(0, 10))  # fmt: skip
    return _Leg(*np.deg2rad(degrees))


def _arm(rng: np.random.Generator, side: str) -> dict[str, Float[ndarray, "3"]]:
    upper, fore = f"upper_arm.{side}", f"forearm.{side}"
    out = -1.0 if side == "R" else 1.0
    for _ in range(50):
        to = rng.normal(0, 1, 3)
        to /= np.linalg.norm(to)
        inwards, backwards = -out * to[0], to[1]
        # Across the chest an arm goes, but not far; behind the back only low and hardly inwards.
        if inwards < (0.75 if backwards < 0 else 0.1) and not (backwards > 0.75 and to[2] > 0):
            break
    swing = rotation_between(_AXES[POSTURE_INDEX[upper]], to)
    twist = Rotation.from_rotvec(_AXES[POSTURE_INDEX[upper]] * np.deg2rad(rng.uniform(-60, 60)))
    hinge = np.cross(_AXES[POSTURE_INDEX[upper]], _AXES[POSTURE_INDEX[fore]])
    bent = np.deg2rad(rng.uniform(-10, 25) if rng.random() < 0.35 else rng.uniform(0, 135))
    turned = Rotation.from_rotvec(_AXES[POSTURE_INDEX[fore]] * np.deg2rad(rng.uniform(-60, 60)))
    return {
        upper: (Rotation.from_matrix(swing) * twist).as_rotvec(),
        fore: (Rotation.from_rotvec(hinge / np.linalg.norm(hinge) * bent) * turned).as_rotvec(),
        f"hand.{side}": np.deg2rad(rng.normal(0, 25, 3)),
    }


def stick_points(posture: Float[ndarray, "20 3"]) -> Float[ndarray, "20 p 3"]:
    """Points along the sticks that stand for an adult's bones (metres), the pelvis at the origin."""
    world = world_rotations(posture)
    ends, points = np.zeros((len(POSTURE_BONES), 3)), np.zeros((len(POSTURE_BONES), len(_ALONG), 3))
    for i, parent in enumerate(POSTURE_PARENTS):
        start = ends[parent] if parent >= 0 else np.zeros(3)
        if _KINDS[i] == "thigh":
            sign = 1.0 if POSTURE_BONES[i].endswith("L") else -1.0
            start = world[parent] @ np.array([sign * _HIP_M[0], 0.0, -_HIP_M[1]])
        ends[i] = start + world[i] @ _AXES[i] * _TABLE[i, 0]
        points[i] = start + (ends[i] - start) * _ALONG[:, None]
    return points


def _strangers() -> Bool[ndarray, "20 20"]:
    """Pairs of bones that may not overlap: neither is the other's parent, nor do both hang on one bone or the trunk."""
    count = len(POSTURE_BONES)
    apart = np.ones((count, count), bool)
    chains = [{i, POSTURE_PARENTS[i]} for i in range(count)]
    trunk = {i for i, kind in enumerate(_KINDS) if kind in ("pelvis", "spine_low", "spine_mid", "spine_up", "neck")}
    trunk |= {i for i, kind in enumerate(_KINDS) if kind in ("clavicle", "head")}
    for i in range(count):
        for j in range(count):
            close = bool(chains[i] & chains[j]) or {i, j} <= trunk
            # An upper arm hangs beside the chest, a thigh on the pelvis and before the belly.
            low, high = sorted((_KINDS[i], _KINDS[j]))
            close |= (low, high) in {("spine_up", "upper_arm"), ("spine_low", "thigh"), ("clavicle", "upper_arm"),
                                     ("thigh", "thigh")}  # fmt: skip
            apart[i, j] = not close
    return apart


_APART = np.repeat(np.repeat(_strangers(), len(_ALONG), 0), len(_ALONG), 1)
_RADII = np.repeat(_TABLE[:, 1], len(_ALONG))
_ROOM = _RADII[:, None] + _RADII[None] - _SOFT_M


def cuts_itself(posture: Float[ndarray, "20 3"]) -> bool:
    """Whether a limb passes through another or through the trunk."""
    points = stick_points(posture).reshape(-1, 3)
    return bool(((cdist(points, points) < _ROOM) & _APART).any())


def on_floor(posture: Float[ndarray, "20 3"], rng: np.random.Generator) -> Float[ndarray, "20 3"]:
    """The posture turned as a whole so that it stays lying, sitting or standing where it is put, on the floor z = 0.

    The body rests on a face of its convex hull above which its centre of mass is; of several, larger ones more often.
    """
    sticks = stick_points(posture)
    mass = (sticks.mean(1) * _TABLE[:, 2:]).sum(0) / _TABLE[:, 2].sum()
    points = (sticks.reshape(-1, 1, 3) + _AROUND * _RADII[:, None, None]).reshape(-1, 3)
    try:
        hull = ConvexHull(points)
    except QhullError:  # flat bodies do not occur, but nothing may stop training
        return posture
    corners, normals = points[hull.simplices], hull.equations[:, :3]
    # The centre of mass projected onto every face's plane, in the face's barycentric coordinates.
    foot = mass - (normals @ mass + hull.equations[:, 3])[:, None] * normals
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    c = foot - corners[:, 0]
    cross = np.cross(a, b)
    area2 = (cross**2).sum(1)
    v = (np.cross(a, c) * cross).sum(1) / np.maximum(area2, 1e-12)
    u = (np.cross(c, b) * cross).sum(1) / np.maximum(area2, 1e-12)
    stable = np.flatnonzero((u >= 0) & (v >= 0) & (u + v <= 1))
    if not len(stable):
        return posture
    weights = np.sqrt(area2[stable])
    face = stable[int(rng.choice(len(stable), p=weights / weights.sum()))]
    turn = rotation_between(normals[face], np.array([0.0, 0.0, -1.0]))
    return _turned(posture, Rotation.from_matrix(turn))


def _turned(posture: Float[ndarray, "20 3"], turn: Rotation) -> Float[ndarray, "20 3"]:
    """The posture turned as a whole."""
    out = posture.copy()
    out[0] = (turn * Rotation.from_rotvec(posture[0])).as_rotvec()
    return out
