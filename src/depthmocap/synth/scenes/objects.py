"""What a person holds, as solids that follow from the posed body. Ranges of sizes (metres, of an adult's
things; a child's are smaller in proportion) are ours, from common sizes of such things, and stand where they are drawn.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.body.regions import REGION_NAMES
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.geometry.transforms import unit
from depthmocap.synth.body.mesh import BodyModel
from depthmocap.synth.render import Material, PosedPerson
from depthmocap.synth.scenes.solids import NONE, Solids, above, box, capsule, chain, cylinder, ellipsoid, join

#: Length of an adult's forearm, which held things are scaled by (metres).
_FOREARM_M = 0.255
#: Attempts at a thing that does not run through the body.
TRIES = 5


@functools.lru_cache(maxsize=32)
def vertices_of(model: BodyModel, kinds: tuple[str, ...], side: str = "") -> Bool[ndarray, "v"]:
    """Vertices of the regions of these kinds, of one side ("R", "L") or both."""
    of_kind = np.array([n.removesuffix(" R").removesuffix(" L") in kinds and n.endswith(side) for n in REGION_NAMES])
    mask = np.zeros(int(model.faces.max()) + 1, dtype=np.bool_)
    mask[model.faces[of_kind[model.face_regions]]] = True
    return mask


_ARM = ("hand", "wrist", "forearm")


def axes_of(z: Float[ndarray, "3"], x_hint: Float[ndarray, "3"]) -> Float[ndarray, "3 3"]:
    """A rotation with z axis ``z`` and the x axis nearest to ``x_hint``."""
    z = unit(z)
    x = x_hint - (x_hint @ z) * z
    if np.linalg.norm(x) < 1e-3:
        x = np.cross(z, [0.3, 0.8, 0.5])
    x = unit(x)
    return np.stack([x, np.cross(z, x), z], 1)


_UP = np.array([0.0, 0.0, 1.0])


def trunk_axes(joints: Float[ndarray, "18 3"]) -> Float[ndarray, "3 3"]:
    """``world_from_trunk``: left, backwards, up, as the body stands in the rest pose."""
    at = {name: joints[i] for name, i in JOINT_INDEX.items()}
    up = at["Neck"] - (at["RHip"] + at["LHip"]) / 2
    return axes_of(up, at["LShoulder"] - at["RShoulder"] + at["LHip"] - at["RHip"])


def skin_points(person: PosedPerson, chosen: Bool[ndarray, "v"]) -> Float[ndarray, "p 3"]:
    """The chosen vertices of the skin."""
    return person.vertices[chosen].astype(float)


@dataclasses.dataclass(frozen=True, eq=False)
class _Hand:
    """A hand that holds: its palm, where the forearm points, and how large it is (1: an adult's)."""

    palm: Float[ndarray, "3"]
    forearm: Float[ndarray, "3"]
    other: Float[ndarray, "3"]
    trunk: Float[ndarray, "3 3"]
    middle: Float[ndarray, "3"]
    scale: float


def _hand(person: PosedPerson, side: str) -> _Hand:
    joints = person.joints
    palms = {}
    for s in "RL":
        wrist, elbow = joints[JOINT_INDEX[f"{s}Hand"]], joints[JOINT_INDEX[f"{s}Elbow"]]
        palms[s] = (wrist, unit(wrist - elbow), float(np.linalg.norm(wrist - elbow)) / _FOREARM_M)
    (wrist, forearm, scale), far = palms[side], palms["L" if side == "R" else "R"]
    return _Hand(
        wrist + 0.085 * scale * forearm, forearm, far[0] + 0.085 * far[2] * far[1], trunk_axes(joints),
        joints[JOINT_INDEX["Spine2"]], scale,
    )  # fmt: skip


def _ball(rng: np.random.Generator, hand: _Hand) -> Solids:
    """6–24 cm across, on the palm."""
    radius = rng.uniform(0.03, 0.12) * hand.scale
    centre = hand.palm + hand.forearm * 0.8 * radius
    return ellipsoid(centre, (radius, radius, radius), material=Material.OBJECT)


def _hanging_bag(rng: np.random.Generator, hand: _Hand) -> Solids:
    """A bag or a suitcase 0.25–0.45 wide and 0.2–0.4 high, which hangs from the hand."""
    half = rng.uniform([0.125, 0.03, 0.1], [0.225, 0.09, 0.2]) * hand.scale
    handle = rng.uniform(0.03, 0.25) * hand.scale
    turn = axes_of(_UP, hand.trunk[:, 1])  # along the leg
    top = hand.palm - above(handle)
    ends = [top + x * 0.5 * half[0] * turn[:, 0] for x in (-1, 1)]
    strap = chain(np.stack([ends[0], hand.palm, ends[1]]), 0.01, Material.OBJECT)
    return join([strap, box(top - above(half[2]), half, turn, Material.OBJECT)])


def _carton(rng: np.random.Generator, hand: _Hand) -> Solids:
    """A box between both hands, 0.15–0.4 high and deep, or a board 0.2–0.8 high; nothing where the hands are not both
    before the trunk."""
    across = hand.other - hand.palm
    before = min((p - hand.middle) @ -hand.trunk[:, 1] for p in (hand.palm, hand.other))
    wide = float(np.linalg.norm(across))
    if not 0.15 < wide / hand.scale < 0.7 or before < 0.15 * hand.scale:
        return NONE
    if rng.random() < 0.3:
        half = np.array([wide / 2 + rng.uniform(0, 0.12), rng.uniform(0.004, 0.02), rng.uniform(0.1, 0.4) * hand.scale])
    else:
        half = np.array([wide / 2 - 0.02, *rng.uniform(0.075, 0.2, 2) * hand.scale])
    axes = axes_of(across, _UP)
    turn = np.stack([axes[:, 2], np.cross(axes[:, 0], axes[:, 2]), axes[:, 0]], 1)  # across, before, upwards
    centre = (hand.palm + hand.other) / 2 - hand.trunk[:, 1] * 0.5 * half[1]
    return box(centre, half, turn, Material.OBJECT)


def _bottle(rng: np.random.Generator, hand: _Hand) -> Solids:
    """A bottle or a can, 0.1–0.3 high, in the fist."""
    axis = _grip_axis(rng, hand, 0.3)
    radius, half = rng.uniform(0.025, 0.045), rng.uniform(0.05, 0.15)
    body = cylinder(hand.palm - half * axis, hand.palm + half * axis, radius, Material.OBJECT)
    neck = hand.palm + half * axis
    return join([body, capsule(neck, neck + 0.06 * axis, 0.014, Material.OBJECT)])


def _slab(rng: np.random.Generator, hand: _Hand) -> Solids:
    """A phone, a book or a tablet, 0.07–0.25 wide and 1–4 cm thick."""
    half = rng.uniform([0.035, 0.05, 0.005], [0.125, 0.16, 0.02])
    return box(hand.palm + 0.03 * hand.forearm, half, axes_of(rng.normal(size=3), hand.forearm), Material.OBJECT)


def _stick(rng: np.random.Generator, hand: _Hand) -> Solids:
    """A stick, an umbrella or a broom, 0.6–1.6 long, its lower end above the floor (see :func:`held_object`)."""
    axis = _grip_axis(rng, hand, 0.35)
    long, below = rng.uniform(0.6, 1.6), rng.uniform(0.2, 0.8)
    low, high = hand.palm - below * long * axis, hand.palm + (1 - below) * long * axis
    parts = [capsule(low, high, rng.uniform(0.008, 0.018), Material.OBJECT)]
    if rng.random() < 0.4:  # a broom
        parts.append(box(low, (0.17, 0.03, 0.05), axes_of(axis, hand.trunk[:, 0]), Material.OBJECT))
    return join(parts)


def _racket(rng: np.random.Generator, hand: _Hand) -> Solids:
    """A racket or a pan, 0.35–0.7 long, which goes on from the forearm."""
    along = unit(hand.forearm + rng.normal(0, 0.4, 3))
    handle, radius = rng.uniform(0.12, 0.35), rng.uniform(0.08, 0.15)
    turn = axes_of(along, rng.normal(size=3))
    centre = hand.palm + (handle + radius) * along
    head = ellipsoid(centre, (radius, 0.012, 1.15 * radius), turn, Material.OBJECT)
    return join([capsule(hand.palm - 0.06 * along, hand.palm + handle * along, 0.016, Material.OBJECT), head])


def _tray(rng: np.random.Generator, hand: _Hand) -> Solids:
    """A tray 0.25–0.5 wide on the hand, with things on it."""
    half = rng.uniform([0.125, 0.1], [0.25, 0.18])
    turn = axes_of(_UP, hand.forearm * [1, 1, 0] + [1e-6, 0, 0])
    centre = hand.palm + above(0.05 * hand.scale) + turn[:, 0] * 0.3 * half[0]
    parts = [box(centre, (*half, 0.01), turn, Material.OBJECT)]
    for _ in range(rng.integers(0, 4)):
        at = centre + turn[:, :2] @ (rng.uniform(-0.7, 0.7, 2) * half)
        parts.append(cylinder(at, at + above(rng.uniform(0.05, 0.25)), rng.uniform(0.025, 0.05), Material.OBJECT))
    return join(parts)


def _grip_axis(rng: np.random.Generator, hand: _Hand, spread: float) -> Float[ndarray, "3"]:
    """Axis of an object in a fist: across the forearm, as upright as possible."""
    upright = _UP + rng.normal(0, spread, 3)
    return axes_of(hand.forearm, upright)[:, 0]


_Holder: TypeAlias = Callable[[np.random.Generator, _Hand], Solids]
#: What one hand holds; the carton takes both, and is tried first because few postures allow it.
_HELD: tuple[_Holder, ...] = (_ball, _hanging_bag, _bottle, _slab, _stick, _racket, _tray)


def held_object(rng: np.random.Generator, person: PosedPerson, floor_m: float) -> Solids:
    """Something in the person's right or left hand or both, above the floor, which touches nothing but hands and
    forearms; nothing where a few tries find no place."""
    for attempt in range(TRIES):
        side = "RL"[int(rng.integers(2))]
        hand = _hand(person, side)
        carried = attempt == 0 and rng.random() < 0.6
        holder = _carton if carried else _HELD[int(rng.integers(len(_HELD)))]
        thing = holder(rng, hand)
        if not len(thing) or thing.corners[..., 2].min() < floor_m:
            continue
        holding = vertices_of(person.body.model, _ARM, "" if carried else side)
        if not thing.hold_any(skin_points(person, ~holding)):
            return thing
    return NONE
