"""UBC3V's camera, a simulated Kinect 2: its intrinsics, its poses as Maya stores them, its measured rays."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.ndimage import distance_transform_edt, map_coordinates

from depthmocap.core.reading.matlab_files import read_mat
from depthmocap.errors import InputError
from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.geometry.transforms import is_rigid, z_up_from

#: Pinhole fit to the ray table of the authors' toolkit, in pixels of the stored images: within a pixel on average up
#: to 250 px from the centre, and up to 33 px off in the corners.
KINECT2 = DepthCamera("Kinect2", width=512, height=424, fx=368.74, fy=367.93, cx=253.15, cy=205.13)

_MAX_ROLL = 1e-3
_ITERATIONS = 30


def kinect2_camera(name: str, world_from_camera: Float[ndarray, "4 4"]) -> DepthCamera:
    """The Kinect 2 of UBC3V at a pose: the only intrinsics that a section can hold."""
    return dataclasses.replace(KINECT2, name=name, world_from_camera=world_from_camera)


def camera_pose(translate_cm: Float[ndarray, " 3"], rotate_deg: Float[ndarray, " 3"]) -> Float[ndarray, "4 4"]:
    """``world_from_camera`` (metres, Z up) from a Maya camera (cm, Y up; look-at angles in degrees).

    The toolkit's rule, exactly: it ignores ``rotate[2]``, and its sign tests are strict, so that zero counts with
    ``rotate[0] <= 0``, ``rotate[1] >= 0`` and ``translate[0] * translate[2] <= 0``.
    """
    rx, ry = np.asarray(rotate_deg, np.float64)[:2]
    ax = 180 - rx if rx > 0 else -rx
    same_sign = translate_cm[0] * translate_cm[2] > 0
    ay = -ry if same_sign == (ry < 0) else ry - 180
    (sin_x, sin_y), (cos_x, cos_y) = np.sin(np.radians([ax, ay])), np.cos(np.radians([ax, ay]))
    # Columns of Ry(ay) @ Rx(ax): the toolkit's camera axes left, up and forward in the Y-up world.
    left = np.array([cos_y, 0, -sin_y])
    up = np.array([sin_y * sin_x, cos_x, cos_y * sin_x])
    forward = np.array([sin_y * cos_x, -sin_x, cos_y * cos_x])
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = z_up_from("y") @ np.stack([-left, -up, forward], axis=1)
    world_from_camera[:3, 3] = z_up_from("y") @ translate_cm / 100
    return world_from_camera


def maya_angles(world_from_camera: Float[ndarray, "4 4"]) -> tuple[Float[ndarray, " 3"], Float[ndarray, " 3"]]:
    """``translate_cm`` and ``rotate_deg`` that :func:`camera_pose` reads back as this pose.

    Of the angles, equal up to full turns, that the toolkit's rule accepts, these are also the plain Euler angles of
    a Maya camera (rotation order xyz, rotate z = 0), so a program that knows nothing of the rule reads them too.

    Raises:
        ValueError: when the pose is not rigid, or the camera rolls by more than 0.001 rad, which cannot be stored.
    """
    if not is_rigid(world_from_camera):
        raise ValueError("world_from_camera must be a rotation and a translation")
    left, up, forward = (z_up_from("y").T @ world_from_camera[:3, :3] * [-1, -1, 1]).T
    if abs(left[1]) > _MAX_ROLL:
        raise ValueError(
            f"UBC3V cannot store a camera with roll: its x axis must be level, but rises by {-left[1]:.4f}; "
            "place cameras with look_at and roll 0"
        )
    translate_cm = z_up_from("y").T @ world_from_camera[:3, 3] * 100
    ax = np.degrees(np.arctan2(-forward[1], up[1]))
    ay = np.degrees(np.arctan2(-left[2], left[0]))
    # ax = -rx wants rx <= 0; ay = ry - 180 wants ry >= 0 or ry < 0, after the sign of translate x times z.
    same_sign = translate_cm[0] * translate_cm[2] > 0
    rotate_deg = np.array([-(ax % 360), (ay + 180) % 360 - (0 if same_sign else 360), 0.0])
    return translate_cm, rotate_deg


@dataclasses.dataclass(frozen=True, eq=False)
class RayTableCamera(DepthCamera):
    """A camera with a table of rays (x/z right, y/z down); its intrinsics are a pinhole fitted to the table."""

    ray_table: Float[ndarray, "h w 2"] = dataclasses.field(kw_only=True)

    @functools.cached_property
    def rays(self) -> Float[ndarray, "h w 2"]:
        """x/z and y/z of every pixel's ray (float32)."""
        return self.ray_table.astype(np.float32)

    @functools.cached_property
    def _shift(self) -> Float[ndarray, "2 h w"]:
        """How far, in pixels, the pinhole projects each pixel's ray from that pixel."""
        v, u = np.indices(self.ray_table.shape[:2])
        x, y = self.ray_table[..., 0], self.ray_table[..., 1]
        return np.stack([x * self.fx + self.cx - u, y * self.fy + self.cy - v])

    def project(self, points_world: Float[ndarray, "*n 3"]) -> Float[ndarray, "*n 3"]:
        """Pixel u, v and depth z (metres) of world points, by inverting the table; pinhole-like outside the image."""
        uvz = super().project(points_world)
        pinhole = uvz[..., :2]
        uv = pinhole
        for _ in range(_ITERATIONS):  # fixed point of uv = pinhole - shift(uv): a contraction, as the lens bends little
            at = np.nan_to_num(np.moveaxis(uv[..., ::-1], -1, 0))
            shift = [map_coordinates(part, at, order=1, mode="nearest") for part in self._shift]
            uv = pinhole - np.stack(shift, -1)
        return np.concatenate([uv, uvz[..., 2:]], -1)


def load_ray_table(path: Path) -> RayTableCamera:
    """The Kinect 2 with the rays of the toolkit's ``mapper.mat``, at the identity pose.

    The file holds one struct, either an array with a scalar ``x`` and ``y`` for each pixel (or a single struct of
    two such images), whose x is mirrored in the stored images, or ``xmap`` and ``ymap`` ready to use. Both count x
    to the left and y up. Pixels without a finite ray get one that bends as the nearest pixel's.

    Raises:
        InputError: when the file is missing or holds no table of 424×512 rays.
    """
    path = Path(path)
    size = (KINECT2.height, KINECT2.width)
    mat = read_mat(path, "give the mapper.mat of the UBC3V toolkit, or no ray table", squeeze_me=True)
    for value in mat.values():
        names = getattr(getattr(value, "dtype", None), "names", None) or ()
        for x_name, y_name in (("x", "y"), ("xmap", "ymap")):
            if x_name in names and y_name in names:
                left, up = _image(value[x_name], size), _image(value[y_name], size)
                if left is None or up is None:
                    continue
                if x_name == "x":
                    left = left[:, ::-1]
                table = _without_holes(-np.stack([left, up], -1))
                if not (table[-1, -1] > table[0, 0]).all():
                    raise InputError(
                        f"{path}: the rays run the wrong way; expected x and y of the toolkit's mapper.mat"
                    )
                options = {field.name: getattr(KINECT2, field.name) for field in dataclasses.fields(KINECT2)}
                return RayTableCamera(**options, ray_table=table)
    raise InputError(f"{path} holds no struct with x and y of {size[0]}×{size[1]}: expected the toolkit's mapper.mat")


def _image(field: ndarray, size: tuple[int, int]) -> ndarray | None:
    """A struct field as an image, whether the struct holds the image or is itself an array of pixels."""
    value = field.item() if field.ndim == 0 else field
    try:
        # MATLAB's column order, as the toolkit reshapes it.
        return np.asarray(value, np.float64).ravel(order="F").reshape(size, order="F")
    except (TypeError, ValueError):
        return None


def _without_holes(table: ndarray) -> ndarray:
    """The table with its non-finite rays filled, smoothly, so that ``project`` can invert it there too."""
    holes = ~np.isfinite(table).all(-1)
    nearest = distance_transform_edt(holes, return_distances=False, return_indices=True)
    assert isinstance(nearest, ndarray)
    v, u = nearest
    return KINECT2.rays + (table - KINECT2.rays)[v, u]
