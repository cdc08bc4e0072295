"""Cloth over hands that are in pockets, and how dressed people hold their arms for what they wear."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.geometry.transforms import unit
from depthmocap.synth.motion.pocketed_hands import Pocketed, PocketKind, arms_off_trunk, hands_in_pockets
from depthmocap.synth.motion.touch import across
from depthmocap.synth.people.garments import DressedBody, cloth_material
from depthmocap.synth.people.sheet import grid_faces
from depthmocap.synth.people.wardrobe import Garment
from depthmocap.synth.render import Layer, PosedPerson
from depthmocap.synth.scenes.objects import vertices_of

#: Share of people with a hand or both in pockets: those with pockets on the trunk, and those who wear trousers alone.
_ON_THE_TRUNK, _IN_TROUSERS = 0.3, 0.12
#: Families with pockets on the trunk; those with one before the belly; how often each kind where there are several.
_JACKETS = ("hoodie", "jacket", "puffer", "parka", "anorak", "fleece")
_TROUSERS = ("trousers", "shorts")
_FRONT = ("hoodie", "anorak")
_SHARES: dict[PocketKind, float] = {"jacket": 5, "front": 3, "trousers": 1.5, "seat": 0.3}
#: Spacing of a pocket's cloth (metres), its thickness, and how far it goes beyond the hand all around.
_STEP_M, _THICK_M, _AROUND_M = 0.014, (0.004, 0.012), (0.045, 0.08)
#: Where its mouth is, from the wrist towards the fingers (metres): in jackets sleeves go in.
_MOUTH_M: dict[PocketKind, tuple[float, float]] = {
    "jacket": (-0.06, 0.02), "front": (-0.06, 0.02), "trousers": (0.0, 0.05), "seat": (0.0, 0.05)
}  # fmt: skip
#: Rounds in which it is drawn taut.
_ROUNDS = 30
_ARM = ("hand", "wrist", "forearm", "elbow", "upper arm", "shoulder front", "shoulder back")
#: The body is looked for within this of the hand (metres).
_NEAR_M = 0.25


def pockets_of(garments: tuple[Garment, ...]) -> dict[PocketKind, Garment]:
    """The pockets there are in what somebody wears, and what each is of."""
    top = _top(garments)
    found: dict[PocketKind, Garment] = {}
    if top is not None and top.family in _JACKETS:
        found["jacket"] = top
        if top.family in _FRONT and not top.open_m:
            found["front"] = top
    for garment in garments:
        if garment.family in _TROUSERS:
            found["trousers"] = found["seat"] = garment
    return found


def _top(garments: tuple[Garment, ...]) -> Garment | None:
    """The outermost of what hangs from the shoulders."""
    tops = [garment for garment in garments if garment.top is None]
    return tops[-1] if tops else None


def posed_in_clothes(
    dressed: DressedBody, posture: Float[ndarray, "20 3"], rng: np.random.Generator, share: float | None = None
) -> PosedPerson:
    """Somebody in a posture as their clothes let them hold their arms: off the trunk in thick sleeves, and now and
    then with hands in the pockets.

    Args:
        share: of people with a hand in a pocket, where they have pockets; by default what is ordinary.
    """
    top = _top(dressed.clothes.garments)
    bulk = 0.0 if top is None or not top.sleeve else top.thickness_m + 0.3 * top.slack_m
    if bulk > 0.02:
        posture = arms_off_trunk(posture, bulk * rng.uniform(0.3, 1.0))
    pockets = pockets_of(dressed.clothes.garments)
    if share is None:
        share = _ON_THE_TRUNK if "jacket" in pockets else _IN_TROUSERS
    if not pockets or rng.random() >= share:
        return dressed.pose(posture)
    kinds = list(pockets)
    weights = np.array([_SHARES[kind] for kind in kinds])
    order = rng.choice(len(kinds), 2, p=weights / weights.sum())
    beneath = rng.uniform(0.2, 0.7) * bulk
    posture, hands = hands_in_pockets(posture, [kinds[int(i)] for i in order], beneath, rng)
    person = dressed.pose(posture)
    covers = tuple(_cover(person, hand, pockets[hand.kind], rng) for hand in hands)
    return dataclasses.replace(person, layers=person.layers + covers)


def _cover(person: PosedPerson, pocketed: Pocketed, garment: Garment, rng: np.random.Generator) -> Layer:
    """A pocket's cloth: over the hand, down to the body around it, open towards the wrist.

    It is a height over the plane of the body's skin there, found on a grid: above the hand, and taut between that and
    the body.
    """
    side, normal = pocketed.side, pocketed.normal
    hand = person.vertices[vertices_of(person.body.model, ("hand",), side)].astype(float)
    middle, wrist = hand.mean(0), person.joints[JOINT_INDEX[f"{side}Hand"]]
    ahead = unit(across(middle - wrist, normal))
    frame = np.stack([ahead, np.cross(normal, ahead), normal], 1)
    local = (hand - middle) @ frame
    mouth = float((wrist - middle) @ ahead) + rng.uniform(*_MOUTH_M[pocketed.kind])
    around = rng.uniform(*_AROUND_M)
    rows = np.arange(mouth, local[:, 0].max() + around, _STEP_M)
    columns = np.arange(local[:, 1].min() - around, local[:, 1].max() + around, _STEP_M)

    others = ~vertices_of(person.body.model, _ARM) & (np.abs(person.vertices - middle).max(1) < _NEAR_M)
    body = (person.vertices[others] - middle) @ frame
    padding = 0.5 * garment.thickness_m if garment.padded else 0.0
    over_hand = _widest(_heights(local, rows, columns)) + rng.uniform(*_THICK_M) + padding
    under = _heights(body, rows, columns)
    floor = float(local[:, 2].min()) - 0.05
    under = np.where(np.isfinite(under), np.minimum(under, local[:, 2].max()), floor)
    under[1:-1, 1:-1] = _around(under)
    # The edge lies in the clothes that are on the body, but for the mouth.
    lowest = np.maximum(over_hand, under - 0.01)
    height = lowest.copy()
    height[-1], height[:, 0], height[:, -1] = under[-1], under[:, 0], under[:, -1]
    for _ in range(_ROUNDS):
        height[1:-1, 1:-1] = np.maximum(lowest[1:-1, 1:-1], _around(height))
        height[0, 1:-1] = np.maximum(lowest[0, 1:-1], height[1, 1:-1])
    x, y = np.meshgrid(rows, columns, indexing="ij")
    points = middle + np.stack([x, y, height], -1).reshape(-1, 3) @ frame.T
    return Layer(points.astype(np.float32), grid_faces(len(rows), len(columns), False), cloth_material(garment))


def _heights(
    points: Float[ndarray, "n 3"], rows: Float[ndarray, "r"], columns: Float[ndarray, "c"]
) -> Float[ndarray, "r c"]:
    """The highest of the points around each place of a grid; −∞ where there is none."""
    out = np.full((len(rows), len(columns)), -np.inf)
    row = np.round((points[:, 0] - rows[0]) / _STEP_M).astype(int)
    column = np.round((points[:, 1] - columns[0]) / _STEP_M).astype(int)
    inside = (row >= 0) & (row < len(rows)) & (column >= 0) & (column < len(columns))
    np.maximum.at(out, (row[inside], column[inside]), points[inside, 2])
    return out


def _widest(height: Float[ndarray, "r c"]) -> Float[ndarray, "r c"]:
    """The highest of each place of a grid and those around it."""
    padded = np.pad(height, 1, mode="edge")
    rows = np.maximum.reduce([padded[:-2], padded[1:-1], padded[2:]])
    return np.maximum.reduce([rows[:, :-2], rows[:, 1:-1], rows[:, 2:]])


def _around(height: Float[ndarray, "r c"]) -> Float[ndarray, "r2 c2"]:
    """The mean of the four places around each of a grid but its edge."""
    return (height[:-2, 1:-1] + height[2:, 1:-1] + height[1:-1, :-2] + height[1:-1, 2:]) / 4
