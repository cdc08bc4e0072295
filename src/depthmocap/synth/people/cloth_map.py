"""Where clothes go on the body's mesh: coordinates along trunk, arms, legs and neck, shared by all shapes."""

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

#: Columns of a sheet that hangs around both legs, evenly around the body from its back, and of one of hair.
SKIRT_COLUMNS, HAIR_COLUMNS = 44, 18
#: Height of the line that long hair hangs from, metres above the eyes.
HAIR_LINE_M = 0.015
#: Half the part of the head's circle, from the back, that long hair hangs from (radians).
HAIR_SIDE_RAD = 1.9
#: Where thighs and shins are measured, as counted by ``ClothMap.along``.
SECTIONS = ((0.3, 0.95), (1.2, 1.9))
#: Typical lengths (metres) of what ``ClothMap.along`` counts as 1.
ARM_M, LEG_M = 0.26, 0.46
#: Random fields of each kind.
_FIELDS = 24


@dataclasses.dataclass(frozen=True, eq=False)
class Anchors:
    """Points on edges of the cloth map's mesh: ``(1 − share) · first + share · second``; azimuth from the back."""

    first: Int[ndarray, "c"]
    second: Int[ndarray, "c"]
    share: Float[ndarray, "c"]
    azimuth: Float[ndarray, "c"]


@dataclasses.dataclass(frozen=True, eq=False)
class ClothMap:
    """The skin without hands, toes and face, with coordinates on the default body (metres) that all bodies share.

    Attributes:
        vertices: indices into the body's mesh; all else counts these.
        starts, neighbours: edges at each vertex, in CSR form.
        trunk, arm, left_leg, right_leg, leg, head: slices of the vertices; the trunk comes first, upwards.
        armness: weight of the arm's bones.
        height: above the crotch.
        along: on arms 0 shoulder, 1 elbow, 2 wrist; on legs 0 hip, 1 knee, 2 ankle; 0 elsewhere.
        neck: above a slope through the root of the neck, which is lower in front.
        scalp: 1 where hair grows, 0 elsewhere, softened.
        azimuth: around the trunk, around the bone on limbs; 0 is at the back, positive to the left (radians).
        slant: 1 on the left and −1 on the right, so that what slants is symmetric.
        metres: along the limb, or the height.
        coarse, fine: smooth random fields of deviation about 0.7, of 12–40 cm and of 5–12 cm.
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
        """The map of a body model, built once a process."""
        return _build(model)


def _starts_with(names: tuple[str, ...], *prefixes: str) -> Bool[ndarray, "b"]:
    return np.array([name.startswith(prefixes) for name in names])


def _edges(faces: Int[ndarray, "f 3"]) -> Int[ndarray, "e 2"]:
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return np.unique(np.concatenate([pairs, pairs[:, ::-1]]), axis=0)


class _Skin(NamedTuple):
    """The skin that cloth or hair covers, its vertices sorted by part and height.

    Attributes:
        vertices: indices into the body's mesh.
        part: 0 trunk, 1 arms, 2 left leg, 3 right leg, 4 scalp.
        points: on the default body, metres.
        armness: weight of the arm's bones.
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
    around = np.linspace(-np.pi, np.pi, SKIRT_COLUMNS, endpoint=False)
    hair_around = np.linspace(-HAIR_SIDE_RAD, HAIR_SIDE_RAD, HAIR_COLUMNS)
    eye = float(heads["eye.L"][2])
    as_float = np.float32
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
        armness=armness.astype(as_float),
        default=points.astype(as_float),
        height=(z - crotch).astype(as_float),
        along=along.astype(as_float),
        neck=neck.astype(as_float),
        scalp=scalp.astype(as_float),
        azimuth=azimuth.astype(as_float),
        slant=np.where((part == 0) | (x > 0), 1, -1).astype(as_float),
        metres=np.select([part == 1, (part == 2) | (part == 3)], [along * ARM_M, along * LEG_M], z - crotch).astype(
            as_float
        ),
        coarse=_random_fields(points, (0.12, 0.4), 4),
        fine=_random_fields(points, (0.05, 0.12), 6),
        chest=np.flatnonzero((part == 0) & (np.abs(z - heads["spine01"][2]) < 0.05) & (np.abs(x) < 0.05)),
        sections=_limb_sections(part, along),
        stature=float(np.ptp(body.rest_vertices[:, 2])),
        skirt=_anchors(points, edges, np.isin(part, (0, 2, 3)), crotch + SKIRT_LINE_M, (0.0, centre), around),
        hair=_anchors(points, edges, part == 4, eye + HAIR_LINE_M, (0.0, float(skull[1])), hair_around),
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
    # The leg begins where cloth must part, below the crotch.
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
        of_leg = part == code
        slices = [np.flatnonzero(of_leg & (np.abs(along - at) < 0.1)) for at in (above, below)]
        sections[side, bone] = slices[0], slices[1]
    return sections


def _random_fields(
    points: Float[ndarray, "n 3"], wavelengths: tuple[float, float], waves: int
) -> Float[ndarray, "b n"]:
    """Sums of plane waves of random directions and lengths (metres): always the same, garments choose among them."""
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
    # Either side of the plane that halves the bend.
    half = (points - bend) @ (first / np.linalg.norm(first) + second / np.linalg.norm(second))
    along = np.where(half < 0, np.minimum(upper, 1), 1 + np.maximum(lower, 0))
    on_bone = np.where(
        half[:, None] < 0, start + np.clip(upper, 0, 1)[:, None] * first, bend + np.clip(lower, 0, 2)[:, None] * second
    )
    away = points - on_bone
    return along, np.arctan2(away[:, 0], away[:, 1])


def _anchors(
    points: Float[ndarray, "n 3"],
    edges: Int[ndarray, "e 2"],
    allowed: Bool[ndarray, "n"],
    height: float,
    centre: tuple[float, float],
    azimuths: Float[ndarray, "c"],
) -> Anchors:
    """Edges that cross a height, the nearest in azimuth for each column."""
    a, b = edges.T
    crossing = allowed[a] & allowed[b] & (points[a, 2] <= height) & (points[b, 2] > height)
    a, b = a[crossing], b[crossing]
    share = (height - points[a, 2]) / (points[b, 2] - points[a, 2])
    at = points[a] + share[:, None] * (points[b] - points[a])
    azimuth = np.arctan2(at[:, 0] - centre[0], at[:, 1] - centre[1])
    apart = np.abs(np.angle(np.exp(1j * (azimuth[None] - azimuths[:, None]))))
    nearest = apart.argmin(1)
    return Anchors(
        a[nearest].astype(np.int32),
        b[nearest].astype(np.int32),
        share[nearest].astype(np.float32),
        azimuths.astype(np.float32),
    )
