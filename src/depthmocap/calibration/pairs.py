"""The relative pose of two cameras: the rigid transform between the skeletons that they see.

The distance of joint j at time t, d = |p_a(t, j) - a_from_b p_b(t, j)|, has the expected square s² = σ_a² + σ_b². The
sum of Geman-McClure's ρ(d / s) is minimised by iteratively reweighted least squares, starting from the best of many
fits to a few frames. Mirrored views and views of another person then have no weight.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.geometry import transform_points

#: Joints with a larger expected error (metres) are left out.
MOST_SIGMA_M = 0.15
#: Fewest usable joints of a frame.
LEAST_JOINTS = 8
#: Number of initial fits.
_FITS = 200
#: Number of frames in an initial fit.
_FRAMES = 2
#: Scale of the robust weight, in units of the expected distance: residuals beyond it have little weight.
CUT = 2.5
#: A frame agrees if the median distance of its joints is below this (metres).
AGREES_M = 0.12
#: Iterations of reweighted least squares.
_ITERATIONS = 30


@dataclasses.dataclass(frozen=True, eq=False)
class CameraPair:
    """The relative pose of two cameras.

    Attributes:
        a_from_b: 4×4.
        shared: number of frames in which both see the person.
        agreed: number of these in which the skeletons agree.
        distance_m: median distance of the joints in the agreeing frames (metres).
        late_s: how much later than a camera b exposes, roughly (seconds); 0 where little or unknown.
        time_told: False if their timestamps are apart, but it cannot be told by how much.
    """

    a_from_b: Float[ndarray, "4 4"]
    shared: int
    agreed: int
    distance_m: float
    late_s: float = 0.0
    time_told: bool = True


def usable_joints(joints: Float[ndarray, "*n 18 3"], sigma_m: Float[ndarray, "*n 18"]) -> Bool[ndarray, "*n 18"]:
    """Mask of the joints with a small enough expected error."""
    return np.isfinite(joints).all(-1) & (sigma_m < MOST_SIGMA_M)


def align(a: Float[ndarray, "n 3"], b: Float[ndarray, "n 3"], weights: Float[ndarray, " n"]) -> Float[ndarray, "4 4"]:
    """The rigid transform (4×4) from points b to points a by weighted least squares."""
    normalised = weights / weights.sum()
    middle_a, middle_b = normalised @ a, normalised @ b
    rotation = Rotation.align_vectors(a - middle_a, b - middle_b, normalised)[0]
    a_from_b = np.eye(4)
    a_from_b[:3, :3] = rotation.as_matrix()
    a_from_b[:3, 3] = middle_a - a_from_b[:3, :3] @ middle_b
    return a_from_b


def geman_mcclure(ratio: Float[ndarray, "*n"]) -> Float[ndarray, "*n"]:
    """Robust weights of residuals given in units of their expected size."""
    return 1 / (1 + (ratio / CUT) ** 2) ** 2


def estimate_pair(
    joints: tuple[Float[ndarray, "n 18 3"], Float[ndarray, "n 18 3"]],
    sigma_m: tuple[Float[ndarray, "n 18"], Float[ndarray, "n 18"]],
    rng: np.random.Generator,
    fits: int = _FITS,
) -> CameraPair | None:
    """The relative pose of two cameras from their skeletons at the same times, from the best of so many initial fits;
    None without a common frame."""
    common = usable_joints(joints[0], sigma_m[0]) & usable_joints(joints[1], sigma_m[1])
    common &= common.sum(1, keepdims=True) >= LEAST_JOINTS
    frames = np.flatnonzero(common.any(1))
    if not len(frames):
        return None
    frame_of = np.nonzero(common)[0]
    a, b = joints[0][common], joints[1][common]
    expected = np.sqrt(sigma_m[0][common] ** 2 + sigma_m[1][common] ** 2)

    def ratios(a_from_b: Float[ndarray, "4 4"]) -> Float[ndarray, " k"]:
        return np.linalg.norm(a - transform_points(a_from_b, b), axis=1) / expected

    a_from_b, best_score = np.eye(4), -1.0
    for _ in range(fits):
        chosen = np.isin(frame_of, rng.choice(frames, min(_FRAMES, len(frames)), replace=False))
        candidate = align(a[chosen], b[chosen], 1 / expected[chosen] ** 2)
        if (score := float(geman_mcclure(ratios(candidate)).sum())) > best_score:
            a_from_b, best_score = candidate, score
    for _ in range(_ITERATIONS):
        a_from_b = align(a, b, geman_mcclure(ratios(a_from_b)) / expected**2)
    distances = np.full(common.shape, np.nan)
    distances[common] = ratios(a_from_b) * expected
    medians = np.nanmedian(distances[frames], axis=1)
    agreed = medians < AGREES_M
    distance = float(np.nanmedian(distances[frames[agreed]])) if agreed.any() else float("nan")
    return CameraPair(a_from_b, len(frames), int(agreed.sum()), distance)
