"""Extreme postures, which recordings lack: limbs over their whole range of motion, bodies lying or in the air.

Motion capture shows people who walk, play and dance, but no splits, bridges, headstands or people curled up on the
floor. Here joint angles cover the whole range of motion (after Boone and Azen, "Normal range of motion of joints in
male subjects", J. Bone Joint Surg. 1979, widened for gymnasts and contortionists). Self-intersecting postures are
rejected. On the floor a body rests in a stable position: on a face of its convex hull below its centre of mass.
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

#: Resting on the floor; about as upright as the source posture; in the air with any orientation.
Family = Literal["floor", "acrobatic", "air"]
#: Share of each family.
FAMILIES: dict[Family, float] = {"floor": 0.45, "acrobatic": 0.35, "air": 0.2}
#: Share of bodies whose legs get random angles; otherwise they keep those of the source posture.
_LEG_SHARE = 0.85
#: The same for each arm.
_ARM_SHARE = 0.6
#: The same for the trunk.
_TRUNK_SHARE = 0.6
#: Share of symmetric pairs among random legs, as in a bridge, a squat or a crouch.
_SYMMETRIC_SHARE = 0.3
#: Largest number of draws of a posture within the limits that does not intersect itself.
_TRIES = 12
#: Standard deviation of the tilt of upright bodies (radians): a standing scale is tilted by 45°.
_LEAN_RAD = 0.45

#: Capsule of each kind of bone of an adult: length and radius (metres), share of the mass.
_CAPSULES: dict[str, tuple[float, float, float]] = {
    "pelvis": (0.0, 0.11, 0.14), "spine_low": (0.12, 0.12, 0.12), "spine_mid": (0.12, 0.11, 0.12),
    "spine_up": (0.16, 0.12, 0.14), "neck": (0.1, 0.06, 0.02), "head": (0.17, 0.09, 0.06),
    "clavicle": (0.17, 0.06, 0.01), "upper_arm": (0.28, 0.045, 0.025), "forearm": (0.25, 0.035, 0.016),
    "hand": (0.16, 0.03, 0.006), "thigh": (0.42, 0.07, 0.1), "shin": (0.41, 0.05, 0.045), "foot": (0.17, 0.04, 0.014),
}  # fmt: skip
#: Offsets of a thigh's capsule from the middle of the pelvis: sideways and downwards (metres).
_HIP_M = (0.09, 0.05)
#: Positions of sample points along each capsule, as shares of its length.
_SAMPLES = np.array([0.0, 0.35, 0.7, 1.0])
_KINDS = [name.partition(".")[0] for name in POSTURE_BONES]
_DIMENSIONS = np.array([_CAPSULES[kind] for kind in _KINDS])
_AXES = np.stack([bone_axis(name) / np.linalg.norm(bone_axis(name)) for name in POSTURE_BONES])
#: Overlap of two capsules that does not count as an intersection (metres), because flesh is soft.
_OVERLAP_M = 0.03
#: Directions in which the sphere around a sample point is sampled for the convex hull.
_DIRECTIONS = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], float)
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)


def extreme_posture(
    posture: Float[ndarray, "20 3"], rng: np.random.Generator, family: Family | None = None
) -> Float[ndarray, "20 3"]:
    """An extreme posture: some parts get random angles over their whole range of motion, and the body rests on the
    floor, is in the air, or is about upright, according to the family.

    Args:
        family: a random one by default.
    """
    result = posture
    for _ in range(_TRIES):
        candidate = random_bone_angles(posture, rng)
        if within_limits(candidate[None])[0] and not self_intersects(candidate):
            result = candidate
            break
    if family is None:
        family = list(FAMILIES)[int(rng.choice(len(FAMILIES), p=list(FAMILIES.values())))]
    if family == "floor":
        return rest_on_floor(result, rng)
    if family == "air":
        quaternion = rng.normal(size=4)  # uniform over all rotations
        return _rotated(result, Rotation.from_quat(quaternion))
    side, lean = rng.uniform(-np.pi, np.pi), abs(rng.normal(0, _LEAN_RAD))
    return _rotated(result, Rotation.from_rotvec([lean * np.cos(side), lean * np.sin(side), 0]))


def random_bone_angles(posture: Float[ndarray, "20 3"], rng: np.random.Generator) -> Float[ndarray, "20 3"]:
    """The posture with random angles of legs, arms or trunk over their whole range; it may intersect itself."""
    out = posture.copy()
    if rng.random() < _LEG_SHARE:
        first = _random_leg(rng)
        second = first if rng.random() < _SYMMETRIC_SHARE else _random_leg(rng)
        for side, leg in (("R", first), ("L", second)):
            for bone, angles in leg.rotations(side).items():
                out[POSTURE_INDEX[bone]] = angles
    for side in "RL":
        if rng.random() < _ARM_SHARE:
            for bone, angles in _random_arm(rng, side).items():
                out[POSTURE_INDEX[bone]] = angles
    if rng.random() < _TRUNK_SHARE:
        # Bent forwards, or backwards as in a bridge; each bone of the spine takes a third.
        bend = np.deg2rad(rng.uniform(-100, -20) if rng.random() < 0.3 else rng.uniform(-20, 95))
        sway, twist = np.deg2rad(rng.normal(0, 18)), np.deg2rad(rng.normal(0, 20))
        for bone in ("spine_low", "spine_mid", "spine_up"):
            out[POSTURE_INDEX[bone]] = Rotation.from_euler("XYZ", [bend / 3, sway / 3, twist / 3]).as_rotvec()
        for bone in ("neck", "head"):
            nod, tip, turn = np.deg2rad([rng.uniform(-30, 25), rng.normal(0, 10), rng.uniform(-35, 35)])
            out[POSTURE_INDEX[bone]] = Rotation.from_euler("XYZ", [nod, tip, turn]).as_rotvec()
    return out


@dataclasses.dataclass(frozen=True)
class LegAngles:
    """Joint angles of a leg (radians)."""

    flexion: float
    abduction: float
    rotation: float
    knee: float
    ankle: float
    roll: float

    def rotations(self, side: str) -> dict[str, Float[ndarray, "3"]]:
        """Rotation vectors of the leg's posture bones."""
        sign = 1.0 if side == "L" else -1.0
        # The body faces −Y, its left at +X: a rotation about +X moves a hanging leg backwards, about +Y to the right.
        lifted = Rotation.from_rotvec([-self.flexion, 0, 0])
        apart = Rotation.from_rotvec([0, -sign * self.abduction, 0])
        about = Rotation.from_rotvec([0, 0, sign * self.rotation])
        return {
            f"thigh.{side}": (apart * lifted * about).as_rotvec(),
            f"shin.{side}": np.array([self.knee, 0.0, 0.0]),
            f"foot.{side}": Rotation.from_euler("XY", [-self.ankle, sign * self.roll]).as_rotvec(),
        }


def _random_leg(rng: np.random.Generator) -> LegAngles:
    flexion = rng.uniform(-35, 135)
    # Splits, scales and kicks need straight legs.
    knee = rng.uniform(0, 12) if rng.random() < 0.4 else rng.uniform(0, 150)
    degrees = (flexion, rng.uniform(-12, 45) if rng.random() < 0.7 else rng.uniform(30, 85),
               rng.normal(0, 22), knee, rng.uniform(-45, 20), rng.normal(0, 10))  # fmt: skip
    return LegAngles(*np.deg2rad(degrees))


def _random_arm(rng: np.random.Generator, side: str) -> dict[str, Float[ndarray, "3"]]:
    out = -1.0 if side == "R" else 1.0
    tries = 0
    while True:
        direction = rng.normal(0, 1, 3)
        direction /= np.linalg.norm(direction)
        tries += 1
        inward, backward = -out * direction[0], direction[1]
        # An arm reaches a little across the chest; behind the back it stays low and hardly moves inwards.
        fits = inward < (0.75 if backward < 0 else 0.1) and not (backward > 0.75 and direction[2] > 0)
        if fits or tries == 50:
            break
    twist = np.deg2rad(rng.uniform(-60, 60))
    bent = np.deg2rad(rng.uniform(-10, 25) if rng.random() < 0.35 else rng.uniform(0, 135))
    turned = np.deg2rad(rng.uniform(-60, 60))
    return {**arm_rotations(side, direction, twist, bent, turned), f"hand.{side}": np.deg2rad(rng.normal(0, 25, 3))}


def arm_rotations(
    side: str, direction: Float[ndarray, "3"], twist: float, bent: float, turned: float
) -> dict[str, Float[ndarray, "3"]]:
    """Rotation vectors of an arm's posture bones.

    Args:
        direction: of the upper arm against the trunk, which faces −Y with its left at +X.
        twist, bent, turned: of the upper arm about its length, of the elbow, and of the forearm about its length
            (radians).
    """
    upper, fore = f"upper_arm.{side}", f"forearm.{side}"
    upper_axis, fore_axis = _AXES[POSTURE_INDEX[upper]], _AXES[POSTURE_INDEX[fore]]
    swing = Rotation.from_matrix(rotation_between(upper_axis, direction))
    hinge = np.cross(upper_axis, fore_axis)
    return {
        upper: (swing * Rotation.from_rotvec(upper_axis * twist)).as_rotvec(),
        fore: (
            Rotation.from_rotvec(hinge / np.linalg.norm(hinge) * bent) * Rotation.from_rotvec(fore_axis * turned)
        ).as_rotvec(),
    }


def capsule_points(posture: Float[ndarray, "20 3"]) -> Float[ndarray, "20 p 3"]:
    """Points along the capsules of an adult's bones (metres), the pelvis at the origin."""
    world = world_rotations(posture)
    ends, points = np.zeros((len(POSTURE_BONES), 3)), np.zeros((len(POSTURE_BONES), len(_SAMPLES), 3))
    for i, parent in enumerate(POSTURE_PARENTS):
        start = ends[parent] if parent >= 0 else np.zeros(3)
        if _KINDS[i] == "thigh":
            sign = 1.0 if POSTURE_BONES[i].endswith("L") else -1.0
            start = world[parent] @ np.array([sign * _HIP_M[0], 0.0, -_HIP_M[1]])
        ends[i] = start + world[i] @ _AXES[i] * _DIMENSIONS[i, 0]
        points[i] = start + (ends[i] - start) * _SAMPLES[:, None]
    return points


def _must_be_apart() -> Bool[ndarray, "20 20"]:
    """Pairs of bones that must not intersect: all but parent and child, siblings, and bones of the trunk."""
    count = len(POSTURE_BONES)
    apart = np.ones((count, count), bool)
    chains = [{i, POSTURE_PARENTS[i]} for i in range(count)]
    trunk = {i for i, kind in enumerate(_KINDS) if kind in ("pelvis", "spine_low", "spine_mid", "spine_up", "neck")}
    trunk |= {i for i, kind in enumerate(_KINDS) if kind in ("clavicle", "head")}
    for i in range(count):
        for j in range(count):
            adjacent = bool(chains[i] & chains[j]) or {i, j} <= trunk
            # Upper arms touch the chest; thighs touch the belly and each other.
            low, high = sorted((_KINDS[i], _KINDS[j]))
            adjacent |= (low, high) in {("spine_up", "upper_arm"), ("spine_low", "thigh"), ("clavicle", "upper_arm"),
                                     ("thigh", "thigh")}  # fmt: skip
            apart[i, j] = not adjacent
    return apart


_MUST_BE_APART = np.repeat(np.repeat(_must_be_apart(), len(_SAMPLES), 0), len(_SAMPLES), 1)
_RADII = np.repeat(_DIMENSIONS[:, 1], len(_SAMPLES))
_LEAST_DISTANCES = _RADII[:, None] + _RADII[None] - _OVERLAP_M


def self_intersects(posture: Float[ndarray, "20 3"]) -> bool:
    """Whether a limb intersects another one or the trunk."""
    points = capsule_points(posture).reshape(-1, 3)
    return bool(((cdist(points, points) < _LEAST_DISTANCES) & _MUST_BE_APART).any())


def rest_on_floor(posture: Float[ndarray, "20 3"], rng: np.random.Generator) -> Float[ndarray, "20 3"]:
    """The posture rotated as a whole into a stable position on the floor z = 0.

    The body rests on a face of its convex hull that contains the projected centre of mass; larger faces are likelier.
    """
    capsules = capsule_points(posture)
    mass = (capsules.mean(1) * _DIMENSIONS[:, 2:]).sum(0) / _DIMENSIONS[:, 2].sum()
    points = (capsules.reshape(-1, 1, 3) + _DIRECTIONS * _RADII[:, None, None]).reshape(-1, 3)
    try:
        hull = ConvexHull(points)
    except QhullError:  # no body is flat, but an exception would stop training
        return posture
    corners, normals = points[hull.simplices], hull.equations[:, :3]
    # Barycentric coordinates of the centre of mass, projected onto the plane of each face.
    projections = mass - (normals @ mass + hull.equations[:, 3])[:, None] * normals
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    c = projections - corners[:, 0]
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
    return _rotated(posture, Rotation.from_matrix(turn))


def _rotated(posture: Float[ndarray, "20 3"], turn: Rotation) -> Float[ndarray, "20 3"]:
    """The posture rotated as a whole."""
    out = posture.copy()
    out[0] = (turn * Rotation.from_rotvec(posture[0])).as_rotvec()
    return out
