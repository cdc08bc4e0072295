"""Things in rooms that resemble people in depth images and are none: animals, coats on stands, filled chairs.

Each stands on the floor z = 0 with its middle at the origin. The ranges of their sizes (metres) are ours, from common
sizes of such things.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from depthmocap.synth.scenes.furniture import Maker, make_chair, make_stool, yaw
from depthmocap.synth.scenes.solids import Solids, above, box, capsule, capsules, cylinder, ellipsoid, join


def make_dog(rng: np.random.Generator) -> Solids:
    """A dog or a cat, 0.25–0.75 high at the shoulder, standing, sitting or lying."""
    height = rng.uniform(0.25, 0.75)
    long, thick = rng.uniform(0.9, 1.3) * height, rng.uniform(0.16, 0.26) * height
    posture = rng.choice(["standing", "sitting", "lying"], p=[0.5, 0.25, 0.25])
    back = {"standing": height, "sitting": 0.35 * height, "lying": 1.3 * thick}[posture]
    front = {"standing": height, "sitting": height, "lying": 1.3 * thick}[posture]
    shoulder = np.array([0.0, -long / 2, front - thick])
    hips = np.array([0.0, long / 2, back - thick]) if posture != "sitting" else np.array([0.0, long / 5, back - thick])
    turn = yaw(rng.normal(0, 0.5))
    skull = shoulder + turn @ np.array([0.0, -0.35 * height, rng.uniform(0.1, 0.45) * height])
    parts = [
        capsule(shoulder, hips, thick),
        capsule(shoulder, skull, 0.55 * thick),
        ellipsoid(skull, (0.6 * thick, 0.8 * thick, 0.6 * thick)),
        capsule(skull, skull + turn @ np.array([0.0, -1.1 * thick, -0.3 * thick]), 0.35 * thick),
    ]
    for x in (-0.6 * thick, 0.6 * thick):
        for start, lies in ((shoulder, posture == "lying"), (hips, posture != "standing")):
            foot = np.array([x, start[1] - (0.5 * height if lies else rng.normal(0, 0.06)), 0.03])
            parts.append(capsule(start + np.array([x, 0, 0]), foot, 0.3 * thick))
    if rng.random() < 0.8:
        tip = hips + np.array([rng.normal(0, 0.1), 0.45 * height, rng.uniform(-0.2, 0.4) * height])
        parts.append(capsule(hips, np.maximum(tip, 0.02), 0.15 * thick))
    return join(parts)


def make_coat_stand(rng: np.random.Generator) -> Solids:
    """A stand 1.5–1.9 high with one to four coats, bags or hats; or a coat on a tailor's dummy."""
    height = rng.uniform(1.5, 1.9)
    parts = [
        cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.04), rng.uniform(0.15, 0.25)),
        capsule((0.0, 0.0, 0.03), (0.0, 0.0, height), 0.02),
    ]
    for _ in range(rng.integers(1, 5)):
        turn, top = yaw(rng.uniform(-np.pi, np.pi)), height - rng.uniform(0.05, 0.35)
        long, half = rng.uniform(0.5, 1.2), rng.uniform(0.12, 0.26)
        deep, out = rng.uniform(0.05, 0.14), rng.uniform(0.0, 0.14)
        middle = turn @ np.array([0.0, -out, 0.0])
        parts.append(ellipsoid(middle + above(top - long / 2), (half, deep, long / 2), turn))
        if rng.random() < 0.7:  # shoulders and sleeves
            parts.append(ellipsoid(middle + above(top - 0.12), (half, 0.8 * deep, 0.1), turn))
            for side in (-1, 1):
                end = middle + turn @ np.array([side * half * 0.9, 0, 0]) + above(top - 0.12)
                parts.append(capsule(end, end - above(rng.uniform(0.35, 0.6)), rng.uniform(0.04, 0.07)))
    if rng.random() < 0.4:
        radius = rng.uniform(0.09, 0.16)
        parts.append(ellipsoid((0.0, 0.0, height), (radius, radius, rng.uniform(0.05, 0.12))))
    return join(parts)


def make_laden_chair(rng: np.random.Generator) -> Solids:
    """A chair or stool with a coat over its back, a bag, a pile of clothes or a cushion on it."""
    chair = make_chair(rng) if rng.random() < 0.8 else make_stool(rng)
    seat = rng.uniform(0.42, 0.5)
    parts = [chair]
    if rng.random() < 0.6:
        tall = rng.uniform(0.25, 0.35)
        parts.append(ellipsoid((0.0, 0.22, seat + tall), (rng.uniform(0.2, 0.3), rng.uniform(0.05, 0.12), tall)))
    if rng.random() < 0.6:
        half = rng.uniform([0.12, 0.1, 0.06], [0.22, 0.2, 0.25])
        place = (rng.normal(0, 0.03), -0.02, seat + half[2])
        parts.append(ellipsoid(place, half) if rng.random() < 0.6 else box(place, half, yaw(rng.normal(0, 0.3))))
    return join(parts)


def make_sack(rng: np.random.Generator) -> Solids:
    """Bean bags, sacks, rolled carpets and piles of laundry, lying or leaning."""
    parts = []
    for _ in range(rng.integers(1, 4)):
        half = rng.uniform([0.15, 0.15, 0.1], [0.45, 0.4, 0.4])
        at = np.array([*rng.normal(0, 0.2, 2), 0.9 * half[2]])
        parts.append(ellipsoid(at, half, yaw(rng.uniform(0, np.pi))))
    if rng.random() < 0.4:
        tip = np.array([rng.normal(0, 0.3), 0.1, rng.uniform(0.1, 1.5)])
        parts.append(capsule((0.0, -0.3, 0.12), tip, rng.uniform(0.06, 0.14)))
    return join(parts)


def make_snowman(rng: np.random.Generator) -> Solids:
    """Round things over one another: lamps, vases, punch bags, balls on stands."""
    parts, z = [], 0.0
    for _ in range(rng.integers(2, 5)):
        radius, tall = rng.uniform(0.08, 0.28), rng.uniform(0.08, 0.45)
        parts.append(ellipsoid((*rng.normal(0, 0.02, 2), z + tall), (radius, radius, tall)))
        z += 1.8 * tall
    return join(parts)


def make_limbed(rng: np.random.Generator) -> Solids:
    """Sticks and cylinders in all directions: easels, drying racks, fitness machines, drum kits."""
    count = int(rng.integers(4, 12))
    starts = rng.normal(0, [0.25, 0.25, 0.0], (count, 3))
    starts[:, 2] = rng.uniform(0, 1.3, count)
    ends = starts + Rotation.from_quat(rng.normal(size=(count, 4))).apply([0, 0, 1.0]) * rng.uniform(
        0.2, 0.8, (count, 1)
    )
    starts[:, 2], ends[:, 2] = np.maximum(starts[:, 2], 0.06), np.clip(ends[:, 2], 0.06, 1.8)
    return capsules(starts, ends, rng.uniform(0.015, 0.09, count))


LOOKALIKES: tuple[Maker, ...] = (
    make_dog, make_dog, make_coat_stand, make_coat_stand, make_laden_chair, make_sack, make_snowman, make_limbed,
)  # fmt: skip
