"""The layout of a recording folder: a rig, one folder of 16-bit depth PNGs per camera, and optional files.

::

    rig.json
    <camera>/<timestamp ns>.png     16-bit grey raw depth, 0 = invalid; one clock for all cameras
    <camera>/background.png         the empty scene (optional)
    truth.csv                       true joints: timestamp_ns and the positions of pose.csv (optional)
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from jaxtyping import UInt16
from numpy import ndarray

from depthmocap.core.reading.image_files import LARGEST_PICTURE, decode_png, png_header
from depthmocap.core.reading.input_files import read_bytes
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig
from depthmocap.recordings.depth_codec import SwappedSizeError

BACKGROUND_FILE = "background.png"
TRUTH_FILE = "truth.csv"
#: The layout in a sentence, for messages.
LAYOUT = "a recording folder holds rig.json and, for each camera in it, <camera>/<timestamp in ns>.png"


def read_depth_png(path: Path, camera: DepthCamera) -> UInt16[ndarray, "h w"]:
    """Read the raw depth of one frame.

    Raises:
        InputError: when the file is unreadable, damaged, not 16-bit grey, or not of the camera's size.
    """
    data = read_bytes(path, LARGEST_PICTURE)
    width, height, bits, kind = png_header(data, str(path))
    if (bits, kind) != (16, "grey"):
        raise InputError(f"{path} is {bits}-bit {kind}: depth must be 16-bit grey, raw depth units, 0 where invalid")
    if (width, height) != (camera.width, camera.height):
        raise (SwappedSizeError if (height, width) == (camera.width, camera.height) else InputError)(
            f"{path} is {width}×{height} but rig.json says {camera.width}×{camera.height} for camera "
            f"{camera.name!r}: correct its width, height and intrinsics, or the frames"
        )
    return decode_png(data, str(path))


class UnfitFrameError(InputError):
    """A frame does not fit a recording; other frames may fit."""


def check_frame(path: Path, rig: Rig, name: str, raw: UInt16[ndarray, "h w"]) -> None:
    """Check that a frame can be written to the recording ``path``.

    Raises:
        UnfitFrameError: when the rig has no such camera, or the frame does not have its size or is not 16 bit.
    """
    if name not in rig.names:
        raise UnfitFrameError(f"{path}: no camera {name!r} in the rig, which has {', '.join(rig.names)}")
    camera = rig[name]
    if raw.dtype != np.uint16 or raw.shape != (camera.height, camera.width):
        raise UnfitFrameError(
            f"{path}: a frame of {name!r} must be uint16 of {camera.height} rows and {camera.width} columns, "
            f"got {raw.dtype} {raw.shape}"
        )


def list_frames(folder: Path) -> dict[int, str]:
    """Names of the frame files by timestamp, in order of time; empty if the folder does not exist."""
    frames: dict[int, str] = {}
    if not folder.is_dir():
        return frames
    with os.scandir(folder) as entries:  # names alone, for an hour has half a million files
        names = [entry.name for entry in entries]
    for name in names:
        stem, dot, ending = name.rpartition(".")
        if not dot or ending.lower() != "png" or name == BACKGROUND_FILE or name.startswith("."):
            continue
        if not (stem.isascii() and stem.isdecimal() and int(stem) < 2**63):
            raise InputError(
                f"{folder / name}: a frame's name must be its timestamp in ns, an integer such as 33333333.png"
            )
        if other := frames.get(int(stem)):
            raise InputError(f"{folder / name} and {folder / other} have the same timestamp: delete one of them")
        frames[int(stem)] = name
    return dict(sorted(frames.items()))


def camera_folder(recording: Path, name: str) -> Path:
    """The folder of a camera's frames. Its name on the disk is UTF-8 in every locale."""
    return recording / os.fsdecode(name.encode())
