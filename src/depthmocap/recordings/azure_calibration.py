"""The factory calibration of an Azure Kinect, as its SDK gives it and recorders store it."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.cameras.lens import five_coefficients
from depthmocap.cameras.sdk import checked
from depthmocap.core.reading.json_text import array, parse_json
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, rigid_inverse

#: Metres of one depth unit: the SDK gives millimetres.
_UNIT_M = 0.001
#: The SDK's names of the places of the depth camera and of the colour camera.
_DEPTH, _COLOUR = "CALIBRATION_CameraLocationD0", "CALIBRATION_CameraLocationPV0"


@dataclasses.dataclass(frozen=True)
class _Mode:
    """The part of the calibrated square sensor that a depth mode reads: the square's side and the corner (pixels)."""

    square: int
    left: int = 0
    top: int = 0


#: The camera's depth modes by picture size, from the SDK's sources.
_MODES = {
    (320, 288): _Mode(512, 96, 90),
    (640, 576): _Mode(1024, 192, 180),
    (512, 512): _Mode(512),
    (1024, 1024): _Mode(1024),
}


def is_depth_size(width: int, height: int) -> bool:
    """Whether the camera delivers depth pictures of this size."""
    return (width, height) in _MODES


def depth_camera(name: str, size: tuple[int, int], document: bytes, where: str) -> DepthCamera:
    """The depth camera, at the origin.

    Args:
        size: width and height of its pictures, which :func:`is_depth_size` knows.
        document: the calibration, JSON.
        where: what it is, for messages.

    Raises:
        InputError: when it cannot be read.
    """
    mode = _MODES[size]
    try:
        cx, cy, fx, fy, *k, _, _, p2, p1 = _parameters(_cameras(document, where)[_DEPTH])
    except (ValueError, KeyError, TypeError, OverflowError):
        raise _unreadable(where) from None
    # The factory calibration is in units of the square's side, with the origin at the corner of its first pixel.
    side = mode.square
    lens = np.array([k[0], k[1], p1, p2, *k[2:]], np.float64)
    return checked(DepthCamera(
        name, *size, fx * side, fy * side, cx * side - mode.left - 0.5, cy * side - mode.top - 0.5,
        distortion=five_coefficients(lens), depth_unit_m=_UNIT_M,
    ))  # fmt: skip


def colour_from_depth(document: bytes, where: str) -> Float[ndarray, "4 4"]:
    """The pose of the depth camera in the frame of the colour camera (metres).

    Raises:
        InputError: when it cannot be read.
    """
    poses = {}
    for place in (_DEPTH, _COLOUR):
        try:
            pose = _cameras(document, where)[place]["Rt"]
            rotation, translation = pose["Rotation"], pose["Translation"]
        except (ValueError, KeyError, TypeError):
            raise _unreadable(where) from None
        poses[place] = np.eye(4)
        poses[place][:3, :3] = array(rotation, (9,), f"{where}: Rotation").reshape(3, 3)
        poses[place][:3, 3] = array(translation, (3,), f"{where}: Translation")
    return poses[_COLOUR] @ rigid_inverse(poses[_DEPTH])


def _cameras(document: bytes, where: str) -> dict[str, dict[str, Any]]:
    """The entries of the cameras, by their places."""
    entries = parse_json(document.rstrip(b"\0"), where)["CalibrationInformation"]["Cameras"]
    return {entry["Location"]: entry for entry in reversed(entries)}


def _parameters(entry: dict[str, Any]) -> list[float]:
    """The 14 lens parameters of a camera."""
    return [float(value) for value in entry["Intrinsics"]["ModelParameters"][:14]]


def _unreadable(where: str) -> InputError:
    return InputError(f"{where} of the depth camera cannot be read")
