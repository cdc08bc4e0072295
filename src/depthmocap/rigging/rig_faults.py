"""What is wrong with cameras while a rig is set up, in words."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.cameras.source import ConnectedCamera
from depthmocap.geometry import Rig
from depthmocap.realtime.status import CameraStatus
from depthmocap.rigging.walk_observer import Sight
from depthmocap.text import camera_list

#: Cameras nearer to each other than this (metres),
SAME_M = 0.05
#: and turned by less (degrees), look at the same from one place.
SAME_DEG = 3.0
#: Every so many-th row is compared.
_ROW_STEP = 8
#: Frames after which a camera that has seen nobody is told.
_PATIENCE = 60
#: Share of a picture that must have depth.
_LEAST_DEPTH = 0.05


def connection_faults(connected: Sequence[ConnectedCamera], failures: Mapping[str, str]) -> list[str]:
    """What the search for connected cameras tells: USB, permissions, an SDK that is missing."""
    lines = [f"{camera.spec}: {camera.problem}" for camera in connected if camera.problem]
    return [*lines, *(f"{kind}: {reason}" for kind, reason in failures.items())]


def camera_faults(
    statuses: Sequence[CameraStatus], sights: Mapping[str, Sight], seen: Mapping[str, tuple[int, int]]
) -> dict[str, str]:
    """What is wrong with each camera that has something wrong, by name."""
    faults = {}
    anybody = any(count for count, _ in seen.values())
    for status in statuses:
        count, frames = seen.get(status.name, (0, 0))
        sight = sights.get(status.name)
        if status.state not in ("running", "opening", "at its end"):
            faults[status.name] = status.state
        elif sight is not None and np.count_nonzero(sight.depth_m) < _LEAST_DEPTH * sight.depth_m.size:
            faults[status.name] = "hardly a pixel has depth: is it too near to something, covered, or in the sun?"
        elif anybody and not count and frames >= _PATIENCE:
            faults[status.name] = "it has not seen the person yet: turn it to where the others look"
    return faults


def same_pictures(sights: Mapping[str, Sight]) -> list[str]:
    """Cameras that give the same picture: one device twice."""
    return [
        f"{camera_list([a, b])} give the same picture: one device is named twice"
        for a, b in itertools.combinations(sights, 2)
        if sights[a].depth_m.any() and _equal(sights[a].depth_m, sights[b].depth_m)
    ]


def _equal(a: ndarray, b: ndarray) -> bool:
    return a.shape == b.shape and np.array_equal(a[::_ROW_STEP], b[::_ROW_STEP])


def same_views(rig: Rig) -> list[str]:
    """Cameras that stand at one place and look the same way, so that one of them tells nothing new."""
    lines = []
    for a, b in itertools.combinations(rig.cameras, 2):
        apart = np.linalg.inv(a.world_from_camera) @ b.world_from_camera
        turned_deg = np.rad2deg(Rotation.from_matrix(apart[:3, :3]).magnitude())
        if np.linalg.norm(apart[:3, 3]) < SAME_M and turned_deg < SAME_DEG:
            lines.append(
                f"{camera_list([a.name, b.name])} see the same from one place: put one where it sees the other side"
            )
    return lines
