"""Surfaces that two cameras see of the same thing, and how far they are from each other."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial import KDTree

from depthmocap.calibration.pairs import geman_mcclure
from depthmocap.calibration.solve import Rows
from depthmocap.geometry import DepthCamera, transform_points

#: Directions are of pixels this far to either side; steeper steps between them than of a surface seen at 79° are edges
#: (tangent).
_APART, _STEEP = 3, 5.0
#: Surfaces seen at more than 75° are too noisy (cosine).
_GRAZING = 0.26
#: Surfaces are the same only if they face the same way (cosine).
_ALIKE = 0.85


@dataclasses.dataclass(frozen=True, eq=False)
class Surface:
    """Points and the directions their surface faces, towards the camera; in the camera's frame or the world."""

    points: Float[ndarray, "n 3"]
    normals: Float[ndarray, "n 3"]

    def seen_from(self, world_from_camera: Float[ndarray, "4 4"]) -> Surface:
        """The same in the world."""
        normals = self.normals @ world_from_camera[:3, :3].T
        return Surface(transform_points(world_from_camera, self.points), normals)

    def thinned(self, most: int) -> Surface:
        """Evenly chosen points, so many at most."""
        every = max(-(-len(self.points) // most), 1)
        return Surface(self.points[::every], self.normals[::every])


def surface_of(
    camera: DepthCamera, depth_m: Float[ndarray, "h w"], every: int, mask: Bool[ndarray, "h w"] | None = None
) -> Surface:
    """The surface at every so many pixels, in the camera's frame, where it is smooth around them."""
    z = depth_m.astype(np.float64)
    points = np.concatenate([camera.rays.astype(np.float64) * z[..., None], z[..., None]], -1)
    inner = np.s_[_APART:-_APART:every, _APART:-_APART:every]
    known = (z > 0) & np.isfinite(points[..., 0])
    if mask is not None:
        known &= mask
    right, left = points[:, 2 * _APART :], points[:, : -2 * _APART]
    below, above = points[2 * _APART :], points[: -2 * _APART]
    across, down = (right - left)[_APART:-_APART:every, ::every], (below - above)[::every, _APART:-_APART:every]
    smooth = known[inner]
    middle, after, before = slice(_APART, -_APART, every), slice(2 * _APART, None, every), slice(0, -2 * _APART, every)
    edge = _STEEP * _APART / camera.fx * z[inner]
    for beside in ((middle, after), (middle, before), (after, middle), (before, middle)):
        smooth &= known[beside] & (np.abs(z[beside] - z[inner]) < edge)
    normals = np.cross(down[smooth], across[smooth])  # towards the camera
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found = points[inner][smooth]
    facing = -(normals * found).sum(1) / np.linalg.norm(found, axis=1) > _GRAZING
    return Surface(found[facing], normals[facing])


def meeting_surfaces(
    cameras: tuple[int, int], a: Surface, b: Surface, reach_m: float, expected_m: float, block: int = 0
) -> Rows | None:
    """Rows that say that nearest points of two surfaces, in the world, should meet along the normal.

    Args:
        reach_m: points further apart are of different things.
        expected_m: the distance along the normal to expect of the same thing.

    Returns:
        The rows, all of one block; None where the surfaces have nothing in common.
    """
    if not len(a.points) or not len(b.points):
        return None
    distances, nearest = KDTree(b.points).query(a.points, distance_upper_bound=reach_m)
    near = np.flatnonzero(np.isfinite(distances))
    other = np.asarray(nearest)[near]
    alike = (a.normals[near] * b.normals[other]).sum(1) > _ALIKE
    near, other = near[alike], other[alike]
    if not len(near):
        return None
    normals = a.normals[near] + b.normals[other]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    apart = np.abs(((a.points[near] - b.points[other]) * normals).sum(1))
    weights = geman_mcclure(apart / expected_m) / expected_m**2
    return Rows(cameras, a.points[near], b.points[other], normals, weights, np.full(len(near), block))
