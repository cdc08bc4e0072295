"""Furniture of random sizes, out of simple solids.

Each piece stands on the floor z = 0 with its middle at the origin and its back towards +y. The ranges of its sizes are
ours, from common household sizes, and stand where they are drawn (metres).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from depthmocap.synth.scenes.room import box_solids, shelf, table
from depthmocap.synth.scenes.solids import Solids, above, box, capsule, capsules, chain, cylinder, ellipsoid, join

Maker: TypeAlias = Callable[[np.random.Generator], Solids]
Range: TypeAlias = tuple[float, float]


def yaw(angle_rad: float) -> np.ndarray:
    """Rotation about the vertical."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])


def _block(x: Range, y: Range, z: Range) -> Solids:
    """A box along the axes, from range to range."""
    low, high = np.array([x[0], y[0], z[0]]), np.array([x[1], y[1], z[1]])
    return box((low + high) / 2, (high - low) / 2)


def _legs(half_x: float, half_y: float, height: float, radius: float, splay: float = 0.0) -> Solids:
    tops = np.array([[x, y, height] for x in (-half_x, half_x) for y in (-half_y, half_y)])
    feet = tops * [1 + splay, 1 + splay, 0] + [0, 0, radius]
    return capsules(tops, feet, np.full(4, radius))


def _clutter(rng: np.random.Generator, half_x: float, half_y: float, height: float) -> list[Solids]:
    """What stands and lies on a table: books, cartons, bottles, vases, a screen."""
    things: list[Solids] = []
    for _ in range(rng.integers(0, 5)):
        at = np.array([rng.uniform(-0.75, 0.75) * half_x, rng.uniform(-0.6, 0.6) * half_y, height])
        if rng.random() < 0.55:
            half = rng.uniform([0.04, 0.03, 0.01], [0.17, 0.12, 0.13])
            things.append(box(at + above(half[2]), half, yaw(rng.uniform(0, np.pi))))
        elif rng.random() < 0.6:
            radius, tall = rng.uniform(0.03, 0.07), rng.uniform(0.1, 0.32)
            things.append(cylinder(at, at + above(tall), radius))
        else:
            radius = rng.uniform(0.05, 0.13)
            things.append(ellipsoid(at + above(radius), (radius, radius, radius)))
    if rng.random() < 0.25:
        wide, tall = rng.uniform(0.2, 0.4), rng.uniform(0.13, 0.25)
        things.append(box((0.0, 0.5 * half_y, height + tall + 0.08), (wide, 0.02, tall)))
        things.append(box((0.0, 0.5 * half_y, height + 0.06), (0.04, 0.02, 0.06)))
    return things


def make_table(rng: np.random.Generator) -> Solids:
    """A table or desk 0.8–1.8 × 0.5–0.9 and 0.68–0.78 high, or a coffee table 0.36–0.5 high; things on it."""
    half = rng.uniform([0.4, 0.25], [0.9, 0.45])
    height = rng.uniform(0.36, 0.5) if rng.random() < 0.25 else rng.uniform(0.68, 0.78)
    boards = box_solids(table((-half[0], -half[1]), (half[0], half[1]), height))
    return join([boards, *_clutter(rng, half[0], half[1], height)])


def make_round_table(rng: np.random.Generator) -> Solids:
    """A round table on one foot, 0.6–1.2 across; or a bar table up to 1.1 high."""
    radius = rng.uniform(0.3, 0.6)
    height = rng.uniform(0.68, 0.78) if rng.random() < 0.7 else rng.uniform(0.95, 1.1)
    parts = [
        cylinder((0.0, 0.0, height - 0.035), (0.0, 0.0, height), radius),
        cylinder((0.0, 0.0, 0.03), (0.0, 0.0, height), 0.04),
        cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.03), 0.55 * radius),
    ]
    return join([*parts, *_clutter(rng, 0.6 * radius, 0.6 * radius, height)])


def make_chair(rng: np.random.Generator) -> Solids:
    """A chair 0.38–0.5 wide, seat at 0.42–0.5, back up to 0.75–1.05, with or without arms."""
    half = rng.uniform(0.19, 0.25)
    seat, top = rng.uniform(0.42, 0.5), rng.uniform(0.75, 1.05)
    thick = rng.uniform(0.02, 0.08)
    parts = [_block((-half, half), (-half, half), (seat - thick, seat))]
    if rng.random() < 0.25:  # on castors
        parts.append(cylinder((0.0, 0.0, 0.08), (0.0, 0.0, seat), 0.03))
        turns = np.arange(5) * 2 * np.pi / 5
        ends = np.stack([0.27 * np.cos(turns), 0.27 * np.sin(turns), np.full(5, 0.05)], 1)
        parts.append(capsules(np.tile([0.0, 0.0, 0.09], (5, 1)), ends, np.full(5, 0.025)))
    else:
        parts.append(_legs(half - 0.03, half - 0.03, seat - thick, rng.uniform(0.012, 0.025), rng.uniform(0, 0.25)))
    lean = rng.uniform(0, 0.12)
    if rng.random() < 0.5:
        tilt = Rotation.from_euler("x", -np.arctan2(lean, top - seat)).as_matrix()
        middle, low = (top + seat) / 2, rng.uniform(0, 0.15)
        parts.append(box((0.0, half + lean / 2, middle + low / 2), (half, 0.015, (top - seat - low) / 2), tilt))
    else:
        posts = np.array([[-half + 0.02, half - 0.02, seat], [half - 0.02, half - 0.02, seat]])
        heads = posts + np.array([0, lean, top - seat])
        parts.append(capsules(posts, heads, np.full(2, 0.016)))
        for share in np.linspace(0.35, 1.0, rng.integers(2, 5)):
            rail = posts + share * (heads - posts)
            parts.append(capsule(rail[0], rail[1], 0.018))
    if rng.random() < 0.35:
        arm = seat + rng.uniform(0.18, 0.25)
        for x in (-half, half):
            parts.append(chain(np.array([[x, -half + 0.08, seat], [x, -half + 0.06, arm], [x, half, arm]]), 0.02))
    return join(parts)


def make_stool(rng: np.random.Generator) -> Solids:
    """A stool 0.4–0.75 high, round or square."""
    radius, height = rng.uniform(0.14, 0.2), rng.uniform(0.4, 0.75)
    seat = (
        cylinder((0.0, 0.0, height - 0.04), (0.0, 0.0, height), radius)
        if rng.random() < 0.6
        else _block((-radius, radius), (-radius, radius), (height - 0.04, height))
    )
    return join([seat, _legs(0.6 * radius, 0.6 * radius, height - 0.04, 0.014, rng.uniform(0, 0.6))])


def make_sofa(rng: np.random.Generator) -> Solids:
    """An armchair or a sofa, 0.75–2.2 wide, 0.75–0.95 deep, with or without cushions."""
    half_x, half_y = (rng.uniform(0.37, 0.5) if rng.random() < 0.5 else rng.uniform(0.7, 1.1)), rng.uniform(0.37, 0.47)
    seat, arm, top = rng.uniform(0.36, 0.46), rng.uniform(0.52, 0.66), rng.uniform(0.72, 1.0)
    wide, back = rng.uniform(0.08, 0.2), rng.uniform(0.14, 0.24)
    tilt = Rotation.from_euler("x", -rng.uniform(0, 0.15)).as_matrix()
    parts = [
        _block((-half_x, half_x), (-half_y, half_y), (0.04, seat)),
        box((0.0, half_y - back / 2, (top + seat) / 2 - 0.05), (half_x, back / 2, (top - seat) / 2 + 0.05), tilt),
    ]
    for side in (-1, 1):
        x = side * (half_x - wide / 2)
        parts.append(_block((x - wide / 2, x + wide / 2), (-half_y, half_y), (seat - 0.02, arm - wide / 2)))
        ends = np.array([[x, -half_y + wide / 2, arm - wide / 2], [x, half_y - wide / 2, arm - wide / 2]])
        parts.append(capsule(ends[0], ends[1], wide / 2))
    for _ in range(rng.integers(0, 4)):
        at = (rng.uniform(-0.7, 0.7) * (half_x - wide), half_y - back - 0.08, seat + 0.2)
        parts.append(ellipsoid(at, (0.22, 0.08, 0.2), Rotation.from_euler("x", -0.3).as_matrix()))
    return join(parts)


def make_bed(rng: np.random.Generator) -> Solids:
    """A bed 0.9–1.6 wide, 2 long, with a headboard, a pillow and a blanket."""
    half, height = rng.uniform(0.45, 0.8), rng.uniform(0.4, 0.6)
    parts = [
        _block((-half, half), (-1.0, 1.0), (0.1, height)),
        _block((-half, half), (1.0, 1.05), (0.0, rng.uniform(0.7, 1.1))),
        ellipsoid((0.0, -0.2, height), (0.9 * half, 0.75, rng.uniform(0.04, 0.12))),
    ]
    parts.extend(ellipsoid((x * half, 0.72, height + 0.06), (0.35, 0.22, 0.1)) for x in (-0.5, 0.5))
    return join(parts)


def make_shelf(rng: np.random.Generator) -> Solids:
    """An open shelf 0.5–1.4 wide, 0.9–2.1 high, 3–6 boards, partly filled with books and boxes."""
    half_x, half_y = rng.uniform(0.25, 0.7), rng.uniform(0.13, 0.2)
    height, boards = rng.uniform(0.9, 2.1), int(rng.integers(3, 7))
    parts = [box_solids(shelf((-half_y, -half_x), (half_y, half_x), height, boards)).moved(yaw(np.pi / 2), np.zeros(3))]
    if rng.random() < 0.6:
        parts.append(_block((-half_x, half_x), (half_y - 0.01, half_y), (0.0, height)))
    levels = np.linspace(0.03, height, boards)
    gap = levels[1] - levels[0] - 0.03
    for z in levels[:-1]:
        x = -half_x + 0.04
        while x < half_x - 0.3:
            long, tall, deep = rng.uniform(0.06, 0.3), rng.uniform(0.3, 0.9) * gap, rng.uniform(0.5, 0.95) * half_y
            if rng.random() < 0.65:
                parts.append(_block((x, x + long), (half_y - 2 * deep, half_y), (z, z + tall)))
            x += long + rng.uniform(0.005, 0.05)
    return join(parts)


def make_cupboard(rng: np.random.Generator) -> Solids:
    """A cupboard, wardrobe or chest of drawers, 0.5–1.8 wide, 0.7–2.2 high, its fronts a little proud."""
    half_x, half_y, height = rng.uniform(0.25, 0.9), rng.uniform(0.18, 0.32), rng.uniform(0.7, 2.2)
    parts = [_block((-half_x, half_x), (-half_y + 0.02, half_y), (0.0, height))]
    columns, rows = int(rng.integers(1, 4)), int(rng.integers(1, 5)) if height < 1.3 else int(rng.integers(1, 3))
    xs, zs = np.linspace(-half_x, half_x, columns + 1), np.linspace(0.08, height - 0.02, rows + 1)
    for x in range(columns):
        for z in range(rows):
            front = ((xs[x] + 0.008, xs[x + 1] - 0.008), (zs[z] + 0.008, zs[z + 1] - 0.008))
            parts.append(_block(front[0], (-half_y, -half_y + 0.03), front[1]))
            knob = (sum(front[0]) / 2, -half_y - 0.01, sum(front[1]) / 2)
            parts.append(ellipsoid(knob, (0.02, 0.025, 0.02)))
    if height < 1.4:
        parts.extend(_clutter(rng, half_x, half_y, height))
    return join(parts)


def make_plant(rng: np.random.Generator) -> Solids:
    """A plant in a pot, 0.5–1.9 high: a stem and 10–30 leaves."""
    radius, pot, height = rng.uniform(0.1, 0.22), rng.uniform(0.15, 0.4), rng.uniform(0.5, 1.9)
    height = max(height, pot + 0.3)
    lean = rng.normal(0, 0.05, 2)
    top = np.array([*lean, height])
    parts = [cylinder((0.0, 0.0, 0.0), (0.0, 0.0, pot), radius), capsule((0.0, 0.0, pot), top, 0.015)]
    for _ in range(rng.integers(10, 31)):
        share = rng.uniform(0.15, 1)
        root = np.array([0, 0, pot]) + share * (top - [0, 0, pot])
        turn = Rotation.from_euler("zy", [rng.uniform(0, 2 * np.pi), rng.uniform(-1.2, 0.5)]).as_matrix()
        long = rng.uniform(0.08, 0.25)
        parts.append(ellipsoid(root + turn[:, 0] * long, (long, long * rng.uniform(0.15, 0.45), 0.008), turn))
    return join(parts)


def make_cartons(rng: np.random.Generator) -> Solids:
    """One to four cartons on one another, 0.2–0.7 wide."""
    parts, z, half = [], 0.0, rng.uniform([0.15, 0.12, 0.08], [0.35, 0.3, 0.25])
    for _ in range(rng.integers(1, 5)):
        parts.append(box((*rng.normal(0, 0.02, 2), z + half[2]), half, yaw(rng.normal(0, 0.2))))
        z += 2 * half[2]
        half = half * rng.uniform(0.7, 1.0, 3)
    return join(parts)


def make_steps(rng: np.random.Generator) -> Solids:
    """Two to five steps up, 0.6–1.2 wide, each 0.15–0.2 high and 0.25–0.3 deep."""
    half, rise, tread, count = rng.uniform(0.3, 0.6), rng.uniform(0.15, 0.2), rng.uniform(0.25, 0.3), rng.integers(2, 6)
    back = count * tread / 2
    return join(_block((-half, half), (i * tread - back, back), (i * rise, (i + 1) * rise)) for i in range(count))


def make_lamp(rng: np.random.Generator) -> Solids:
    """A floor lamp 1.3–1.8 high."""
    height, radius, tall = rng.uniform(1.3, 1.8), rng.uniform(0.12, 0.25), rng.uniform(0.15, 0.35)
    return join(
        [
            cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.03), rng.uniform(0.12, 0.18)),
            capsule((0.0, 0.0, 0.03), (0.0, 0.0, height), 0.014),
            cylinder((0.0, 0.0, height - tall), (0.0, 0.0, height), radius),
        ]
    )


def make_bin(rng: np.random.Generator) -> Solids:
    """A bin or a drum, 0.25–0.9 high."""
    return cylinder((0.0, 0.0, 0.0), (0.0, 0.0, rng.uniform(0.25, 0.9)), rng.uniform(0.12, 0.28))


def make_tripod(rng: np.random.Generator) -> Solids:
    """A stand on three feet, 0.9–1.7 high, with something small on top: a camera, a music stand's board."""
    height, spread, turn = rng.uniform(0.9, 1.7), rng.uniform(0.25, 0.45), rng.uniform(0, 2 * np.pi)
    turns = turn + np.arange(3) * 2 * np.pi / 3
    feet = np.stack([spread * np.cos(turns), spread * np.sin(turns), np.full(3, 0.02)], 1)
    parts = [
        capsules(np.tile([0.0, 0.0, 0.55 * height], (3, 1)), feet, np.full(3, 0.014)),
        capsule((0.0, 0.0, 0.5 * height), (0.0, 0.0, height), 0.016),
        box((0.0, 0.0, height), rng.uniform([0.05, 0.01, 0.03], [0.25, 0.05, 0.17]), yaw(turn)),
    ]
    return join(parts)


def make_screen(rng: np.random.Generator) -> Solids:
    """A folding screen or partition 0.6–1.6 wide and 1–1.8 high, on two feet."""
    half, height = rng.uniform(0.3, 0.8), rng.uniform(1.0, 1.8)
    panel = _block((-half, half), (-0.02, 0.02), (0.08, height))
    return join([panel, *(_block((x - 0.02, x + 0.02), (-0.2, 0.2), (0.0, 0.08)) for x in (-half, half))])


def make_picture(rng: np.random.Generator) -> Solids:
    """A picture or a whiteboard on the wall, 0.3–1.6 wide."""
    half, tall, z = rng.uniform(0.15, 0.8), rng.uniform(0.15, 0.5), rng.uniform(1.35, 1.6)
    return _block((-half, half), (-0.015, 0.015), (z - tall, z + tall))


def make_radiator(rng: np.random.Generator) -> Solids:
    """A radiator 0.5–1.4 wide, of ribs."""
    half, height = rng.uniform(0.25, 0.7), rng.uniform(0.5, 0.75)
    x = np.arange(-half, half, 0.09)
    low = np.stack([x, np.zeros_like(x), np.full_like(x, 0.15)], 1)
    return join([capsules(low, low + above(height - 0.15), np.full(len(x), 0.035)), capsule(low[0], low[-1], 0.03)])


def make_curtain(rng: np.random.Generator) -> Solids:
    """A curtain 0.5–1.6 wide in folds, from the floor to 2–2.25."""
    half, top = rng.uniform(0.25, 0.8), rng.uniform(2.0, 2.25)
    x = np.cumsum(rng.uniform(0.04, 0.08, 50)) - half
    x = x[x < half]
    low = np.stack([x, rng.normal(0, 0.015, len(x)), np.full_like(x, 0.06)], 1)
    rail = capsule((-half - 0.1, 0.0, top + 0.03), (half + 0.1, 0.0, top + 0.03), 0.015)
    return join([capsules(low, low * [1, 1, 0] + [0, 0, top], rng.uniform(0.04, 0.06, len(x))), rail])


def make_door(rng: np.random.Generator) -> Solids:
    """A closed door in its frame."""
    half, top = rng.uniform(0.38, 0.48), rng.uniform(1.95, 2.1)
    parts = [_block((-half, half), (0.0, 0.02), (0.0, top)), _block((-half, half), (-0.03, 0.02), (top, top + 0.07))]
    parts.extend(_block((x - 0.035, x + 0.035), (-0.03, 0.02), (0.0, top + 0.07)) for x in (-half, half))
    parts.append(capsule((half - 0.18, -0.05, 1.03), (half - 0.07, -0.05, 1.03), 0.012))
    return join(parts)


#: What stands or hangs along walls.
AGAINST_WALLS: tuple[Maker, ...] = (
    make_table, make_sofa, make_bed, make_shelf, make_shelf, make_cupboard, make_cupboard, make_plant, make_cartons,
    make_steps, make_lamp, make_chair, make_picture, make_radiator, make_curtain, make_door,
)  # fmt: skip
#: What stands about.
FREE_STANDING: tuple[Maker, ...] = (
    make_table, make_round_table, make_chair, make_chair, make_stool, make_sofa, make_plant, make_cartons, make_steps,
    make_lamp, make_bin, make_tripod, make_screen,
)  # fmt: skip
