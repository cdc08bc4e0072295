"""Shells: clothes and hair that follow the skin, with air beneath, folds, and edges along the cut of the garment."""

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
#: Overlap of a shell and the skirt that hangs from it (metres).
OVERLAP_M = 0.015
#: Largest distance that falling cloth keeps from the skin (metres).
MOST_AIR_M = 0.11
#: Height above the crotch (metres) from which tops rest on the body.
_CARRIED_M = 0.63
#: Level of vertices that a garment does not reach (metres).
_OUTSIDE = np.float32(-1.0)


@dataclasses.dataclass(frozen=True, eq=False)
class RestCloth:
    """The skin that clothes cover, in the rest pose.

    Attributes:
        normals: of a taut cloth over the skin (``kernels.garment.smooth_cloth``).
        lengths: of the edges, metres.
        span: distance of that cloth from the skin, metres; negative at bumps, which it would cut off.
        centre_y: of the line that skirts hang from, metres.
        scale: stature as a share of the default body's.
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
        taut = smooth_cloth(points, cloth.starts, cloth.neighbours, cloth.trunk.stop, 14)
        # Cloth is offset along its own normals, because the skin's normals cross in hollows.
        normals = np.empty_like(points)
        vertex_normals(taut, cloth.faces, normals)
        span = ((taut - points) * normals).sum(1)
        lengths = edge_lengths(points, cloth.starts, cloth.neighbours)
        scale = float(np.ptp(body.rest_vertices[:, 2])) / cloth.stature
        line = cloth.skirt
        centre_y = float((points[line.first, 1].max() + points[line.first, 1].min()) / 2)
        return cls(cloth, points, normals, lengths, span, centre_y, scale)


@dataclasses.dataclass(frozen=True, eq=False)
class PosedCloth:
    """The skin that clothes cover, posed: points, unit normals and compression (0–1)."""

    points: Float[ndarray, "n 3"]
    normals: Float[ndarray, "n 3"]
    compression: Float[ndarray, "n"]

    @classmethod
    def of(cls, rest: RestCloth, transforms: BoneTransforms) -> PosedCloth:
        """The rest skin moved by a posture."""
        cloth = rest.cloth
        points, normals = np.empty_like(rest.points), np.empty_like(rest.points)
        skin_with_normals(
            rest.points, rest.normals, cloth.skin_indices, cloth.skin_weights,
            transforms.rotations, transforms.offsets, points, normals,
        )  # fmt: skip
        compression = np.empty(len(points), np.float32)
        edge_compression(points, cloth.starts, cloth.neighbours, rest.lengths, compression)
        return cls(points, normals, compression)


@dataclasses.dataclass(frozen=True, eq=False)
class Shell:
    """A part of the skin, offset outwards (``kernels.garment.offset_shell``).

    Attributes:
        vertices, partner, mix: every vertex is ``(1 − mix) · vertex + mix · partner`` of the skin.
        thickness, slack, fold: cloth and inner clothes, air beneath, and height of folds, metres.
        anchors: number of vertices at the end that carry a sheet and have no faces.
    """

    vertices: Int[ndarray, "m"]
    partner: Int[ndarray, "m"]
    mix: Float[ndarray, "m"]
    thickness: Float[ndarray, "m"]
    slack: Float[ndarray, "m"]
    fold: Float[ndarray, "m"]
    faces: Int[ndarray, "g 3"]
    anchors: int

    @property
    def anchor_offsets_m(self) -> Float[ndarray, "c"]:
        """Distance from the skin (metres) of the vertices that carry a sheet."""
        return (self.thickness + self.slack)[len(self.vertices) - self.anchors :]

    def pose(self, posed: PosedCloth) -> Float[ndarray, "m 3"]:
        """Vertices over the posed skin."""
        out = np.empty((len(self.vertices), 3), np.float32)
        offset_shell(
            posed.points, posed.normals, posed.compression, self.vertices, self.partner, self.mix,
            self.thickness, self.slack, self.fold, np.float32(CREASE), out,
        )  # fmt: skip
        return out


def smoothstep(x: Float[ndarray, "*n"]) -> Float[ndarray, "*n"]:
    """0 up to 0, 1 from 1 on, a cubic between."""
    x = np.clip(x, 0, 1)
    return x * x * (3 - 2 * x)


def garment_level(cloth: ClothMap, garment: Garment) -> Float[ndarray, "n"]:
    """Signed distance to the garment's edges (metres): positive inside."""
    level = np.full(len(cloth.vertices), _OUTSIDE, np.float32)
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
            level[arm][cloth.slant[arm] != garment.one_shoulder] = _OUTSIDE
    else:
        level[trunk] = np.minimum(inside, (0.3 - cloth.armness[trunk]) * 0.2)
    return level


def _shape(cloth: ClothMap, garment: Garment, level: Float[ndarray, "n"]) -> Float[ndarray, "n"]:
    """Share of the slack: from 0 where a garment rests on the body (shoulders, waistband) to 1 where it is loosest."""
    shape = np.zeros(len(level), np.float32)
    trunk, arm, leg = cloth.trunk, cloth.arm, cloth.leg
    if garment.top is None:
        shape[trunk] = 0.1 + 0.9 * smoothstep((0.62 - cloth.height[trunk]) / 0.4)
        # A short sleeve is widest at its opening, a long one at the elbow.
        along, sleeve = cloth.along[arm], garment.sleeve
        widening = along / max(sleeve, 0.1) if sleeve < 1.3 else np.sin(np.pi / 2.4 * along)
        shape[arm] = 0.3 + 0.45 * np.clip(widening, 0, 1)
    else:
        shape[trunk] = 0.4 * smoothstep((garment.top - cloth.height[trunk]) / 0.28)
        shape[leg] = 0.4 + 0.6 * smoothstep(cloth.along[leg] / max(garment.leg, 0.5))
    if garment.cuff:
        near = smoothstep(level / 0.06)
        bulge = np.exp(-(((level - 0.09) / 0.05) ** 2))
        if garment.padded and garment.hangs_m:  # an elastic gathers an edge, not the line that a skirt hangs from
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
    from_spine = points[low, :2] - np.array([0, rest.centre_y], np.float32)
    radius = np.hypot(from_spine[:, 0], from_spine[:, 1])
    fall(low, points[low, 2], radius * (free > 0), decay if garment.top is None else 3.0)
    # No cloth lies over skin that faces inwards or down, between the legs.
    facing = np.clip((from_spine * rest.normals[low, :2]).sum(1) / radius, 0, 1)
    air[low] *= free * facing**2 * smoothstep((_CARRIED_M - cloth.height[low]) / 0.12)
    if garment.leg:
        for part, side in ((cloth.left_leg, "L"), (cloth.right_leg, "R")):
            # Radius about a polyline down the leg.
            (thigh, knee), (_, ankle) = (cloth.sections[side, bone] for bone in (0, 1))
            knots = (SECTIONS[0][0], SECTIONS[0][1], SECTIONS[1][1])
            line = [points[indices, :2].mean(0) for indices in (thigh, knee, ankle)]
            along = cloth.along[part]
            radius = np.hypot(*(points[part, k] - np.interp(along, knots, [p[k] for p in line]) for k in (0, 1)))
            fall(part, along * np.float32(-LEG_M), radius, decay)
    return np.minimum(air * np.float32(0.3 + 0.7 * garment.sag), np.float32(MOST_AIR_M))


def _folds(
    cloth: ClothMap, garment: Garment, level: Float[ndarray, "n"], rng: np.random.Generator
) -> Float[ndarray, "n"]:
    """Signed height of folds (metres): slanting rings along limbs and trunk, drapes that widen towards the hem."""
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
    # The folds of a skirt are part of its sheet.
    folds *= min(garment.folds_m, 0.006) if garment.skirt_m else garment.folds_m
    if garment.top is None:
        trunk = cloth.trunk
        phase = rng.integers(4, 10) * cloth.azimuth[trunk] + cloth.coarse[wander, trunk] + rng.uniform(0, 2 * np.pi)
        low = 1 - (cloth.height[trunk] - garment.hem) / 0.35
        # Cloth is taut over the chest and gathers below.
        folds[trunk] *= 0.35 + 0.65 * smoothstep((0.55 - cloth.height[trunk]) / 0.3)
        folds[trunk] += 0.4 * garment.slack_m * np.cos(phase) * smoothstep(low)
    # Folds concentrate at elbows and knees, and where long trousers meet the foot.
    for part in (cloth.arm, cloth.leg):
        along = cloth.along[part]
        folds[part] *= 0.5 + 0.6 * np.exp(-(((along - 1) / 0.3) ** 2)) + 1.2 * smoothstep((along - 1.6) / 0.4)
    return folds


def _cut_shell(
    cloth: ClothMap,
    level: Float[ndarray, "n"],
    fields: tuple[Float[ndarray, "n"], ...],
    anchors: Anchors | None,
    hidden: Bool[ndarray, "n"] | None = None,
) -> Shell:
    """The shell where ``level`` is positive. Vertices outside move to the edge; hidden faces are left out.

    Args:
        fields: thickness, slack and fold of the skin's vertices, metres.
    """
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
    inner_offsets_m: Float[ndarray, "n"],
    outer_level: Float[ndarray, "n"] | None,
    rng: np.random.Generator,
) -> tuple[Shell, Float[ndarray, "n"]]:
    """The part of a garment that follows the body, and the distance of the outermost clothes from the skin (metres).

    Args:
        level: of the garment (:func:`garment_level`).
        inner_offsets_m: distance of the clothes beneath from the skin.
        outer_level: level of the garments above. They press on this garment and hide it except for a rim.
    """
    cloth = rest.cloth
    air = _air(rest, garment) + garment.slack_m * rest.scale * _shape(cloth, garment, level)
    # Thick or loose cloth does not show small bumps beneath it.
    stiffness = np.float32(min((garment.thickness_m + 0.4 * garment.slack_m) / 0.015, 1.0))
    cloth_m = garment.thickness_m * _padding(cloth, garment, level, rng) if garment.padded else garment.thickness_m
    cloth_m = np.float32(cloth_m)
    thickness = inner_offsets_m + np.maximum(cloth_m + stiffness * rest.span, np.float32(0.4) * cloth_m)
    if garment.hood_m:
        thickness = thickness + _hood(cloth, garment, level)
    # The slack of inner clothes is not added: the outer garment presses on it, or has room for it.
    air = np.maximum(air - 0.5 * inner_offsets_m, 0)
    folds = _folds(cloth, garment, level, rng)
    hidden = None
    if outer_level is not None:
        free = 1 - 0.8 * smoothstep(outer_level / 0.04 + 0.5)
        air, folds, hidden = air * free, folds * free, outer_level > 0.05
    anchors = cloth.skirt if garment.hangs_m else None
    shell = _cut_shell(cloth, level, (thickness, air, folds), anchors, hidden)
    offsets_m = np.where(level > 0, thickness + 0.4 * air, inner_offsets_m).astype(np.float32)
    return shell, offsets_m


def _padding(
    cloth: ClothMap, garment: Garment, level: Float[ndarray, "n"], rng: np.random.Generator
) -> Float[ndarray, "n"]:
    """Thickness of padding as a share of the garment's: uneven, thinner at quilting seams and elastics."""
    uneven, wander = rng.choice(len(cloth.coarse), 2, replace=False)
    share = 1 + np.float32(0.2) * cloth.coarse[uneven]
    if garment.quilt_m:
        rows = cloth.metres / np.float32(garment.quilt_m) + np.float32(0.12) * cloth.coarse[wander] + rng.uniform()
        from_seam = 1 - np.abs(2 * (rows - np.floor(rows)) - 1)
        share *= 1 - np.float32(rng.uniform(0.25, 0.6)) * (1 - from_seam) ** 2
    # Padding is thinner on sleeves, shoulders and neck.
    share[cloth.arm] *= 0.8
    trunk = cloth.trunk
    near_edge = 1 - smoothstep(level / 0.05)
    if garment.hangs_m:
        near_edge[trunk] = 0
    share *= 1 - np.float32(0.65 * garment.cuff) * near_edge
    share[trunk] *= 1 - 0.6 * smoothstep((cloth.neck[trunk] + 0.1) / 0.08)
    return np.maximum(share, np.float32(0.15))


def _hood(cloth: ClothMap, garment: Garment, level: Float[ndarray, "n"]) -> Float[ndarray, "n"]:
    """Bulge of a hood or collar at the neckline (metres), thickest behind."""
    out = np.zeros_like(level)
    trunk = cloth.trunk
    lump = np.exp(-(((level[trunk] - 0.03) / 0.045) ** 2)) * (cloth.neck[trunk] > garment.neck - 0.13)
    out[trunk] = garment.hood_m * lump * (0.55 + 0.45 * np.cos(cloth.azimuth[trunk]))
    return out


def hair_cap(rest: RestCloth, hair: Hair, rng: np.random.Generator) -> Shell:
    """Hair over the scalp."""
    cloth = rest.cloth
    # The hairline differs between people.
    forehead = rng.uniform(0.0, 0.09)
    head = cloth.head
    back = cloth.default[head, 1] - (cloth.default[head, 1].min() + forehead)
    high = cloth.height[head] - cloth.height[head].min()
    level, thickness = np.full(len(cloth.vertices), _OUTSIDE, np.float32), np.zeros(len(cloth.vertices), np.float32)
    level[head] = np.minimum(cloth.scalp[head] * 0.06 - 0.02, back + np.clip(high - 0.1, 0, 1))
    rim = 0.35 + 0.65 * smoothstep(level[head] / 0.03)
    lumps = 1 + 0.4 * hair.lumps * cloth.fine[rng.integers(len(cloth.fine)), head]
    # Hair is thicker at the crown than at the nape.
    crown = 0.6 + 0.4 * smoothstep((high - 0.02) / 0.12)
    thickness[head] = np.maximum(hair.volume_m * rim * lumps * crown, 0.003) * max(rest.scale, 0.8)
    zeros = np.zeros_like(thickness)
    return _cut_shell(cloth, level, (thickness, zeros, zeros), cloth.hair if hair.style in ("bob", "long") else None)


def boot_shell(
    rest: RestCloth, shoes: Shoes, inner_offsets_m: Float[ndarray, "n"]
) -> tuple[Shell, Float[ndarray, "n"]]:
    """The shafts of boots, and the distance of the outermost clothes from the skin (metres)."""
    cloth = rest.cloth
    level = np.full(len(cloth.vertices), _OUTSIDE, np.float32)
    level[cloth.leg] = (cloth.along[cloth.leg] - shoes.shaft) * LEG_M
    thickness = (shoes.upper_m + 0.004 + inner_offsets_m).astype(np.float32)
    zeros = np.zeros_like(thickness)
    shell = _cut_shell(cloth, level, (thickness, zeros, zeros), None)
    return shell, np.where(level > 0, thickness, inner_offsets_m).astype(np.float32)
