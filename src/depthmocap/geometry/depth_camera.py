"""Depth cameras and rigs, and the ``rig.json`` file that describes them."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt16
from numpy import ndarray

from depthmocap.core.camera_names import check_camera_name
from depthmocap.core.output import write_file
from depthmocap.core.reading.image_files import check_picture_size
from depthmocap.core.reading.json_text import array, number, read_json, whole_number
from depthmocap.errors import InputError
from depthmocap.geometry.floor_area import FloorArea, parse_area
from depthmocap.geometry.transforms import is_rigid, rigid_inverse, transform_points

#: Largest distance of two cameras of a rig (metres): a larger one is in other units.
LARGEST_RIG_M = 100.0
#: Largest coordinate of a camera in the world (metres).
_LARGEST_COORDINATE_M = 1e6
#: Range of focal lengths.
_FOCAL_PX = (1.0, 1e6, "pixels")
#: Range of the coordinates of the principal point.
_CENTRE_PX = (-1e6, 1e6, "pixels")
#: Range of the length of a depth unit.
_UNIT_M = (1e-7, 1.0, "metres")
#: Range of factors on a camera's depth.
_FACTOR = (1e-3, 1e3, "")
#: Range of time offsets.
_OFFSET_S = (-3600.0, 3600.0, "seconds")
#: Least share of the image in which a lens model must be invertible: the widest mode of an Azure Kinect has a half.
_LEAST_INVERTIBLE = 0.3
#: Number of columns and rows at which a lens model is tested.
_GRID = 64
#: Least length of the up direction in the image plane: a camera that looks straighter up or down has no upright image.
_LEAST_UP = 0.35


@dataclasses.dataclass(frozen=True, eq=False)
class DepthCamera:
    """A calibrated depth camera. Camera frame: x right, y down, z forward; an integer pixel is its centre.

    ``distortion`` is OpenCV's (k1, k2, p1, p2, k3). ``depth_unit_m`` is the length of one raw depth unit.
    ``time_offset_s`` is to be added to the camera's timestamps, where frames become sets. :meth:`to_metres` mends
    pictures: by ``depth_factor`` on the depth unit that the device tells, and by exchanging left and right where they
    come ``mirrored``. All else, the intrinsics too, is of the mended pictures.
    """

    name: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_from_camera: Float[ndarray, "4 4"] = dataclasses.field(default_factory=lambda: np.eye(4))
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    depth_unit_m: float = 0.001
    time_offset_s: float = 0.0
    depth_factor: float = 1.0
    mirrored: bool = False

    def __post_init__(self) -> None:
        """Raises InputError for an invalid name."""
        check_camera_name(self.name)

    @property
    def time_offset_ns(self) -> int:
        """``time_offset_s`` in nanoseconds."""
        return round(self.time_offset_s * 1e9)

    @property
    def matrix(self) -> Float[ndarray, "3 3"]:
        """The 3×3 intrinsic matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    @property
    def camera_from_world(self) -> Float[ndarray, "4 4"]:
        """Inverse of ``world_from_camera``."""
        return rigid_inverse(self.world_from_camera)

    @functools.cached_property
    def rays(self) -> Float[ndarray, "h w 2"]:
        """x/z and y/z of every pixel's ray, lens distortion removed (float32).

        NaN where the lens model cannot be inverted within a pixel: corners beyond the calibrated field.
        """
        u, v = np.meshgrid(np.arange(self.width, dtype=np.float64), np.arange(self.height, dtype=np.float64))
        if any(self.distortion):
            rays = self.undistorted(np.stack([u, v], -1).reshape(-1, 2))
            return rays.reshape(self.height, self.width, 2).astype(np.float32)
        return np.stack([(u - self.cx) / self.fx, (v - self.cy) / self.fy], -1).astype(np.float32)

    def undistorted(self, pixels: Float[ndarray, "n 2"]) -> Float[ndarray, "n 2"]:
        """x/z and y/z of the rays through image points (u, v), lens distortion removed; NaN where the lens model cannot
        be inverted within a pixel."""
        rays = self.rays_through(pixels)
        errors_px = np.abs(self._project_rays(rays) - pixels).max(-1)
        return np.where((errors_px < 1.0)[..., None], rays, np.nan)

    def rays_through(self, pixels: Float[ndarray, "n 2"]) -> Float[ndarray, "n 2"]:
        """x/z and y/z of the rays through image points (u, v), lens distortion removed."""
        if any(self.distortion) and len(pixels):
            return cv2.undistortPoints(pixels[:, None], self.matrix, np.array(self.distortion))[:, 0]
        return (pixels - [self.cx, self.cy]) / [self.fx, self.fy]

    def unproject(
        self, depth_m: Float[ndarray, "h w"], mask: Bool[ndarray, "h w"] | None = None
    ) -> Float[ndarray, "n 3"]:
        """Camera-frame points of the masked pixels with valid depth, in row-major order."""
        valid = (depth_m > 0) & np.isfinite(self.rays[..., 0])
        if mask is not None:
            valid &= mask
        z = depth_m[valid].astype(np.float32)
        return np.concatenate([self.rays[valid] * z[:, None], z[:, None]], 1)

    def project(self, points_world: Float[ndarray, "*n 3"]) -> Float[ndarray, "*n 3"]:
        """Pixel u, v and depth z (metres) of world points. Points at or behind the camera get NaN pixels."""
        points_camera = transform_points(self.camera_from_world, points_world.astype(np.float64))
        z = points_camera[..., 2]
        in_front = np.where(z > 0, z, np.nan)
        rays = points_camera[..., :2] / in_front[..., None]
        return np.concatenate([self._project_rays(rays), z[..., None]], -1)

    def nearest_pixels(self, points_world: Float[ndarray, "n 3"]) -> tuple[Int[ndarray, "n"], Int[ndarray, "n"]]:
        """Row and column of the pixel that shows each point; -1, or the height or width, for points outside the
        image."""
        pixels = np.nan_to_num(self.project(points_world)[:, :2], nan=-1)
        # Clipped, because points far outside overflow integers.
        column, row = np.rint(np.clip(pixels, -1, [self.width, self.height])).astype(np.int64).T
        return row, column

    def _project_rays(self, rays: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Pixels of rays (x/z, y/z), by OpenCV's lens model."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = rays[..., 0], rays[..., 1]
        with np.errstate(over="ignore", invalid="ignore"):  # far outside the image
            r2 = x * x + y * y
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            x_d = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
            y_d = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.stack([x_d * self.fx + self.cx, y_d * self.fy + self.cy], -1)

    def turned(self, quarters: int) -> DepthCamera:
        """The camera of the image rotated anticlockwise by a number of quarter turns, as by ``np.rot90``."""
        camera = self
        for _ in range(quarters % 4):
            # (x, y) becomes (y, −x): right in the new image is down in the old one.
            pose = camera.world_from_camera.copy()
            pose[:3, 0], pose[:3, 1] = camera.world_from_camera[:3, 1], -camera.world_from_camera[:3, 0]
            k1, k2, p1, p2, k3 = camera.distortion
            camera = dataclasses.replace(
                camera, width=camera.height, height=camera.width, fx=camera.fy, fy=camera.fx,
                cx=camera.cy, cy=camera.width - 1 - camera.cx, world_from_camera=pose,
                distortion=(k1, k2, -p2, p1, k3),
            )  # fmt: skip
        return camera

    def quarters_upright(self, up_world: Float[ndarray, "3"]) -> int:
        """Number of anticlockwise quarter turns (:meth:`turned`) that bring the world's up direction nearest to up in
        the image.

        0 for a camera that looks nearly straight up or down, and for an identity pose, which means unknown extrinsics.
        """
        right, down, _ = self.world_from_camera[:3, :3].T @ up_world
        if np.hypot(right, down) < _LEAST_UP or np.array_equal(self.world_from_camera, np.eye(4)):
            return 0
        # If up points right in the image, one anticlockwise quarter turn corrects it.
        return round(float(np.arctan2(right, -down)) / (np.pi / 2)) % 4

    def to_metres(self, raw: UInt16[ndarray, "h w"]) -> Float[ndarray, "h w"]:
        """Raw sensor depth in metres (float32), mended. Raw 0 and the saturated 65535 are invalid: 0."""
        # In one pass: it is done with every frame of a running camera.
        depth_m = np.multiply(raw, np.float32(self.depth_unit_m * self.depth_factor), dtype=np.float32)
        saturated = raw == 65535
        if saturated.any():
            depth_m[saturated] = 0
        return np.ascontiguousarray(depth_m[:, ::-1]) if self.mirrored else depth_m


@dataclasses.dataclass(frozen=True, eq=False)
class Rig:
    """Cameras in one world, whose up axis is ``"z"``, ``"y"`` or ``"-y"``; ``area_m`` is where people are followed."""

    cameras: tuple[DepthCamera, ...]
    up: str = "z"
    area_m: FloorArea = ()

    def __getitem__(self, name: str) -> DepthCamera:
        for camera in self.cameras:
            if camera.name == name:
                return camera
        raise KeyError(name)

    @property
    def names(self) -> tuple[str, ...]:
        """Camera names in order."""
        return tuple(camera.name for camera in self.cameras)


def time_offsets_s(cameras: Iterable[DepthCamera]) -> dict[str, float]:
    """The time offsets (seconds) of the cameras that have one, by name."""
    return {camera.name: camera.time_offset_s for camera in cameras if camera.time_offset_s}


def _parse_camera(entry: Any, path: Path, index: int) -> DepthCamera:
    where = f"{path}: camera {index}"
    if not isinstance(entry, dict):
        raise InputError(f"{where} must be an object with name, width, height, fx, fy, cx, cy")
    where = f"{path}: camera {entry.get('name', index)!r}"
    required = ("name", "width", "height", "fx", "fy", "cx", "cy")
    if absent := [key for key in required if key not in entry]:
        raise InputError(f"{where} lacks {', '.join(absent)}")
    width, height = (whole_number(entry[key], f"{where}: {key}") for key in ("width", "height"))
    numbers = {key: number(entry[key], f"{where}: {key}") for key in ("fx", "fy", "cx", "cy")}
    unit = number(entry.get("depth_unit_m", 0.001), f"{where}: depth_unit_m")
    offset_s = number(entry.get("time_offset_s", 0.0), f"{where}: time_offset_s")
    factor = number(entry.get("depth_factor", 1.0), f"{where}: depth_factor")
    mirrored = entry.get("mirrored", False)
    if not isinstance(mirrored, bool):
        raise InputError(f"{where}: mirrored must be true or false, got {mirrored!r}")
    distortion = array(entry.get("distortion", [0.0] * 5), (5,), f"{where}: distortion [k1, k2, p1, p2, k3]").tolist()
    pose = array(entry.get("world_from_camera", np.eye(4).tolist()), (4, 4), f"{where}: world_from_camera")
    k1, k2, p1, p2, k3 = distortion
    name = str(entry["name"]) if type(entry["name"]) is int else entry["name"]
    try:
        check_camera_name(name)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    camera = DepthCamera(
        name, width, height, **numbers, world_from_camera=pose,
        distortion=(k1, k2, p1, p2, k3), depth_unit_m=unit, time_offset_s=offset_s,
        depth_factor=factor, mirrored=mirrored,
    )  # fmt: skip
    check_camera(camera, where)
    return camera


def check_camera(camera: DepthCamera, where: str) -> None:
    """Check the parameters of a camera from a file or a device.

    Args:
        where: their source, for the message.

    Raises:
        InputError: when the image size or a number is out of range or not finite, the lens model is invertible only in
            a small part of the image, or the pose is not rigid.
    """
    check_picture_size(camera.width, camera.height, f"{where}: the picture")
    bounds = {
        "fx": _FOCAL_PX, "fy": _FOCAL_PX, "cx": _CENTRE_PX, "cy": _CENTRE_PX, "depth_unit_m": _UNIT_M,
        "time_offset_s": _OFFSET_S, "depth_factor": _FACTOR,
    }  # fmt: skip
    for key, (least, most, unit) in bounds.items():
        if not least <= getattr(camera, key) <= most:
            bounds_text = f"{least:g} to {most:g} {unit}".rstrip()
            raise InputError(f"{where}: {key} must be {bounds_text}, got {getattr(camera, key):g}")
    if not np.isfinite(camera.distortion).all():
        raise InputError(f"{where}: distortion must be finite numbers, got {list(camera.distortion)}")
    if not is_rigid(camera.world_from_camera):
        raise InputError(
            f"{where}: world_from_camera is not a rotation and a translation "
            "(columns of length 1 at right angles, determinant +1, last row 0 0 0 1); calibrate this camera again"
        )
    if (distance_m := float(np.abs(camera.world_from_camera[:3, 3]).max())) > _LARGEST_COORDINATE_M:
        raise InputError(f"{where}: the place in world_from_camera is {distance_m:g} m away; it must be in metres")
    if any(camera.distortion) and (invertible := _invertible_share(camera)) < _LEAST_INVERTIBLE:
        raise InputError(
            f"{where}: distortion {list(camera.distortion)} can be undone in {100 * invertible:.0f} % of the picture "
            "only; give OpenCV's [k1, k2, p1, p2, k3], for x/z and y/z"
        )


def _invertible_share(camera: DepthCamera) -> float:
    """Share of the image in which the lens model can be inverted, tested on a grid of pixels."""
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, _GRID), np.linspace(0, camera.height - 1, _GRID))
    with np.errstate(all="ignore"):
        return float(np.isfinite(camera.undistorted(np.stack([u, v], -1).reshape(-1, 2))[:, 0]).mean())


def check_extrinsics(cameras: Iterable[DepthCamera]) -> None:
    """Check that the extrinsics of the cameras are known.

    Raises:
        InputError: when two cameras have the same pose.
    """
    by_pose: dict[bytes, str] = {}
    for camera in cameras:
        other = by_pose.setdefault(camera.world_from_camera.round(6).tobytes(), camera.name)
        if other != camera.name:
            raise InputError(
                f"cameras {other!r} and {camera.name!r} have the same place: nobody has told where they stand. "
                "Record one person who walks about, then: depthmocap calibrate RECORDING --out rig.json; "
                "run, record and live take it by --rig"
            )


def load_rig(path: Path) -> Rig:
    """Read ``rig.json``. A camera without ``world_from_camera`` is at the origin (see :func:`check_extrinsics`).

    Raises:
        InputError: when the file is missing or malformed, a pose is not rigid, two cameras share a name, or the area
            encloses nothing.
    """
    document = read_json(path, "a recording needs a rig.json that describes its cameras")
    entries = document.get("cameras") if isinstance(document, dict) else None
    if not isinstance(entries, list) or not entries:
        raise InputError(f'{path} must hold {{"cameras": [...]}} with at least one camera')
    cameras = tuple(_parse_camera(entry, path, i) for i, entry in enumerate(entries))
    names = [camera.name for camera in cameras]
    if len(set(names)) < len(names):
        raise InputError(f"{path}: camera names must differ, got {names}")
    positions = np.stack([camera.world_from_camera[:3, 3] for camera in cameras])
    if (distance_m := float(np.linalg.norm(positions - positions[0], axis=1).max())) > LARGEST_RIG_M:
        raise InputError(
            f"{path}: two cameras are {distance_m:,.0f} m apart; the places in world_from_camera must be in metres "
            f"(divided by 1000, if they are in millimetres, {distance_m / 1000:.1f} m)"
        )
    return Rig(cameras, check_up(document.get("up", "z"), str(path)), parse_area(document.get("area_m", []), str(path)))


def check_up(up: Any, where: str) -> str:
    """The world's up axis, checked.

    Raises:
        InputError: when it is not "z", "y" or "-y".
    """
    if up not in ("z", "y", "-y"):
        raise InputError(f'{where}: up must be "z", "y" or "-y", not {up!r}')
    return up


def save_rig(rig: Rig, path: Path) -> None:
    """Write ``rig.json``.

    Raises:
        InputError: when it cannot be written.
    """
    entries = [
        {
            **{key: getattr(camera, key) for key in ("name", "width", "height", "fx", "fy", "cx", "cy")},
            "distortion": list(camera.distortion),
            "depth_unit_m": camera.depth_unit_m,
            **({"time_offset_s": camera.time_offset_s} if camera.time_offset_s else {}),
            **({"depth_factor": camera.depth_factor} if camera.depth_factor != 1 else {}),
            **({"mirrored": True} if camera.mirrored else {}),
            "world_from_camera": camera.world_from_camera.tolist(),
        }
        for camera in rig.cameras
    ]
    area = {"area_m": rig.area_m} if rig.area_m else {}
    write_file(path, json.dumps({"up": rig.up, **area, "cameras": entries}, indent=1) + "\n")
