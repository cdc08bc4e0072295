"""Points of the skin behind a filter over time: they stay where they were seen beside their joints."""

from __future__ import annotations

import collections
import dataclasses

from depthmocap.body.landmarks import POINT_JOINTS
from depthmocap.frames import Pose

#: No filter waits for so many frames.
_LONGEST = 256


class PointCarrier:
    """Remembers poses as they were measured, and moves the points of filtered ones along with their joints."""

    def __init__(self) -> None:
        self._measured: collections.OrderedDict[int, Pose] = collections.OrderedDict()

    def reset(self) -> None:
        """Forget the past."""
        self._measured.clear()

    def add(self, pose: Pose) -> None:
        """Remember a measured pose, if it has points."""
        if pose.points is None:
            return
        self._measured[pose.timestamp_ns] = pose
        if len(self._measured) > _LONGEST:
            self._measured.popitem(last=False)

    def carried(self, pose: Pose) -> Pose:
        """A filtered pose with the points that were measured at its time, moved as its joints were."""
        measured = self._measured.get(pose.timestamp_ns)
        if measured is None or measured.points is None:
            return dataclasses.replace(pose, points=None, points_confidence=None)
        points = measured.points + (pose.joints - measured.joints)[POINT_JOINTS]
        return dataclasses.replace(pose, points=points, points_confidence=measured.points_confidence)
