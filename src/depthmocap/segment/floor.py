"""Estimation of the floor plane from depth views."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.frames import View
from depthmocap.geometry import transform_points, z_up_from

#: Only every so many-th pixel is used, for speed.
STRIDE = 4
#: A surface is horizontal if its normal's cosine with the vertical is above this.
LEAST_COSINE = 0.95
#: Width of the bins of the height histogram (metres).
BIN_M = 0.02
#: Points within this distance of the floor plane are its inliers (metres).
INLIER_M = 0.05
#: Least visible surface of a floor (m²).
LEAST_M2 = 0.3
#: Least surface of a floor, as a share of the largest horizontal surface.
LEAST_SHARE = 0.25
#: Greatest tilt of a floor against the rig's up axis (sine); a floor tilted more is taken to be horizontal.
LARGEST_TILT = 0.1


def find_floor(views: Sequence[View], up: str, unseen_m: float = 0.0) -> Float[ndarray, "4 4"]:
    """``floor_from_world`` (4×4): Z up, the floor at z = 0.

    The floor is the lowest large horizontal surface. Without one in view it is at the height ``unseen_m`` of the rig's
    world (metres).

    Args:
        views: of the empty room if possible; people and furniture matter little.
        up: the rig's up axis.
    """
    floor_from_world = np.eye(4)
    floor_from_world[:3, :3] = z_up_from(up)
    unseen = floor_from_world.copy()
    unseen[2, 3] = -unseen_m
    surfaces = [_horizontal_points(view, floor_from_world) for view in views]
    points = np.concatenate([points for points, _ in surfaces]) if surfaces else np.empty((0, 3))
    areas = np.concatenate([areas for _, areas in surfaces]) if surfaces else np.empty(0)
    if areas.sum() < LEAST_M2:
        return unseen
    bins = np.floor(points[:, 2] / BIN_M).astype(int)
    heights = np.bincount(bins - bins.min(), areas)
    heights = np.convolve(heights, np.ones(3), "same")
    large = np.flatnonzero(heights >= max(LEAST_M2, LEAST_SHARE * heights.max()))
    if not len(large):
        return unseen
    # The peak of the lowest run of neighbouring bins.
    stretch = large[: int(np.argmax(np.append(np.diff(large), 2) > 1)) + 1]
    height = (stretch[heights[stretch].argmax()] + bins.min() + 0.5) * BIN_M
    plane = np.array([0.0, 0.0, height])  # z = ax + by + c
    for _ in range(3):
        inliers = np.abs(points[:, 2] - points[:, :2] @ plane[:2] - plane[2]) < INLIER_M
        weights = np.sqrt(areas[inliers])
        terms = np.column_stack([points[inliers, :2], np.ones(inliers.sum())])
        plane = np.linalg.lstsq(terms * weights[:, None], points[inliers, 2] * weights, rcond=None)[0]
    normal = np.array([-plane[0], -plane[1], 1.0])
    normal /= np.linalg.norm(normal)
    if np.hypot(*normal[:2]) > LARGEST_TILT:
        plane, normal = np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 1.0])
    from_level = np.eye(4)
    x = np.cross([0.0, 1.0, 0.0], normal)
    x /= np.linalg.norm(x)
    from_level[:3, :3] = np.stack([x, np.cross(normal, x), normal])
    from_level[2, 3] = -normal[2] * plane[2]
    return from_level @ floor_from_world


def _horizontal_points(
    view: View, floor_from_world: Float[ndarray, "4 4"]
) -> tuple[Float[ndarray, "n 3"], Float[ndarray, " n"]]:
    """Points of horizontal surfaces seen from above, and the surface (m²) of each point."""
    camera = view.camera
    z = view.depth_m[::STRIDE, ::STRIDE].astype(np.float64)
    rays = camera.rays[::STRIDE, ::STRIDE].astype(np.float64)
    points = np.concatenate([rays * z[..., None], z[..., None]], -1)
    points = transform_points(floor_from_world @ camera.world_from_camera, points)
    across, down = points[:-1, 1:] - points[:-1, :-1], points[1:, :-1] - points[:-1, :-1]
    normals = np.cross(down, across)  # towards the camera
    lengths = np.linalg.norm(normals, axis=-1)
    valid = (z[:-1, :-1] > 0) & (z[:-1, 1:] > 0) & (z[1:, :-1] > 0)
    # A longer edge spans a gap between two surfaces.
    connected = np.maximum(np.linalg.norm(across, axis=-1), np.linalg.norm(down, axis=-1)) < 0.25
    with np.errstate(invalid="ignore", divide="ignore"):
        level = valid & connected & (normals[..., 2] / lengths > LEAST_COSINE)
    return points[:-1, :-1][level], lengths[level]
