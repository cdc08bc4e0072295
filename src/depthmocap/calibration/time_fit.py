"""The time offset of two cameras, the drift between their clocks and their relative pose, all at once, from near.

If camera b exposes later than a by τ, its joints are displaced along their motion: p_b - a_from_b⁻¹ p_a = τ v. A turn
of the world does much the same where a person walks in a circle, so that pose and time are solved together, and the
uncertainty of each has that of the other in it. Velocities are noisy, and least squares would underestimate τ: as in
``camera_placement.estimate_offsets``, the product of the velocities from both cameras replaces the square of one. What
is compared with them are velocities in a band: instruments, by which nothing is biased. What is faster than people move
is noise, and what is slower has the errors of a view that come with the posture. The uncertainty is that of sums over
blocks of time, whose errors are taken as independent.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d

from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.pairs import estimate_pair, geman_mcclure, usable_joints
from depthmocap.calibration.solve import apply_twists
from depthmocap.geometry import transform_points

#: Errors within this time (seconds) are correlated.
_BLOCK_S = 1.0
#: Velocities are of a band: what is faster than this (seconds) is noise,
_FAST_S = 0.08
#: and what is slower than this (seconds) has the bias of a view, which depends on the posture.
_SLOW_S = 0.4
#: Most iterations;
_ITERATIONS = 25
#: they end when the offset changes by less than this (seconds).
_CONVERGED_S = 0.0002
#: A fit that comes further from where it started (seconds) is none.
_FARTHEST_S = 0.35
#: Drift can be told of clocks that share at least this (seconds).
DRIFT_SHARED_S = 60.0
#: Fewest blocks of a fit.
_LEAST_BLOCKS = 4
#: Most moments of a fit.
_MOMENTS = 12_000


@dataclasses.dataclass(frozen=True, eq=False)
class TimeFit:
    """The clocks of two cameras.

    Attributes:
        shift_s: to be added to the timestamps of b (seconds), at ``middle_s``.
        sigma_s: its standard error.
        drift: by how much this grows in a second of a's clock (a ratio); 0 where it was not asked for.
        drift_sigma: its standard error.
        middle_s: the middle of the common time, by the clock of a.
        a_from_b: relative pose.
        block_times_s: middles of the blocks of time, by the clock of a.
        late_s: what is left of the offset in each block (seconds), NaN where nobody moved.
        late_sigma_s: its standard error, from the scatter of all.
    """

    shift_s: float
    sigma_s: float
    drift: float
    drift_sigma: float
    middle_s: float
    a_from_b: Float[ndarray, "4 4"]
    block_times_s: Float[ndarray, " k"]
    late_s: Float[ndarray, " k"]
    late_sigma_s: Float[ndarray, " k"]


def shared_times(a: JointTrack, b: JointTrack, shift_s: float) -> Float[ndarray, " n"]:
    """Evenly spaced times, by the clock of a, over the time that both tracks cover; empty without any."""
    period_s = min(float(np.median(np.diff(track.times_s))) for track in (a, b))
    first = max(float(a.times_s[0]), float(b.times_s[0]) + shift_s)
    last = min(float(a.times_s[-1]), float(b.times_s[-1]) + shift_s)
    count = int((last - first) / period_s) + 1 if last > first else 0
    return first + period_s * max(count / _MOMENTS, 1.0) * np.arange(min(count, _MOMENTS))


def fit_time(
    a: JointTrack, b: JointTrack, shift_s: float, rng: np.random.Generator, with_drift: bool = False
) -> TimeFit | None:
    """The fit from an offset that is right to a tenth of a second or so; None if it finds none."""
    times_s = shared_times(a, b, shift_s)
    if len(times_s) < 5:
        return None
    period_s = times_s[1] - times_s[0]
    middle_s, half_s = (times_s[0] + times_s[-1]) / 2, max((times_s[-1] - times_s[0]) / 2, 1e-9)
    along = (times_s - middle_s) / half_s  # -1 to 1
    shift = np.array([shift_s, 0.0])  # at the middle, and half of its change over the whole time
    gaps_s = [float(np.median(np.diff(track.times_s))) for track in (a, b)]
    one, sigma_a = a.interpolate(times_s, gaps_s[0])
    velocity_a = _Velocities.of(one, period_s)
    blocks = ((times_s - times_s[0]) / _BLOCK_S).astype(np.int64)
    pose, system = None, None
    for _ in range(_ITERATIONS):
        other, sigma_b = b.interpolate(times_s - shift[0] - shift[1] * along, gaps_s[1])
        if pose is None:
            pair = estimate_pair((one, other), (sigma_a, sigma_b), rng)
            if pair is None:
                return None
            pose = pair.a_from_b
        system = _System(one, other, sigma_a, sigma_b, velocity_a, _Velocities.of(other, period_s), pose, along, blocks)
        if system.blocks < _LEAST_BLOCKS:
            return None
        change = system.solve(with_drift)
        pose = apply_twists(pose[None], change[None, :6])[0]
        shift = shift + change[6:]
        if abs(shift[0] - shift_s) > _FARTHEST_S:
            return None
        if np.abs(change[6:]).max() < _CONVERGED_S:
            break
    assert pose is not None and system is not None
    covariance = system.covariance(with_drift)
    late_s, late_sigma_s = system.block_offsets()
    block_times_s = times_s[0] + _BLOCK_S * (np.arange(len(late_s)) + 0.5)
    return TimeFit(
        float(shift[0]), float(np.sqrt(covariance[0, 0])), float(shift[1] / half_s),
        float(np.sqrt(covariance[1, 1]) / half_s), float(middle_s), pose, block_times_s, late_s, late_sigma_s,
    )  # fmt: skip


class _System:
    """The equations of a twist of b, of its offset, and of half the change of that offset over the time, by blocks."""

    def __init__(
        self,
        one: Float[ndarray, "n 18 3"],
        other: Float[ndarray, "n 18 3"],
        sigma_a: Float[ndarray, "n 18"],
        sigma_b: Float[ndarray, "n 18"],
        velocity_a: _Velocities,
        velocity_b: _Velocities,
        pose: Float[ndarray, "4 4"],
        along: Float[ndarray, " n"],
        block_of: Int[ndarray, " n"],
    ) -> None:
        moved = transform_points(pose, other)
        common = usable_joints(one, sigma_a) & usable_joints(moved, sigma_b)
        common &= np.isfinite(velocity_a.all).all(-1) & np.isfinite(velocity_b.all).all(-1)
        moment = np.nonzero(common)[0]
        p, q, rotation = one[common], moved[common], pose[:3, :3].T
        v, w = velocity_a.all[common], velocity_b.all[common] @ rotation
        v_band, w_band = velocity_a.band[common], velocity_b.band[common] @ rotation
        expected = np.sqrt(sigma_a[common] ** 2 + sigma_b[common] ** 2)
        weights = geman_mcclure(np.linalg.norm(p - q, axis=1) / expected) / expected**2
        # Columns: the three axes of each joint's residual p - q, by the turn and the displacement of q, and by time:
        # b that is read later by dτ shows what was earlier, q - w dτ.
        jacobian = np.zeros((len(p), 3, 8))
        jacobian[:, :, :3] = -_cross(q)
        jacobian[:, :, 3:6] = np.eye(3)
        instruments = jacobian.copy()
        late = -np.stack([np.ones(len(moment)), along[moment]], 1)
        jacobian[:, :, 6:] = ((v + w) / 2)[:, :, None] * late[:, None, :]
        instruments[:, :, 6:] = ((v_band + w_band) / 2)[:, :, None] * late[:, None, :]
        # Of the other camera's velocities each, since their errors are not those of the band.
        both = weights * ((v_band * w).sum(1) + (w_band * v).sum(1)) / 2
        count = int(block_of[-1]) + 1
        self._matrices = np.zeros((count, 8, 8))
        self._sides = np.zeros((count, 8))
        edges = np.searchsorted(block_of[moment], np.arange(count + 1))
        for block, (first, end) in enumerate(itertools.pairwise(edges.tolist())):
            weighted = instruments[first:end].reshape(-1, 8) * np.repeat(weights[first:end], 3)[:, None]
            self._matrices[block] = weighted.T @ jacobian[first:end].reshape(-1, 8)
            self._matrices[block, 6:, 6:] = (late[first:end] * both[first:end, None]).T @ late[first:end]
            self._sides[block] = weighted.T @ (p - q)[first:end].ravel()
        self.blocks = int((np.diff(edges) > 0).sum())

    def solve(self, with_drift: bool) -> Float[ndarray, " 8"]:
        """What the twist and the two times change by; the second 0 without drift."""
        used = 8 if with_drift else 7
        matrix = self._matrices.sum(0)[:used, :used]
        solution = np.linalg.lstsq(matrix, self._sides.sum(0)[:used], rcond=None)[0]
        # Far from the truth, a step may be too long for what is linear.
        solution[6:] = np.clip(solution[6:], -0.1, 0.1)
        return np.concatenate([solution, np.zeros(8 - used)])

    def covariance(self, with_drift: bool) -> Float[ndarray, "2 2"]:
        """Of the two times, from how the blocks scatter about the solution."""
        used = 8 if with_drift else 7
        matrices, sides = self._matrices[:, :used, :used], self._sides[:, :used]
        inverse = np.linalg.pinv(matrices.sum(0))
        residuals = (sides - matrices @ (inverse @ sides.sum(0))) @ inverse.T
        covariance = np.zeros((2, 2))
        times = residuals[:, 6:]
        covariance[: used - 6, : used - 6] = times.T @ times * self.blocks / max(self.blocks - used, 1)
        return covariance

    def block_offsets(self) -> tuple[Float[ndarray, " k"], Float[ndarray, " k"]]:
        """What is left of the offset in each block alone, with the pose of all, and its standard error."""
        motion, sides = self._matrices[:, 6, 6], self._sides[:, 6]
        moved = motion > 0.05 * np.median(motion[motion > 0]) if (motion > 0).any() else motion > 0
        late_s = np.where(moved, sides / np.where(moved, motion, 1), np.nan)
        # One scale for all: the scatter of sides is as motion, times a variance.
        scale = np.nanmedian(np.abs(late_s) * np.sqrt(np.maximum(motion, 0))) / 0.6745 if moved.any() else 0.0
        return late_s, np.where(moved, scale / np.sqrt(np.where(moved, motion, 1)), np.nan)


@dataclasses.dataclass(frozen=True, eq=False)
class _Velocities:
    """Velocities of joints in their camera's frame (m/s): all of them, and what is left of them in the band."""

    all: Float[ndarray, "n 18 3"]
    band: Float[ndarray, "n 18 3"]

    @classmethod
    def of(cls, joints: Float[ndarray, "n 18 3"], period_s: float) -> _Velocities:
        velocities = np.full_like(joints, np.nan)
        velocities[1:-1] = (joints[2:] - joints[:-2]) / (2 * period_s)
        steady = _smoothed(velocities, _FAST_S / period_s)
        return cls(velocities, steady - _smoothed(steady, _SLOW_S / period_s))


def _smoothed(values: Float[ndarray, "n 18 3"], samples: float) -> Float[ndarray, "n 18 3"]:
    """A Gaussian mean over time of what is known; NaN where nothing is."""
    known = np.isfinite(values)
    total = gaussian_filter1d(np.where(known, values, 0), samples, axis=0, mode="constant")
    weight = gaussian_filter1d(known.astype(np.float64), samples, axis=0, mode="constant")
    return np.where(known, total / np.maximum(weight, 1e-6), np.nan)


def _cross(points: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3 3"]:
    """Matrices of the cross product with each point."""
    x, y, z = points.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).reshape(-1, 3, 3)
