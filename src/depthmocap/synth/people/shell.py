"""Shells: clothes and hair that follow the skin, with air under them, folds and an edge that runs where it was cut."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from depthmocap.kernels.garment import (
    add_folds,
    cut_mesh,
    edge_compression,
    edge_lengths,
    hanging_offsets,
    interpolate_cut,
    offset_shell,
    smooth_cloth,
)
from depthmocap.kernels.skin import skin_with_normals, vertex_normals
from depthmocap.synth.body.mesh import Body, BoneTransforms
from depthmocap.synth.people.cloth_map import ARM_M, LEG_M, SECTIONS, Anchors, ClothMap
from depthmocap.synth.people.wardrobe import SKIRT_LINE_M, Garment, Hair, Shoes

#: Growth of folds with compression: a bent elbow or groin shortens the skin by 10–30 %.
CREASE = 9.0
#: A shell with a skirt ends this far below the line that the skirt hangs from.
OVERLAP_M = 0.015
#: Most air that falling cloth leaves under it.
MOST_AIR_M = 0.11
#: Above this height over the crotch (metres) tops rest on the body.
_CARRIED_M = 0.63
_OFF = np.float32(-1.0)


@dataclasses.dataclass(frozen=True, eq=False)
class RestCloth:
    """A body's skin in the rest pose, where clothes go.

    ``normals`` are those of a taut cloth over it, and ``span`` how far that is off the skin, negative where it would
    cut bumps off (see ``kernels.garment.taut``); ``scale`` is the body's stature over the default's.
    """

    cloth: ClothMap
    points: Float[ndarray, "n 3"]
    normals: Float[ndarray, "n 3"]
    lengths: Float[ndarray, "e"]
    span: Float[ndarray, "n"]
    centre_y: float
    scale: float

    @classmethod
    def of(cls, body: Body) -> RestCloth:
        """The rest skin of a body."""
        cloth = ClothMap.of(body.model)
        points = body.rest_vertices[cloth.vertices]
        over = smooth_cloth(points, cloth.starts, cloth.neighbours, cloth.trunk.stop, 14)
        # Cloth leaves the skin the way it faces itself: in a hollow the skin's own normals cross.
        normals = np.empty_like(points)
        vertex_normals(over, cloth.faces, normals)
        span = ((over - points) * normals).sum(1)
        lengths = edge_lengths(points, cloth.starts, cloth.neighbours)
        scale = float(np.ptp(body.rest_vertices[:, 2])) / cloth.stature
        line = cloth.skirt
        centre_y = float((points[line.first, 1].max() + points[line.first, 1].min()) / 2)
        return cls(cloth, points, normals, lengths, span, centre_y, scale)


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
        skin_with_normals(
            rest.points, rest.normals, cloth.skin_indices, cloth.skin_weights,
            transforms.rotations, transforms.offsets, points, normals,
        )  # fmt: skip
        compressed = np.empty(len(points), np.float32)
        edge_compression(points, cloth.starts, cloth.neighbours, rest.lengths, compressed)
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
        offset_shell(
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
    height = cloth.height[trunk]
    hem = SKIRT_LINE_M - OVERLAP_M if garment.hangs_m else garment.hem
    if garment.top is not None:
        level[trunk] = garment.top - height
        if garment.leg:
            level[leg] = (garment.leg - cloth.along[leg]) * LEG_M
        else:
            level[trunk] = np.minimum(level[trunk], height - hem)
        return level
    across = np.abs(cloth.default[trunk, 0])
    front = np.abs(cloth.azimuth[trunk]) > np.pi / 2
    dip = garment.v_neck_m * front * np.clip(1 - across / 0.11, 0, 1)
    inside = np.minimum(height - hem, garment.neck - dip - cloth.neck[trunk])
    if garment.open_m:
        gap = garment.open_m * (1 - 0.8 * np.clip(height, 0, 0.6))
        inside[front] = np.minimum(inside, across - gap)[front]
    if garment.one_shoulder:
        slanted = garment.one_shoulder * cloth.default[trunk, 0] + 0.03 - 0.45 * (height - 0.55)
        inside = np.minimum(inside, slanted)
    level[trunk] = inside
    if garment.sleeve > 0:
        level[arm] = (garment.sleeve - cloth.along[arm]) * ARM_M
        if garment.one_shoulder:
            level[arm][cloth.slant[arm] != garment.one_shoulder] = _OFF
    else:
        level[trunk] = np.minimum(inside, (0.3 - cloth.armness[trunk]) * 0.2)
    return level


def _shape(cloth: ClothMap, garment: Garment, level: Float[ndarray, "n"]) -> Float[ndarray, "n"]:
    """Share of the slack, 0 where a garment rests on the body (shoulders, waistband) to 1 where it is loosest."""
    shape = np.zeros(len(level), np.float32)
    trunk, arm, leg = cloth.trunk, cloth.arm, cloth.leg
    if garment.top is None:
        shape[trunk] = 0.1 + 0.9 * _smooth((0.62 - cloth.height[trunk]) / 0.4)
        # A short sleeve is widest at its opening, a long one at the elbow.
        along, sleeve = cloth.along[arm], garment.sleeve
        widening = along / max(sleeve, 0.1) if sleeve < 1.3 else np.sin(np.pi / 2.4 * along)
        shape[arm] = 0.3 + 0.45 * np.clip(widening, 0, 1)
    else:
        shape[trunk] = 0.4 * _smooth((garment.top - cloth.height[trunk]) / 0.28)
        shape[leg] = 0.4 + 0.6 * _smooth(cloth.along[leg] / max(garment.leg, 0.5))
    if garment.cuff:
        near = _smooth(level / 0.06)
        bulge = np.exp(-(((level - 0.09) / 0.05) ** 2))
        if garment.padded and garment.hangs_m:  # an elastic is where cloth ends, not where it hangs on
            near[trunk], bulge[trunk] = 1, 0
        shape = shape * (1 - garment.cuff * (1 - near)) + 0.4 * garment.cuff * bulge * (shape > 0.25)
    return shape


def _air(rest: RestCloth, garment: Garment) -> Float[ndarray, "n"]:
    """Air under cloth that falls straight from chest, belly and seat (metres)."""
    cloth, points = rest.cloth, rest.points
    air = np.zeros(len(points), np.float32)
    if not garment.sag:
        return air
    decay = 0.12 + 0.8 * (1 - garment.sag)

    def fall(part: slice, height: Float[ndarray, "m"], radius: Float[ndarray, "m"], decay: float) -> None:
        radius = radius.astype(np.float32)
        air[part] = hanging_offsets(height, cloth.azimuth[part], radius, np.float32(0.025), np.float32(decay), 24)

    # Shoulders and arms carry a top; a waistband lies taut.
    top = _CARRIED_M if garment.top is None else garment.top
    low = slice(0, int(np.searchsorted(cloth.height[cloth.trunk], top)))
    free = np.clip((0.3 - cloth.armness[low]) / 0.25, 0, 1)
    away = points[low, :2] - np.array([0, rest.centre_y], np.float32)
    radius = np.hypot(away[:, 0], away[:, 1])
    fall(low, points[low, 2], radius * (free > 0), decay if garment.top is None else 3.0)
    # Skin that faces inwards or down, between the legs, has no cloth before it.
    facing = np.clip((away * rest.normals[low, :2]).sum(1) / radius, 0, 1)
    air[low] *= free * facing**2 * _smooth((_CARRIED_M - cloth.height[low]) / 0.12)
    if garment.leg:
        for part, side in ((cloth.left_leg, "L"), (cloth.right_leg, "R")):
            # Away from a broken line down the leg.
            (thigh, knee), (_, ankle) = (cloth.sections[side, bone] for bone in (0, 1))
            at = (SECTIONS[0][0], SECTIONS[0][1], SECTIONS[1][1])
            line = [points[ids, :2].mean(0) for ids in (thigh, knee, ankle)]
            along = cloth.along[part]
            radius = np.hypot(*(points[part, k] - np.interp(along, at, [p[k] for p in line]) for k in (0, 1)))
            fall(part, along * np.float32(-LEG_M), radius, decay)
    return np.minimum(air * np.float32(0.3 + 0.7 * garment.sag), np.float32(MOST_AIR_M))


def _folds(
    cloth: ClothMap, garment: Garment, level: Float[ndarray, "n"], rng: np.random.Generator
) -> Float[ndarray, "n"]:
    """Signed height of folds (metres): slanting rings along limbs and trunk, and drapes that widen to the hem."""
    wander, *patches = rng.choice(len(cloth.coarse), 3, replace=False)
    waves = [
        (2 * np.pi / rng.uniform(0.07, 0.15), 2 * np.pi / rng.uniform(0.11, 0.25), turns, rng.uniform(0, 2 * np.pi))
        for turns in rng.choice((-2, -1, 1, 2), 2)
    ]
    folds = np.zeros(len(level), np.float32)
    add_folds(
        level, cloth.metres, cloth.azimuth, cloth.slant, np.float32(1.8) * cloth.coarse[wander],
        cloth.coarse[patches], cloth.trunk.stop, np.array(waves, np.float32), folds,
    )  # fmt: skip
    # A skirt's folds are those of what hangs.
    folds *= min(garment.folds_m, 0.006) if garment.skirt_m else garment.folds_m
    if garment.top is None:
        trunk = cloth.trunk
        phase = rng.integers(4, 10) * cloth.azimuth[trunk] + cloth.coarse[wander, trunk] + rng.uniform(0, 2 * np.pi)
        low = 1 - (cloth.height[trunk] - garment.hem) / 0.35
        # The chest holds cloth taut; it gathers below.
        folds[trunk] *= 0.35 + 0.65 * _smooth((0.55 - cloth.height[trunk]) / 0.3)
        folds[trunk] += 0.4 * garment.slack_m * np.cos(phase) * _smooth(low)
    # Limbs fold at elbows and knees, and long trousers over the foot.
    for part in (cloth.arm, cloth.leg):
        along = cloth.along[part]
        folds[part] *= 0.5 + 0.6 * np.exp(-(((along - 1) / 0.3) ** 2)) + 1.2 * _smooth((along - 1.6) / 0.4)
    return folds


def _cut(
    cloth: ClothMap,
    level: Float[ndarray, "n"],
    fields: tuple[Float[ndarray, "n"], ...],
    anchors: Anchors | None,
    hidden: Bool[ndarray, "n"] | None = None,
) -> Shell:
    """The shell where ``level`` is above 0, its vertices outside drawn to the edge, without faces that are hidden.
    Fields are (thickness, slack, fold)."""
    if hidden is None:
        hidden = np.zeros(len(level), bool)
    vertices, faces, partner, mix = cut_mesh(level, hidden, cloth.faces, cloth.starts, cloth.neighbours)
    if anchors is not None:
        vertices = np.concatenate([vertices, anchors.first])
        partner = np.concatenate([partner, anchors.second])
        mix = np.concatenate([mix, anchors.share])
    values = [interpolate_cut(field, vertices, partner, mix) for field in fields]
    return Shell(vertices, partner, mix, values[0], values[1], values[2], faces, len(anchors.first) if anchors else 0)


def garment_shell(
    rest: RestCloth,
    garment: Garment,
    level: Float[ndarray, "n"],
    under: Float[ndarray, "n"],
    over: Float[ndarray, "n"] | None,
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
    # Thick or loose cloth does not show what is small beneath it.
    stiff = np.float32(min((garment.thickness_m + 0.4 * garment.slack_m) / 0.015, 1.0))
    own = garment.thickness_m * _padding(cloth, garment, level, rng) if garment.padded else garment.thickness_m
    own = np.float32(own)
    thickness = under + np.maximum(own + stiff * rest.span, np.float32(0.4) * own)
    if garment.hood_m:
        thickness = thickness + _hood(cloth, garment, level)
    # Slack beneath is not added: the outer garment presses on it, or has room for it.
    air = np.maximum(air - 0.5 * under, 0)
    folds = _folds(cloth, garment, level, rng)
    hidden = None
    if over is not None:
        free = 1 - 0.8 * _smooth(over / 0.04 + 0.5)
        air, folds, hidden = air * free, folds * free, over > 0.05
    anchors = cloth.skirt if garment.hangs_m else None
    shell = _cut(cloth, level, (thickness, air, folds), anchors, hidden)
    worn = np.where(level > 0, thickness + 0.4 * air, under).astype(np.float32)
    return shell, worn


def _padding(
    cloth: ClothMap, garment: Garment, level: Float[ndarray, "n"], rng: np.random.Generator
) -> Float[ndarray, "n"]:
    """Share of a padded garment's thickness: uneven, less at seams across it and where an elastic gathers it."""
    uneven, wander = rng.choice(len(cloth.coarse), 2, replace=False)
    share = 1 + np.float32(0.2) * cloth.coarse[uneven]
    if garment.quilt_m:
        rows = cloth.metres / np.float32(garment.quilt_m) + np.float32(0.12) * cloth.coarse[wander] + rng.uniform()
        from_seam = 1 - np.abs(2 * (rows - np.floor(rows)) - 1)
        share *= 1 - np.float32(rng.uniform(0.25, 0.6)) * (1 - from_seam) ** 2
    # Sleeves are thinner; shoulders and neck carry the rest.
    share[cloth.arm] *= 0.8
    trunk = cloth.trunk
    near_edge = 1 - _smooth(level / 0.05)
    if garment.hangs_m:
        near_edge[trunk] = 0
    share *= 1 - np.float32(0.65 * garment.cuff) * near_edge
    share[trunk] *= 1 - 0.6 * _smooth((cloth.neck[trunk] + 0.1) / 0.08)
    return np.maximum(share, np.float32(0.15))


def _hood(cloth: ClothMap, garment: Garment, level: Float[ndarray, "n"]) -> Float[ndarray, "n"]:
    """A hood's or collar's bulge at the neckline: thickest behind."""
    out = np.zeros_like(level)
    trunk = cloth.trunk
    lump = np.exp(-(((level[trunk] - 0.03) / 0.045) ** 2)) * (cloth.neck[trunk] > garment.neck - 0.13)
    out[trunk] = garment.hood_m * lump * (0.55 + 0.45 * np.cos(cloth.azimuth[trunk]))
    return out


def hair_cap(rest: RestCloth, hair: Hair, rng: np.random.Generator) -> Shell:
    """Hair over the scalp."""
    cloth = rest.cloth
    # Where the forehead ends differs from head to head.
    forehead = rng.uniform(0.0, 0.09)
    head = cloth.head
    back = cloth.default[head, 1] - (cloth.default[head, 1].min() + forehead)
    high = cloth.height[head] - cloth.height[head].min()
    level, thickness = np.full(len(cloth.vertices), _OFF, np.float32), np.zeros(len(cloth.vertices), np.float32)
    level[head] = np.minimum(cloth.scalp[head] * 0.06 - 0.02, back + np.clip(high - 0.1, 0, 1))
    rim = 0.35 + 0.65 * _smooth(level[head] / 0.03)
    lumps = 1 + 0.4 * hair.lumps * cloth.fine[rng.integers(len(cloth.fine)), head]
    # Hair stands off the crown more than off the nape.
    crown = 0.6 + 0.4 * _smooth((high - 0.02) / 0.12)
    thickness[head] = np.maximum(hair.volume_m * rim * lumps * crown, 0.003) * max(rest.scale, 0.8)
    none = np.zeros_like(thickness)
    return _cut(cloth, level, (thickness, none, none), cloth.hair if hair.style in ("bob", "long") else None)


def boot_shell(rest: RestCloth, shoes: Shoes, under: Float[ndarray, "n"]) -> tuple[Shell, Float[ndarray, "n"]]:
    """The shafts of boots, and how far all that is worn now stands off the skin."""
    cloth = rest.cloth
    level = np.full(len(cloth.vertices), _OFF, np.float32)
    level[cloth.leg] = (cloth.along[cloth.leg] - shoes.shaft) * LEG_M
    thickness = (shoes.upper_m + 0.004 + under).astype(np.float32)
    none = np.zeros_like(thickness)
    shell = _cut(cloth, level, (thickness, none, none), None)
    return shell, np.where(level > 0, thickness, under).astype(np.float32)
