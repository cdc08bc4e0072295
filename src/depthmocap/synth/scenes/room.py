"""A plain room as a depth camera sees it: floor, walls, and furniture made of boxes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.synth.scenes.solids import Solids, box, join, shell

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
    depth = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
    solids = join([shell(room.shell.low, room.shell.high), box_solids(room.boxes)])
    solids.draw(camera, depth, np.empty(depth.shape, dtype=np.uint8))
    return depth


def box_solids(boxes: Iterable[Box]) -> Solids:
    """The boxes as solids to draw."""
    sides = [(np.array(b.low), np.array(b.high)) for b in boxes]
    return join(box((low + high) / 2, (high - low) / 2) for low, high in sides)
