"""Files of a CMU Panoptic sequence: JSON, a frame of depth, a Kinect's calibration. See ``panoptic``."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, UInt16
from numpy import ndarray

from depthmocap.core.reading.input_files import open_file
from depthmocap.errors import InputError
from depthmocap.geometry.depth_camera import DepthCamera, check_camera
from depthmocap.geometry.transforms import is_rigid, rigid_inverse

#: Columns of a depth picture.
WIDTH = 512
#: Rows of a depth picture.
HEIGHT = 424
#: Whether M_color leads from a Kinect's frame to its colour camera, or back.
MColor = Literal["to-colour", "from-colour"]


def at(document: Any, *keys: str, default: Any) -> Any:
    """The value under keys of nested objects."""
    for key in keys:
        if not isinstance(document, dict) or key not in document:
            return default
        document = document[key]
    return document


def sensors_of(kinects: Any) -> list[Any]:
    """The entry of each Kinect in the document kcalibration."""
    sensors = at(kinects, "sensors", default=[])
    return sensors if isinstance(sensors, list) else []


def _pose(rows: Any) -> Float[ndarray, "4 4"]:
    """A 3×4 or 4×4 matrix as 4×4."""
    pose = np.eye(4)
    matrix = np.array(rows, np.float64)
    if matrix.shape not in ((3, 4), (4, 4)):
        raise ValueError(f"a pose of shape {matrix.shape}")
    pose[: len(matrix)] = matrix
    return pose


def read_depth(path: Path, frame: int) -> UInt16[ndarray, "424 512"]:
    """A frame of a Kinect's depth (mm), not mirrored: the file's pictures are mirrored.

    Raises:
        InputError: when the file ends before it.
    """
    pixels = WIDTH * HEIGHT
    with open_file(path) as file:
        raw = np.fromfile(file, "<u2", pixels, offset=2 * pixels * frame)
    if len(raw) < pixels:
        raise InputError(f"{path} is cut off: it has {path.stat().st_size // (2 * pixels)} frames")
    return np.ascontiguousarray(np.fliplr(raw.reshape(HEIGHT, WIDTH)))


def kinect_camera(folder: Path, kinects: Any, dome: Any, kinect: int, m_color: MColor) -> DepthCamera:
    """A Kinect's depth camera in the dome's world (metres).

    Args:
        folder: of the sequence, for messages.
        kinects: the document kcalibration.
        dome: the document calibration.

    Raises:
        InputError: when the Kinect or a number is missing, or a pose is not rigid.
    """
    path, dome_path = (folder / f"{kind}_{folder.name}.json" for kind in ("kcalibration", "calibration"))
    sensors = sensors_of(kinects)
    if kinect > len(sensors):
        raise InputError(f"{path} has {len(sensors)} sensors, so no Kinect {kinect}")
    name = f"50_{kinect:02d}"
    cameras = at(dome, "cameras", default=[])
    cameras = cameras if isinstance(cameras, list) else []
    colour = next((entry for entry in cameras if at(entry, "name", default="") == name), None)
    if colour is None:
        raise InputError(f"{dome_path} has no camera {name}")
    try:
        sensor = sensors[kinect - 1]
        matrix = np.array(sensor["K_depth"], np.float64).reshape(3, 3)
        k1, k2, p1, p2, k3 = np.array(sensor["distCoeffs_depth"], np.float64).ravel()[:5].tolist()
        local_colour, depth_from_local = _pose(sensor["M_color"]), _pose(sensor["M_depth"])
        colour_from_world = _pose(np.hstack([np.reshape(colour["R"], (3, 3)), np.reshape(colour["t"], (3, 1))]))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{path} and {dome_path.name}: Kinect {kinect} cannot be read: {error}") from None
    colour_from_world[:3, 3] /= 100
    if not all(is_rigid(pose) for pose in (local_colour, depth_from_local, colour_from_world)):
        raise InputError(f"{path} and {dome_path.name}: a pose of Kinect {kinect} is not a rotation and a shift")
    fx, fy, cx, cy = map(float, (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]))
    if not (0 < cx < WIDTH and 0 < cy < HEIGHT and min(fx, fy) > 0):
        raise InputError(f"{path}: K_depth of Kinect {kinect} is not of a {WIDTH}×{HEIGHT} picture")
    colour_from_local = local_colour if m_color == "to-colour" else rigid_inverse(local_colour)
    pose = rigid_inverse(colour_from_world) @ colour_from_local @ rigid_inverse(depth_from_local)
    camera = DepthCamera(f"Kinect {kinect}", WIDTH, HEIGHT, fx, fy, cx, cy, pose, (k1, k2, p1, p2, k3))
    check_camera(camera, f"{path}: Kinect {kinect}")
    return camera
