"""Poses as arrays in a Y-up world, and their uniform sampling in time, for the animation formats."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.landmarks import POINT_JOINTS
from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.geometry import z_up_from

#: Rotation into the Y-up world of TRC and BVH files from our Z-up world.
Y_UP_FROM_Z_UP = z_up_from("y").T

#: Joints with less confidence were hardly observed: docs/guides/export.md has the measurement.
LEAST_CONFIDENCE = 0.2
#: A point of the skin with less confidence tells nothing of how its bone is turned.
LEAST_POINT_CONFIDENCE = 0.5
#: The frame interval of a recording of a single pose (seconds).
SINGLE_FRAME_S = 1 / 30
#: Smoothing takes frames to be no closer than this (seconds), however wrong the unit of their timestamps.
SHORTEST_FRAME_S = 1e-3


def y_up_from(up: str) -> Float[ndarray, "3 3"]:
    """Rotation into the Y-up world of files from a world whose up axis is "z", "y" or "-y"."""
    return Y_UP_FROM_Z_UP @ z_up_from(up)


@dataclasses.dataclass(frozen=True, eq=False)
class Timeline:
    """A recording's joints (metres, Y up, NaN where unobserved or of low confidence), times from the origin and frame
    interval (seconds); and, where the estimator tells them, points of the skin (``body.landmarks.POINTS``) from their
    joints (metres, Y up, NaN where unknown)."""

    times_s: Float[ndarray, " t"]
    joints_y_up: Float[ndarray, "t 18 3"]
    frame_s: float
    beside_y_up: Float[ndarray, "t 18 3"] | None = None


def timeline(
    poses: Sequence[Pose], up: str, least_confidence: float = LEAST_CONFIDENCE, origin_ns: int | None = None
) -> Timeline:
    """Stack poses whose world has the up axis ``up`` ("z", "y" or "-y").

    ``frame_s`` is the mean interval, with gaps divided into median intervals. The median alone would drift for
    timestamps rounded to milliseconds (33, 33, 34, …).

    Args:
        least_confidence: a joint with less counts as unobserved.
        origin_ns: the timestamp of time 0; by default that of the first pose.

    Raises:
        InputError: when there is no pose, none shows a person, or the timestamps do not increase.
    """
    if not poses:
        raise InputError("there are no poses to write: the recording holds no frames")
    joints = np.stack([pose.joints for pose in poses]).astype(np.float64)
    joints[~np.isfinite(joints).all(-1)] = np.nan
    if np.isnan(joints).all():
        raise InputError(
            f"no person was found in any frame of {len(poses)}: check that the person stands within the range "
            "of the cameras, and that the background frames were taken without the person"
        )
    joints[np.stack([pose.confidence for pose in poses]) < least_confidence] = np.nan
    if np.isnan(joints).all():
        raise InputError(f"no joint of {len(poses)} frames has a confidence of {least_confidence:g}: see pose.csv")
    # Differences of integers: nanoseconds since 1970 do not fit in a double.
    timestamps_ns = np.array([pose.timestamp_ns for pose in poses], dtype=np.int64)
    times_s = (timestamps_ns - (timestamps_ns[0] if origin_ns is None else origin_ns)) * 1e-9
    intervals_s = np.diff(times_s)
    if (intervals_s <= 0).any():
        index = int(np.argmax(intervals_s <= 0)) + 1
        raise InputError(f"the poses' timestamps must increase, but pose {index} is not later than pose {index - 1}")
    frame_s = SINGLE_FRAME_S
    if len(poses) > 1:
        steps = np.maximum(np.rint(intervals_s / np.median(intervals_s)), 1)
        frame_s = float((times_s[-1] - times_s[0]) / steps.sum())
    return Timeline(times_s, joints @ y_up_from(up).T, frame_s, points_beside(poses, up))


def points_beside(poses: Sequence[Pose], up: str) -> Float[ndarray, "t 18 3"] | None:
    """Points of the skin from their joints (m, Y up), NaN where they are unsure; None where no pose has any."""
    if all(pose.points is None for pose in poses):
        return None
    beside = np.full((len(poses), len(POINT_JOINTS), 3), np.nan)
    for row, pose in zip(beside, poses, strict=True):
        if pose.points is not None and pose.points_confidence is not None:
            sure = pose.points_confidence >= LEAST_POINT_CONFIDENCE
            row[sure] = (pose.points - pose.joints[POINT_JOINTS])[sure]
    return beside @ y_up_from(up).T


@dataclasses.dataclass(frozen=True)
class FrameTimes:
    """Evenly spaced frames: the first one's time, the interval (seconds) and their number."""

    start_s: float
    frame_s: float
    count: int

    @property
    def times_s(self) -> Float[ndarray, " n"]:
        """Of every frame."""
        return self.start_s + np.arange(self.count) * self.frame_s


def frame_times(lines: Sequence[Timeline]) -> FrameTimes:
    """Evenly spaced frames from the first pose to the last, at the interval of the longest recording.

    Raises:
        InputError: when long pauses would fill a file with frames of nobody.
    """
    longest = max(lines, key=lambda line: len(line.times_s))
    start_s, end_s = min(line.times_s[0] for line in lines), max(line.times_s[-1] for line in lines)
    count = int(np.rint((end_s - start_s) / longest.frame_s)) + 1
    check_pauses(np.unique(np.concatenate([line.times_s for line in lines])), count)
    return FrameTimes(float(start_s), longest.frame_s, count)


def check_pauses(times_s: Float[ndarray, " n"], count: int) -> None:
    """Refuse poses at these times (seconds) when so many evenly spaced frames from the first to the last hold nobody
    but in a few.

    Raises:
        InputError: with the longest pause.
    """
    if count > 20 * len(times_s) + 1000:
        pause = int(np.diff(times_s).argmax())
        pause_s = times_s[pause + 1] - times_s[pause]
        raise InputError(
            f"the recording pauses for {pause_s:.0f} s after frame {pause} (from 0), which evenly spaced frames "
            "would fill with copies of it: record its parts one by one, or take out what does not belong to it"
        )


def evenly_spaced(line: Timeline, frames: FrameTimes | None = None) -> Timeline:
    """A recording in evenly spaced frames, by default from its first pose on.

    A frame has the nearest pose in time; where none is within half an interval, a frame was lost, and its joints are
    NaN. Regular timestamps keep every pose.

    Raises:
        InputError: as :func:`frame_times`.
    """
    frames = frames or frame_times([line])
    half_s = 0.5 * frames.frame_s
    source = np.searchsorted(line.times_s, frames.times_s + half_s, side="right") - 1
    lost = (source < 0) | (line.times_s[source] < frames.times_s - half_s * (1 + 1e-6))
    joints = np.where(lost[:, None, None], np.nan, line.joints_y_up[source])
    beside = None if line.beside_y_up is None else np.where(lost[:, None, None], np.nan, line.beside_y_up[source])
    return Timeline(frames.times_s, joints, frames.frame_s, beside)
