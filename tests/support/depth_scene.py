"""A room with a floor, a back wall, a crate and a person of ellipsoids, seen by noisy depth cameras."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt16
from numpy import ndarray

from depthmocap.geometry import DepthCamera, look_at

#: Centre (metres, person standing at the origin, floor z = 0) and half-axes of each part.
_PARTS = (
    ((0, 0, 1.65), (0.09, 0.1, 0.13)),  # head
    ((0, 0, 1.2), (0.2, 0.13, 0.36)),  # trunk
    ((-0.28, 0, 1.15), (0.055, 0.055, 0.33)),  # arms
    ((0.28, 0, 1.15), (0.055, 0.055, 0.33)),
    ((-0.1, 0, 0.5), (0.09, 0.09, 0.5)),  # legs
    ((0.1, 0, 0.5), (0.09, 0.09, 0.5)),
    ((-0.1, -0.06, 0.04), (0.05, 0.13, 0.05)),  # feet
    ((0.1, -0.06, 0.04), (0.05, 0.13, 0.05)),
)
_CRATE = ((0.9, 2.6, 0.2), (0.3, 0.3, 0.25))


def make_camera(name: str = "cam0", width: int = 256, height: int = 212, x: float = 0.0) -> DepthCamera:
    """A camera of a Kinect 2's field of view, 1.3 m up, 3 m from where the person stands."""
    focal = 366.0 * width / 512
    pose = look_at(np.array([x, -3.0, 1.3]), np.array([0.0, 0.0, 0.9]))
    return DepthCamera(name, width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, pose)


def bands(size: tuple[int, int], rng: np.random.Generator) -> UInt16[ndarray, "h w"]:
    """Raw depth of every value that there is, rough, and yet not noise: rows at distances of their own."""
    rows = rng.integers(0, 2**16 - 100, (size[0], 1))
    return (rows + rng.integers(0, 101, size)).astype(np.uint16)


def render(
    camera: DepthCamera, people_xy: list[tuple[float, float]], hidden_below_m: float = 0.0
) -> tuple[Float[ndarray, "h w"], Bool[ndarray, "h w"]]:
    """Exact depth (metres) of the room with people at these places, and which pixels are theirs."""
    rays = np.concatenate([camera.rays, np.ones_like(camera.rays[..., :1])], -1).astype(np.float64)
    rays = rays @ camera.world_from_camera[:3, :3].T  # of depth 1
    eye = camera.world_from_camera[:3, 3]

    def plane(axis: int, at: float) -> ndarray:
        with np.errstate(divide="ignore"):
            z = (at - eye[axis]) / rays[..., axis]
        return np.where(z > 0, z, np.inf)

    def ellipsoid(centre: tuple[float, ...], axes: tuple[float, ...]) -> ndarray:
        d, o = rays / np.array(axes), (eye - np.array(centre)) / np.array(axes)
        a, b, c = (d * d).sum(-1), d @ o, o @ o - 1
        root = b * b - a * c
        return np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)

    room = np.minimum(np.minimum(plane(2, 0.0), plane(1, 3.2)), ellipsoid(*_CRATE))
    body = np.full_like(room, np.inf)
    for x, y in people_xy:
        for (px, py, pz), axes in _PARTS:
            body = np.minimum(body, ellipsoid((px + x, py + y, pz), axes))
    if hidden_below_m:  # a static board in front of the person
        board = plane(1, -0.8)
        board[eye[2] + rays[..., 2] * board > hidden_below_m] = np.inf
        room = np.minimum(room, board)
    depth_m = np.minimum(room, body)
    return np.where(depth_m < 8, depth_m, 0).astype(np.float32), body < room


def sense(depth_m: Float[ndarray, "h w"], rng: np.random.Generator, noise: float = 1.0) -> Float[ndarray, "h w"]:
    """What a sensor makes of it: noise of 3 to 10 mm, and lost and stray pixels at silhouettes. 0 stays 0."""
    box = np.ones((3, 3), np.uint8)
    near, far = cv2.erode(depth_m, box), cv2.dilate(depth_m, box)
    edge, draw = far - near > 0.1, rng.random(depth_m.shape)
    sigma = noise * (0.002 + 0.0005 * depth_m**2)
    noisy = depth_m + sigma * rng.standard_normal(depth_m.shape)
    stray = near + (far - near) * rng.random(depth_m.shape)
    noisy = np.where(edge & (draw < 0.15), stray, noisy)
    lost = (depth_m == 0) | (edge & (draw > 0.6)) | (draw > 0.997)
    return np.where(lost, 0, np.round(noisy, 3)).astype(np.float32)
