"""A plain room as a depth camera sees it: floor, walls, and furniture made of boxes."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.geometry.cameras import DepthCamera

_Point = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Box:
    """A box along the world's axes, from its lowest to its highest corner (metres)."""

    low: _Point
    high: _Point


@dataclasses.dataclass(frozen=True)
class Room:
    """The inside of a shell (floor, walls, ceiling) and the boxes that stand in it."""

    shell: Box
    boxes: tuple[Box, ...] = ()


def table(low: tuple[float, float], high: tuple[float, float], height_m: float) -> tuple[Box, ...]:
    """A table over a rectangle of the floor: a top 4 cm thick on four legs 6 cm wide."""
    top = Box((*low, height_m - 0.04), (*high, height_m))
    legs = (
        Box((x, y, 0.0), (x + 0.06, y + 0.06, height_m - 0.04))
        for x in (low[0], high[0] - 0.06)
        for y in (low[1], high[1] - 0.06)
    )
    return top, *legs


def shelf(low: tuple[float, float], high: tuple[float, float], height_m: float, boards: int) -> tuple[Box, ...]:
    """An open shelf over a rectangle of the floor: boards 3 cm thick between the sides at its two ends along y."""
    heights = np.linspace(0.03, height_m, boards)
    levels = (Box((*low, float(z) - 0.03), (*high, float(z))) for z in heights)
    sides = (Box((low[0], y, 0.0), (high[0], y + 0.03, height_m)) for y in (low[1], high[1] - 0.03))
    return *levels, *sides


def render_room(room: Room, camera: DepthCamera) -> Float[ndarray, "h w"]:
    """Exact depth (metres along z, float32) of the room, lens distortion included, by casting every pixel's ray.

    Raises:
        ValueError: when the camera is not inside the shell.
    """
    eye = camera.world_from_camera[:3, 3]
    if not (np.all(eye > room.shell.low) and np.all(eye < room.shell.high)):
        raise ValueError(f"camera {camera.name!r} at {eye.round(2)} must be inside the room's shell {room.shell}")
    rays = np.concatenate([camera.rays, np.ones((camera.height, camera.width, 1))], -1)  # of depth 1
    rays = rays @ camera.world_from_camera[:3, :3].T
    depth = _span(room.shell, eye, rays)[1]
    for box in room.boxes:
        enter, leave = _span(box, eye, rays)
        depth = np.where((enter < leave) & (enter > 0), np.minimum(depth, enter), depth)
    return depth.astype(np.float32)


def _span(
    box: Box, eye: Float[ndarray, "3"], rays: Float[ndarray, "h w 3"]
) -> tuple[Float[ndarray, "h w"], Float[ndarray, "h w"]]:
    """Depths at which rays enter and leave a box; a ray that misses it leaves before it enters."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (np.array(box.low) - eye) / rays, (np.array(box.high) - eye) / rays
    # A ray that runs within a face's plane (0/0) is not limited by that pair of faces.
    enter, leave = np.fmin(a, b), np.fmax(a, b)
    return (
        np.where(np.isnan(enter), -np.inf, enter).max(-1),
        np.where(np.isnan(leave), np.inf, leave).min(-1),
    )
