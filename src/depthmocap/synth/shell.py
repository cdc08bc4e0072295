"""Shells: clothes and hair that follow the skin, with air under them, folds and an edge that runs where it was cut."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from depthmocap.body.model import Body, BoneTransforms
from depthmocap.kernels.garment import compression, hang, pose_skin, snap, wear
from depthmocap.kernels.skin import vertex_normals
from depthmocap.synth.cloth_map import Anchors, ClothMap
from depthmocap.synth.wardrobe import SKIRT_LINE_M, Garment, Hair, Shoes

#: Folds of a fully compressed spot, as a multiple of those at rest.
CREASE = 5.0
#: A shell with a skirt ends this far below the line that the skirt hangs from.
OVERLAP_M = 0.015
#: Most air that falling cloth leaves under it.
MOST_AIR_M = 0.11
#: Typical lengths (metres) of what ``ClothMap.along`` counts as 1.
_ARM_M, _LEG_M = 0.26, 0.46
_OFF = np.float32(-1.0)


@dataclasses.dataclass(frozen=True, eq=False)
class RestCloth:
    """A body's skin in the rest pose, where clothes go. ``scale`` is its stature over the default body's."""

    cloth: ClothMap
    points: Float[ndarray, "n 3"]
    normals: Float[ndarray, "n 3"]
    lengths: Float[ndarray, "e"]
    centre_y: float
    scale: float

    @classmethod
    def of(cls, body: Body) -> RestCloth:
        """The rest skin of a body."""
        cloth = ClothMap.of(body.model)
        points = body.rest_vertices[cloth.vertices]
        normals = np.empty_like(points)
        vertex_normals(points, cloth.faces, normals)
        owners = np.repeat(np.arange(len(points)), np.diff(cloth.starts))
        lengths = np.linalg.norm(points[cloth.neighbours] - points[owners], axis=1) + np.float32(1e-6)
        scale = float(np.ptp(body.rest_vertices[:, 2])) / cloth.stature
        line = cloth.skirt
        centre_y = float((points[line.first, 1].max() + points[line.first, 1].min()) / 2)
        return cls(cloth, points, normals, lengths, centre_y, scale)


@dataclasses.dataclass(frozen=True, eq=False)
class PosedCloth:
    """The posed skin where clothes go: points, unit normals and 0–1 how much it is compressed there."""

    points: Float[ndarray, "n 3"]
    normals: Float[ndarray, "n 3"]
    compressed: Float[ndarray, "n"]

    @classmethod
    def of(cls, rest: RestCloth, transforms: BoneTransforms) -> PosedCloth:
        """The rest skin moved by a posture."""
        cloth = rest.cloth
        points, normals = np.empty_like(rest.points), np.empty_like(rest.points)
        pose_skin(
            rest.points, rest.normals, cloth.skin_indices, cloth.skin_weights,
            transforms.rotations, transforms.offsets, points, normals,
        )  # fmt: skip
        compressed = np.empty(len(points), np.float32)
        compression(points, cloth.starts, cloth.neighbours, rest.lengths, compressed)
        return cls(points, normals, compressed)


@dataclasses.dataclass(frozen=True, eq=False)
class Shell:
    """Part of the skin pushed out (see ``kernels.garment.wear``); its last ``anchors`` vertices carry a
    sheet and have no faces."""

    vertices: Int[ndarray, "m"]
    partner: Int[ndarray, "m"]
    mix: Float[ndarray, "m"]
    thickness: Float[ndarray, "m"]
    slack: Float[ndarray, "m"]
    fold: Float[ndarray, "m"]
    faces: Int[ndarray, "g 3"]
    anchors: int

    @property
    def anchors_off_m(self) -> Float[ndarray, "c"]:
        """How far (metres) the vertices that carry a sheet stand off the skin where they are upright."""
        return (self.thickness + self.slack)[len(self.vertices) - self.anchors :]

    def pose(self, posed: PosedCloth) -> Float[ndarray, "m 3"]:
        """Vertices over the posed skin."""
        out = np.empty((len(self.vertices), 3), np.float32)
        wear(
            posed.points, posed.normals, posed.compressed, self.vertices, self.partner, self.mix,
            self.thickness, self.slack, self.fold, np.float32(CREASE), out,
        )  # fmt: skip
        return out


def _smooth(x: Float[ndarray, "*n"]) -> Float[ndarray, "*n"]:
    x = np.clip(x, 0, 1)
    return x * x * (3 - 2 * x)


def garment_level(cloth: ClothMap, garment: Garment) -> Float[ndarray, "n"]:
    """Metres inside a garment's edges; 0 and below is outside."""
    level = np.full(len(cloth.vertices), _OFF, np.float32)
    trunk, arm, leg = cloth.trunk, cloth.arm, cloth.leg
    hem = SKIRT_LINE_M - OVERLAP_M if garment.hangs_m else garment.hem
    if garment.top is not None:
        level[trunk] = garment.top - cloth.height[trunk]
        if not garment.leg:
            level[trunk] = np.minimum(level[trunk], cloth.height[trunk] - hem)
        level[leg] = (garment.leg - cloth.along[leg]) * _LEG_M if garment.leg else _OFF
        return level
    level[trunk] = cloth.height[trunk] - hem
    if garment.sleeve > 0:
        level[arm] = (garment.sleeve - cloth.along[arm]) * _ARM_M
    else:
        level = np.minimum(level, (np.float32(0.3) - cloth.armness) * np.float32(0.2))
    across = np.abs(cloth.default[:, 0])
    front = np.abs(cloth.azimuth) > np.pi / 2
    dip = garment.v_neck_m * front * np.clip(1 - across / 0.11, 0, 1)
    level[trunk] = np.minimum(level, garment.neck - dip - cloth.neck)[trunk]
    if garment.open_m:
        gap = garment.open_m * (1 - 0.8 * np.clip(cloth.height, 0, 0.6))
        level[trunk & front] = np.minimum(level, across - gap)[trunk & front]
    return level


def _shape(cloth: ClothMap, garment: Garment, level: Float[ndarray, "n"]) -> Float[ndarray, "n"]:
    """Share of the slack, 0 where a garment rests on the body (shoulders, waistband) to 1 where it is loosest."""
    shape = np.zeros(len(level), np.float32)
    trunk, arm, leg = cloth.trunk, cloth.arm, cloth.leg
    if garment.top is None:
        shape[trunk] = 0.1 + 0.9 * _smooth((0.62 - cloth.height[trunk]) / 0.4)
        full = np.minimum(garment.sleeve, 2.0)
        # A short sleeve is widest at its opening, a long one at the elbow.
        widening = cloth.along[arm] / max(full, 0.1) if full < 1.3 else np.sin(np.pi * cloth.along[arm] / 2.4)
        shape[arm] = 0.3 + 0.45 * np.clip(widening, 0, 1)
    else:
        down = _smooth((garment.top - cloth.height[trunk]) / 0.28)
        shape[trunk] = 0.4 * down
        shape[leg] = 0.4 + 0.6 * _smooth(cloth.along[leg] / max(garment.leg, 0.5))
    if garment.cuff:
        near = _smooth(level / 0.06)
        bulge = np.exp(-(((level - 0.09) / 0.05) ** 2))
        shape = shape * (1 - garment.cuff * (1 - near)) + 0.4 * garment.cuff * bulge * (shape > 0.25)
    return shape


def _air(rest: RestCloth, garment: Garment) -> Float[ndarray, "n"]:
    """Air under cloth that falls straight from chest, belly and seat (metres)."""
    cloth, points = rest.cloth, rest.points
    air = np.zeros(len(points), np.float32)
    if not garment.sag:
        return air
    decay = np.float32(0.12 + 0.8 * (1 - garment.sag))
    taut = np.float32(3.0)
    step = np.float32(0.025)
    parts = []
    if garment.top is None:
        hanging = cloth.trunk & (cloth.armness < 0.3) & (cloth.height < 0.63)
    else:
        hanging = cloth.trunk & (cloth.height < garment.top)
    radius = np.hypot(points[hanging, 0], points[hanging, 1] - rest.centre_y)
    parts.append((hanging, points[hanging, 2], radius, decay if garment.top is None else taut))
    if garment.leg:
        for side in (cloth.left, ~cloth.left):
            mask = cloth.leg & side
            along = cloth.along[mask]
            # Away from a straight line down the leg.
            ends = [points[mask][np.abs(along - at) < 0.12].mean(0) for at in (0.5, 1.0, 1.9)]
            bone = np.stack([np.interp(along, (0.5, 1.0, 1.9), [end[k] for end in ends]) for k in (0, 1)], 1)
            parts.append((mask, -along * np.float32(_LEG_M), np.linalg.norm(points[mask, :2] - bone, axis=1), decay))
    for mask, height, radius, shrink in parts:
        air[mask] = hang(height, cloth.azimuth[mask], radius.astype(np.float32), step, shrink, 24)
    # Shoulders and arms carry it.
    carried = _smooth((0.63 - cloth.height) / 0.12) * _smooth((0.3 - cloth.armness) / 0.25)
    air = np.where(cloth.trunk, air * carried, air)
    return np.minimum(air * (0.3 + 0.7 * garment.sag), MOST_AIR_M).astype(np.float32)


def _noise(
    points: Float[ndarray, "n 3"], wavelengths: tuple[float, float], waves: int, rng: np.random.Generator
) -> Float[ndarray, "n"]:
    """Smooth noise of deviation about 0.7: plane waves of random directions and lengths (metres)."""
    directions = rng.normal(size=(3, waves))
    directions *= 2 * np.pi / rng.uniform(*wavelengths, waves) / np.linalg.norm(directions, axis=0)
    phases = points @ directions.astype(np.float32) + rng.uniform(0, 2 * np.pi, waves).astype(np.float32)
    return np.sin(phases).sum(1) / np.float32(np.sqrt(waves))


def _folds(
    rest: RestCloth, garment: Garment, level: Float[ndarray, "n"], rng: np.random.Generator
) -> Float[ndarray, "n"]:
    """Signed height of folds (metres): slanting rings along limbs and trunk, and drapes that widen to the hem."""
    cloth = rest.cloth
    wander = _noise(rest.points, (0.12, 0.35), 4, rng)
    metres = np.where(cloth.arm, cloth.along * _ARM_M, np.where(cloth.leg, cloth.along * _LEG_M, cloth.height))
    rings = np.zeros(len(level), np.float32)
    for _ in range(2):
        wavelength = np.where(cloth.trunk, rng.uniform(0.08, 0.17), rng.uniform(0.06, 0.12))
        slant = np.where(cloth.left, 1, -1) * rng.choice((-2, -1, 1, 2))
        phase = 2 * np.pi * metres / wavelength + slant * cloth.azimuth + 2.5 * wander + rng.uniform(0, 2 * np.pi)
        # Ridges are narrower than the valleys between them, and here and there cloth lies smooth.
        patches = _smooth(0.3 + 0.8 * _noise(rest.points, (0.15, 0.4), 3, rng))
        rings += patches * (1 - 1.6 * np.abs(np.sin(phase / 2))).astype(np.float32)
    # A skirt's folds are those of what hangs.
    folds = rings * (min(garment.folds_m, 0.006) if garment.skirt_m else garment.folds_m)
    if garment.top is None:
        drapes = np.cos(rng.integers(4, 10) * cloth.azimuth + rng.uniform(0, 2 * np.pi) + wander)
        folds += np.where(cloth.trunk, 0.4 * garment.slack_m * drapes * _smooth(1 - level / 0.35), 0)
    if garment.leg > 1.5:  # cloth gathers over the foot
        folds *= 1 + 1.2 * cloth.leg * _smooth((cloth.along - 1.5) / 0.4)
    return folds.astype(np.float32)


def _cut(
    cloth: ClothMap,
    level: Float[ndarray, "n"],
    fields: tuple[Float[ndarray, "n"], ...],
    anchors: Anchors | None,
    hidden: Bool[ndarray, "n"] | None = None,
) -> Shell:
    """The shell where ``level`` is above 0, its vertices outside drawn to the edge, without faces that are hidden.
    Fields are (thickness, slack, fold)."""
    kept = (level > 0)[cloth.faces].any(1)
    if hidden is not None:
        kept &= ~hidden[cloth.faces].all(1)
    used = np.zeros(len(level), bool)
    used[cloth.faces[kept]] = True
    vertices = np.flatnonzero(used).astype(np.int32)
    number = (np.cumsum(used) - 1).astype(np.int32)
    partner, mix = np.empty_like(vertices), np.empty(len(vertices), np.float32)
    snap(level, vertices, cloth.starts, cloth.neighbours, partner, mix)
    if anchors is not None:
        vertices = np.concatenate([vertices, anchors.first])
        partner = np.concatenate([partner, anchors.second])
        mix = np.concatenate([mix, anchors.share])
    values = [((1 - mix) * field[vertices] + mix * field[partner]).astype(np.float32) for field in fields]
    return Shell(
        vertices, partner, mix, *values, faces=number[cloth.faces[kept]], anchors=len(anchors.first) if anchors else 0
    )


def garment_shell(
    rest: RestCloth,
    garment: Garment,
    level: Float[ndarray, "n"],
    under: Float[ndarray, "n"],
    over: Float[ndarray, "n"],
    rng: np.random.Generator,
) -> tuple[Shell, Float[ndarray, "n"]]:
    """The part of a garment that follows the body, and how far (metres) all that is worn now stands off the skin.

    Args:
        level: the garment's own (see :func:`garment_level`).
        under: how far what is worn beneath stands off the skin.
        over: level of what is worn above: it presses on this garment, and hides it but for the rim.
    """
    cloth = rest.cloth
    air = _air(rest, garment) + garment.slack_m * rest.scale * _shape(cloth, garment, level)
    thickness = garment.thickness_m + under
    if garment.hood_m:
        thickness = thickness + _hood(cloth, garment, level)
    # Slack beneath is not added: the outer garment presses on it, or has room for it.
    air = np.maximum(air - 0.5 * under, 0)
    folds = _folds(rest, garment, level, rng)
    free = 1 - 0.8 * _smooth(over / 0.04 + 0.5)
    air, folds = air * free, folds * free
    anchors = cloth.skirt if garment.hangs_m else None
    shell = _cut(cloth, level, (thickness, air, folds), anchors, over > 0.05)
    worn = np.where(level > 0, thickness + 0.4 * air, under).astype(np.float32)
    return shell, worn


def _hood(cloth: ClothMap, garment: Garment, level: Float[ndarray, "n"]) -> Float[ndarray, "n"]:
    """A hood's or collar's bulge at the neckline: thickest behind."""
    lump = np.exp(-(((level - 0.03) / 0.045) ** 2)) * (cloth.neck > garment.neck - 0.13)
    behind = 0.55 + 0.45 * np.cos(cloth.azimuth)
    return (garment.hood_m * lump * np.where(cloth.trunk, behind, 0)).astype(np.float32)


def hair_cap(rest: RestCloth, hair: Hair, rng: np.random.Generator) -> Shell:
    """Hair over the scalp."""
    cloth = rest.cloth
    # Where the forehead ends differs from head to head.
    forehead = rng.uniform(0.0, 0.09)
    back = cloth.default[:, 1] - (cloth.default[cloth.head, 1].min() + forehead)
    high = cloth.height - cloth.height[cloth.head].min()
    level = np.where(cloth.head, np.minimum(cloth.scalp * 0.06 - 0.02, back + np.clip(high - 0.1, 0, 1)), _OFF)
    level = level.astype(np.float32)
    rim = 0.35 + 0.65 * _smooth(level / 0.03)
    lumps = 1 + 0.25 * hair.lumps * _noise(rest.points, (0.05, 0.12), 6, rng)
    # Hair stands off the crown more than off the nape.
    crown = 0.6 + 0.4 * _smooth((high - 0.02) / 0.12)
    thickness = (np.maximum(hair.volume_m * rim * lumps * crown, 0.003) * max(rest.scale, 0.8)).astype(np.float32)
    none = np.zeros_like(thickness)
    return _cut(cloth, level, (thickness, none, none), cloth.hair if hair.style in ("bob", "long") else None)


def boot_shell(
    rest: RestCloth, shoes: Shoes, under: Float[ndarray, "n"]
) -> tuple[Shell, Float[ndarray, "n"]]:
    """The shafts of boots, and how far all that is worn now stands off the skin."""
    cloth = rest.cloth
    level = np.where(cloth.leg, (cloth.along - shoes.shaft) * _LEG_M, _OFF).astype(np.float32)
    thickness = (shoes.upper_m + 0.004 + under).astype(np.float32)
    none = np.zeros_like(thickness)
    shell = _cut(cloth, level, (thickness, none, none), None)
    return shell, np.where(level > 0, thickness, under).astype(np.float32)
