"""Dressed bodies: meshes of garments, hair and shoes over the skin, posed with the skeleton.

dressed = clothe(body, random_clothes(rng), rng)
person = dressed.pose(posture)      # the skin with its labels, and the layers over it
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from depthmocap.synth.body.mesh import Body, BodyModel, BoneTransforms, Phenotype
from depthmocap.synth.people.headwear import (
    SkinnedMesh,
    collar_mesh,
    hat_mesh,
    lowered_hood_mesh,
    raised_hood_mesh,
    scarf_mesh,
)
from depthmocap.synth.people.sheet import (
    Sheet,
    grid_faces,
    hair_sheet,
    leg_capsules,
    scarf_end,
    skirt_sheet,
    tail_sheet,
)
from depthmocap.synth.people.shell import (
    PosedCloth,
    RestCloth,
    Shell,
    boot_shell,
    garment_level,
    garment_shell,
    hair_cap,
)
from depthmocap.synth.people.wardrobe import Clothes, Garment, Hair, Shoes
from depthmocap.synth.render import Layer, Material, PosedPerson

#: Number of points around a shoe and a bun.
_RING_POINTS = 14
#: Cross-sections of a shoe: positions as shares of the foot's length from the heel.
_STATIONS = np.array([-0.03, -0.02, 0.02, 0.1, 0.2, 0.32, 0.45, 0.58, 0.7, 0.82, 0.92, 1.0, 1.04, 1.06])
#: Girth of a shoe at these stations as a share of the foot's.
_GIRTHS = np.array([0.0, 0.6, 0.9, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.85, 0.55, 0.0])
#: Trousers with less slack than this are tucked into boots (metres).
_TIGHT_M = 0.015
#: Height of a shoe's opening above the floor on the default body (metres).
_OPENING_M = 0.085


@dataclasses.dataclass(frozen=True, eq=False)
class RigidMesh:
    """A mesh that moves with one bone; its vertices are in the rest pose, metres."""

    rest: Float[ndarray, "v 3"]
    faces: Int[ndarray, "f 3"]
    bone: int

    def pose(self, transforms: BoneTransforms) -> Float[ndarray, "v 3"]:
        """Vertices in a posture."""
        return self.rest @ transforms.rotations[self.bone].T + transforms.offsets[self.bone]


@dataclasses.dataclass(frozen=True, eq=False)
class Piece:
    """One piece of clothing or hair: a shell over the skin, a sheet that hangs from the shell or from bones, or a mesh
    bound to bones."""

    material: Material
    shell: Shell | None = None
    sheet: Sheet | None = None
    mesh: RigidMesh | SkinnedMesh | None = None

    def pose(self, cloth: PosedCloth, transforms: BoneTransforms, floor: float) -> Layer:
        """The piece in a posture."""
        vertices, faces = [], []
        anchors = None
        if self.shell is not None:
            points = self.shell.pose(cloth)
            vertices.append(points)
            faces.append(self.shell.faces)
            if self.sheet is not None:
                anchors = points[len(points) - self.shell.anchors :]
        if self.sheet is not None:
            faces.append(self.sheet.faces + sum(map(len, vertices)))
            vertices.append(self.sheet.pose(transforms, anchors, floor))
        if self.mesh is not None:
            faces.append(self.mesh.faces + sum(map(len, vertices)))
            vertices.append(self.mesh.pose(transforms))
        if len(vertices) == 1:
            return Layer(vertices[0], faces[0], self.material)
        return Layer(np.concatenate(vertices), np.concatenate(faces), self.material)


@dataclasses.dataclass(frozen=True, eq=False)
class DressedBody:
    """A body and its clothes, from the inside out, bound to its skeleton."""

    body: Body
    clothes: Clothes
    rest: RestCloth
    pieces: tuple[Piece, ...]

    def pose(self, posture: Float[ndarray, "20 3"]) -> PosedPerson:
        """The person in a posture (see ``body.posture``). The skin is that of ``body.pose``."""
        return self.pose_with(self.body.bone_transforms(posture))

    def pose_with(self, transforms: BoneTransforms) -> PosedPerson:
        """The person in a posture, from the transforms of the body's bones."""
        posed = self.body.pose_with(transforms)
        if not self.pieces:
            return PosedPerson(posed)
        cloth = PosedCloth.of(self.rest, transforms)
        floor = float(posed.vertices[:, 2].min())
        return PosedPerson(posed, tuple(piece.pose(cloth, transforms, floor) for piece in self.pieces))


def clothe(body: Body, clothes: Clothes, rng: np.random.Generator) -> DressedBody:
    """Dress a body; ``rng`` draws folds, lumps and hems. The labels stay those of the skin."""
    rest = RestCloth.of(body)
    pieces = []
    offsets_m = np.zeros(len(rest.points), np.float32)
    # Wide trousers fall over boots; tight ones are tucked into them.
    boots = clothes.shoes.style == "boots"
    over_trousers = boots and all(garment.slack_m < _TIGHT_M for garment in clothes.garments if garment.leg)
    if boots and not over_trousers:
        shaft, offsets_m = boot_shell(rest, clothes.shoes, offsets_m)
        pieces.append(Piece(Material.SHOE, shaft))
    legs = leg_capsules(rest, body)
    levels = [garment_level(rest.cloth, garment) for garment in clothes.garments]
    for i, garment in enumerate(clothes.garments):
        outer_level = np.max(levels[i + 1 :], axis=0) if i + 1 < len(levels) else None
        shell, outer_offsets_m = garment_shell(rest, garment, levels[i], offsets_m, outer_level, rng)
        sheet = None
        if garment.hangs_m:
            leg_offset_m = float(offsets_m[rest.cloth.sections["L", 0][1]].mean())
            sheet = skirt_sheet(rest, body, legs, garment, shell.anchor_offsets_m, leg_offset_m, rng)
        offsets_m = outer_offsets_m
        if len(shell.faces) or sheet is not None:  # not entirely covered by another garment
            pieces.append(Piece(cloth_material(garment), shell, sheet))
        pieces.extend(_neckwear(rest, body, garment, clothes.hair, offsets_m, rng))
    if over_trousers:
        pieces.append(Piece(Material.SHOE, boot_shell(rest, clothes.shoes, offsets_m)[0]))
    if clothes.shoes.style != "bare":
        pieces.extend(Piece(Material.SHOE, mesh=_shoe(body, clothes.shoes, side)) for side in "LR")
    pieces.extend(_hair(rest, body, clothes.hair, rng))
    pieces.extend(_accessories(rest, body, clothes, offsets_m, rng))
    return DressedBody(body, clothes, rest, tuple(pieces))


def cloth_material(garment: Garment) -> Material:
    """The material of a garment, which decides how much light it returns to a sensor."""
    return Material.DARK_CLOTH if garment.dark else Material.CLOTH


def _neckwear(
    rest: RestCloth, body: Body, garment: Garment, hair: Hair, offsets_m: Float[ndarray, "n"], rng: np.random.Generator
) -> list[Piece]:
    """The standing collar and the hood of a garment."""
    parts = []
    if garment.collar_m:
        parts.append(collar_mesh(rest, body, garment, offsets_m, rng))
    if garment.hood == "down":
        parts.append(lowered_hood_mesh(rest, body, garment, offsets_m, rng))
    if garment.hood == "up":
        parts.append(raised_hood_mesh(rest, body, garment, hair.volume_m, offsets_m, rng))
    return [Piece(cloth_material(garment), mesh=part) for part in parts]


def _accessories(
    rest: RestCloth, body: Body, clothes: Clothes, offsets_m: Float[ndarray, "n"], rng: np.random.Generator
) -> list[Piece]:
    """Scarf and hat."""
    pieces = []
    if clothes.scarf is not None:
        pieces.append(Piece(Material.CLOTH, mesh=scarf_mesh(rest, body, clothes.scarf, offsets_m, rng)))
        chest_offset_m = float(offsets_m[rest.cloth.chest].mean())
        for side, length in zip((-1.0, 1.0), clothes.scarf.ends_m, strict=True):
            if length:
                pieces.append(Piece(Material.CLOTH, sheet=scarf_end(rest, body, side, length, chest_offset_m, rng)))
    if clothes.hat.style != "none":
        pieces.append(Piece(Material.CLOTH, mesh=hat_mesh(rest, body, clothes.hat, clothes.hair.volume_m, rng)))
    return pieces


def _hair(rest: RestCloth, body: Body, hair: Hair, rng: np.random.Generator) -> list[Piece]:
    if hair.style == "bald":
        return []
    cap = hair_cap(rest, hair, rng)
    if hair.style in ("bob", "long"):
        return [Piece(Material.HAIR, cap, hair_sheet(rest, body, hair, cap.anchor_offsets_m, rng))]
    pieces = [Piece(Material.HAIR, cap)]
    if hair.style == "ponytail":
        pieces.append(Piece(Material.HAIR, sheet=tail_sheet(rest, body, hair, rng)))
    if hair.style == "bun":
        pieces.append(Piece(Material.HAIR, mesh=_bun(rest, body, hair, rng)))
    return pieces


def _bun(rest: RestCloth, body: Body, hair: Hair, rng: np.random.Generator) -> RigidMesh:
    """A ball of hair, anywhere from the nape to the crown."""
    scalp = rest.points[rest.cloth.head]
    centre = (scalp.max(0) + scalp.min(0)) / 2
    tilt = rng.uniform(0.0, 1.4)
    skull = float(np.ptp(scalp[:, 1])) / 2
    radius = (0.03 + 0.6 * hair.volume_m) * max(rest.scale, 0.8)
    position = centre + (skull + 0.5 * radius) * np.array([0, np.cos(tilt), np.sin(tilt)])
    polar = np.linspace(0, np.pi, 9)[:, None]
    around = np.linspace(0, 2 * np.pi, _RING_POINTS, endpoint=False)
    ball = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar) + 0 * around], -1)
    points = (position + radius * ball.reshape(-1, 3)).astype(np.float32)
    return RigidMesh(points, grid_faces(9, _RING_POINTS, True), body.model.bone_names.index("head"))


@functools.cache
def _foot_stations(model: BodyModel, side: str) -> tuple[Int[ndarray, "n"], Int[ndarray, "s"], int, int]:
    """Vertices of a foot sorted by station, the first index of every station, and the vertices of heel and toe."""
    body = model.shape(Phenotype())
    names = np.array(model.bone_names)[model.skin_indices[:, 0]]
    foot = np.array([name.startswith(("foot", "toe")) and name.endswith(side) for name in names])
    points = body.rest_vertices.astype(np.float64)
    foot &= points[:, 2] < points[:, 2].min() + _OPENING_M
    heel = int(np.argmax(np.where(foot, points[:, 1], -np.inf)))
    toe = int(np.argmin(np.where(foot, points[:, 1], np.inf)))
    forward = points[toe, :2] - points[heel, :2]
    share = (points[:, :2] - points[heel, :2]) @ forward / (forward @ forward)
    near = [np.flatnonzero(foot & (np.abs(share - np.clip(station, 0.05, 0.95)) < 0.07)) for station in _STATIONS]
    return np.concatenate(near), np.cumsum([0, *map(len, near[:-1])]), heel, toe


def _shoe(body: Body, shoes: Shoes, side: str) -> RigidMesh:
    """A shoe lofted through rings along the foot, measured on its skin, with a flat sole and one toe cap."""
    vertices, starts, heel, toe = _foot_stations(body.model, side)
    points = body.rest_vertices[vertices].astype(np.float64)
    back, front = (body.rest_vertices[end, :2].astype(np.float64) for end in (heel, toe))
    length = float(np.linalg.norm(front - back))
    forward = (front - back) / length
    across = np.array([-forward[1], forward[0]])
    aside = (points[:, :2] - back) @ across
    low, high = np.minimum.reduceat(aside, starts), np.maximum.reduceat(aside, starts)
    top = np.maximum.reduceat(points[:, 2], starts) + shoes.upper_m
    bottom = float(points[:, 2].min()) - shoes.sole_m
    around = np.linspace(0, 2 * np.pi, _RING_POINTS, endpoint=False)
    # Cross-sections between a box and an ellipse (a superellipse).
    x, z = (np.sign(c) * np.abs(c) ** 0.6 for c in (np.cos(around), np.sin(around)))
    sideways = ((low + high) / 2)[:, None] + (((high - low) / 2 + shoes.upper_m) * _GIRTHS)[:, None] * x
    plane = back + (_STATIONS * length)[:, None, None] * forward + sideways[..., None] * across
    upwards = bottom + ((top - bottom) / 2 * _GIRTHS)[:, None] * (1 + z)
    mesh = np.concatenate([plane, upwards[..., None]], 2).reshape(-1, 3).astype(np.float32)
    return RigidMesh(mesh, grid_faces(len(_STATIONS), _RING_POINTS, True), body.model.bone_names.index(f"foot.{side}"))
