"""The floor of a room, from what cameras see of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.frames import View
from depthmocap.geometry import transform_points, z_up_from

#: Every so many pixels are looked at.
EVERY = 4
#: A surface is level if its normal is this near to the vertical (cosine).
LEVEL = 0.95
#: Heights are counted in bins of this; what is in the same floor is within this of it.
BIN_M, NEAR_M = 0.02, 0.05
#: A floor has at least so much of its surface in view, and this share of the largest level surface.
LEAST_M2, LEAST_SHARE = 0.3, 0.25
#: Floors tilted by more than this against the rig's up axis (sine) are not believed.
MOST_TILT = 0.1


def find_floor(views: Sequence[View], up: str) -> Float[ndarray, "4 4"]:
    """``floor_from_world``: Z up, the floor at z = 0. The lowest of the large level surfaces is the floor; where none
    is in view it is taken to be where the rig's world has it, at height 0.

    Args:
        views: of the empty room if possible; people and furniture do not matter much.
        up: the rig's up axis.
    """
    floor_from_world = np.eye(4)
    floor_from_world[:3, :3] = z_up_from(up)
    found = [_level_points(view, floor_from_world) for view in views]
    points = np.concatenate([points for points, _ in found]) if found else np.empty((0, 3))
    areas = np.concatenate([areas for _, areas in found]) if found else np.empty(0)
    if areas.sum() < LEAST_M2:
        return floor_from_world
    bins = np.floor(points[:, 2] / BIN_M).astype(int)
    heights = np.bincount(bins - bins.min(), areas)
    heights = np.convolve(heights, np.ones(3), "same")
    large = np.flatnonzero(heights >= max(LEAST_M2, LEAST_SHARE * heights.max()))
    if not len(large):
        return floor_from_world
    # The peak of the lowest stretch of bins.
    stretch = large[: int(np.argmax(np.append(np.diff(large), 2) > 1)) + 1]
    height = (stretch[heights[stretch].argmax()] + bins.min() + 0.5) * BIN_M
    plane = np.array([0.0, 0.0, height])  # z = ax + by + c
    for _ in range(3):
        near = np.abs(points[:, 2] - points[:, :2] @ plane[:2] - plane[2]) < NEAR_M
        weights = np.sqrt(areas[near])
        terms = np.column_stack([points[near, :2], np.ones(near.sum())])
        plane = np.linalg.lstsq(terms * weights[:, None], points[near, 2] * weights, rcond=None)[0]
    normal = np.array([-plane[0], -plane[1], 1.0])
    normal /= np.linalg.norm(normal)
    if np.hypot(*normal[:2]) > MOST_TILT:
        plane, normal = np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 1.0])
    from_level = np.eye(4)
    x = np.cross([0.0, 1.0, 0.0], normal)
    x /= np.linalg.norm(x)
    from_level[:3, :3] = np.stack([x, np.cross(normal, x), normal])
    from_level[2, 3] = -normal[2] * plane[2]
    return from_level @ floor_from_world


def _level_points(
    view: View, floor_from_world: Float[ndarray, "4 4"]
) -> tuple[Float[ndarray, "n 3"], Float[ndarray, " n"]]:
    """Points of level surfaces that are seen from above, and the surface (m²) that each stands for."""
    camera = view.camera
    z = view.depth_m[::EVERY, ::EVERY].astype(np.float64)
    rays = camera.rays[::EVERY, ::EVERY].astype(np.float64)
    points = np.concatenate([rays * z[..., None], z[..., None]], -1)
    points = transform_points(floor_from_world @ camera.world_from_camera, points)
    across, down = points[:-1, 1:] - points[:-1, :-1], points[1:, :-1] - points[:-1, :-1]
    normals = np.cross(down, across)  # towards the camera
    lengths = np.linalg.norm(normals, axis=-1)
    valid = (z[:-1, :-1] > 0) & (z[:-1, 1:] > 0) & (z[1:, :-1] > 0)
    # A pixel's patch is not longer than what lies between two surfaces is.
    near = np.maximum(np.linalg.norm(across, axis=-1), np.linalg.norm(down, axis=-1)) < 0.25
    with np.errstate(invalid="ignore", divide="ignore"):
        level = valid & near & (normals[..., 2] / lengths > LEVEL)
    return points[:-1, :-1][level], lengths[level]
