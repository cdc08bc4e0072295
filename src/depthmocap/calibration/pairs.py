"""The relative pose of two cameras: the rigid transform between the skeletons that they see.

The distance of joint j at time t, d = |p_a(t, j) - a_from_b p_b(t, j)|, has the expected square s² = σ_a² + σ_b². The
sum of Geman-McClure's ρ(d / s) is minimised by iteratively reweighted least squares, starting from the best of many
fits to a few frames. Mirrored views and views of another person then have no weight.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

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
    # The orthogonal Procrustes problem (Kabsch): thousands of these make a calibration, so nothing around it.
    u, _, vt = np.linalg.svd((a - middle_a).T @ ((b - middle_b) * normalised[:, None]))
    if np.linalg.det(u) * np.linalg.det(vt) < 0:
        u[:, 2] *= -1
    a_from_b = np.eye(4)
    a_from_b[:3, :3] = u @ vt
    a_from_b[:3, 3] = middle_a - a_from_b[:3, :3] @ middle_b
    return a_from_b


def geman_mcclure(ratio: Float[ndarray, "*n"]) -> Float[ndarray, "*n"]:
    """Robust weights of residuals given in units of their expected size."""
    return 1 / (1 + (ratio / CUT) ** 2) ** 2


@dataclasses.dataclass(frozen=True, eq=False)
class SharedJoints:
    """The joints that both of two cameras see well enough, one after the other.

    Attributes:
        frame_of: the frame of each joint, ascending.
        a, b: in the frame of each camera (metres).
        expected_m: the expected distance of the two.
    """

    frame_of: Int[ndarray, " k"]
    a: Float[ndarray, "k 3"]
    b: Float[ndarray, "k 3"]
    expected_m: Float[ndarray, " k"]

    @classmethod
    def of(
        cls,
        joints: tuple[Float[ndarray, "n 18 3"], Float[ndarray, "n 18 3"]],
        sigma_m: tuple[Float[ndarray, "n 18"], Float[ndarray, "n 18"]],
    ) -> SharedJoints:
        """Of two cameras' skeletons at the same times; without frames that show too few common joints."""
        common = usable_joints(joints[0], sigma_m[0]) & usable_joints(joints[1], sigma_m[1])
        common &= common.sum(1, keepdims=True) >= LEAST_JOINTS
        expected_m = np.sqrt(sigma_m[0][common] ** 2 + sigma_m[1][common] ** 2)
        return cls(np.nonzero(common)[0], joints[0][common], joints[1][common], expected_m)

    def ratios(self, a_from_b: Float[ndarray, "4 4"]) -> Float[ndarray, " k"]:
        """The distances of the joints in units of the expected ones."""
        return np.linalg.norm(self.a - transform_points(a_from_b, self.b), axis=1) / self.expected_m

    def fit(self, rng: np.random.Generator, fits: int, iterations: int) -> Float[ndarray, "4 4"]:
        """``a_from_b`` by so many iterations from the best of so many fits to a few frames. Needs a frame."""
        frames, starts = np.unique(self.frame_of, return_index=True)
        joints_of = np.split(np.arange(len(self.frame_of)), starts[1:])
        weights = 1 / self.expected_m**2
        best, most = np.eye(4), -1.0
        for _ in range(fits):
            drawn = rng.choice(len(frames), min(_FRAMES, len(frames)), replace=False)
            chosen = np.concatenate([joints_of[i] for i in drawn])
            candidate = align(self.a[chosen], self.b[chosen], weights[chosen])
            if (score := float(geman_mcclure(self.ratios(candidate)).sum())) > most:
                best, most = candidate, score
        for _ in range(iterations):
            best = align(self.a, self.b, geman_mcclure(self.ratios(best)) * weights)
        return best


def estimate_pair(
    joints: tuple[Float[ndarray, "n 18 3"], Float[ndarray, "n 18 3"]],
    sigma_m: tuple[Float[ndarray, "n 18"], Float[ndarray, "n 18"]],
    rng: np.random.Generator,
    fits: int = _FITS,
) -> CameraPair | None:
    """The relative pose of two cameras from their skeletons at the same times, from the best of so many initial fits;
    None without a common frame."""
    shared = SharedJoints.of(joints, sigma_m)
    if not len(shared.frame_of):
        return None
    a_from_b = shared.fit(rng, fits, _ITERATIONS)
    distances = shared.ratios(a_from_b) * shared.expected_m
    frames, starts = np.unique(shared.frame_of, return_index=True)
    by_frame = np.split(distances, starts[1:])
    agreed = [of_frame for of_frame in by_frame if np.median(of_frame) < AGREES_M]
    distance = float(np.median(np.concatenate(agreed))) if agreed else float("nan")
    return CameraPair(a_from_b, len(frames), len(agreed), distance)
