"""Postures of dressed people: arms held off the trunk by thick sleeves, hands in pockets and the cloth over them."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.geometry.transforms import unit
from depthmocap.synth.motion.pocketed_hands import PocketedHand, PocketKind, hands_in_pockets, hold_arms_off_trunk
from depthmocap.synth.motion.touch import perpendicular
from depthmocap.synth.people.garments import DressedBody, cloth_material
from depthmocap.synth.people.sheet import grid_faces
from depthmocap.synth.people.wardrobe import Garment
from depthmocap.synth.render import Layer, PosedPerson
from depthmocap.synth.scenes.objects import vertices_of

#: Share of people with a hand in a pocket, of those with pockets in a jacket.
_JACKET_POCKET_SHARE = 0.3
#: The same of those with pockets in their trousers only.
_TROUSER_POCKET_SHARE = 0.12
#: Families of garments with pockets at the sides of the trunk.
_JACKET_POCKET_FAMILIES = ("hoodie", "jacket", "puffer", "parka", "anorak", "fleece")
#: Families with pockets at the hips.
_TROUSER_POCKET_FAMILIES = ("trousers", "shorts")
#: Families with one pocket in front of the belly.
_FRONT_POCKET_FAMILIES = ("hoodie", "anorak")
#: Relative frequency of the kinds of pockets.
_KIND_WEIGHTS: dict[PocketKind, float] = {"jacket": 5, "front": 3, "trousers": 1.5, "seat": 0.3}
#: Grid spacing of a pocket's cloth (metres).
_STEP_M = 0.014
#: Least and greatest thickness of a pocket's cloth (metres).
_CLOTH_M = (0.004, 0.012)
#: Least and greatest width of a pocket beyond the hand, on all sides (metres).
_BORDER_M = (0.045, 0.08)
#: Range of a pocket's opening, measured from the wrist towards the fingers (metres); pockets of jackets take the cuff
#: in.
_MOUTH_M: dict[PocketKind, tuple[float, float]] = {
    "jacket": (-0.06, 0.02), "front": (-0.06, 0.02), "trousers": (0.0, 0.05), "seat": (0.0, 0.05)
}  # fmt: skip
#: Number of rounds in which the cloth is relaxed.
_RELAXATION_ROUNDS = 30
#: Regions of the arm, which are not part of the body beneath a pocket.
_ARM_REGIONS = ("hand", "wrist", "forearm", "elbow", "upper arm", "shoulder front", "shoulder back")
#: Range from the hand within which the body beneath a pocket is measured (metres).
_RANGE_M = 0.25


def find_pockets(garments: tuple[Garment, ...]) -> dict[PocketKind, Garment]:
    """The kinds of pockets in a person's garments, and the garment of each."""
    top = _outermost_top(garments)
    pockets: dict[PocketKind, Garment] = {}
    if top is not None and top.family in _JACKET_POCKET_FAMILIES:
        pockets["jacket"] = top
        if top.family in _FRONT_POCKET_FAMILIES and not top.open_m:
            pockets["front"] = top
    for garment in garments:
        if garment.family in _TROUSER_POCKET_FAMILIES:
            pockets["trousers"] = pockets["seat"] = garment
    return pockets


def _outermost_top(garments: tuple[Garment, ...]) -> Garment | None:
    """The outermost garment that hangs from the shoulders."""
    tops = [garment for garment in garments if garment.top is None]
    return tops[-1] if tops else None


def pose_in_clothes(
    dressed: DressedBody, posture: Float[ndarray, "20 3"], rng: np.random.Generator, share: float | None = None
) -> PosedPerson:
    """A dressed person in a posture. Thick sleeves keep the arms off the trunk; some people put hands in pockets.

    Args:
        share: of people with a hand in a pocket, of those with pockets; by default an ordinary share.
    """
    top = _outermost_top(dressed.clothes.garments)
    bulk = 0.0 if top is None or not top.sleeve else top.thickness_m + 0.3 * top.slack_m
    if bulk > 0.02:
        posture = hold_arms_off_trunk(posture, bulk * rng.uniform(0.3, 1.0))
    pockets = find_pockets(dressed.clothes.garments)
    if share is None:
        share = _JACKET_POCKET_SHARE if "jacket" in pockets else _TROUSER_POCKET_SHARE
    if not pockets or rng.random() >= share:
        return dressed.pose(posture)
    kinds = list(pockets)
    weights = np.array([_KIND_WEIGHTS[kind] for kind in kinds])
    kind_indices = rng.choice(len(kinds), 2, p=weights / weights.sum())
    inner_m = rng.uniform(0.2, 0.7) * bulk
    posture, hands = hands_in_pockets(posture, [kinds[int(i)] for i in kind_indices], inner_m, rng)
    person = dressed.pose(posture)
    pocket_layers = tuple(_pocket_layer(person, hand, pockets[hand.kind], rng) for hand in hands)
    return dataclasses.replace(person, layers=person.layers + pocket_layers)


def _pocket_layer(person: PosedPerson, pocketed: PocketedHand, garment: Garment, rng: np.random.Generator) -> Layer:
    """The cloth of a pocket: it lies over the hand, meets the body around it, and is open towards the wrist.

    The cloth is a height map over the tangent plane of the skin: above the hand, and taut between hand and body.
    """
    side, normal = pocketed.side, pocketed.normal
    hand = person.vertices[vertices_of(person.body.model, ("hand",), side)].astype(float)
    middle, wrist = hand.mean(0), person.joints[JOINT_INDEX[f"{side}Hand"]]
    ahead = unit(perpendicular(middle - wrist, normal))
    frame = np.stack([ahead, np.cross(normal, ahead), normal], 1)
    local = (hand - middle) @ frame
    mouth = float((wrist - middle) @ ahead) + rng.uniform(*_MOUTH_M[pocketed.kind])
    border = rng.uniform(*_BORDER_M)
    rows = np.arange(mouth, local[:, 0].max() + border, _STEP_M)
    columns = np.arange(local[:, 1].min() - border, local[:, 1].max() + border, _STEP_M)

    is_body = ~vertices_of(person.body.model, _ARM_REGIONS) & (np.abs(person.vertices - middle).max(1) < _RANGE_M)
    body = (person.vertices[is_body] - middle) @ frame
    padding = 0.5 * garment.thickness_m if garment.padded else 0.0
    hand_height = _dilate(_height_map(local, rows, columns)) + rng.uniform(*_CLOTH_M) + padding
    body_height = _height_map(body, rows, columns)
    floor = float(local[:, 2].min()) - 0.05
    body_height = np.where(np.isfinite(body_height), np.minimum(body_height, local[:, 2].max()), floor)
    body_height[1:-1, 1:-1] = _neighbour_mean(body_height)
    # All edges but the opening lie on the body.
    lowest = np.maximum(hand_height, body_height - 0.01)
    height = lowest.copy()
    height[-1], height[:, 0], height[:, -1] = body_height[-1], body_height[:, 0], body_height[:, -1]
    for _ in range(_RELAXATION_ROUNDS):
        height[1:-1, 1:-1] = np.maximum(lowest[1:-1, 1:-1], _neighbour_mean(height))
        height[0, 1:-1] = np.maximum(lowest[0, 1:-1], height[1, 1:-1])
    x, y = np.meshgrid(rows, columns, indexing="ij")
    points = middle + np.stack([x, y, height], -1).reshape(-1, 3) @ frame.T
    return Layer(points.astype(np.float32), grid_faces(len(rows), len(columns), False), cloth_material(garment))


def _height_map(
    points: Float[ndarray, "n 3"], rows: Float[ndarray, "r"], columns: Float[ndarray, "c"]
) -> Float[ndarray, "r c"]:
    """Largest height of the points in each cell of a grid; −∞ in empty cells."""
    heights = np.full((len(rows), len(columns)), -np.inf)
    row = np.round((points[:, 0] - rows[0]) / _STEP_M).astype(int)
    column = np.round((points[:, 1] - columns[0]) / _STEP_M).astype(int)
    inside = (row >= 0) & (row < len(rows)) & (column >= 0) & (column < len(columns))
    np.maximum.at(heights, (row[inside], column[inside]), points[inside, 2])
    return heights


def _dilate(height: Float[ndarray, "r c"]) -> Float[ndarray, "r c"]:
    """Maximum over each cell and its eight neighbours."""
    padded = np.pad(height, 1, mode="edge")
    rows = np.maximum.reduce([padded[:-2], padded[1:-1], padded[2:]])
    return np.maximum.reduce([rows[:, :-2], rows[:, 1:-1], rows[:, 2:]])


def _neighbour_mean(height: Float[ndarray, "r c"]) -> Float[ndarray, "r2 c2"]:
    """Mean of the four neighbours of every inner cell."""
    return (height[:-2, 1:-1] + height[2:, 1:-1] + height[1:-1, :-2] + height[1:-1, 2:]) / 4
