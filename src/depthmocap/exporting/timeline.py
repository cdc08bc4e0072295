"""Poses as arrays in a Y-up world, and their uniform sampling in time, for the animation formats."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.geometry import z_up_from

#: Rotation into the Y-up world of TRC and BVH files from our Z-up world.
Y_UP_FROM_Z_UP = z_up_from("y").T

#: Joints with less confidence were hardly observed: docs/guides/export.md has the measurement.
LEAST_CONFIDENCE = 0.2
#: The frame interval of a recording of a single pose (seconds).
SINGLE_FRAME_S = 1 / 30


@dataclasses.dataclass(frozen=True, eq=False)
class Timeline:
    """A recording's joints (metres, Y up, NaN where unobserved or of low confidence), times from the origin and frame
    interval (seconds)."""

    times_s: Float[ndarray, " t"]
    joints_y_up: Float[ndarray, "t 18 3"]
    frame_s: float


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
    return Timeline(times_s, joints @ (Y_UP_FROM_Z_UP @ z_up_from(up)).T, frame_s)


def uniform_frames(line: Timeline) -> tuple[Int[ndarray, " n"], Bool[ndarray, " n"]]:
    """The index of the pose in each of evenly spaced frames, and whether it is repeated for a lost frame.

    It is the nearest pose, or the last one if none is within half an interval. Regular timestamps give 0, 1, 2, ….

    Raises:
        InputError: when long pauses would fill the file with copies of one pose.
    """
    count = int(np.rint((line.times_s[-1] - line.times_s[0]) / line.frame_s)) + 1
    if count > 20 * len(line.times_s) + 1000:
        longest = int(np.diff(line.times_s).argmax())
        longest_s = line.times_s[longest + 1] - line.times_s[longest]
        raise InputError(
            f"the recording pauses for {longest_s:.0f} s after frame {longest} (from 0), which evenly spaced frames "
            "would fill with copies of it: record its parts one by one, or take out what does not belong to it"
        )
    frame_times_s = line.times_s[0] + np.arange(count) * line.frame_s
    half_s = 0.5 * line.frame_s
    source = np.searchsorted(line.times_s, frame_times_s + half_s, side="right") - 1
    return source, line.times_s[source] < frame_times_s - half_s * (1 + 1e-6)
