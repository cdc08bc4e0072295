"""Where furniture can stand: not in people, not before a camera's lens, and not where it hides too much."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.synth.scenes.furniture import AGAINST_WALLS, FREE_STANDING, Maker, yaw
from depthmocap.synth.scenes.solids import NONE, Solids, box, join, shell

#: Least distance of furniture from a camera, metres.
CAMERA_CLEARANCE_M = 0.5
#: Least distance of furniture from a person's skin, metres.
BODY_CLEARANCE_M = 0.05
#: Largest distance from the person of furniture that does not stand at a wall, metres.
_ABOUT_M = 3.0
_TRIES = 8


class Place:
    """People, cameras and the solids placed so far.

    Args:
        eyes: positions of the cameras.
        joints: of the person (or people) who must stay visible.
        seen_by_one, seen_by_each: shares of the joints that one camera and every camera must see.
    """

    def __init__(
        self, eyes: Float[ndarray, "c 3"], joints: Float[ndarray, "j 3"], seen_by_one: float, seen_by_each: float
    ) -> None:
        self.eyes, self.joints = eyes, joints
        self._least = (seen_by_one, seen_by_each)
        self._hidden: Bool[ndarray, "c j"] = np.zeros((len(eyes), len(joints)), dtype=np.bool_)
        #: The skin and clothes of all people.
        self.points: Float[ndarray, "p 3"] = np.zeros((0, 3))
        self._footprints: list[Float[ndarray, "4 2"]] = []

    def moved(self, rotation: Float[ndarray, "3 3"], offset: Float[ndarray, "3"]) -> Place:
        """The same place in other axes."""
        moved = Place(self.eyes @ rotation.T + offset, self.joints @ rotation.T + offset, *self._least)
        moved._hidden = self._hidden
        moved.points = self.points @ rotation.T + offset
        return moved

    def occupy(self, points: Float[ndarray, "p 3"]) -> None:
        """Add points of people."""
        self.points = np.concatenate([self.points, points])

    def accept(self, solids: Solids, clear_of_body: bool = True) -> bool:
        """Place solids if they may stand there. ``clear_of_body=False`` skips the test against people, for worn and
        held objects."""
        if solids.grown(CAMERA_CLEARANCE_M).hold_any(self.eyes):
            return False
        if clear_of_body and self._touches_people(solids):
            return False
        hidden = self._hidden | solids.hide(self.eyes, self.joints)
        visible = 1 - hidden.mean(1)
        if len(visible) and (visible.max() < self._least[0] or visible.min() < self._least[1]):
            return False
        self._hidden = hidden
        return True

    def _touches_people(self, solids: Solids) -> bool:
        around = solids.corners.reshape(-1, 3)
        low, high = around.min(0) - BODY_CLEARANCE_M, around.max(0) + BODY_CLEARANCE_M
        # A bounding box first, since most furniture is far from all people.
        return box((low + high) / 2, (high - low) / 2).hold_any(self.points) and solids.grown(
            BODY_CLEARANCE_M
        ).hold_any(self.points)

    def stand(self, solids: Solids, footprint: Float[ndarray, "4 2"], clear_of_body: bool = True) -> bool:
        """Place furniture if it may stand there and overlaps no other; ``footprint``: corners of its rectangle."""
        if any(_overlap(footprint, other) for other in self._footprints) or not self.accept(solids, clear_of_body):
            return False
        self._footprints.append(footprint)
        return True


def _overlap(a: Float[ndarray, "4 2"], b: Float[ndarray, "4 2"]) -> bool:
    """Whether two rectangles overlap: no side of either keeps them apart (separating axes)."""
    sides = np.concatenate([a[1:3] - a[:2], b[1:3] - b[:2]])
    p, q = a @ sides.T, b @ sides.T
    return bool(((p.max(0) > q.min(0)) & (q.max(0) > p.min(0))).all())


def room_shell(rng: np.random.Generator, place: Place, walls_m: tuple[float, float]) -> Solids:
    """Floor z = 0, four walls about the origin and a ceiling around all people and cameras."""
    people, eyes = np.ascontiguousarray(place.points.T), np.concatenate([place.eyes, np.zeros((1, 3))])
    lowest, highest = people.min(1), people.max(1)
    behind = rng.uniform(0.1, 0.6, 4)
    walls = rng.uniform(*walls_m, 4)
    low = -np.maximum(walls[:2], np.maximum(0.1 - lowest[:2], behind[:2] - eyes.min(0)[:2]))
    high = np.maximum(walls[2:], np.maximum(0.1 + highest[:2], behind[2:] + eyes.max(0)[:2]))
    ceiling = max(rng.uniform(2.3, 3.2), highest[2] + 0.1, eyes[:, 2].max() + 0.1)
    return shell((*low, 0.0), (*high, ceiling))


def furnish(
    rng: np.random.Generator, place: Place, room: Solids, count: int, hiding: float, against_walls: bool
) -> list[Solids]:
    """Up to ``count`` pieces on the floor z = 0 of a room along the axes; those without a place are left out.

    Args:
        hiding: probability that a piece is put between a camera and the person.
        against_walls: whether some stand along the walls.
    """
    corners = room.corners.reshape(-1, 3)
    low, high = corners.min(0), corners.max(0)
    pieces = []
    for _ in range(count):
        hides, at_wall = rng.random() < hiding and len(place.eyes) > 0, against_walls and rng.random() < 0.6
        makers: tuple[Maker, ...] = AGAINST_WALLS if at_wall and not hides else FREE_STANDING
        piece = makers[int(rng.integers(len(makers)))](rng)
        around = piece.corners.reshape(-1, 3)
        least, most = around.min(0), around.max(0)
        rectangle = np.array([[least[0], least[1]], [most[0], least[1]], [most[0], most[1]], [least[0], most[1]]])
        for _ in range(_TRIES):
            if hides:
                turn, at = _between(rng, place)
            elif at_wall:
                turn, at = _at_wall(rng, low, high, least, most)
            else:
                turn, at = yaw(rng.uniform(-np.pi, np.pi)), rng.uniform(-_ABOUT_M, _ABOUT_M, 2)
            footprint = rectangle @ turn[:2, :2].T + at
            if (footprint < low[:2]).any() or (footprint > high[:2]).any():
                continue
            moved = piece.moved(turn, np.array([*at, 0.0]))
            if place.stand(moved, footprint):
                pieces.append(moved)
                break
    return pieces


def _between(rng: np.random.Generator, place: Place) -> tuple[Float[ndarray, "3 3"], Float[ndarray, "2"]]:
    """A turn and a place on the floor between a camera and the person."""
    hip = place.joints[JOINT_INDEX["Hip"], :2]
    way = place.eyes[int(rng.integers(len(place.eyes))), :2] - hip
    distance = float(np.linalg.norm(way))
    along = rng.uniform(0.25, max(0.25, distance - CAMERA_CLEARANCE_M)) / max(distance, 1e-6)
    return yaw(rng.uniform(-np.pi, np.pi)), hip + along * way + rng.normal(0, 0.3, 2)


def _at_wall(
    rng: np.random.Generator,
    low: Float[ndarray, "3"], high: Float[ndarray, "3"],
    least: Float[ndarray, "3"], most: Float[ndarray, "3"],
) -> tuple[Float[ndarray, "3 3"], Float[ndarray, "2"]]:  # fmt: skip
    """A turn and a place on the floor with the back to a wall of the room ``low``…``high``."""
    turn = yaw(int(rng.integers(4)) * np.pi / 2).round()
    # The room in the axes of that wall, which is at the high end of y.
    ends = np.stack([low, high]) @ turn
    low, high = ends.min(0), ends.max(0)
    x = rng.uniform(low[0] - least[0], max(high[0] - most[0], low[0] - least[0]))
    y = high[1] - most[1] - rng.uniform(0.001, 0.05)
    return turn, (turn @ [x, y, 0])[:2]


def seat(rng: np.random.Generator, place: Place) -> Solids:
    """A block, with or without a back, under a person who looks seated; nothing under others."""
    at = {name: place.joints[i] for name, i in JOINT_INDEX.items()}
    hips, knees, feet = ((at[f"R{j}"] + at[f"L{j}"]) / 2 for j in ("Hip", "Knee", "Foot"))
    level = all(
        abs(at[f"{s}Knee"][2] - at[f"{s}Hip"][2]) < 0.5 * np.linalg.norm(at[f"{s}Knee"] - at[f"{s}Hip"]) for s in "RL"
    )
    upright = at["Neck"][2] - hips[2] > 0.7 * np.linalg.norm(at["Neck"] - hips)
    if not (level and upright and feet[2] < knees[2] - 0.15):
        return NONE
    back = (hips - knees)[:2]
    turn = yaw(float(np.arctan2(-back[0], back[1])))  # carries y to backwards
    half = rng.uniform([0.17, 0.12], [0.28, 0.18])
    local = (place.points - hips) @ turn
    above = local[(np.abs(local[:, 0]) < half[0]) & (np.abs(local[:, 1]) < half[1]), 2]
    height = hips[2] + float(above.min()) - 0.003 if len(above) else 0.0
    if not 0.2 < height < 0.8:
        return NONE
    block = box((hips[0], hips[1], height / 2), (*half, height / 2), turn)
    top = height + rng.uniform(0.2, 0.55)
    behind = local[(np.abs(local[:, 0]) < half[0]) & (local[:, 2] < top - hips[2]), 1]
    rest = hips + turn @ np.array([0, max(float(behind.max()), half[1]) + 0.03, 0])
    support = box((rest[0], rest[1], top / 2), (half[0], 0.02, top / 2), turn)
    corners = hips[:2] + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half @ turn[:2, :2].T
    for piece in (join([block, support]), block):
        if not piece.hold_any(place.points) and place.stand(piece, corners, clear_of_body=False):
            return piece
    return NONE
