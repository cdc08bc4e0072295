"""A scene whose depth tells the time."""

from __future__ import annotations

import numpy as np

from depthmocap.geometry import DepthCamera, Rig


def small_rig(count=4):
    return Rig(tuple(DepthCamera(f"cam{i}", 4, 3, 5.0, 5.0, 1.5, 1.0) for i in range(count)))


class Ramp:
    """Depth is the time in milliseconds."""

    def __init__(self, count=4):
        self.rig = small_rig(count)

    def depth(self, camera, time_s):
        return np.full((3, 4), 1000 + round(time_s * 1000), np.uint16)
