"""Collars, scarves, hoods and hats: meshes around neck and head that do not follow the skin."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from depthmocap.synth.body.mesh import Body, BoneTransforms
from depthmocap.synth.people.sheet import grid_faces
from depthmocap.synth.people.shell import RestCloth, smoothstep
from depthmocap.synth.people.wardrobe import Garment, Hat, Scarf

#: Number of columns around the neck and around the opening of a hood.
_COLUMNS = 28
#: Range of ``ClothMap.neck`` (metres) in which the neck's width is measured.
_NECK_M = (0.01, 0.05)
#: Range of ``ClothMap.neck`` (metres) in which the thickness of the clothes at the neck is measured.
_ROOT_M = (-0.04, 0.01)
#: Slope of the root of the neck, which is lower in front (metres a metre).
_SLOPE = 0.55


@dataclasses.dataclass(frozen=True, eq=False)
class SkinnedMesh:
    """A mesh bound to a few bones: vertices in the rest pose (metres), indices of bones and skinning weights."""

    rest: Float[ndarray, "v 3"]
    faces: Int[ndarray, "f 3"]
    indices: Int[ndarray, "v k"]
    weights: Float[ndarray, "v k"]

    def pose(self, transforms: BoneTransforms) -> Float[ndarray, "v 3"]:
        """Vertices in a posture."""
        return transforms.skin(self.rest, self.indices, self.weights)


@dataclasses.dataclass(frozen=True)
class _Neck:
    """The root of a body's neck with the clothes on it (metres), and the body's scale."""

    centre: Float[ndarray, "3"]
    half_width: float
    half_depth: float
    scale: float

    @classmethod
    def of(cls, rest: RestCloth, body: Body, offsets_m: Float[ndarray, "n"]) -> _Neck:
        level = rest.cloth.neck[rest.cloth.trunk]
        skin = rest.points[: len(level)][(level > _NECK_M[0]) & (level < _NECK_M[1])]
        low, high = skin.min(0), skin.max(0)
        root = body.rest_heads[body.model.bone_names.index("neck01")]
        clothes_m = 0.5 * float(np.median(offsets_m[: len(level)][(level > _ROOT_M[0]) & (level < _ROOT_M[1])]))
        centre = np.array([0.0, (low[1] + high[1]) / 2, root[2]])
        return cls(centre, float(high[0]) + clothes_m, float(high[1] - low[1]) / 2 + clothes_m, rest.scale)

    def ring(
        self,
        azimuth: Float[ndarray, "c"],
        offset_m: Float[ndarray, "r c"],
        up_m: Float[ndarray, "r c"],
        slope: Float[ndarray, "r 1"] | float = _SLOPE,
    ) -> Float[ndarray, "r c 3"]:
        """Points around the neck, ``offset_m`` off it and ``up_m`` above its root."""
        x, back = (self.half_width + offset_m) * np.sin(azimuth), (self.half_depth + offset_m) * np.cos(azimuth)
        z = self.centre[2] + up_m + slope * back
        return np.stack([x + self.centre[0], back + self.centre[1], z], -1)


def _bind_grid(
    body: Body, points: Float[ndarray, "r c 3"], bones: dict[str, ndarray | float], closed: bool
) -> SkinnedMesh:
    """A mesh of a grid of points, bound to bones with weights that broadcast to the grid."""
    bone_weights = np.stack([np.broadcast_to(weight, points.shape[:2]).ravel() for weight in bones.values()], 1)
    bone_indices = np.array([body.model.bone_names.index(name) for name in bones], np.int32)
    order = np.argsort(-bone_weights, axis=1)
    weights = np.ascontiguousarray(np.take_along_axis(bone_weights, order, 1), np.float32)
    rest = np.ascontiguousarray(points.reshape(-1, 3), np.float32)
    rows, columns = points.shape[:2]
    return SkinnedMesh(rest, grid_faces(rows, columns, closed), np.ascontiguousarray(bone_indices[order]), weights)


def collar_mesh(
    rest: RestCloth, body: Body, garment: Garment, offsets_m: Float[ndarray, "n"], rng: np.random.Generator
) -> SkinnedMesh:
    """A standing collar. A high one reaches chin and ears; that of an open garment gapes in front.

    Args:
        offsets_m: distance of the outermost clothes from the skin (metres).
    """
    neck = _Neck.of(rest, body, offsets_m)
    half = np.pi - (rng.uniform(0.35, 1.0) if garment.open_m else 0.0)
    azimuth = np.linspace(-half, half, _COLUMNS, endpoint=half < np.pi)
    height = garment.collar_m * neck.scale * (1 + 0.15 * np.cos(azimuth))
    thick = np.clip(0.6 * garment.thickness_m, 0.006, 0.025)
    lean = rng.uniform(0.0, 0.25)  # outwards
    offset_m = rng.uniform(0.004, 0.02)
    share = np.array([-0.4, 0.0, 0.35, 0.7, 0.95, 1.0, 0.9, 0.4, 0.0])[:, None]
    wall = np.array([1.0, 1.0, 1.15, 1.1, 0.8, 0.3, 0.0, 0.0, 0.0])[:, None] * thick
    gape = rng.uniform(0, 0.03) * smoothstep(np.abs(azimuth) / half - 0.5) if garment.open_m else 0.0
    waves = 0.004 * np.cos(rng.integers(3, 7) * azimuth + rng.uniform(0, 6))
    up = share * height
    reach = offset_m + wall + lean * np.maximum(up, 0) + (gape + waves) * np.clip(share, 0, 1)
    points = neck.ring(azimuth, reach, up, _SLOPE - 0.3 * np.clip(share, 0, 1))
    head_share = 0.5 * np.clip(share, 0, 1)
    return _bind_grid(body, points, {"spine01": 1 - head_share, "neck02": head_share}, half == np.pi)


def lowered_hood_mesh(
    rest: RestCloth, body: Body, garment: Garment, offsets_m: Float[ndarray, "n"], rng: np.random.Generator
) -> SkinnedMesh:
    """A hood that is not pulled up: a thick roll around the neck from collarbone to collarbone, hanging on the back."""
    neck = _Neck.of(rest, body, offsets_m)
    half = rng.uniform(1.9, 2.7)
    azimuth = np.linspace(-half, half, _COLUMNS)
    behind = np.clip(np.cos(azimuth), 0, 1)
    # Thin at its ends in front, thick and drooping behind.
    size = garment.hood_m * neck.scale * (0.35 + 0.65 * smoothstep((half - np.abs(azimuth)) / 1.2))
    droop = rng.uniform(0.03, 0.17) * neck.scale * behind**1.5
    angle = np.linspace(0, 2 * np.pi, 11)[:, None]
    low = 0.5 - 0.5 * np.sin(angle)
    lumps = 1 + 0.15 * np.cos(rng.integers(3, 8) * azimuth + rng.uniform(0, 6))
    base = rng.uniform(0.0, 0.015)
    offset_m = base + size + size * lumps * np.cos(angle) + 0.25 * droop * low
    up = rng.uniform(0.0, 0.03) + 0.7 * size + rng.uniform(0.8, 1.3) * size * lumps * np.sin(angle) - droop * low
    return _bind_grid(body, neck.ring(azimuth, offset_m, up), {"spine01": 1.0}, False)


def raised_hood_mesh(
    rest: RestCloth,
    body: Body,
    garment: Garment,
    hair_m: float,
    offsets_m: Float[ndarray, "n"],
    rng: np.random.Generator,
) -> SkinnedMesh:
    """A hood pulled up: around head and neck at a distance of a few centimetres, open in front of the face.

    Args:
        hair_m: thickness of the hair beneath.
    """
    neck = _Neck.of(rest, body, offsets_m)
    scalp = rest.points[rest.cloth.head]
    low, high = scalp.min(0), scalp.max(0)
    eye = float(body.rest_heads[body.model.bone_names.index("eye.L")][2])
    pad = hair_m + (rng.uniform(0.008, 0.04) + 0.3 * garment.thickness_m) * max(neck.scale, 0.8)
    centre = np.array([0.0, (low[1] + high[1]) / 2, eye])
    half = (high - low) / 2 + pad
    above, below = float(high[2] - eye + pad), float(eye - neck.centre[2] + 0.05 * neck.scale)
    # Rows from the opening, a circle about the forward axis, to the back of the head.
    opening = rng.uniform(0.75, 1.25)
    polar = np.linspace(opening, np.pi, 15)[:, None]
    around = np.linspace(0, 2 * np.pi, _COLUMNS, endpoint=False)
    side, up = np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around)
    forward = np.broadcast_to(-np.cos(polar), side.shape)
    # Below, an ellipsoid would be too narrow for the shoulders; at the back of the crown the cloth is slack.
    bulge = 1 + rng.uniform(0, 0.22) * np.clip(0.7 * forward + 0.7 * up, 0, 1) ** 3
    bulge = bulge + 0.03 * np.cos(rng.integers(2, 5) * around + rng.uniform(0, 6)) * np.sin(2 * polar)
    bulge = bulge + 0.12 * np.clip(-up, 0, 1) * np.abs(side)
    z = np.where(up > 0, above, below) * up
    points = centre + np.stack([half[0] * side * bulge, half[1] * forward * bulge, z * np.where(up > 0, bulge, 1)], -1)
    # The rim reaches forward and narrows; it is as thick as the cloth, or thicker, of fur.
    rim = rng.uniform(0.0, 0.055) * neck.scale
    edge = rng.uniform(0.015, 0.03) if rng.random() < 0.25 else rng.uniform(0.003, 0.012)
    outwards = np.stack([np.cos(around), 0 * around, np.sin(around)], -1)
    turn = np.array([0.0, 0.8, 1.6, 2.4, 3.2])[::-1, None, None]
    tip = points[0] - np.array([0, rim, 0]) - rng.uniform(0, 0.35) * rim * outwards
    lip = tip + edge * (np.cos(turn) - 1) * outwards + edge * np.sin(turn) * np.array([0, -1.0, 0])
    points = np.concatenate([lip, points])
    head_share = smoothstep((points[..., 2] - neck.centre[2] - 0.02) / (0.1 * neck.scale))
    return _bind_grid(body, points, {"head": head_share, "spine01": 1 - head_share}, True)


def scarf_mesh(
    rest: RestCloth, body: Body, scarf: Scarf, offsets_m: Float[ndarray, "n"], rng: np.random.Generator
) -> SkinnedMesh:
    """A scarf wound around the neck; a thick one reaches the chin."""
    neck = _Neck.of(rest, body, offsets_m)
    azimuth = np.linspace(-np.pi, np.pi, _COLUMNS, endpoint=False)
    size = scarf.roll_m * neck.scale * (1 + 0.15 * np.cos(rng.integers(2, 6) * azimuth + rng.uniform(0, 6)))
    angle = np.linspace(0, 2 * np.pi, 11)[:, None]
    tall = rng.uniform(1.0, 1.6)
    offset_m = 0.7 * size + size * np.cos(angle)
    up = (0.8 * tall - 0.2) * size + tall * size * np.sin(angle)
    head_share = rng.uniform(0.1, 0.5)
    return _bind_grid(body, neck.ring(azimuth, offset_m, up), {"spine01": 1 - head_share, "neck02": head_share}, True)


def hat_mesh(rest: RestCloth, body: Body, hat: Hat, hair_m: float, rng: np.random.Generator) -> SkinnedMesh:
    """A beanie, a cap, a hat with a brim or a helmet.

    Args:
        hair_m: thickness of the hair beneath.
    """
    scalp = rest.points[rest.cloth.head]
    low, high = scalp.min(0), scalp.max(0)
    scale = max(rest.scale, 0.8)
    eye = float(body.rest_heads[body.model.bone_names.index("eye.L")][2])
    pad = hair_m + hat.thickness_m
    edge = eye + rng.uniform(0.025, 0.055) * scale
    half = (high - low) / 2 + pad
    above = float(high[2]) + pad - edge
    centre = np.array([0.0, (low[1] + high[1]) / 2, edge])
    # Enlarged until the whole skull is inside.
    skull = (scalp[scalp[:, 2] > edge] - centre) / (np.array([half[0], half[1], above]) - pad)
    growth = max(float(np.linalg.norm(skull, axis=1).max()), 1.0)
    half, above = half * growth, above * growth
    azimuth = np.linspace(-np.pi, np.pi, _COLUMNS, endpoint=False)
    polar = np.linspace(0.0, np.pi / 2, 9)[:, None]
    roundness = np.sin(polar) ** rng.uniform(0.75, 1.0)
    # The edge is lower behind than in front; helmets and some beanies cover the ears.
    behind = 0.5 + 0.5 * np.cos(azimuth)
    beside = np.sin(azimuth) ** 2
    ears = {"helmet": rng.uniform(0.01, 0.08), "beanie": rng.uniform(0.0, 0.06)}.get(hat.style, 0.0)
    nape = rng.uniform(0.04, 0.09) if hat.style == "beanie" else rng.uniform(0.02, 0.06)
    lower = (nape * behind + ears * np.maximum(beside, behind)) * scale * polar / (np.pi / 2)
    slack = rng.uniform(0, 0.35) if hat.style == "beanie" else 0.0
    bulge = 1 + slack * np.cos(polar) ** 2 * np.sin(polar) * behind
    radius = np.stack(
        [half[0] * roundness * np.sin(azimuth) * bulge, half[1] * roundness * np.cos(azimuth) * bulge], -1
    )
    z = edge + above * np.cos(polar) * (1 + 0.5 * slack * behind) - lower
    points = np.concatenate([radius + centre[:2], z[..., None]], -1)
    rim = _rim(points[-1], hat, azimuth, rng)
    return _bind_grid(body, np.concatenate([points, rim]), {"head": 1.0}, True)


def _rim(edge: Float[ndarray, "c 3"], hat: Hat, azimuth: Float[ndarray, "c"], rng: np.random.Generator) -> ndarray:
    """Rows of points beyond a hat's edge: a turned-up border, a visor in front, a brim, or a short inward row."""
    out = np.stack([np.sin(azimuth), np.cos(azimuth), 0 * azimuth], -1)
    up = np.array([0.0, 0, 1])
    if hat.style == "beanie":
        tall, thick = rng.uniform(0.03, 0.06), rng.uniform(0.004, 0.012)
        return np.stack([edge + thick * out, edge + thick * out + tall * up, edge - thick * out + tall * up])
    front = 0.5 - 0.5 * np.cos(azimuth)
    reach = hat.brim_m * (np.clip(front - 0.55, 0, None) / 0.45) ** 0.5 if hat.style == "cap" else hat.brim_m
    reach = np.broadcast_to(reach, azimuth.shape)[:, None]
    curl, tilt = rng.uniform(-0.3, 0.5), rng.uniform(-0.1, 0.3)
    sides = (curl * np.sin(azimuth) ** 2 - tilt * front)[:, None]
    rows = [edge + share * reach * (out + share * sides * up) for share in (0.33, 0.66, 1.0)]
    return np.stack(rows) if hat.brim_m else np.stack([edge - 0.01 * out])
