"""All cameras in one world, from the skeletons that they see: pairs first, then everything together."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from depthmocap.calibration.joint_tracks import Skeletons, Track, at_common_times, common_times
from depthmocap.calibration.pairs import Pair, geman_mcclure, relate, usable
from depthmocap.calibration.solve import Rows, equations, meeting_rows, moved
from depthmocap.geometry import rigid_inverse, transform_points

#: Cameras are related if so many shared poses agree, and this share of them.
LEAST_AGREED, LEAST_SHARE = 12, 0.3
#: Errors within so many seconds are alike.
BLOCK_S = 2.0
_ROUNDS, _STILL = 12, 1e-5
#: Poses and lateness take turns, until no camera's changes by more than this (s), so often at most: for somebody who
#: walks in a circle, a turn of the world is much like a shift in time.
_SETTLED_S, _TURNS = 0.0005, 25


@dataclasses.dataclass(frozen=True, eq=False)
class Placement:
    """Cameras by their skeletons.

    Attributes:
        cameras: numbers of those that could be placed, in order.
        poses: ``world_from_camera`` of these; the first stands at the origin of this world.
        late_s: how much later than its timestamps say each of them looks; 0 on average.
        late_sigma_s: the standard error of that.
        pairs: of all cameras that share frames.
    """

    cameras: tuple[int, ...]
    poses: Float[ndarray, "k 4 4"]
    late_s: Float[ndarray, " k"]
    late_sigma_s: Float[ndarray, " k"]
    pairs: dict[tuple[int, int], Pair]
    skeletons: Skeletons


def place(tracks: Sequence[Track], rng: np.random.Generator) -> Placement:
    """Place the largest group of cameras that are related."""
    times_s = common_times(tracks)
    seen = at_common_times(tracks, times_s, np.zeros(len(tracks)))
    pairs: dict[tuple[int, int], Pair] = {}
    for a, b in itertools.combinations(range(len(tracks)), 2):
        found = relate((seen.joints[a], seen.joints[b]), (seen.sigma_m[a], seen.sigma_m[b]), rng)
        if found is not None:
            pairs[a, b] = found
    cameras, poses = _chain(pairs, len(tracks))
    own = [tracks[camera] for camera in cameras]
    late_s = late_sigma_s = np.zeros(len(own))
    seen = at_common_times(own, times_s, late_s)
    for _ in range(_TURNS if len(own) > 1 else 0):
        poses = _solve(poses, seen)
        more_s, late_sigma_s = lateness(poses, seen)
        late_s = late_s + more_s
        seen = at_common_times(own, times_s, late_s)
        if np.abs(more_s).max() < _SETTLED_S:
            break
    return Placement(cameras, _solve(poses, seen), late_s, late_sigma_s, pairs, seen)


def related(pair: Pair) -> bool:
    """Whether a pair may be built on."""
    return pair.agreed >= LEAST_AGREED and pair.agreed >= LEAST_SHARE * pair.shared


def lacking(pair: Pair) -> str:
    """What a pair lacks to be built on."""
    if pair.agreed < LEAST_AGREED:
        return f"only {pair.agreed} poses agree, where {LEAST_AGREED} or more are needed"
    return f"only {pair.agreed} of {pair.shared} poses agree, where {LEAST_SHARE:.0%} or more are needed"


def _chain(pairs: dict[tuple[int, int], Pair], count: int) -> tuple[tuple[int, ...], Float[ndarray, "k 4 4"]]:
    """The largest group of related cameras, and their poses along the pairs that agree most often."""
    links = np.zeros((count, count))
    for (a, b), pair in pairs.items():
        if related(pair):
            links[a, b] = links[b, a] = pair.agreed
    _, group = connected_components(csr_array(links), directed=False)
    sums = [((group == each).sum(), links[group == each].sum()) for each in range(group.max() + 1)]
    cameras = np.flatnonzero(group == max(range(len(sums)), key=sums.__getitem__))
    tree = minimum_spanning_tree(csr_array(-links))
    order, parents = breadth_first_order(tree, int(cameras[0]), directed=False)
    poses = {int(cameras[0]): np.eye(4)}
    for camera in order[1:].tolist():
        parent = int(parents[camera])
        low, high = min(camera, parent), max(camera, parent)
        low_from_high = pairs[low, high].a_from_b
        poses[camera] = poses[parent] @ (low_from_high if parent == low else rigid_inverse(low_from_high))
    return tuple(cameras.tolist()), np.stack([poses[camera] for camera in cameras.tolist()])


def joint_rows(poses: Float[ndarray, "k 4 4"], seen: Skeletons) -> list[Rows]:
    """Rows that say that every joint is where any two cameras see it; blocks are of time."""
    places = [transform_points(pose, joints) for pose, joints in zip(poses, seen.joints, strict=True)]
    blocks = ((seen.times_s - seen.times_s[0]) / BLOCK_S).astype(np.int64)
    known = usable(seen.joints, seen.sigma_m)
    rows = []
    for a, b in itertools.combinations(range(len(poses)), 2):
        both = known[a] & known[b]
        if both.any():
            expected = np.sqrt(seen.sigma_m[a][both] ** 2 + seen.sigma_m[b][both] ** 2)
            rows.append(meeting_rows((a, b), places[a][both], places[b][both], expected, blocks[np.nonzero(both)[0]]))
    return rows


def mean_joints(poses: Float[ndarray, "k 4 4"], seen: Skeletons) -> Float[ndarray, "n 18 3"]:
    """Joints that all cameras together see, in the world; NaN where none does."""
    places = np.stack([transform_points(pose, joints) for pose, joints in zip(poses, seen.joints, strict=True)])
    weights = np.where(usable(seen.joints, seen.sigma_m), 1 / seen.sigma_m**2, 0.0)[..., None]
    with np.errstate(invalid="ignore"):
        return (np.where(weights > 0, places, 0.0) * weights).sum(0) / weights.sum(0)


def _solve(poses: Float[ndarray, "k 4 4"], seen: Skeletons) -> Float[ndarray, "k 4 4"]:
    for _ in range(_ROUNDS):
        twists = equations(joint_rows(poses, seen), len(poses)).twists()
        poses = moved(poses, twists)
        if np.abs(twists).max() < _STILL:
            break
    return poses


def lateness(poses: Float[ndarray, "k 4 4"], seen: Skeletons) -> tuple[Float[ndarray, " k"], Float[ndarray, " k"]]:
    """How much later than its timestamps say each camera still looks (s), 0 on average, and the standard error.

    A camera b that looks later than a by τ sees joints that are further on their way: p_b − p_a = τ v. Velocities are
    as noisy as places, so that least squares would find too little; the product of both cameras' velocities, whose
    errors are their own, in place of the square of one does not (instrumental variables).
    """
    turned = np.einsum("kij,knlj->knli", poses[:, :3, :3], seen.velocities())
    places = np.stack([transform_points(pose, joints) for pose, joints in zip(poses, seen.joints, strict=True)])
    known = usable(seen.joints, seen.sigma_m) & np.isfinite(turned).all(-1)
    blocks = ((seen.times_s - seen.times_s[0]) / BLOCK_S).astype(np.int64)
    count = len(poses)
    # Σ over pairs of (late_b − late_a) m = n, block by block.
    matrices, vectors = np.zeros((blocks[-1] + 1, count, count)), np.zeros((blocks[-1] + 1, count))
    for a, b in itertools.combinations(range(count), 2):
        both = known[a] & known[b]
        apart = places[b][both] - places[a][both]
        variance = seen.sigma_m[a][both] ** 2 + seen.sigma_m[b][both] ** 2
        weights = geman_mcclure(np.linalg.norm(apart, axis=1) / np.sqrt(variance)) / variance
        block = blocks[np.nonzero(both)[0]]
        moving = weights * (turned[a][both] * turned[b][both]).sum(1)
        ahead = weights * (apart * (turned[a][both] + turned[b][both]) / 2).sum(1)
        m, n = (np.bincount(block, each, len(vectors)) for each in (moving, ahead))
        for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
            matrices[:, i, j] += sign * m
        vectors[:, a] -= n
        vectors[:, b] += n
    # The mean is held at 0, which differences leave open.
    inverse = np.linalg.pinv(matrices.sum(0))
    late_s = inverse @ vectors.sum(0)
    left = (vectors - matrices @ late_s) @ inverse.T
    return late_s, np.sqrt((left**2).sum(0))
