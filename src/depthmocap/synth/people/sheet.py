"""Sheets: cloth and hair that hang from a shell or from the head: skirts, coat tails, long hair, ends of scarves."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from depthmocap.kernels.garment import relax_sheet
from depthmocap.synth.body.mesh import Body, BoneTransforms
from depthmocap.synth.people.cloth_map import HAIR_SIDE_RAD
from depthmocap.synth.people.shell import RestCloth, smoothstep
from depthmocap.synth.people.wardrobe import Garment, Hair

#: Distance between rows of a skirt (metres).
_SKIRT_ROW_M = 0.045
#: Distance between rows of hair and of a scarf (metres).
_HAIR_ROW_M = 0.035


@dataclasses.dataclass(frozen=True, eq=False)
class Capsules:
    """Tapered capsules that sheets collide with, each bound to one bone: ends in the rest pose and radii (metres)."""

    bones: Int[ndarray, "c"]
    starts: Float[ndarray, "c 3"]
    ends: Float[ndarray, "c 3"]
    start_radii: Float[ndarray, "c"]
    end_radii: Float[ndarray, "c"]

    def pose(self, transforms: BoneTransforms) -> tuple[Float[ndarray, "c 3"], Float[ndarray, "c 3"]]:
        """Starts and ends in a posture."""
        rotations, offsets = transforms.rotations[self.bones], transforms.offsets[self.bones]
        starts = np.einsum("cij,cj->ci", rotations, self.starts) + offsets
        ends = np.einsum("cij,cj->ci", rotations, self.ends) + offsets
        return starts.astype(np.float32), ends.astype(np.float32)


def _capsules(rows: Sequence[tuple[int, ndarray, ndarray, float, float]]) -> Capsules:
    bones, starts, ends, first, last = zip(*rows, strict=True)
    floats = [np.array(values, np.float32) for values in (starts, ends, first, last)]
    return Capsules(np.array(bones), *floats)


def leg_capsules(rest: RestCloth, body: Body) -> Capsules:
    """Thighs, shins and the trunk above, measured on the body."""
    cloth, names, rows = rest.cloth, body.model.bone_names, []
    for side in ("L", "R"):
        joints = [names.index(f"{bone}.{side}") for bone in ("upperleg01", "lowerleg01")]
        for bone in (0, 1):
            (start, near), (end, far) = (_section(rest.points[indices]) for indices in cloth.sections[side, bone])
            # The capsule of the thigh extends into the pelvis and down to the knee.
            rows.append((joints[bone], start + 0.15 * (start - end), end + 0.1 * (end - start), near, far))
    middle = [body.rest_heads[names.index(bone)] for bone in ("root", "spine02")]
    chest = rest.points[cloth.chest]
    radius = float(np.ptp(chest[:, 1])) / 2
    for side in (-0.35, 0.35):
        shift = np.array([side * body.rest_heads[names.index("upperarm01.L"), 0], 0, 0])
        rows.append((names.index("spine04"), middle[0] + shift + [0, 0, radius], middle[1] + shift, radius, radius))
    return _capsules(rows)


def _section(points: Float[ndarray, "n 3"]) -> tuple[Float[ndarray, "3"], float]:
    """Centre and radius (metres) of a slice of a limb."""
    centre = points.mean(0)
    distances = np.hypot(*(points - centre)[:, :2].T)
    return centre, float(np.sort(distances)[int(0.95 * len(distances))])


def upper_capsules(rest: RestCloth, body: Body) -> Capsules:
    """Head, neck, shoulders and the trunk below, measured on the body."""
    cloth, names = rest.cloth, body.model.bone_names
    heads = dict(zip(names, body.rest_heads, strict=True))
    root, skull = heads["neck01"], heads["head"]
    shoulder = heads["upperarm01.L"]
    scalp = rest.points[cloth.head]
    centre = (scalp.max(0) + scalp.min(0)) / 2
    head_radius = float(np.ptp(scalp[:, 0])) / 2
    nose = np.array([0, 0.02, 0])
    chest = rest.points[cloth.chest, 1]
    chest_radius = float(np.ptp(chest)) / 2
    middle_y = float(chest.max()) - chest_radius
    spine, chest_bone = names.index("spine01"), names.index("spine03")
    rows = [
        (names.index("head"), centre - nose, centre + nose, head_radius, head_radius),
        (names.index("neck02"), root, skull, 0.06 * rest.scale, 0.06 * rest.scale),
    ]
    for sign in (-1, 1):
        inner = np.array([sign * 0.35 * shoulder[0], middle_y, shoulder[2] - 0.6 * chest_radius])
        outer = np.array([sign * 0.9 * shoulder[0], shoulder[1], shoulder[2]])
        low = np.array([sign * 0.4 * shoulder[0], middle_y, heads["spine04"][2]])
        rows.append((spine, inner, outer, 0.09 * rest.scale, 0.065 * rest.scale))
        rows.append((chest_bone, inner, low, chest_radius, chest_radius))
    return _capsules(rows)


@dataclasses.dataclass(frozen=True, eq=False)
class Sheet:
    """A grid of points. The first row is fixed; the others are skinned and then relaxed
    (``kernels.garment.relax_sheet``).

    Attributes:
        along, across: rest lengths of the edges along columns and rows, metres.
        closed: the last column joins the first.
        columns: the anchors of the columns.
        margin_m: added to the capsules' radii.
        fall_m: downward move in each round.
    """

    rows: int
    rest: Float[ndarray, "m 3"]
    indices: Int[ndarray, "m k"]
    weights: Float[ndarray, "m k"]
    along: Float[ndarray, "rows1 c"]
    across: Float[ndarray, "rows c"]
    closed: bool
    columns: Int[ndarray, "c"]
    capsules: Capsules
    margin_m: float
    fall_m: float
    rounds: int
    faces: Int[ndarray, "f 3"]

    def pose(
        self, transforms: BoneTransforms, anchors: Float[ndarray, "_ 3"] | None, floor: float
    ) -> Float[ndarray, "m 3"]:
        """Points in a posture.

        Args:
            anchors: positions of the anchors of all columns; without them the first row follows its bones.
            floor: lowest height of a point (metres).
        """
        points = transforms.skin(self.rest, self.indices, self.weights).reshape(self.rows, -1, 3)
        if anchors is not None:
            points[0] = anchors[self.columns]
        starts, ends = self.capsules.pose(transforms)
        margin = np.float32(self.margin_m)
        relax_sheet(
            points, self.along, self.across, self.closed, starts, ends, self.capsules.start_radii + margin,
            self.capsules.end_radii + margin, np.float32(self.fall_m), np.float32(floor), self.rounds,
        )  # fmt: skip
        return points.reshape(-1, 3)


def grid_faces(rows: int, columns: int, closed: bool) -> Int[ndarray, "f 3"]:
    """Triangles of a grid of points in row-major order; a closed grid joins its last column to its first."""
    number = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    if closed:
        number = np.concatenate([number, number[:, :1]], 1)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    return np.stack([a, c, b, b, c, d], -1).reshape(-1, 3)


def _sheet(
    points: Float[ndarray, "r c 3"], bones: Sequence[int], weights: Float[ndarray, "r c k"], closed: bool,
    columns: Int[ndarray, "c"], capsules: Capsules, margin_m: float, fall_m: float, rounds: int,
) -> Sheet:  # fmt: skip
    rows, width = points.shape[:2]
    bone_weights = weights.reshape(-1, len(bones))
    order = np.argsort(-bone_weights, axis=1)
    next_column = np.roll(points, -1, axis=1)
    return Sheet(
        rows=rows,
        rest=points.reshape(-1, 3).astype(np.float32),
        indices=np.asarray(bones, np.int32)[order],
        weights=np.take_along_axis(bone_weights, order, 1).astype(np.float32),
        along=np.linalg.norm(np.diff(points, axis=0), axis=2).astype(np.float32),
        across=np.linalg.norm(next_column - points, axis=2).astype(np.float32),
        closed=closed,
        columns=columns,
        capsules=capsules,
        margin_m=margin_m,
        fall_m=fall_m,
        rounds=rounds,
        faces=grid_faces(rows, width, closed),
    )


def skirt_sheet(
    rest: RestCloth,
    body: Body,
    capsules: Capsules,
    garment: Garment,
    offset_m: Float[ndarray, "c"],
    leg_offset_m: float,
    rng: np.random.Generator,
) -> Sheet:
    """A skirt, or the part of a dress or coat that hangs around both legs.

    Args:
        capsules: of the legs (:func:`leg_capsules`).
        offset_m: distance of the garment from the skin at the line it hangs from, by column.
        leg_offset_m: distance of the inner clothes from the legs.
    """
    anchors, names = rest.cloth.skirt, body.model.bone_names
    heads = dict(zip(names, body.rest_heads, strict=True))
    share = anchors.share[:, None]
    line = (1 - share) * rest.points[anchors.first] + share * rest.points[anchors.second]
    azimuth = anchors.azimuth.astype(np.float64)
    out = np.stack([np.sin(azimuth), np.cos(azimuth)], 1)
    centre = np.array([0.0, rest.centre_y])
    radius = ((line[:, :2] - centre) * out).sum(1) + offset_m
    top = float(line[:, 2].mean())
    mean_radius = np.pad(radius, 2, mode="wrap")
    mean_radius = np.lib.stride_tricks.sliding_window_view(mean_radius, 5).mean(1)
    columns = np.arange(len(azimuth))
    if garment.open_m:
        columns = columns[np.abs(azimuth) < np.pi - garment.open_m / float(mean_radius.mean())]
    floor = float(body.rest_vertices[:, 2].min())
    length = min(garment.hangs_m * rest.scale, top - floor - 0.03)
    down = np.linspace(0, length, max(round(length / _SKIRT_ROW_M), 2) + 1)
    eased = smoothstep(down / 0.15)[:, None]
    reach = (1 - eased) * radius + eased * (mean_radius + garment.slack_m * rest.scale) + garment.flare * down[:, None]
    waves = int(rng.integers(5, 12))
    height = (garment.folds_m + 0.06 * garment.flare) * smoothstep(down / 0.35)
    reach = reach + height[:, None] * np.cos(waves * azimuth + 0.8 * np.sin(azimuth + rng.uniform(0, 6)))
    hem = rng.uniform(-0.15, 0.15) * 0.3 * length  # the hem is longer behind or in front
    drop = down[:, None] + hem * (down / length)[:, None] ** 2 * np.cos(azimuth)
    plane = centre + reach[..., None] * out
    points = np.concatenate([plane, (top - np.minimum(drop, top - floor - 0.02))[..., None]], 2)[:, columns]

    # In front, cloth follows the thighs from the groin down; behind, it follows the seat first.
    legs = smoothstep(down[:, None] / (0.13 + 0.08 * np.cos(azimuth[columns])))
    knee = float(heads["lowerleg01.L"][2])
    shins = smoothstep((knee + 0.06 - points[..., 2]) / 0.14)
    left = smoothstep(0.5 + points[..., 0] / (2 * float(mean_radius.mean())))
    weights = np.stack(
        [
            1 - legs,
            legs * left * (1 - shins), legs * (1 - left) * (1 - shins), legs * left * shins, legs * (1 - left) * shins,
        ],
        -1,
    )  # fmt: skip
    bones = [names.index(bone) for bone in ("root", "upperleg01.L", "upperleg01.R", "lowerleg01.L", "lowerleg01.R")]
    margin = garment.thickness_m + leg_offset_m + 0.012
    return _sheet(points, bones, weights, not garment.open_m, columns, capsules, margin, 0.012, 12)


def hair_sheet(
    rest: RestCloth, body: Body, hair: Hair, offset_m: Float[ndarray, "c"], rng: np.random.Generator
) -> Sheet:
    """Hair that hangs around the head from temple to temple (bob and long); ``offset_m`` as in :func:`skirt_sheet`."""
    anchors, names = rest.cloth.hair, body.model.bone_names
    share = anchors.share[:, None]
    line = (1 - share) * rest.points[anchors.first] + share * rest.points[anchors.second]
    azimuth = anchors.azimuth.astype(np.float64)
    out = np.stack([np.sin(azimuth), np.cos(azimuth)], 1)
    length = hair.length_m * rest.scale
    down = np.linspace(0, length, max(round(length / _HAIR_ROW_M), 3) + 1)
    waves = 1 + hair.lumps * np.cos(rng.integers(4, 9) * azimuth + rng.uniform(0, 6))
    reach = offset_m + (hair.volume_m * (waves - 1) + 0.015) * smoothstep(down / 0.06)[:, None]
    plane = line[:, :2] + reach[..., None] * out
    if hair.forward:  # hair at the sides falls in front of the shoulders
        side, fallen = np.abs(azimuth), hair.forward * rest.scale * smoothstep(down / 0.2)[:, None]
        inwards = np.sign(azimuth) * (0.06 * smoothstep((side - 1.3) / 0.6) - 0.015)
        plane = plane - fallen[..., None] * np.stack([inwards, 0.16 * smoothstep((side - 0.7) / 0.8)], -1)
    # Hair is shorter towards the face.
    shorter = 1 - 0.35 * rng.uniform() * (np.abs(azimuth) / HAIR_SIDE_RAD) ** 4
    points = np.concatenate([plane, (line[:, 2] - down[:, None] * shorter)[..., None]], 2)
    shoulders = np.broadcast_to(smoothstep((down - 0.1) / 0.15)[:, None], plane.shape[:2])
    weights = np.stack([1 - shoulders, shoulders], -1)
    bones = [names.index("head"), names.index("spine01")]
    columns, margin = np.arange(len(azimuth)), 0.012 + 0.02 * hair.forward
    return _sheet(points, bones, weights, False, columns, upper_capsules(rest, body), margin, 0.015, 14)


def tail_sheet(rest: RestCloth, body: Body, hair: Hair, rng: np.random.Generator) -> Sheet:
    """A ponytail from the back of the head."""
    scalp = rest.points[rest.cloth.head]
    back = scalp[np.argmax(scalp[:, 1])]
    length = hair.length_m * rest.scale
    down = np.linspace(0, length, max(round(length / _HAIR_ROW_M), 3) + 1)
    share = down / length
    girth = (0.012 + hair.volume_m * np.sin(np.pi * np.clip(share * 0.9 + 0.12, 0, 1)))[:, None]
    angle = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    root_height = rng.uniform(-0.02, 0.07) * rest.scale
    x = girth * np.sin(angle)
    y = back[1] + 0.005 + 0.03 * smoothstep(down / 0.06)[:, None] + girth * np.cos(angle)
    z = back[2] + root_height - down[:, None] + 0.0 * angle
    points = np.stack([x, y, z], 2)
    shoulders = np.broadcast_to(smoothstep((down - 0.15) / 0.2)[:, None], x.shape)
    names = body.model.bone_names
    bones = [names.index("head"), names.index("spine01")]
    weights = np.stack([1 - shoulders, shoulders], -1)
    return _sheet(points, bones, weights, True, np.arange(8), upper_capsules(rest, body), 0.01, 0.012, 14)


def scarf_end(
    rest: RestCloth, body: Body, side: float, length_m: float, offset_m: float, rng: np.random.Generator
) -> Sheet:
    """An end of a scarf that hangs on the chest.

    Args:
        side: from −1 on the right to 1 on the left.
        offset_m: distance of the clothes from the chest.
    """
    names = body.model.bone_names
    root = body.rest_heads[names.index("neck01")]
    chest = float(rest.points[rest.cloth.chest, 1].min())
    length = length_m * rest.scale
    down = np.linspace(0, length, max(round(length / _HAIR_ROW_M), 3) + 1)
    angle = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    half_width, half_depth = rng.uniform(0.03, 0.08) * rest.scale, rng.uniform(0.008, 0.02)
    fold = 1 + 0.2 * np.cos(rng.uniform(8, 20) * down[:, None] + rng.uniform(0, 6))
    x = side * 0.045 * rest.scale + half_width * fold * np.sin(angle)
    # From the front of the neck down to the front of the chest.
    front = (root[1] - 0.09 * rest.scale) + (chest - offset_m - root[1] + 0.06 * rest.scale) * smoothstep(down / 0.12)
    y = front[:, None] - half_depth * (1 + np.cos(angle))
    z = root[2] - 0.02 - down[:, None] + 0.0 * angle
    lower = np.broadcast_to(smoothstep((down - 0.15) / 0.2)[:, None], x.shape)
    bones = [names.index("spine01"), names.index("spine03")]
    weights = np.stack([1 - lower, lower], -1)
    capsules = upper_capsules(rest, body)
    return _sheet(np.stack([x, y, z], 2), bones, weights, True, np.arange(8), capsules, offset_m + 0.008, 0.012, 14)
