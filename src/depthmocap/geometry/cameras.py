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
from jaxtyping import Bool, Float, UInt16
from numpy import ndarray

from depthmocap.errors import InputError
from depthmocap.geometry.transforms import is_rigid, rigid_inverse, transform_points
from depthmocap.names import check_camera_name
from depthmocap.output import write_file

#: No two cameras that see one person are this far apart (metres).
FURTHEST_M = 100.0


@dataclasses.dataclass(frozen=True, eq=False)
class DepthCamera:
    """A calibrated depth camera. Camera frame: x right, y down, z forward; an integer pixel is its centre.

    ``distortion`` is OpenCV's (k1, k2, p1, p2, k3). ``depth_unit_m`` is the length of one raw depth unit.
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

    def __post_init__(self) -> None:
        """Raises InputError when the name cannot be a camera's."""
        check_camera_name(self.name)

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
            pixels = np.stack([u, v], -1)
            rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2), self.matrix, np.array(self.distortion))
            rays = rays.reshape(self.height, self.width, 2)
            off = np.abs(self._pixels_of(rays) - pixels).max(-1)
            return np.where((off < 1.0)[..., None], rays, np.nan).astype(np.float32)
        return np.stack([(u - self.cx) / self.fx, (v - self.cy) / self.fy], -1).astype(np.float32)

    def rays_through(self, pixels: Float[ndarray, "n 2"]) -> Float[ndarray, "n 2"]:
        """x/z and y/z of the rays through any places (u, v) of the picture, lens distortion removed."""
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
        return np.concatenate([self._pixels_of(rays), z[..., None]], -1)

    def _pixels_of(self, rays: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Pixels of rays (x/z, y/z), by OpenCV's lens model."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = rays[..., 0], rays[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        x_d = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        y_d = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.stack([x_d * self.fx + self.cx, y_d * self.fy + self.cy], -1)

    def to_metres(self, raw: UInt16[ndarray, "h w"]) -> Float[ndarray, "h w"]:
        """Raw sensor depth in metres (float32). Raw 0 stays 0, invalid; so does the saturated 65535."""
        return np.where(raw == 65535, 0, raw).astype(np.float32) * np.float32(self.depth_unit_m)


@dataclasses.dataclass(frozen=True, eq=False)
class Rig:
    """Cameras in one world, whose up axis is ``"z"``, ``"y"`` or ``"-y"``."""

    cameras: tuple[DepthCamera, ...]
    up: str = "z"

    def __getitem__(self, name: str) -> DepthCamera:
        for camera in self.cameras:
            if camera.name == name:
                return camera
        raise KeyError(name)

    @property
    def names(self) -> tuple[str, ...]:
        """Camera names in order."""
        return tuple(camera.name for camera in self.cameras)


def _parse_camera(entry: Any, path: Path, index: int) -> DepthCamera:
    where = f"{path}: camera {index}"
    if not isinstance(entry, dict):
        raise InputError(f"{where} must be an object with name, width, height, fx, fy, cx, cy")
    where = f"{path}: camera {entry.get('name', index)!r}"
    required = ("name", "width", "height", "fx", "fy", "cx", "cy")
    if absent := [key for key in required if key not in entry]:
        raise InputError(f"{where} lacks {', '.join(absent)}")
    try:
        numbers = {key: float(entry[key]) for key in ("fx", "fy", "cx", "cy")}
        width, height = int(entry["width"]), int(entry["height"])
        if (width, height) != (entry["width"], entry["height"]):
            raise ValueError(f"width {entry['width']!r} and height {entry['height']!r} must be whole numbers")
        unit = float(entry.get("depth_unit_m", 0.001))
        distortion = [float(k) for k in entry.get("distortion", [0.0] * 5)]
        pose = np.array(entry.get("world_from_camera", np.eye(4)), dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{where} has a value that is not a number: {error}") from None
    if min(width, height) < 1 or min(numbers["fx"], numbers["fy"], unit) <= 0:
        raise InputError(f"{where}: width, height, fx, fy and depth_unit_m must be positive")
    if not np.isfinite([*numbers.values(), unit, *distortion]).all():
        raise InputError(f"{where}: intrinsics must be finite numbers")
    if len(distortion) != 5:
        raise InputError(f"{where}: distortion must be [k1, k2, p1, p2, k3], got {len(distortion)} numbers")
    if pose.shape != (4, 4):
        raise InputError(f"{where}: world_from_camera must be 4×4, row major, in metres; got shape {pose.shape}")
    if not is_rigid(pose):
        raise InputError(
            f"{where}: world_from_camera is not a rotation and a translation "
            "(columns of length 1 at right angles, determinant +1, last row 0 0 0 1); calibrate this camera again"
        )
    k1, k2, p1, p2, k3 = distortion
    try:
        check_camera_name(str(entry["name"]))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    camera = DepthCamera(
        str(entry["name"]), width, height, **numbers, world_from_camera=pose,
        distortion=(k1, k2, p1, p2, k3), depth_unit_m=unit,
    )  # fmt: skip
    if any(distortion) and (undone := np.isfinite(camera.rays[..., 0]).mean()) < 0.5:
        raise InputError(
            f"{where}: distortion {distortion} can be undone in {100 * undone:.0f} % of the picture only; "
            "give OpenCV's [k1, k2, p1, p2, k3], for x/z and y/z"
        )
    return camera


def check_placed(cameras: Iterable[DepthCamera]) -> None:
    """See that nobody has left out to tell where the cameras stand.

    Raises:
        InputError: when two of them have the same pose.
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
    """Read ``rig.json``. A camera without ``world_from_camera`` is at the origin (see :func:`check_placed`).

    Raises:
        InputError: when the file is missing or malformed, a pose is not rigid, or two cameras share a name.
    """
    try:
        document = json.loads(path.read_text())
    except FileNotFoundError:
        raise InputError(f"{path} not found: a recording needs a rig.json that describes its cameras") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is not valid JSON: {error}") from None
    entries = document.get("cameras") if isinstance(document, dict) else None
    if not isinstance(entries, list) or not entries:
        raise InputError(f'{path} must hold {{"cameras": [...]}} with at least one camera')
    cameras = tuple(_parse_camera(entry, path, i) for i, entry in enumerate(entries))
    names = [camera.name for camera in cameras]
    if len(set(names)) < len(names):
        raise InputError(f"{path}: camera names must differ, got {names}")
    places = np.stack([camera.world_from_camera[:3, 3] for camera in cameras])
    if (apart_m := float(np.linalg.norm(places - places[0], axis=1).max())) > FURTHEST_M:
        raise InputError(
            f"{path}: two cameras are {apart_m:,.0f} m apart; the places in world_from_camera must be in metres"
        )
    up = document.get("up", "z")
    if up not in ("z", "y", "-y"):
        raise InputError(f'{path}: up must be "z", "y" or "-y", not {up!r}')
    return Rig(cameras, up)


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
            "world_from_camera": camera.world_from_camera.tolist(),
        }
        for camera in rig.cameras
    ]
    write_file(path, json.dumps({"up": rig.up, "cameras": entries}, indent=1) + "\n")
