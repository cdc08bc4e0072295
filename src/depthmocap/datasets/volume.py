"""The space in which a studio's people move, and the empty scene of its cameras as far as it can be known.

Studios record nobody-in-view frames seldom, and people who act on one spot hide the same pixels all the time, so that a
background learnt from the recordings alone would hold them. What lies inside the space and above its floor is
therefore never taken for background.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.segment.background import estimate_background

#: What the floor's depth may be off by, so that it is not taken for something that stands on it.
FLOOR_M = 0.1
#: Depth of the background where a pixel's ray misses the space: nothing there is the person.
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
        """The space around places that joints were at (NaN: unknown); the lowest is on the floor."""
        axis, sign = ("xyz".index(up[-1]), -1.0 if up[0] == "-" else 1.0)
        low, high = np.nanmin(places_world, 0) - room_m, np.nanmax(places_world, 0) + room_m
        floor = low if sign > 0 else high
        floor[axis] += sign * room_m
        return cls(low, high, up)

    def above_floor(self, points_world: Float[ndarray, "*n 3"], by_m: float) -> Bool[ndarray, "*n"]:
        """Whether points are inside, and above the floor by more than this."""
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
    """The empty scene (metres) for ``PersonSegmenter``: what the samples (depth, metres) show at the far end, or where
    the space ends, if that is nearer; and only the latter where it is something that stands in the space.

    Args:
        samples_m: frames of the camera, spread over the recordings.
    """
    seen_m = estimate_background(samples_m)
    exit_m = volume.exit_depth_m(camera)
    points = np.concatenate([camera.rays * seen_m[..., None], seen_m[..., None]], -1).astype(np.float64)
    world = points @ camera.world_from_camera[:3, :3].T + camera.world_from_camera[:3, 3]
    scenery = (seen_m > 0) & ~volume.above_floor(world, FLOOR_M)
    return np.where(scenery, np.minimum(seen_m, exit_m), exit_m).astype(np.float32)
