"""Refinement of the extrinsics by surfaces: where two cameras see the same wall, floor or side of the person, their
point clouds should coincide.

The iterative closest point method (point to plane) brings nearest points with similar normals together, for all pairs
of cameras at once. Joints constrain what no surface determines. The skeletons also detect wrong matches: if they fit
worse afterwards, the poses stay as they were.
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
from depthmocap.calibration.pairs import usable_joints
from depthmocap.calibration.solve import ResidualRows, apply_twists, normal_equations
from depthmocap.calibration.surfaces import Surface, surface_rows
from depthmocap.geometry import transform_points

#: Iterations.
_ITERATIONS = 18
#: Factor by which reach and expected distance shrink in each iteration.
_SHRINK = 0.82
#: Greatest distance of corresponding points (metres), at first and at last.
_REACH_M = {"room": (0.2, 0.05), "person": (0.1, 0.03)}
#: Expected distance of corresponding points (metres), at first and at last.
_EXPECTED_M = (0.04, 0.008)
#: Weight of the joints: the errors of one skeleton, and of neighbouring frames, are correlated.
_JOINT_WEIGHT = 0.03
#: Size of the cells in which errors of surfaces are correlated (metres): one bootstrap block each.
_CELL_M = 0.75
#: Fewest corresponding points of a pair; fewer are chance.
LEAST_POINTS = 150
#: The median joint distance may grow by this (metres): joint errors have a bias if the person did not turn, and a wrong
#: match costs much more.
_TOLERANCE_M = 0.02
#: Systematic errors of a camera's skeletons, which the bootstrap does not see (standard deviations from generated
#: people): along the line of sight, the same for all cameras, since they have the same network (metres);
_RANGE_SIGMA_M = 0.006
#: in every direction, different for each camera (metres);
_SHIFT_SIGMA_M = 0.003
#: and about every axis, different for each camera (radians).
_ROTATION_SIGMA_RAD = np.deg2rad(0.2)
#: Samples of the uncertainty.
_DRAWS = 200


@dataclasses.dataclass(frozen=True, eq=False)
class RefinedPlacement:
    """The refined poses and their uncertainty.

    Attributes:
        poses: ``world_from_camera``.
        surfaces_used: False if the poses are those of the skeletons alone.
        shared_points: number of corresponding surface points of each pair.
        distances_m: their median distance along the normal, before and after (metres).
        twist_samples: samples of the poses' errors, as twists.
    """

    poses: Float[ndarray, "k 4 4"]
    surfaces_used: bool
    shared_points: dict[tuple[int, int], int]
    distances_m: dict[tuple[int, int], tuple[float, float]]
    twist_samples: Float[ndarray, "d k 6"]


class SurfaceScene:
    """The surfaces that the placed cameras see: of the room, and of the person at many moments."""

    def __init__(self, placement: Placement, observations: Sequence[Observation]) -> None:
        """``observations``: of the placed cameras, in their order."""
        self._rooms = [observation.empty_surface() for observation in observations]
        joints = mean_joints(placement.poses, placement.skeletons)
        times_s = placement.skeletons.times_s
        velocities = np.gradient(joints, times_s, axis=0)
        self._moments: list[tuple[int, list[Surface | None]]] = []
        for moment in sorted({moment for observation in observations for moment in observation.person}):
            timed = [observation.person.get(moment) for observation in observations]
            exposures_s = [
                offset + entry[0] for offset, entry in zip(placement.offset_s, timed, strict=True) if entry is not None
            ]
            now_s = float(np.median(exposures_s))
            nearest = int(np.abs(times_s - now_s).argmin())
            known = np.isfinite(joints[nearest] + velocities[nearest]).all(-1)
            if len(exposures_s) < 2 or not known.any():
                continue
            motion = joints[nearest, known], velocities[nearest, known]
            surfaces = [
                None if entry is None else _motion_compensated(entry[1], pose, *motion, now_s - offset - entry[0])
                for entry, pose, offset in zip(timed, placement.poses, placement.offset_s, strict=True)
            ]
            self._moments.append((int((times_s[nearest] - times_s[0]) / BLOCK_S), surfaces))

    def rows(
        self, poses: Float[ndarray, "k 4 4"], index: int = _ITERATIONS
    ) -> tuple[list[ResidualRows], list[ResidualRows]]:
        """Residuals of the room and of the person in an iteration; the person's are in the blocks of the joints."""
        expected = _annealed(_EXPECTED_M, index)
        rooms = [room.to_world(pose) for room, pose in zip(self._rooms, poses, strict=True)]
        pairs = list(itertools.permutations(range(len(poses)), 2))
        reach = _annealed(_REACH_M["room"], index)
        room = [surface_rows((a, b), rooms[a], rooms[b], reach, expected) for a, b in pairs]
        reach, person = _annealed(_REACH_M["person"], index), []
        for block, surfaces in self._moments:
            placed = [surface and surface.to_world(pose) for surface, pose in zip(surfaces, poses, strict=True)]
            for a, b in pairs:
                one, other = placed[a], placed[b]
                if one is not None and other is not None:
                    person.append(surface_rows((a, b), one, other, reach, expected, block))
        return [rows for rows in room if rows is not None], [rows for rows in person if rows is not None]


def refine(placement: Placement, observations: Sequence[Observation], rng: np.random.Generator) -> RefinedPlacement:
    """Refine the poses by the surfaces, unless the joints then fit worse.

    Args:
        observations: of the placed cameras, in their order.
    """
    scene, skeletons, count = SurfaceScene(placement, observations), placement.skeletons, len(observations)
    initial = refined = placement.poses
    for index in range(_ITERATIONS):
        room, person = scene.rows(refined, index)
        rows = [*_downweighted(joint_rows(refined, skeletons)), *room, *person]
        refined = apply_twists(refined, normal_equations(rows, count).solve())
    room, person = scene.rows(refined)
    before = _distances_by_pair([row for rows in scene.rows(initial) for row in rows])
    after = _distances_by_pair([*room, *person])
    shared_points = {pair: len(rows) for pair, rows in after.items() if len(rows) >= LEAST_POINTS}
    tolerated_m = joint_distance_m(initial, skeletons) + _TOLERANCE_M
    surfaces_used = bool(shared_points) and joint_distance_m(refined, skeletons) <= tolerated_m
    poses = refined if surfaces_used else initial
    joints = joint_rows(poses, skeletons)
    if surfaces_used:
        joints = _downweighted(joints)
    rows = [*joints, *person, *_in_spatial_blocks(room, joints)] if surfaces_used else joints
    distances_m = {pair: (_median(before.get(pair, np.empty(0))), _median(after[pair])) for pair in shared_points}
    samples = _sample_twists(poses, skeletons, rows, joints, rng)
    return RefinedPlacement(poses, surfaces_used, shared_points, distances_m, samples)


def joint_distance_m(poses: Float[ndarray, "k 4 4"], skeletons: Skeletons) -> float:
    """The median distance (metres) between the positions of a joint in two cameras."""
    positions = [transform_points(pose, joints) for pose, joints in zip(poses, skeletons.joints, strict=True)]
    known = usable_joints(skeletons.joints, skeletons.sigma_m)
    distances = [
        np.linalg.norm(positions[a] - positions[b], axis=-1)[known[a] & known[b]]
        for a, b in itertools.combinations(range(len(poses)), 2)
    ]
    return float(np.median(np.concatenate(distances)))


def _sample_twists(
    poses: Float[ndarray, "k 4 4"],
    skeletons: Skeletons,
    rows: Sequence[ResidualRows],
    joints: Sequence[ResidualRows],
    rng: np.random.Generator,
) -> Float[ndarray, "d k 6"]:
    """Samples of the poses' errors: random ones by a bootstrap, plus the systematic errors of skeletons."""
    system = normal_equations(rows, len(poses))
    by_joints = normal_equations(joints, len(poses)).matrices.sum(0)
    middle = np.nanmedian(mean_joints(poses, skeletons), axis=(0, 1))
    views = middle - poses[:, :3, 3]
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    samples = system.bootstrap(rng, _DRAWS)
    for sample in samples:
        rotation = rng.normal(0, _ROTATION_SIGMA_RAD, (len(poses), 3))
        shift = rng.normal(0, _SHIFT_SIGMA_M, (len(poses), 3)) + rng.normal(0, _RANGE_SIGMA_M) * views
        # A rotation about the person, as a twist about the origin.
        errors = np.concatenate([rotation, shift - np.cross(rotation, middle)], 1)
        sample += system.solve_for(by_joints @ errors.ravel())
    return samples


def _annealed(bounds: tuple[float, float], index: int) -> float:
    start, end = bounds
    return max(start * _SHRINK**index, end)


def _motion_compensated(
    surface: Surface,
    pose: Float[ndarray, "4 4"],
    joints: Float[ndarray, "j 3"],
    velocities: Float[ndarray, "j 3"],
    elapsed_s: float,
) -> Surface:
    """A surface (in the camera's frame) after a time, moved with the nearest joint of each point."""
    _, nearest = KDTree(joints).query(transform_points(pose, surface.points))
    return Surface(surface.points + elapsed_s * velocities[nearest] @ pose[:3, :3], surface.normals)


def _downweighted(rows: Sequence[ResidualRows]) -> list[ResidualRows]:
    return [dataclasses.replace(row_set, weights=_JOINT_WEIGHT * row_set.weights) for row_set in rows]


def _in_spatial_blocks(rows: Sequence[ResidualRows], others: Sequence[ResidualRows]) -> list[ResidualRows]:
    """The rows with one block for each cell of space, numbered after the blocks of ``others``."""
    if not rows:
        return []
    first = 1 + max(int(row_set.blocks.max()) for row_set in others)
    cells = np.floor(np.concatenate([row_set.a for row_set in rows]) / _CELL_M)
    _, blocks = np.unique(cells, axis=0, return_inverse=True)
    parts = np.split(first + blocks.reshape(-1), np.cumsum([len(row_set.a) for row_set in rows])[:-1])
    return [dataclasses.replace(row_set, blocks=part) for row_set, part in zip(rows, parts, strict=True)]


def _distances_by_pair(rows: Sequence[ResidualRows]) -> dict[tuple[int, int], Float[ndarray, " n"]]:
    """Distances along the normal (metres) of each pair of cameras, in either order."""
    distances: dict[tuple[int, int], list[ndarray]] = {}
    for row_set in rows:
        pair = min(row_set.cameras), max(row_set.cameras)
        distances.setdefault(pair, []).append(np.abs(((row_set.a - row_set.b) * row_set.normals).sum(1)))
    return {pair: np.concatenate(parts) for pair, parts in distances.items()}


def _median(values: Float[ndarray, " n"]) -> float:
    return float(np.median(values)) if len(values) else float("nan")
