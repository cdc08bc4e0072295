"""How two cameras stand to each other: the rigid motion that brings one's skeletons onto the other's.

The distance of joint j at time t, d = |p_a(t, j) - a_from_b p_b(t, j)|, is expected to be s² = σ_a² + σ_b². The sum
of Geman-McClure's ρ(d / s) is minimised by reweighted least squares, from the best of many fits to a few frames each:
views whose left and right are exchanged, or that show somebody else, then count for nothing.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.geometry import transform_points

#: Joints that the network is less sure of than this do not count (metres); a frame has at least so many others.
MOST_SIGMA_M, LEAST_JOINTS = 0.15, 8
#: First fits, and frames that each is to.
_FITS, _FRAMES = 200, 2
#: Distances are judged in units of what is expected; beyond this many they hardly count.
CUT = 2.5
#: A frame agrees when half of its joints are within this of each other (metres).
AGREES_M = 0.12
_ROUNDS = 30


@dataclasses.dataclass(frozen=True, eq=False)
class Pair:
    """Two cameras' relation.

    Attributes:
        a_from_b: rigid motion.
        shared: frames that show the person to both.
        agreed: those of them in which the skeletons agree.
        distance_m: the median distance of joints in these.
    """

    a_from_b: Float[ndarray, "4 4"]
    shared: int
    agreed: int
    distance_m: float


def usable(joints: Float[ndarray, "*n 18 3"], sigma_m: Float[ndarray, "*n 18"]) -> Bool[ndarray, "*n 18"]:
    """Joints that are known well enough."""
    return np.isfinite(joints).all(-1) & (sigma_m < MOST_SIGMA_M)


def align(a: Float[ndarray, "n 3"], b: Float[ndarray, "n 3"], weights: Float[ndarray, " n"]) -> Float[ndarray, "4 4"]:
    """The rigid motion that takes points b to points a with least weighted squares."""
    share = weights / weights.sum()
    middle_a, middle_b = share @ a, share @ b
    rotation = Rotation.align_vectors(a - middle_a, b - middle_b, share)[0]
    a_from_b = np.eye(4)
    a_from_b[:3, :3] = rotation.as_matrix()
    a_from_b[:3, 3] = middle_a - a_from_b[:3, :3] @ middle_b
    return a_from_b


def geman_mcclure(ratio: Float[ndarray, "*n"]) -> Float[ndarray, "*n"]:
    """Weights of residuals, given in units of what is expected."""
    return 1 / (1 + (ratio / CUT) ** 2) ** 2


def relate(
    joints: tuple[Float[ndarray, "n 18 3"], Float[ndarray, "n 18 3"]],
    sigma_m: tuple[Float[ndarray, "n 18"], Float[ndarray, "n 18"]],
    rng: np.random.Generator,
) -> Pair | None:
    """How two cameras stand to each other, from their skeletons at the same times; None where they share no frame."""
    both = usable(joints[0], sigma_m[0]) & usable(joints[1], sigma_m[1])
    both &= both.sum(1, keepdims=True) >= LEAST_JOINTS
    frames = np.flatnonzero(both.any(1))
    if not len(frames):
        return None
    frame_of = np.nonzero(both)[0]
    a, b = joints[0][both], joints[1][both]
    expected = np.sqrt(sigma_m[0][both] ** 2 + sigma_m[1][both] ** 2)

    def ratios(a_from_b: Float[ndarray, "4 4"]) -> Float[ndarray, " k"]:
        return np.linalg.norm(a - transform_points(a_from_b, b), axis=1) / expected

    best, most = np.eye(4), -1.0
    for _ in range(_FITS):
        chosen = np.isin(frame_of, rng.choice(frames, min(_FRAMES, len(frames)), replace=False))
        tried = align(a[chosen], b[chosen], 1 / expected[chosen] ** 2)
        if (score := float(geman_mcclure(ratios(tried)).sum())) > most:
            best, most = tried, score
    for _ in range(_ROUNDS):
        best = align(a, b, geman_mcclure(ratios(best)) / expected**2)
    distances = np.full(both.shape, np.nan)
    distances[both] = ratios(best) * expected
    typical = np.nanmedian(distances[frames], axis=1)
    agreed = typical < AGREES_M
    distance = float(np.nanmedian(distances[frames[agreed]])) if agreed.any() else float("nan")
    return Pair(best, len(frames), int(agreed.sum()), distance)
