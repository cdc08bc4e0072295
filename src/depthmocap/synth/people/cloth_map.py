"""Coordinates of clothes on the body's mesh: along trunk, arms, legs and neck, the same for all shapes."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from depthmocap.body.regions import REGION_NAMES
from depthmocap.synth.body.mesh import Body, BodyModel, Phenotype
from depthmocap.synth.people.wardrobe import SKIRT_LINE_M

#: Number of columns of a skirt, evenly around the body from its back.
SKIRT_COLUMNS = 44
#: Number of columns of long hair.
HAIR_COLUMNS = 18
#: Height above the eyes of the line that long hair hangs from (metres).
HAIR_LINE_M = 0.015
#: Largest azimuth of long hair, measured from the back of the head (radians).
HAIR_SIDE_RAD = 1.9
#: Positions (``ClothMap.along``) at which thighs and shins are measured.
SECTIONS = ((0.3, 0.95), (1.2, 1.9))
#: Typical length of an upper arm or a forearm, one unit of ``ClothMap.along`` (metres).
ARM_M = 0.26
#: Typical length of a thigh or a shin, one unit of ``ClothMap.along`` (metres).
LEG_M = 0.46
#: Number of random fields of either kind.
_FIELDS = 24


@dataclasses.dataclass(frozen=True, eq=False)
class Anchors:
    """Points on edges of the cloth map's mesh, ``(1 − share) · first + share · second``, and their azimuths from the
    back (radians)."""

    first: Int[ndarray, "c"]
    second: Int[ndarray, "c"]
    share: Float[ndarray, "c"]
    azimuth: Float[ndarray, "c"]


@dataclasses.dataclass(frozen=True, eq=False)
class ClothMap:
    """The skin without hands, toes and face, with coordinates on the default body (metres) that hold for all bodies.

    Attributes:
        vertices: indices into the body's mesh; all other indices are into these.
        starts, neighbours: edges at each vertex, in CSR form.
        trunk, arm, left_leg, right_leg, leg, head: slices of the vertices; the trunk is first, sorted upwards.
        armness: skinning weight of the arm's bones.
        height: above the crotch.
        along: on arms 0 shoulder, 1 elbow, 2 wrist; on legs 0 hip, 1 knee, 2 ankle; 0 elsewhere.
        neck: height above a slope through the root of the neck, which is lower in front.
        scalp: 1 where hair grows, 0 elsewhere, softened.
        azimuth: around the trunk, around the bone on limbs; 0 is at the back, positive to the left (radians).
        slant: 1 on the left and −1 on the right, which makes slanting folds symmetric.
        metres: distance along the limb; on the trunk the height.
        coarse, fine: smooth random fields with a standard deviation of about 0.7 and wavelengths of 12–40 and 5–12 cm.
        chest: vertices around the trunk at the height of the breastbone.
        sections: vertices around each limb (side, 0 for thigh and 1 for shin) at ``SECTIONS``.
    """

    vertices: Int[ndarray, "n"]
    faces: Int[ndarray, "f 3"]
    starts: Int[ndarray, "n1"]
    neighbours: Int[ndarray, "e"]
    skin_indices: Int[ndarray, "n k"]
    skin_weights: Float[ndarray, "n k"]
    trunk: slice
    arm: slice
    left_leg: slice
    right_leg: slice
    leg: slice
    head: slice
    armness: Float[ndarray, "n"]
    default: Float[ndarray, "n 3"]
    height: Float[ndarray, "n"]
    along: Float[ndarray, "n"]
    neck: Float[ndarray, "n"]
    scalp: Float[ndarray, "n"]
    azimuth: Float[ndarray, "n"]
    slant: Float[ndarray, "n"]
    metres: Float[ndarray, "n"]
    coarse: Float[ndarray, "b n"]
    fine: Float[ndarray, "b n"]
    chest: Int[ndarray, "_"]
    sections: dict[tuple[str, int], tuple[Int[ndarray, "_"], Int[ndarray, "_"]]]
    stature: float
    skirt: Anchors
    hair: Anchors

    @classmethod
    @functools.cache
    def of(cls, model: BodyModel) -> ClothMap:
        """The map of a body model; cached."""
        return _build(model)


def _starts_with(names: tuple[str, ...], *prefixes: str) -> Bool[ndarray, "b"]:
    return np.array([name.startswith(prefixes) for name in names])


def _edges(faces: Int[ndarray, "f 3"]) -> Int[ndarray, "e 2"]:
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return np.unique(np.concatenate([pairs, pairs[:, ::-1]]), axis=0)


class _Skin(NamedTuple):
    """The skin that cloth or hair can cover, its vertices sorted by part and height.

    Attributes:
        vertices: indices into the body's mesh.
        part: 0 trunk, 1 arms, 2 left leg, 3 right leg, 4 scalp.
        points: on the default body, metres.
        armness: skinning weight of the arm's bones.
        scalp: 1 where hair grows, 0 elsewhere, softened.
        crotch: height, metres.
    """

    vertices: Int[ndarray, "n"]
    faces: Int[ndarray, "f 3"]
    part: Int[ndarray, "n"]
    points: Float[ndarray, "n 3"]
    armness: Float[ndarray, "n"]
    scalp: Float[ndarray, "n"]
    crotch: float


def _build(model: BodyModel) -> ClothMap:
    body = model.shape(Phenotype())
    heads = dict(zip(model.bone_names, body.rest_heads, strict=True))
    vertices, faces, part, points, armness, scalp, crotch = _covered_skin(model, body, heads)
    edges = _edges(faces)
    x, y, z = points.T
    first = np.searchsorted(part, range(6))
    trunk, arm, left_leg, right_leg, head = (slice(int(a), int(b)) for a, b in itertools.pairwise(first))
    leg = slice(left_leg.start, right_leg.stop)
    root, skull = heads["neck01"], heads["head"]
    neck = (z - root[2]) - 0.55 * (y - root[1])
    along, azimuth = np.zeros(len(points)), np.zeros(len(points))
    mirrored = np.stack([np.abs(x), y, z], 1)
    chains = {"arm": ("upperarm01.L", "lowerarm01.L", "wrist.L"), "leg": ("upperleg01.L", "lowerleg01.L", "foot.L")}
    for mask, (start, bend, end) in ((arm, chains["arm"]), (leg, chains["leg"])):
        along[mask], azimuth[mask] = _along_limb(mirrored[mask], heads[start], heads[bend], heads[end])
    centre = float(np.median(y[trunk][z[trunk] < root[2]]))
    azimuth[trunk] = np.arctan2(x[trunk], y[trunk] - centre)
    azimuth[head] = np.arctan2(x[head], y[head] - skull[1])
    starts = np.searchsorted(edges[:, 0], np.arange(len(vertices) + 1))
    skirt_azimuths = np.linspace(-np.pi, np.pi, SKIRT_COLUMNS, endpoint=False)
    hair_azimuths = np.linspace(-HAIR_SIDE_RAD, HAIR_SIDE_RAD, HAIR_COLUMNS)
    eye = float(heads["eye.L"][2])
    dtype = np.float32
    return ClothMap(
        vertices=vertices,
        faces=faces,
        starts=starts.astype(np.int32),
        neighbours=edges[:, 1].astype(np.int32),
        skin_indices=np.ascontiguousarray(model.skin_indices[vertices]),
        skin_weights=np.ascontiguousarray(model.skin_weights[vertices]),
        trunk=trunk,
        arm=arm,
        left_leg=left_leg,
        right_leg=right_leg,
        leg=leg,
        head=head,
        armness=armness.astype(dtype),
        default=points.astype(dtype),
        height=(z - crotch).astype(dtype),
        along=along.astype(dtype),
        neck=neck.astype(dtype),
        scalp=scalp.astype(dtype),
        azimuth=azimuth.astype(dtype),
        slant=np.where((part == 0) | (x > 0), 1, -1).astype(dtype),
        metres=np.select([part == 1, (part == 2) | (part == 3)], [along * ARM_M, along * LEG_M], z - crotch).astype(
            dtype
        ),
        coarse=_random_fields(points, (0.12, 0.4), 4),
        fine=_random_fields(points, (0.05, 0.12), 6),
        chest=np.flatnonzero((part == 0) & (np.abs(z - heads["spine01"][2]) < 0.05) & (np.abs(x) < 0.05)),
        sections=_limb_sections(part, along),
        stature=float(np.ptp(body.rest_vertices[:, 2])),
        skirt=_anchors(points, edges, np.isin(part, (0, 2, 3)), crotch + SKIRT_LINE_M, (0.0, centre), skirt_azimuths),
        hair=_anchors(points, edges, part == 4, eye + HAIR_LINE_M, (0.0, float(skull[1])), hair_azimuths),
    )


def _covered_skin(model: BodyModel, body: Body, heads: dict[str, Float[ndarray, "3"]]) -> _Skin:
    kinds = np.array([name.removesuffix(" R").removesuffix(" L") for name in REGION_NAMES])[model.face_regions]
    covered = ~np.isin(kinds, ("hand", "forefoot", "face"))
    vertices, inverse = np.unique(model.faces[covered], return_inverse=True)
    faces = inverse.reshape(-1, 3)
    points = body.rest_vertices[vertices].astype(np.float64)

    def weight(*prefixes: str) -> Float[ndarray, "n"]:
        bones = _starts_with(model.bone_names, *prefixes)
        return (model.skin_weights[vertices] * bones[model.skin_indices[vertices]]).sum(1)

    armness = weight("upperarm", "lowerarm", "wrist", "metacarpal", "finger")
    legness = weight("upperleg", "lowerleg", "foot", "toe")
    middle = np.abs(body.rest_vertices[:, 0]) < 0.01
    hip = heads["upperleg01.L"]
    crotch = float(body.rest_vertices[middle & (body.rest_vertices[:, 2] < hip[2] + 0.05), 2].min())
    hairy = np.bincount(faces.ravel(), np.repeat(np.isin(kinds[covered], ("hair", "forehead")), 3))
    scalp = hairy / np.bincount(faces.ravel())
    # Legs begin at the crotch, where cloth divides.
    part = np.select([scalp > 0.3, armness > 0.5, (legness > 0.5) & (points[:, 2] < crotch)], [4, 1, 2], 0)
    part[(part == 2) & (points[:, 0] < 0)] = 3
    order = np.lexsort((points[:, 2], part))
    faces = np.argsort(order)[faces].astype(np.int32)
    return _Skin(vertices[order], faces, part[order], points[order], armness[order], scalp[order], crotch)


def _limb_sections(
    part: Int[ndarray, "n"], along: Float[ndarray, "n"]
) -> dict[tuple[str, int], tuple[Int[ndarray, "_"], Int[ndarray, "_"]]]:
    """Vertices around each leg (side, 0 for thigh and 1 for shin) at ``SECTIONS``."""
    sections: dict[tuple[str, int], tuple[ndarray, ndarray]] = {}
    for (side, code), (bone, (above, below)) in itertools.product((("L", 2), ("R", 3)), enumerate(SECTIONS)):
        is_leg = part == code
        sections_of_bone = [np.flatnonzero(is_leg & (np.abs(along - position) < 0.1)) for position in (above, below)]
        sections[side, bone] = sections_of_bone[0], sections_of_bone[1]
    return sections


def _random_fields(
    points: Float[ndarray, "n 3"], wavelengths: tuple[float, float], waves: int
) -> Float[ndarray, "b n"]:
    """Sums of plane waves with random directions and wavelengths (metres), from a fixed seed; garments choose among
    them."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(_FIELDS, waves, 3))
    lengths = rng.uniform(*wavelengths, (_FIELDS, waves, 1))
    directions *= 2 * np.pi / lengths / np.linalg.norm(directions, axis=2, keepdims=True)
    phases = directions @ points.T + rng.uniform(0, 2 * np.pi, (_FIELDS, waves, 1))
    return (np.sin(phases).sum(1) / np.sqrt(waves)).astype(np.float32)


def _along_limb(
    points: Float[ndarray, "n 3"], start: Float[ndarray, "3"], bend: Float[ndarray, "3"], end: Float[ndarray, "3"]
) -> tuple[Float[ndarray, "n"], Float[ndarray, "n"]]:
    """0 at the start, 1 at the bend, 2 at the end; and the angle around the limb, 0 at the back."""
    first, second = bend - start, end - bend
    upper = (points - start) @ first / (first @ first)
    lower = (points - bend) @ second / (second @ second)
    # Negative on the first bone's side of the plane that bisects the bend.
    side = (points - bend) @ (first / np.linalg.norm(first) + second / np.linalg.norm(second))
    along = np.where(side < 0, np.minimum(upper, 1), 1 + np.maximum(lower, 0))
    on_bone = np.where(
        side[:, None] < 0, start + np.clip(upper, 0, 1)[:, None] * first, bend + np.clip(lower, 0, 2)[:, None] * second
    )
    offsets = points - on_bone
    return along, np.arctan2(offsets[:, 0], offsets[:, 1])


def _anchors(
    points: Float[ndarray, "n 3"],
    edges: Int[ndarray, "e 2"],
    allowed: Bool[ndarray, "n"],
    height: float,
    centre: tuple[float, float],
    azimuths: Float[ndarray, "c"],
) -> Anchors:
    """Points at a height on edges of the mesh: for each column the nearest in azimuth."""
    a, b = edges.T
    crossing = allowed[a] & allowed[b] & (points[a, 2] <= height) & (points[b, 2] > height)
    a, b = a[crossing], b[crossing]
    share = (height - points[a, 2]) / (points[b, 2] - points[a, 2])
    crossings = points[a] + share[:, None] * (points[b] - points[a])
    azimuth = np.arctan2(crossings[:, 0] - centre[0], crossings[:, 1] - centre[1])
    differences = np.abs(np.angle(np.exp(1j * (azimuth[None] - azimuths[:, None]))))
    nearest = differences.argmin(1)
    return Anchors(
        a[nearest].astype(np.int32),
        b[nearest].astype(np.int32),
        share[nearest].astype(np.float32),
        azimuths.astype(np.float32),
    )
