"""Extrinsics of all cameras from the skeletons that they see: first of each pair, then jointly with the time
offsets."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from depthmocap.calibration.joint_tracks import JointTrack, Skeletons, common_times, resample
from depthmocap.calibration.lateness import search_lateness
from depthmocap.calibration.lateness_by_motion import confirm_lateness
from depthmocap.calibration.pairs import CameraPair, estimate_pair, geman_mcclure, usable_joints
from depthmocap.calibration.solve import ResidualRows, apply_twists, normal_equations, point_rows
from depthmocap.geometry import rigid_inverse, transform_points

#: A pair of cameras is reliable if at least this many of its shared poses agree,
LEAST_AGREED = 12
#: and this share of them.
LEAST_SHARE = 0.3
#: Errors within this time (seconds) are correlated: they are in one block of the bootstrap.
BLOCK_S = 2.0
#: Most Gauss–Newton iterations.
_ITERATIONS = 12
#: They end when no twist is larger than this (radians, metres).
_CONVERGED = 1e-5
#: Poses and time offsets are estimated in alternation, until no offset changes by more than this (seconds),
_OFFSETS_CONVERGED_S = 0.0005
#: at most so often: for a person who walks in a circle, a rotation of the world is much like an offset in time.
_ALTERNATIONS = 25
#: The offsets of two cameras have not settled if they still change by more than this (seconds),
_UNSETTLED_S = 0.004
#: and are wrong if they come further from where they started (seconds).
_FARTHEST_S = 0.5


@dataclasses.dataclass(frozen=True, eq=False)
class Placement:
    """Extrinsics by the skeletons alone.

    Attributes:
        cameras: indices of the cameras that could be placed, in order.
        poses: their ``world_from_camera``; the first camera is the origin of this world.
        offset_s: how much later than its timestamps say each of them exposes (seconds); the mean is 0.
        offset_sigma_s: standard error of the offset.
        pairs: of all cameras with common frames.
        untold: pairs of placed cameras (places in ``cameras``) whose time offset cannot be told.
        skeletons: of the placed cameras, at common times.
    """

    cameras: tuple[int, ...]
    poses: Float[ndarray, "k 4 4"]
    offset_s: Float[ndarray, " k"]
    offset_sigma_s: Float[ndarray, " k"]
    pairs: dict[tuple[int, int], CameraPair]
    untold: tuple[tuple[int, int], ...]
    skeletons: Skeletons


def place_cameras(tracks: Sequence[JointTrack], rng: np.random.Generator) -> Placement:
    """Place the largest group of cameras that reliable pairs connect."""
    times_s = common_times(tracks)
    search_rng = rng.spawn(1)[0]
    pairs: dict[tuple[int, int], CameraPair] = {}
    for a, b in itertools.combinations(range(len(tracks)), 2):
        lateness = confirm_lateness(
            search_lateness(tracks[a], tracks[b], search_rng), tracks[a], tracks[b], search_rng.spawn(1)[0]
        )
        two = resample((tracks[a], tracks[b]), times_s, np.array([0.0, lateness.seconds]))
        pair = estimate_pair((two.joints[0], two.joints[1]), (two.sigma_m[0], two.sigma_m[1]), rng)
        if pair is not None:
            pairs[a, b] = dataclasses.replace(pair, late_s=lateness.seconds, time_told=lateness.told)
    cameras, initial_poses, initial_s = _initial_poses(pairs, len(tracks))
    chosen = [tracks[camera] for camera in cameras]
    poses, offset_s = initial_poses, initial_s
    change_s = offset_sigma_s = np.zeros(len(chosen))
    skeletons = resample(chosen, times_s, offset_s)
    for _ in range(_ALTERNATIONS if len(chosen) > 1 else 0):
        poses = _solve(poses, skeletons)
        change_s, offset_sigma_s = estimate_offsets(poses, skeletons)
        offset_s = offset_s + change_s
        if np.ptp(offset_s - initial_s) > _FARTHEST_S:
            break
        skeletons = resample(chosen, times_s, offset_s)
        if np.abs(change_s).max() < _OFFSETS_CONVERGED_S:
            break
    strayed = [
        (a, b)
        for a, b in itertools.combinations(range(len(chosen)), 2)
        if abs((offset_s - initial_s)[a] - (offset_s - initial_s)[b]) > _FARTHEST_S
        or abs(change_s[a] - change_s[b]) > _UNSETTLED_S
    ]
    if strayed:
        poses, offset_s, skeletons = initial_poses, initial_s, resample(chosen, times_s, initial_s)
    untold = [
        (a, b)
        for a, b in itertools.combinations(range(len(chosen)), 2)
        if (a, b) in strayed or ((pair := pairs.get((cameras[a], cameras[b]))) is not None and not pair.time_told)
    ]
    return Placement(cameras, _solve(poses, skeletons), offset_s, offset_sigma_s, pairs, tuple(untold), skeletons)


def is_reliable(pair: CameraPair) -> bool:
    """Whether enough poses of a pair agree to place a camera by it."""
    return pair.agreed >= LEAST_AGREED and pair.agreed >= LEAST_SHARE * pair.shared


def why_unreliable(pair: CameraPair) -> str:
    """What an unreliable pair lacks, for a message."""
    if pair.agreed < LEAST_AGREED:
        return f"only {pair.agreed} poses agree, where {LEAST_AGREED} or more are needed"
    return f"only {pair.agreed} of {pair.shared} poses agree, where {LEAST_SHARE:.0%} or more are needed"


def _initial_poses(
    pairs: dict[tuple[int, int], CameraPair], count: int
) -> tuple[tuple[int, ...], Float[ndarray, "k 4 4"], Float[ndarray, " k"]]:
    """The largest group of connected cameras, and their poses and time offsets (seconds; the mean is 0) along the
    pairs that agree most often."""
    links = np.zeros((count, count))
    for (a, b), pair in pairs.items():
        if is_reliable(pair):
            links[a, b] = links[b, a] = pair.agreed
    _, group = connected_components(csr_array(links), directed=False)
    sizes = [((group == index).sum(), links[group == index].sum()) for index in range(group.max() + 1)]
    cameras = np.flatnonzero(group == max(range(len(sizes)), key=sizes.__getitem__))
    tree = minimum_spanning_tree(csr_array(-links))
    order, parents = breadth_first_order(tree, int(cameras[0]), directed=False)
    poses, late_s = {int(cameras[0]): np.eye(4)}, {int(cameras[0]): 0.0}
    for camera in order[1:].tolist():
        parent = int(parents[camera])
        low, high = min(camera, parent), max(camera, parent)
        low_from_high = pairs[low, high].a_from_b
        late_s[camera] = late_s[parent] + pairs[low, high].late_s * (1 if parent == low else -1)
        poses[camera] = poses[parent] @ (low_from_high if parent == low else rigid_inverse(low_from_high))
    offset_s = np.array([late_s[camera] for camera in cameras.tolist()])
    return (
        tuple(cameras.tolist()),
        np.stack([poses[camera] for camera in cameras.tolist()]),
        offset_s - offset_s.mean(),
    )


def joint_rows(poses: Float[ndarray, "k 4 4"], skeletons: Skeletons) -> list[ResidualRows]:
    """Residuals between the positions of every joint in any two cameras; the blocks are intervals of ``BLOCK_S``."""
    positions = [transform_points(pose, joints) for pose, joints in zip(poses, skeletons.joints, strict=True)]
    blocks = ((skeletons.times_s - skeletons.times_s[0]) / BLOCK_S).astype(np.int64)
    known = usable_joints(skeletons.joints, skeletons.sigma_m)
    rows = []
    for a, b in itertools.combinations(range(len(poses)), 2):
        common = known[a] & known[b]
        if common.any():
            expected = np.sqrt(skeletons.sigma_m[a][common] ** 2 + skeletons.sigma_m[b][common] ** 2)
            rows.append(
                point_rows(
                    (a, b),
                    positions[a][common],
                    positions[b][common],
                    expected,
                    blocks[np.nonzero(common)[0]],
                )
            )
    return rows


def mean_joints(poses: Float[ndarray, "k 4 4"], skeletons: Skeletons) -> Float[ndarray, "n 18 3"]:
    """Mean of the cameras' joints in the world (metres), weighted by their expected errors; NaN without any."""
    positions = np.stack([transform_points(pose, joints) for pose, joints in zip(poses, skeletons.joints, strict=True)])
    weights = np.where(usable_joints(skeletons.joints, skeletons.sigma_m), 1 / skeletons.sigma_m**2, 0.0)[..., None]
    with np.errstate(invalid="ignore"):
        return (np.where(weights > 0, positions, 0.0) * weights).sum(0) / weights.sum(0)


def _solve(poses: Float[ndarray, "k 4 4"], skeletons: Skeletons) -> Float[ndarray, "k 4 4"]:
    for _ in range(_ITERATIONS):
        twists = normal_equations(joint_rows(poses, skeletons), len(poses)).solve()
        poses = apply_twists(poses, twists)
        if np.abs(twists).max() < _CONVERGED:
            break
    return poses


def estimate_offsets(
    poses: Float[ndarray, "k 4 4"], skeletons: Skeletons
) -> tuple[Float[ndarray, " k"], Float[ndarray, " k"]]:
    """Remaining time offset of each camera (seconds; the mean is 0), and its standard error.

    If camera b exposes later than a by τ, its joints are displaced along their motion: p_b − p_a = τ v. Velocities are
    noisy, so that least squares would underestimate τ. The product of the velocities from both cameras, whose errors
    are independent, replaces the square of one (instrumental variables).
    """
    velocities_world = np.einsum("kij,knlj->knli", poses[:, :3, :3], skeletons.velocities())
    positions = np.stack([transform_points(pose, joints) for pose, joints in zip(poses, skeletons.joints, strict=True)])
    known = usable_joints(skeletons.joints, skeletons.sigma_m) & np.isfinite(velocities_world).all(-1)
    blocks = ((skeletons.times_s - skeletons.times_s[0]) / BLOCK_S).astype(np.int64)
    count = len(poses)
    # Σ over pairs of (late_b − late_a) m = n, block by block.
    matrices, vectors = np.zeros((blocks[-1] + 1, count, count)), np.zeros((blocks[-1] + 1, count))
    for a, b in itertools.combinations(range(count), 2):
        common = known[a] & known[b]
        offsets = positions[b][common] - positions[a][common]
        variance = skeletons.sigma_m[a][common] ** 2 + skeletons.sigma_m[b][common] ** 2
        weights = geman_mcclure(np.linalg.norm(offsets, axis=1) / np.sqrt(variance)) / variance
        block = blocks[np.nonzero(common)[0]]
        motion = weights * (velocities_world[a][common] * velocities_world[b][common]).sum(1)
        alignment = weights * (offsets * (velocities_world[a][common] + velocities_world[b][common]) / 2).sum(1)
        m, n = (np.bincount(block, values, len(vectors)) for values in (motion, alignment))
        for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
            matrices[:, i, j] += sign * m
        vectors[:, a] -= n
        vectors[:, b] += n
    # Differences leave the mean undetermined; the pseudo-inverse sets it to 0.
    inverse = np.linalg.pinv(matrices.sum(0))
    offset_s = inverse @ vectors.sum(0)
    residuals = (vectors - matrices @ offset_s) @ inverse.T
    return offset_s, np.sqrt((residuals**2).sum(0))
