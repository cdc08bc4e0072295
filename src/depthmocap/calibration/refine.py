"""Poses made exact by surfaces: where two cameras see the same wall, floor or side of the person, their clouds should
lie on each other.

Nearest points that face the same way are brought together along the normal (iterated closest points), all pairs of
cameras at once, while the joints keep what no surface tells. Skeletons guard against a wrong match: where they fit
worse afterwards, the poses stay what they were.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial import KDTree

from depthmocap.calibration.camera_placement import BLOCK_S, Placement, joint_rows, mean_joints
from depthmocap.calibration.joint_tracks import Skeletons
from depthmocap.calibration.observations import Observation
from depthmocap.calibration.pairs import usable
from depthmocap.calibration.solve import Rows, equations, moved
from depthmocap.calibration.surfaces import Surface, meeting_surfaces
from depthmocap.geometry import transform_points

#: Rounds; reach and the distance to expect shrink from round to round (metres): first, share kept, least.
_ROUNDS, _SHRINK = 18, 0.82
_REACH_M = {"room": (0.2, 0.05), "person": (0.1, 0.03)}
_EXPECTED_M = (0.04, 0.008)
#: Joints of one skeleton, and of neighbouring frames, err alike: they count for fewer than they are.
_JOINT_SHARE = 0.03
#: Surfaces in cells of this size err alike (metres).
_CELL_M = 0.75
#: Fewer points that two cameras see are chance.
LEAST_POINTS = 150
#: Joints may be this much further from each other afterwards (metres): their errors lean one way where the person did
#: not turn, and a wrong match costs much more.
_WORSE_M = 0.02
#: Errors that all skeletons of a camera share, which no repetition tells: along its view, the same for every camera of
#: one network; besides, its own in every direction (metres) and about every axis (radians). Standard deviations, from
#: skeletons of generated people.
_DEEP_M, _OFF_M, _TURNED_RAD = 0.006, 0.003, np.deg2rad(0.2)
_DRAWS = 200


@dataclasses.dataclass(frozen=True, eq=False)
class Refined:
    """Poses, and what they rest on.

    Attributes:
        kept: whether surfaces were used; otherwise the poses are those of the skeletons.
        shared: points of surfaces that a pair has in common.
        apart_m: their median distance along the normal, before and after.
        spread: twists of the poses that are as likely (draws).
    """

    poses: Float[ndarray, "k 4 4"]
    kept: bool
    shared: dict[tuple[int, int], int]
    apart_m: dict[tuple[int, int], tuple[float, float]]
    spread: Float[ndarray, "d k 6"]


class Scene:
    """The surfaces of placed cameras: the room's, and the person's moment by moment."""

    def __init__(self, placement: Placement, seen: Sequence[Observation]) -> None:
        """``seen``: by the placed cameras, in their order."""
        self._rooms = [each.empty_surface() for each in seen]
        joints = mean_joints(placement.poses, placement.skeletons)
        times_s = placement.skeletons.times_s
        speeds = np.gradient(joints, times_s, axis=0)
        self._moments: list[tuple[int, list[Surface | None]]] = []
        for moment in sorted({moment for each in seen for moment in each.person}):
            own = [each.person.get(moment) for each in seen]
            looked = [late + each[0] for late, each in zip(placement.late_s, own, strict=True) if each is not None]
            now_s = float(np.median(looked))
            at = int(np.abs(times_s - now_s).argmin())
            known = np.isfinite(joints[at] + speeds[at]).all(-1)
            if len(looked) < 2 or not known.any():
                continue
            going = joints[at, known], speeds[at, known]
            # As each camera would have seen the person at the same instant.
            surfaces = [
                None if each is None else _carried(each[1], pose, *going, now_s - late - each[0])
                for each, pose, late in zip(own, placement.poses, placement.late_s, strict=True)
            ]
            self._moments.append((int((times_s[at] - times_s[0]) / BLOCK_S), surfaces))

    def rows(self, poses: Float[ndarray, "k 4 4"], index: int = _ROUNDS) -> tuple[list[Rows], list[Rows]]:
        """Rows of the room and of the person, in a round; the person's in the blocks of time that joints are in."""
        expected = _in_round(_EXPECTED_M, index)
        rooms = [room.seen_from(pose) for room, pose in zip(self._rooms, poses, strict=True)]
        pairs = list(itertools.permutations(range(len(poses)), 2))
        reach = _in_round(_REACH_M["room"], index)
        room = [meeting_surfaces((a, b), rooms[a], rooms[b], reach, expected) for a, b in pairs]
        reach, person = _in_round(_REACH_M["person"], index), []
        for block, surfaces in self._moments:
            placed = [each and each.seen_from(pose) for each, pose in zip(surfaces, poses, strict=True)]
            for a, b in pairs:
                one, other = placed[a], placed[b]
                if one is not None and other is not None:
                    person.append(meeting_surfaces((a, b), one, other, reach, expected, block))
        return [each for each in room if each is not None], [each for each in person if each is not None]


def refine(placement: Placement, seen: Sequence[Observation], rng: np.random.Generator) -> Refined:
    """Refine the poses by the surfaces where that leaves the joints together.

    Args:
        seen: by the placed cameras, in their order.
    """
    scene, skeletons, count = Scene(placement, seen), placement.skeletons, len(seen)
    first = exact = placement.poses
    for index in range(_ROUNDS):
        room, person = scene.rows(exact, index)
        exact = moved(exact, equations([*_fewer(joint_rows(exact, skeletons)), *room, *person], count).twists())
    room, person = scene.rows(exact)
    before, after = _in_pairs([row for rows in scene.rows(first) for row in rows]), _in_pairs([*room, *person])
    shared = {pair: len(rows) for pair, rows in after.items() if len(rows) >= LEAST_POINTS}
    kept = bool(shared) and joints_apart_m(exact, skeletons) <= joints_apart_m(first, skeletons) + _WORSE_M
    poses = exact if kept else first
    joints = joint_rows(poses, skeletons)
    if kept:
        joints = _fewer(joints)
    rows = [*joints, *person, *_by_cells(room, joints)] if kept else joints
    apart_m = {pair: (_median(before.get(pair, np.empty(0))), _median(after[pair])) for pair in shared}
    return Refined(poses, kept, shared, apart_m, _spread(poses, skeletons, rows, joints, rng))


def joints_apart_m(poses: Float[ndarray, "k 4 4"], seen: Skeletons) -> float:
    """The median distance of joints that two cameras see."""
    places = [transform_points(pose, joints) for pose, joints in zip(poses, seen.joints, strict=True)]
    known = usable(seen.joints, seen.sigma_m)
    apart = [
        np.linalg.norm(places[a] - places[b], axis=-1)[known[a] & known[b]]
        for a, b in itertools.combinations(range(len(poses)), 2)
    ]
    return float(np.median(np.concatenate(apart)))


def _spread(
    poses: Float[ndarray, "k 4 4"],
    seen: Skeletons,
    rows: Sequence[Rows],
    joints: Sequence[Rows],
    rng: np.random.Generator,
) -> Float[ndarray, "d k 6"]:
    """What the poses could as well be: by chance (a bootstrap), and by errors that all skeletons share."""
    system = equations(rows, len(poses))
    by_joints = equations(joints, len(poses)).matrices.sum(0)
    middle = np.nanmedian(mean_joints(poses, seen), axis=(0, 1))
    views = middle - poses[:, :3, 3]
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    drawn = system.bootstrap(rng, _DRAWS)
    for each in drawn:
        turned = rng.normal(0, _TURNED_RAD, (len(poses), 3))
        off = rng.normal(0, _OFF_M, (len(poses), 3)) + rng.normal(0, _DEEP_M) * views
        # Turned about the person, as a twist about the origin.
        errors = np.concatenate([turned, off - np.cross(turned, middle)], 1)
        each += system.respond(by_joints @ errors.ravel())
    return drawn


def _in_round(bounds: tuple[float, float], index: int) -> float:
    most, least = bounds
    return max(most * _SHRINK**index, least)


def _carried(
    surface: Surface,
    pose: Float[ndarray, "4 4"],
    joints: Float[ndarray, "j 3"],
    speeds: Float[ndarray, "j 3"],
    later_s: float,
) -> Surface:
    """A surface (in the camera's frame) after a moment, each point having gone with the nearest joint."""
    _, nearest = KDTree(joints).query(transform_points(pose, surface.points))
    return Surface(surface.points + later_s * speeds[nearest] @ pose[:3, :3], surface.normals)


def _fewer(rows: Sequence[Rows]) -> list[Rows]:
    return [dataclasses.replace(each, weights=_JOINT_SHARE * each.weights) for each in rows]


def _by_cells(rows: Sequence[Rows], others: Sequence[Rows]) -> list[Rows]:
    """The rows in blocks of space, numbered after those of others."""
    if not rows:
        return []
    first = 1 + max(int(each.blocks.max()) for each in others)
    cells = np.floor(np.concatenate([each.a for each in rows]) / _CELL_M)
    _, blocks = np.unique(cells, axis=0, return_inverse=True)
    parts = np.split(first + blocks.reshape(-1), np.cumsum([len(each.a) for each in rows])[:-1])
    return [dataclasses.replace(each, blocks=part) for each, part in zip(rows, parts, strict=True)]


def _in_pairs(rows: Sequence[Rows]) -> dict[tuple[int, int], Float[ndarray, " n"]]:
    """Distances along the normal by pair, whichever camera was asked first."""
    found: dict[tuple[int, int], list[ndarray]] = {}
    for each in rows:
        pair = min(each.cameras), max(each.cameras)
        found.setdefault(pair, []).append(np.abs(((each.a - each.b) * each.normals).sum(1)))
    return {pair: np.concatenate(parts) for pair, parts in found.items()}


def _median(values: Float[ndarray, " n"]) -> float:
    return float(np.median(values)) if len(values) else float("nan")
