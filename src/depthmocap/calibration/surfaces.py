"""Surfaces as points with normals, and the residuals between the surfaces that two cameras see."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial import KDTree

from depthmocap.calibration.pairs import geman_mcclure
from depthmocap.calibration.solve import ResidualRows
from depthmocap.geometry import DepthCamera, transform_points

#: Normals are computed from pixels this far to either side.
_STEP = 3
#: A steeper depth step than that of a surface seen at 79° (its tangent) is an edge.
_EDGE_SLOPE = 5.0
#: Least cosine between normal and line of sight: surfaces seen at more than 75° are too noisy.
_LEAST_VIEW_COSINE = 0.26
#: Least cosine between the normals of corresponding points.
_LEAST_NORMAL_COSINE = 0.85


@dataclasses.dataclass(frozen=True, eq=False)
class Surface:
    """Points (metres) and their normals towards the camera, in the camera's frame or the world."""

    points: Float[ndarray, "n 3"]
    normals: Float[ndarray, "n 3"]

    def to_world(self, world_from_camera: Float[ndarray, "4 4"]) -> Surface:
        """The surface in the world."""
        normals = self.normals @ world_from_camera[:3, :3].T
        return Surface(transform_points(world_from_camera, self.points), normals)

    def subsampled(self, count: int) -> Surface:
        """At most ``count`` of the points, evenly chosen."""
        stride = max(-(-len(self.points) // count), 1)
        return Surface(self.points[::stride], self.normals[::stride])


def extract_surface(
    camera: DepthCamera, depth_m: Float[ndarray, "h w"], stride: int, mask: Bool[ndarray, "h w"] | None = None
) -> Surface:
    """The surface in the camera's frame at every ``stride``-th pixel, where it is smooth.

    Args:
        mask: the pixels to use; by default all with depth.
    """
    z = depth_m.astype(np.float64)
    points = np.concatenate([camera.rays.astype(np.float64) * z[..., None], z[..., None]], -1)
    inner = np.s_[_STEP:-_STEP:stride, _STEP:-_STEP:stride]
    known = (z > 0) & np.isfinite(points[..., 0])
    if mask is not None:
        known &= mask
    right, left = points[:, 2 * _STEP :], points[:, : -2 * _STEP]
    below, above = points[2 * _STEP :], points[: -2 * _STEP]
    across, down = (right - left)[_STEP:-_STEP:stride, ::stride], (below - above)[::stride, _STEP:-_STEP:stride]
    smooth = known[inner]
    middle, after, before = slice(_STEP, -_STEP, stride), slice(2 * _STEP, None, stride), slice(0, -2 * _STEP, stride)
    edge = _EDGE_SLOPE * _STEP / camera.fx * z[inner]
    for neighbour in ((middle, after), (middle, before), (after, middle), (before, middle)):
        smooth &= known[neighbour] & (np.abs(z[neighbour] - z[inner]) < edge)
    normals = np.cross(down[smooth], across[smooth])  # towards the camera
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    surface_points = points[inner][smooth]
    facing = -(normals * surface_points).sum(1) / np.linalg.norm(surface_points, axis=1) > _LEAST_VIEW_COSINE
    return Surface(surface_points[facing], normals[facing])


def surface_rows(
    cameras: tuple[int, int], a: Surface, b: Surface, reach_m: float, expected_m: float, block: int = 0
) -> ResidualRows | None:
    """Residuals between nearest points of two surfaces in the world, along their mean normal.

    Args:
        reach_m: greatest distance of corresponding points (metres).
        expected_m: expected distance along the normal (metres).

    Returns:
        The rows, all in one block; None without corresponding points.
    """
    if not len(a.points) or not len(b.points):
        return None
    neighbour_distances, nearest = KDTree(b.points).query(a.points, distance_upper_bound=reach_m)
    indices_a = np.flatnonzero(np.isfinite(neighbour_distances))
    indices_b = np.asarray(nearest)[indices_a]
    similar = (a.normals[indices_a] * b.normals[indices_b]).sum(1) > _LEAST_NORMAL_COSINE
    indices_a, indices_b = indices_a[similar], indices_b[similar]
    if not len(indices_a):
        return None
    normals = a.normals[indices_a] + b.normals[indices_b]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    distances = np.abs(((a.points[indices_a] - b.points[indices_b]) * normals).sum(1))
    weights = geman_mcclure(distances / expected_m) / expected_m**2
    return ResidualRows(
        cameras, a.points[indices_a], b.points[indices_b], normals, weights, np.full(len(indices_a), block)
    )
