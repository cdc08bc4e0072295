"""Short gaps of points filled by interpolation over time."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

#: What files say of how gaps were filled.
METHOD = "cubic Hermite interpolation over time, from the positions and velocities before and after the gap"
#: What times in files are rounded to (s).
_ROUNDED_S = 1e-6


def fill_gaps(
    times_s: Float[ndarray, " t"], points: Float[ndarray, "t n 3"], longest_s: float
) -> tuple[Float[ndarray, "t n 3"], Bool[ndarray, "t n"]]:
    """Points with gaps filled that last up to ``longest_s`` seconds, and the mask of those that were filled.

    A gap lasts from the last time at which the point is known to the next one; before the first and after the last
    nothing is filled. A cubic goes through the positions at both ends, with the velocities of the intervals beside the
    gap; where such an interval is a long gap itself, with the gap's mean velocity.

    Args:
        points: NaN where unknown.
    """
    filled = np.zeros(points.shape[:2], bool)
    if not longest_s > 0:
        return points, filled
    longest_s += _ROUNDED_S
    points = points.copy()
    for i in range(points.shape[1]):
        known = np.flatnonzero(~np.isnan(points[:, i]).any(-1))
        for k in np.flatnonzero(np.diff(known) > 1):
            before, after = int(known[k]), int(known[k + 1])
            if times_s[after] - times_s[before] <= longest_s:
                inside = np.arange(before + 1, after)
                beside = known[max(k - 1, 0) : k + 3]
                points[inside, i] = _cubic(times_s, points[:, i], inside, beside, longest_s)
                filled[inside, i] = True
    return points, filled


def _cubic(
    times_s: Float[ndarray, " t"],
    points: Float[ndarray, "t 3"],
    inside: Int[ndarray, " g"],
    beside: Int[ndarray, " k"],
    longest_s: float,
) -> Float[ndarray, "g 3"]:
    """Points inside a gap. ``beside`` are the two to four known frames around it, in order."""
    from scipy.interpolate import CubicHermiteSpline

    ends = [int(inside[0]) - 1, int(inside[-1]) + 1]

    def velocity(first: int, second: int) -> Float[ndarray, "3"]:
        return (points[second] - points[first]) / (times_s[second] - times_s[first])

    velocities = [velocity(*ends)] * 2
    if beside[0] < ends[0] and times_s[ends[0]] - times_s[beside[0]] <= longest_s:
        velocities[0] = velocity(int(beside[0]), ends[0])
    if beside[-1] > ends[1] and times_s[beside[-1]] - times_s[ends[1]] <= longest_s:
        velocities[1] = velocity(ends[1], int(beside[-1]))
    return CubicHermiteSpline(times_s[ends], points[ends], velocities)(times_s[inside])
