"""What a person wears on the back, the shoulder, the belly or the head, as solids that follow from the posed body.
Sizes as in :mod:`depthmocap.synth.scenes.objects`."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.synth.body.mesh import BodyModel, Phenotype, PosedBody
from depthmocap.synth.render import Material, PosedPerson
from depthmocap.synth.scenes.objects import TRIES, axes_of, skin_points, trunk_axes, vertices_of
from depthmocap.synth.scenes.solids import NONE, Solids, box, capsule, chain, ellipsoid, join

#: Length of an adult's trunk, hips to neck, which worn things are scaled by (metres).
_TRUNK_M = 0.59
#: Cloth stands off the trunk by no more than this (metres),
_THICKEST_M = 0.09
#: and off the shoulders by no more than this (metres).
_PADDING_M = 0.045
_TRUNK = ("chest", "belly", "upper back", "lower back", "collar", "shoulder front", "shoulder back", "nape")
_HEAD = ("forehead", "hair", "face")


@dataclasses.dataclass(frozen=True, eq=False)
class _Trunk:
    """The trunk's skin and clothes in its own frame: left, backwards, up from between the hips."""

    world_from_trunk: Float[ndarray, "3 3"]
    origin: Float[ndarray, "3"]
    length: float
    skin: Float[ndarray, "p 3"]
    cloth: Float[ndarray, "q 3"]

    @property
    def scale(self) -> float:
        return self.length / _TRUNK_M

    def back(self, x: float, z: float, side: int, reach: tuple[float, float] = (0.05, 0.05)) -> float:
        """How far back (``side`` 1) or, negative, forward (−1) the clothed trunk is around a place."""

        def around(points: Float[ndarray, "p 3"]) -> Float[ndarray, "q"]:
            return points[(np.abs(points[:, 0] - x) < reach[0]) & (np.abs(points[:, 2] - z) < reach[1]), 1] * side

        skin = around(self.skin)
        surface = float(skin.max()) if len(skin) else 0.12 * self.scale
        cloth = around(self.cloth)
        # What is farther out is cloth of the arms or hangs loose, and gives way.
        return side * max([surface, *cloth[cloth < surface + _THICKEST_M]])

    def shoulder(self, x: float) -> float:
        """Height of the clothed shoulder at a place across."""
        near = self.skin[np.abs(self.skin[:, 0] - x) < 0.04]
        if not len(near):
            return self.length
        top = near[near[:, 2].argmax()]
        cloth = self.cloth[(np.abs(self.cloth[:, :2] - [x, top[1]]) < 0.04).all(1), 2]
        return max([float(top[2]), *cloth[cloth < top[2] + _PADDING_M]]) + 0.01

    def to_world(self, points: list[tuple[float, float, float]]) -> Float[ndarray, "n 3"]:
        return np.array(points, dtype=float) @ self.world_from_trunk.T + self.origin


def _trunk(person: PosedPerson) -> _Trunk:
    joints = person.joints
    axes = trunk_axes(joints)
    origin = (joints[JOINT_INDEX["RHip"]] + joints[JOINT_INDEX["LHip"]]) / 2
    length = float(np.linalg.norm(joints[JOINT_INDEX["Neck"]] - origin))
    skin = (skin_points(person, vertices_of(person.body.model, _TRUNK)) - origin) @ axes
    cloths = [layer.vertices for layer in person.layers if layer.material in (Material.CLOTH, Material.DARK_CLOTH)]
    cloth = np.concatenate([np.zeros((0, 3)), *cloths])
    return _Trunk(axes, origin, length, skin, (cloth - origin) @ axes)


def _strap(trunk: _Trunk, x: float, ends: tuple[float, float], side: int, count: int = 4) -> list[tuple]:
    """Points over the chest (``side`` −1) or the back (1), from the shoulder at ``x`` to (across, height)."""
    points: list[tuple[float, float, float]] = [(x, 0.0, trunk.shoulder(x))]
    for share in np.linspace(0.25, 1, count):
        across = x + share * (ends[0] - x)
        height = points[0][2] + share * (ends[1] - points[0][2])
        points.append((across, trunk.back(across, height, side), height))
    return points


def _backpack(rng: np.random.Generator, trunk: _Trunk) -> tuple[Solids, Solids]:
    """0.24–0.36 wide, 0.1–0.24 deep, 0.36–0.56 high, with two straps."""
    half = rng.uniform([0.12, 0.05, 0.18], [0.18, 0.12, 0.28]) * trunk.scale
    z = trunk.shoulder(0.1) - half[2] + rng.uniform(-0.05, 0.06) * trunk.scale
    y = trunk.back(0.0, z, 1, (half[0], half[2])) + half[1] - 0.01
    centre = trunk.to_world([(0.0, y, z)])[0]
    parts = [box(centre, half, trunk.world_from_trunk, Material.OBJECT)]
    if rng.random() < 0.7:  # a pocket, or bulging contents
        outside = centre + trunk.world_from_trunk @ [0, half[1], -0.3 * half[2]]
        parts.append(ellipsoid(outside, half * [0.85, 0.5, 0.6], trunk.world_from_trunk, Material.OBJECT))
    straps = []
    for side in (-1, 1):
        x, under = side * 0.09 * trunk.scale, (side * 0.14 * trunk.scale, 0.62 * trunk.length)
        path = [(x, y - half[1], z + 0.9 * half[2]), *_strap(trunk, x, under, -1)]
        path.append((side * 0.15 * trunk.scale, y - half[1], z - 0.7 * half[2]))
        straps.append(chain(trunk.to_world(path), rng.uniform(0.012, 0.02), Material.OBJECT))
    return join(parts), join(straps)


def _shoulder_bag(rng: np.random.Generator, trunk: _Trunk) -> tuple[Solids, Solids]:
    """A bag 0.2–0.38 long at one hip, its strap over the other shoulder."""
    half = rng.uniform([0.03, 0.1, 0.09], [0.07, 0.19, 0.16]) * trunk.scale
    side, shoulder = rng.choice([-1.0, 1.0]), 0.09 * trunk.scale
    z = rng.uniform(-0.05, 0.12) * trunk.scale
    level = trunk.skin[np.abs(trunk.skin[:, 2] - 0.1 * trunk.scale) < 0.08]
    x = float(np.abs(level[:, 0]).max() if len(level) else 0.17 * trunk.scale) + half[0]
    centre = trunk.to_world([(side * x, 0.0, z)])[0]
    end = (side * (x - half[0]), z + half[2])
    paths = [_strap(trunk, -side * shoulder, end, way, 6) for way in (-1, 1)]
    radius = rng.uniform(0.01, 0.018)
    straps = [chain(trunk.to_world(path), radius, Material.OBJECT) for path in paths]
    return box(centre, half, trunk.world_from_trunk, Material.OBJECT), join(straps)


def _instrument(rng: np.random.Generator, trunk: _Trunk) -> tuple[Solids, Solids]:
    """Like a guitar: a body of two bulges 0.34–0.42 across and 0.08–0.12 deep before the belly, and a neck."""
    large, deep = rng.uniform(0.17, 0.21) * trunk.scale, rng.uniform(0.04, 0.06) * trunk.scale
    side = 1.0 if rng.random() < 0.85 else -1.0  # left-handed players are few
    z = rng.uniform(0.15, 0.3) * trunk.length
    y = trunk.back(0.0, z, -1, (0.6 * large, 0.6 * large)) - deep
    slope = rng.uniform(0.1, 0.7)
    along = np.array([side * np.cos(slope), 0, np.sin(slope)])
    turn = trunk.world_from_trunk @ axes_of(np.array([0, 1.0, 0]), along)
    lower, upper = trunk.to_world([tuple(np.array([0, y, z]) + s * along) for s in (-0.05, 0.17 * trunk.scale)])
    neck = trunk.to_world([tuple(np.array([0, y - 0.5 * deep, z]) + s * trunk.scale * along) for s in (0.1, 0.75)])
    parts = [
        ellipsoid(lower, (1.1 * large, large, deep), turn, Material.OBJECT),
        ellipsoid(upper, (0.8 * large, 0.75 * large, deep), turn, Material.OBJECT),
        capsule(neck[0], neck[1], 0.025, Material.OBJECT),
        box(neck[1], (0.07, 0.035, 0.015), turn, Material.OBJECT),
    ]
    strap = _strap(trunk, side * 0.09, (-side * 0.1, 1.2 * z), 1, 5)
    return join(parts), chain(trunk.to_world(strap), 0.015, Material.OBJECT)


@functools.lru_cache(maxsize=4)
def _rest_head(model: BodyModel) -> Float[ndarray, "p 3"]:
    """The default body's head at rest."""
    return model.shape(Phenotype()).rest_vertices[vertices_of(model, _HEAD)].astype(float)


def _hat(rng: np.random.Generator, body: PosedBody) -> Solids:
    """A cap, a hat with a brim of 5–12 cm, or a helmet of 2–4 cm."""
    head = body.vertices[vertices_of(body.model, _HEAD)].astype(float)
    rest = _rest_head(body.model)
    # The turn that carries the default head onto this one, by least squares (Kabsch).
    turn = Rotation.align_vectors(head - head.mean(0), rest - rest.mean(0))[0].as_matrix()
    local = head @ turn
    skull = local[local[:, 2] > local[:, 2].max() - 0.45 * np.ptp(local[:, 2])]  # down to the eyebrows
    low, high = skull.min(0), skull.max(0)
    kind = rng.choice(["cap", "hat", "helmet"])
    pad = rng.uniform(0.02, 0.04) if kind == "helmet" else rng.uniform(0.008, 0.02)
    # Its lower half narrows into the head, above the eyes.
    centre = np.array([*(low + high)[:2] / 2, 0.7 * low[2] + 0.3 * high[2]])
    half = (high - low) * [0.54, 0.54, 0.7] + pad
    parts = [ellipsoid(turn @ centre, half, turn, Material.OBJECT)]
    width = rng.uniform(0.05, 0.12)
    if kind == "hat":
        rim = np.array([half[0] + width, half[1] + width, 0.008])
        parts.append(ellipsoid(turn @ centre, rim, turn, Material.OBJECT))
    elif kind == "cap":
        tip = centre - np.array([0, half[1] * 0.8, 0])
        parts.append(ellipsoid(turn @ tip, (half[0] * 0.8, width + 0.02, 0.008), turn, Material.OBJECT))
    return join(parts)


_WORN = (_backpack, _backpack, _shoulder_bag, _instrument)


def worn_object(rng: np.random.Generator, person: PosedPerson) -> Solids:
    """A backpack, a shoulder bag, an instrument or something on the head; nothing where arms or legs are in the way."""
    for _ in range(TRIES):
        if rng.random() < 0.3:
            return _hat(rng, person.body)
        trunk = _trunk(person)
        thing, straps = _WORN[int(rng.integers(len(_WORN)))](rng, trunk)
        limbs = ~vertices_of(person.body.model, _TRUNK)
        if not thing.hold_any(skin_points(person, limbs)):
            return join([thing, straps])
    return NONE
