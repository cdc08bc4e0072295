"""A person's joints at even times, without jitter: what all measures of movement are taken from."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.signal import butter, sosfiltfilt

from depthmocap.body.landmarks import POINT_JOINTS, POINTS
from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.exporting.gap_filling import fill_gaps
from depthmocap.exporting.timeline import Timeline, check_pauses

#: A second pass over the data lowers a second-order Butterworth filter's cutoff by this factor (Winter 2009, 2.2.4.4).
_TWICE = 0.802
#: Samples that the filter extends a stretch by; shorter stretches stay as they are.
_PADDING = 9
#: Largest cutoff, as a share of half the frame rate.
_LARGEST_CUTOFF = 0.9
#: Tips of the right and the left big toe among the points of the skin.
_TOES = [POINTS.index("RToe"), POINTS.index("LToe")]
#: Two poses further apart than so many frame intervals have a gap between them.
_APART = 1.5


@dataclasses.dataclass(frozen=True, eq=False)
class SteadyJoints:
    """Joints at even times, metres, Y up, NaN in gaps; where the estimator tells them, tips of the right and the left
    big toe, too."""

    times_s: Float[ndarray, " t"]
    joints: Float[ndarray, "t 18 3"]
    frame_s: float
    toes: Float[ndarray, "t 2 3"] | None = None

    def of(self, name: str) -> Float[ndarray, "t 3"]:
        """One joint."""
        return self.joints[:, JOINT_INDEX[name]]

    def timeline(self) -> Timeline:
        """The same as the writers of files take it."""
        return Timeline(self.times_s, self.joints, self.frame_s)


def steady_joints(line: Timeline, cutoff_hz: float, fill_s: float) -> SteadyJoints:
    """Gaps of a joint up to ``fill_s`` are filled, then joints are taken at even times, by linear interpolation between
    neighbouring poses, and low-pass filtered by a Butterworth filter of second order, forwards and backwards. Longer
    gaps stay gaps: what is before and after one is filtered by itself. The same of toes.

    Args:
        cutoff_hz: 0 filters nothing; nor is anything filtered where the frame rate is too low for it.

    Raises:
        InputError: when long pauses would fill the even times with nobody.
    """
    joints = line.joints_y_up
    if line.beside_y_up is not None:
        joints = np.concatenate([joints, joints[:, POINT_JOINTS[_TOES]] + line.beside_y_up[:, _TOES]], 1)
    joints, _ = fill_gaps(line.times_s, joints, fill_s)
    count = int(np.floor((line.times_s[-1] - line.times_s[0]) / line.frame_s + 1e-6)) + 1
    check_pauses(line.times_s, count)
    times_s = line.times_s[0] + np.arange(count) * line.frame_s
    longest_s = max(_APART * line.frame_s, fill_s)
    even = np.full((count, *joints.shape[1:]), np.nan)
    for i in range(joints.shape[1]):
        known = np.flatnonzero(~np.isnan(joints[:, i]).any(-1))
        if not len(known):
            continue
        at = line.times_s[known]
        after = np.clip(np.searchsorted(at, times_s - 1e-9), 0, len(at) - 1)
        before = np.maximum(np.where(at[after] > times_s + 1e-9, after - 1, after), 0)
        inside = (times_s >= at[0] - 1e-9) & (times_s <= at[-1] + 1e-9) & (at[after] - at[before] <= longest_s)
        values = np.stack([np.interp(times_s, at, axis) for axis in joints[known, i].T], axis=1)
        even[inside, i] = values[inside]
    even = low_pass(even, line.frame_s, cutoff_hz)
    toes = None if line.beside_y_up is None else even[:, len(JOINTS) :]
    return SteadyJoints(times_s, even[:, : len(JOINTS)], line.frame_s, toes)


def low_pass(points: Float[ndarray, "t n 3"], frame_s: float, cutoff_hz: float) -> Float[ndarray, "t n 3"]:
    """Points without what is faster than the cutoff, every stretch between gaps by itself."""
    share = cutoff_hz / _TWICE * 2 * frame_s
    if not 0 < share < _LARGEST_CUTOFF:
        return points
    sections = butter(2, share, output="sos")
    smooth = points.copy()
    for i in range(points.shape[1]):
        for first, end in stretches(np.asarray(~np.isnan(points[:, i]).any(-1))):
            if end - first > _PADDING:
                smooth[first:end, i] = sosfiltfilt(sections, points[first:end, i], axis=0)
    return smooth


def stretches(mask: Bool[ndarray, " t"]) -> list[tuple[int, int]]:
    """First index and the one after the last of every stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]
