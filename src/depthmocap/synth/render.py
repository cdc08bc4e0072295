"""Depth and region labels of a posed body, seen by a depth camera."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from depthmocap.body.model import PosedBody
from depthmocap.geometry.cameras import DepthCamera
from depthmocap.geometry.transforms import transform_points
from depthmocap.kernels.raster import rasterise

#: Nothing nearer than this is drawn (metres).
NEAR_M = 0.15


def render_body(
    body: PosedBody, camera: DepthCamera, background_m: Float[ndarray, "h w"] | None = None
) -> tuple[Float[ndarray, "h w"], UInt8[ndarray, "h w"]]:
    """Depth (metres along z, 0 where nothing is) and labels 0–43 of a body, without lens distortion.

    Args:
        background_m: depth of the room the body stands in and may be hidden by, 0 where there is none.
    """
    points = np.ascontiguousarray(transform_points(camera.camera_from_world, body.vertices))
    if background_m is None:
        depth = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
    else:
        depth = np.where(background_m > 0, background_m, np.inf).astype(np.float32)
    face = np.full((camera.height, camera.width), -1, dtype=np.int32)
    rasterise(points, body.faces, camera.fx, camera.fy, camera.cx, camera.cy, depth, face, NEAR_M)
    labels = np.where(face >= 0, body.face_regions[face], 0).astype(np.uint8)
    depth[~np.isfinite(depth)] = 0
    return depth, labels
