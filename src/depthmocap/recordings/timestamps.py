"""Timestamps of several cameras: the frame period, the frames that form one set, and gaps."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from depthmocap.errors import InputError

#: Frame period of recordings too short to tell theirs (ns): 30 frames a second.
DEFAULT_PERIOD_NS = 33_333_333
#: Shortest possible frame period (ns): 10,000 frames a second, ten times more than any depth camera.
SHORTEST_PERIOD_NS = 100_000
#: A gap longer than this (ns) is a pause of the recording: it is reported, and not filled with empty sets.
LONGEST_FILLED_GAP_NS = 10_000_000_000


@dataclasses.dataclass(frozen=True)
class StampSet:
    """The frames of one instant: each camera's own timestamp, by camera name, and the median of these with the
    cameras' time offsets."""

    timestamp_ns: int
    stamps: Mapping[str, int]


def frame_period_ns(stamps: Mapping[str, Sequence[int]]) -> int:
    """Frame period of the fastest camera (ns): the smallest of the cameras' median intervals, 30 Hz without intervals.

    It is the smallest because a camera that drops every other frame must not halve the rate of the others. Cameras
    with less than a tenth of the frames of the longest one are ignored, because their few intervals are not reliable.
    """
    most = max(map(len, stamps.values()), default=0)
    trusted = [np.diff(np.array(s, np.int64)) for s in stamps.values() if len(s) > 1 and 10 * len(s) >= most]
    return min((max(1, int(np.median(intervals))) for intervals in trusted), default=DEFAULT_PERIOD_NS)


def check_unit(path: Path, period_ns: int) -> None:
    """Check that timestamps can be nanoseconds, and not frame counts or another unit.

    Raises:
        InputError: when frames follow each other too soon.
    """
    if period_ns < SHORTEST_PERIOD_NS:
        raise InputError(
            f"{path}: its frames are {period_ns} ns apart, {1e9 / period_ns:,.0f} a second: timestamps must be in "
            "nanoseconds (milliseconds × 1000000), of one clock, and no counts of frames"
        )


def group_stamps(
    stamps: Mapping[str, Sequence[int]], period_ns: int, offsets_ns: Mapping[str, int] | None = None
) -> list[StampSet]:
    """Sets of frames within half a period of each other, at most one for each camera, in order of time.

    One pass over all timestamps in order: a set takes every frame up to half a period after its first.

    Args:
        offsets_ns: time offset of each camera, which is added to its timestamps; by default none.
    """
    offsets_ns = offsets_ns or dict.fromkeys(stamps, 0)
    ordered = sorted(
        (stamp + offsets_ns[name], name) for name, camera_stamps in stamps.items() for stamp in camera_stamps
    )
    groups: list[dict[str, int]] = []
    first = 0
    for stamp, name in ordered:
        if not groups or name in groups[-1] or 2 * (stamp - first) > period_ns:
            groups.append({})
            first = stamp
        groups[-1][name] = stamp
    sets: list[StampSet] = []
    for group in groups:
        ordered_stamps = sorted(group.values())
        median = (ordered_stamps[(len(ordered_stamps) - 1) // 2] + ordered_stamps[len(ordered_stamps) // 2]) // 2
        if sets:  # time must advance even when two cameras' equal stamps fall in neighbouring sets
            median = max(median, sets[-1].timestamp_ns + 1)
        sets.append(StampSet(median, {name: stamp - offsets_ns[name] for name, stamp in group.items()}))
    return sets


def add_empty_sets(sets: Sequence[StampSet], period_ns: int) -> tuple[list[StampSet], list[str]]:
    """Add empty sets where no camera delivered for 1.5 periods; returns the sets and a line for each longer gap."""
    filled: list[StampSet] = []
    problems: list[str] = []
    for stamp_set in sets:
        gap = stamp_set.timestamp_ns - filled[-1].timestamp_ns if filled else 0
        if gap > LONGEST_FILLED_GAP_NS:
            problems.append(f"no camera has a frame for {gap / 1e9:.1f} s before {stamp_set.timestamp_ns}; not filled")
        elif 2 * gap > 3 * period_ns:
            start, count = filled[-1].timestamp_ns, round(gap / period_ns)
            filled.extend(StampSet(start + gap * i // count, {}) for i in range(1, count))
        filled.append(stamp_set)
    return filled, problems


def check_clocks(
    path: Path, stamps: Mapping[str, Sequence[int]], period_ns: int, offsets_ns: Mapping[str, int]
) -> None:
    """Check that the time spans of the cameras overlap or join, because otherwise their clocks differ.

    Args:
        offsets_ns: time offset of each camera, which is added to its timestamps.

    Raises:
        InputError: when a camera starts after all earlier ones have ended; the message names it.
    """
    spans = sorted(
        (camera_stamps[0] + offsets_ns[name], camera_stamps[-1] + offsets_ns[name], name)
        for name, camera_stamps in stamps.items()
    )
    end, last = spans[0][1], spans[0][2]
    for start, stop, name in spans[1:]:
        if start - end > period_ns:
            raise InputError(
                f"{path}: the frames of camera {name!r} start {(start - end) / 1e9:.3f} s after the last of camera "
                f"{last!r}: their clocks differ. File names must be timestamps of one clock in ns; give the difference "
                "as time_offset_s in rig.json, or take it out of rig.json"
            )
        if stop > end:
            end, last = stop, name
