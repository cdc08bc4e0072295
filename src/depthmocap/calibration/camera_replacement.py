"""Places a camera that was moved anew, while the others stay, by the joints of a person whom it and they saw since."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.calibration.camera_placement import BLOCK_S, is_reliable, why_unreliable
from depthmocap.calibration.pairs import align, estimate_pair, geman_mcclure, usable_joints
from depthmocap.calibration.pose_faults import moved
from depthmocap.calibration.verdict import NARROW_M
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, transform_points
from depthmocap.text import camera_list

#: Joints of each camera in its own frame, with their expected error (metres), at a time (seconds).
Moment = tuple[float, Mapping[str, Float[ndarray, "18 4"]]]
#: Solutions from blocks drawn at random, for the uncertainty,
_DRAWS = 50
#: which is so many standard deviations.
_SIGMAS = 3.0
#: What all skeletons of a camera may have in common, standard deviations: position (metres)
_COMMON_M = 0.006
#: and rotation (degrees).
_COMMON_DEG = 0.2
#: A pose that is less certain than this is not used (metres);
_MOST_M = 0.06
#: nor one that is less certain than this (degrees).
_MOST_DEG = 3.0


@dataclasses.dataclass(frozen=True, eq=False)
class Replacement:
    """Where a camera stands now.

    Attributes:
        camera: with its new pose.
        moved_m: how far it has moved: where the person is (metres), and by rotation (``moved_deg``, degrees).
        uncertainty_m: of the new pose, the same (three standard deviations), and ``uncertainty_deg``.
        agreed: number of moments in which its skeleton fits the others'.
    """

    camera: DepthCamera
    moved_m: float
    moved_deg: float
    uncertainty_m: float
    uncertainty_deg: float
    agreed: int

    def __str__(self) -> str:
        return (
            f"camera {self.camera.name!r} is placed anew: it had moved by {100 * self.moved_m:.1f} cm where the person "
            f"is and {self.moved_deg:.1f}° (± {100 * self.uncertainty_m:.1f} cm, {self.uncertainty_deg:.1f}°, by "
            f"{self.agreed} poses)"
        )


def place_anew(
    name: str, cameras: Mapping[str, DepthCamera], moments: Sequence[Moment], rng: np.random.Generator
) -> Replacement:
    """Place a camera by the joints that it and the others saw at the same moments.

    Args:
        cameras: with their poses; those of the others are right.
        moments: since it was moved, in order of time.

    Raises:
        InputError: when there is no such camera, they saw too little of a person, or who moved too little.
    """
    if name not in cameras:
        raise InputError(f"there is no camera {name!r}: there are {camera_list(list(cameras))}")
    shared = [moment for moment in moments if name in moment[1] and len(moment[1].keys() & cameras.keys()) > 1]
    advice = "one person must walk about where it and another camera see the whole body, for 20 s or more"
    if not shared:
        raise InputError(f"camera {name!r} cannot be placed anew: it and others have not seen a person; {advice}")
    times_s = np.array([time_s for time_s, _ in shared])
    seen_m = np.stack([seen[name] for _, seen in shared])
    world, sigma_m = _by_others(name, cameras, shared)
    pair = estimate_pair((world, seen_m[..., :3]), (sigma_m, seen_m[..., 3]), rng)
    if pair is None or not is_reliable(pair):
        lack = "it shares no poses with others" if pair is None else why_unreliable(pair)
        raise InputError(f"camera {name!r} cannot be placed anew: {lack}; {advice}")
    hips = world[np.isfinite(world[:, JOINT_INDEX["Hip"]]).all(1), JOINT_INDEX["Hip"]]
    if np.sqrt(hips.var(0).sum()) < NARROW_M:
        raise InputError(f"camera {name!r} cannot be placed anew: the person stays in one place; {advice}")
    person = np.median(hips, axis=0)
    metres, degrees = _uncertainty(
        pair.a_from_b, times_s, (world, seen_m[..., :3]), (sigma_m, seen_m[..., 3]), person, rng
    )
    if metres > _MOST_M or degrees > _MOST_DEG:
        raise InputError(
            f"camera {name!r} cannot be placed anew: it would be known to {100 * metres:.0f} cm and {degrees:.1f}° "
            f"only; {advice}"
        )
    camera = cameras[name]
    at = transform_points(camera.world_from_camera @ np.linalg.inv(pair.a_from_b), person)
    moved_cm, moved_deg = moved(camera.world_from_camera, pair.a_from_b, at)
    placed = dataclasses.replace(camera, world_from_camera=pair.a_from_b)
    return Replacement(placed, moved_cm / 100, moved_deg, metres, degrees, pair.agreed)


def _by_others(
    name: str, cameras: Mapping[str, DepthCamera], shared: Sequence[Moment]
) -> tuple[Float[ndarray, "n 18 3"], Float[ndarray, "n 18"]]:
    """Joints in the world by the other cameras (metres), and their expected errors."""
    sums, weights = np.zeros((len(shared), 18, 3)), np.zeros((len(shared), 18))
    for i, (_, seen) in enumerate(shared):
        for other in (seen.keys() & cameras.keys()) - {name}:
            joints = seen[other]
            known = usable_joints(joints[:, :3], joints[:, 3])
            weight = np.where(known, 1 / np.maximum(joints[:, 3], 1e-3) ** 2, 0.0)
            points = transform_points(cameras[other].world_from_camera, np.where(known[:, None], joints[:, :3], 0.0))
            sums[i] += weight[:, None] * points
            weights[i] += weight
    with np.errstate(divide="ignore", invalid="ignore"):
        return sums / weights[..., None], 1 / np.sqrt(weights)


def _uncertainty(
    world_from_camera: Float[ndarray, "4 4"],
    times_s: Float[ndarray, " n"],
    joints: tuple[Float[ndarray, "n 18 3"], Float[ndarray, "n 18 3"]],
    sigma_m: tuple[Float[ndarray, "n 18"], Float[ndarray, "n 18"]],
    person: Float[ndarray, "3"],
    rng: np.random.Generator,
) -> tuple[float, float]:
    """Of the pose where the person is (metres) and of its rotation (degrees), by drawing blocks of time."""
    common = usable_joints(joints[0], sigma_m[0]) & usable_joints(joints[1], sigma_m[1])
    a, b = joints[0][common], joints[1][common]
    expected = np.hypot(sigma_m[0][common], sigma_m[1][common])
    distances = np.linalg.norm(a - transform_points(world_from_camera, b), axis=1)
    weights = geman_mcclure(distances / expected) / expected**2
    blocks = (times_s // BLOCK_S).astype(int)[np.nonzero(common)[0]]
    numbers = np.unique(blocks)
    apart, turned = [], []
    for _ in range(_DRAWS):
        counts = np.bincount(rng.choice(len(numbers), len(numbers)), minlength=len(numbers))
        drawn = weights * counts[np.searchsorted(numbers, blocks)]
        change = align(a, b, drawn) @ np.linalg.inv(world_from_camera)
        apart.append(np.linalg.norm(transform_points(change, person) - person))
        turned.append(np.rad2deg(Rotation.from_matrix(change[:3, :3]).magnitude()))
    metres = _SIGMAS * float(np.hypot(np.sqrt(np.mean(np.square(apart))), _COMMON_M))
    return metres, _SIGMAS * float(np.hypot(np.sqrt(np.mean(np.square(turned))), _COMMON_DEG))
