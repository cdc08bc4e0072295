"""The volume in which the people of a studio move, and an estimate of its cameras' background.

Studios seldom record the empty scene, and people who act in one spot hide the same pixels all the time. A background
from the recordings alone would contain them. So nothing inside the volume and above its floor counts as background.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.segment.background import estimate_background

#: Largest error of the floor's depth, metres: points above it by less count as floor.
FLOOR_M = 0.1
#: Depth of the background where a pixel's ray misses the volume, metres: nothing there can be the person.
_NOTHING_M = 1e-3


@dataclasses.dataclass(frozen=True, eq=False)
class Volume:
    """A box in the world (metres) by its lower and upper corner, and the world's up axis; its lower face is the floor
    (its upper one where up is "-y")."""

    low: Float[ndarray, "3"]
    high: Float[ndarray, "3"]
    up: str

    @classmethod
    def around(cls, places_world: Float[ndarray, "n 3"], up: str, room_m: float = 0.6) -> Volume:
        """The volume around joint positions (NaN: unknown); the lowest is on the floor."""
        axis, sign = ("xyz".index(up[-1]), -1.0 if up[0] == "-" else 1.0)
        low, high = np.nanmin(places_world, 0) - room_m, np.nanmax(places_world, 0) + room_m
        floor = low if sign > 0 else high
        floor[axis] += sign * room_m
        return cls(low, high, up)

    def above_floor(self, points_world: Float[ndarray, "*n 3"], by_m: float) -> Bool[ndarray, "*n"]:
        """Whether points are inside, and more than ``by_m`` above the floor."""
        axis = "xyz".index(self.up[-1])
        low, high = self.low.copy(), self.high.copy()
        if self.up[0] == "-":
            high[axis] -= by_m
        else:
            low[axis] += by_m
        return np.asarray(((points_world > low) & (points_world < high)).all(-1))

    def exit_depth_m(self, camera: DepthCamera) -> Float[ndarray, "h w"]:
        """Depth (z, float32) at which each pixel's ray leaves the box; 1 mm where it misses it."""
        rays = np.concatenate([camera.rays, np.ones_like(camera.rays[..., :1])], -1).astype(np.float64)
        rays = rays @ camera.world_from_camera[:3, :3].T  # world steps per metre of depth
        eye = camera.world_from_camera[:3, 3]
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            a, b = (self.low - eye) / rays, (self.high - eye) / rays
        enter, leave = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
        crossed = (leave > np.maximum(enter, 0)) & np.isfinite(leave)
        return np.where(crossed, leave, _NOTHING_M).astype(np.float32)


def scene_background(
    samples_m: Sequence[Float[ndarray, "_ _"]], camera: DepthCamera, volume: Volume
) -> Float[ndarray, "h w"]:
    """The background (metres) for ``PersonSegmenter``: the far depth of the samples, or the end of the volume,
    whichever is nearer; the end of the volume where the samples show something that stands in it.

    Args:
        samples_m: frames of the camera, spread over the recordings.
    """
    far_m = estimate_background(samples_m)
    exit_m = volume.exit_depth_m(camera)
    points = np.concatenate([camera.rays * far_m[..., None], far_m[..., None]], -1).astype(np.float64)
    world = points @ camera.world_from_camera[:3, :3].T + camera.world_from_camera[:3, 3]
    scenery = (far_m > 0) & ~volume.above_floor(world, FLOOR_M)
    return np.where(scenery, np.minimum(far_m, exit_m), exit_m).astype(np.float32)
