"""Reads raw takes of LiveScan3D with Azure Kinects like a recording folder.

::

    Extrinsics_Open3D.log                 poses of the colour cameras: 0, serial and number, then 4×4
    client_<N>/Intrinsics_Calib_<N>.json  the factory calibration
    client_<N>/Timestamps_Client<N>.txt   a line for each picture: its number, and the device's time in microseconds
    client_<N>/Depth_<number>.tiff        16-bit grey, millimetres, 0 = invalid

Takes of point clouds (``.bin``, ``.ply``) have no depth pictures.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt16
from numpy import ndarray

from depthmocap.core.reading.image_files import read_picture
from depthmocap.core.reading.input_files import read_bytes, read_text
from depthmocap.core.reading.json_text import LARGEST_JSON, number_from_text
from depthmocap.errors import InputError
from depthmocap.geometry import Rig, is_rigid
from depthmocap.recordings.azure_calibration import colour_from_depth, depth_camera, is_depth_size
from depthmocap.recordings.recording import Recording
from depthmocap.recordings.true_joints import TrueJoints

_EXTRINSICS = "Extrinsics_Open3D.log"
#: Words of a camera in that file: three, and a matrix of 16.
_WORDS = 19
#: Largest size of it, and of a list of times (bytes).
_LARGEST = 1 << 25


class LiveScanRecording(Recording):
    """The depth of a take, or of one client of it. Cameras have the names of their clients' folders."""

    @staticmethod
    def is_one(path: Path) -> bool:
        """Whether a folder is a raw take, or a client of one."""
        return bool(_clients(path))

    def _load(self) -> tuple[Rig, dict[str, list[int]]]:
        poses = _poses(self.path / _EXTRINSICS) or _poses(self.path.parent / _EXTRINSICS)
        cameras = []
        self._frames: dict[str, dict[int, Path]] = {}
        for folder in _clients(self.path):
            number = int(folder.name.rpartition("_")[2])
            calibration = read_bytes(folder / f"Intrinsics_Calib_{number}.json", LARGEST_JSON)
            frames = self._frames[folder.name] = _frames(folder, number)
            height, width = read_picture(next(iter(frames.values())), "I;16").shape
            if not is_depth_size(width, height):
                raise InputError(f"{folder} has depth of {width}×{height}, which no Azure Kinect delivers")
            where = f"{folder}: the calibration"
            camera = depth_camera(folder.name, (width, height), calibration, where)
            if number in poses:
                pose = poses[number] @ colour_from_depth(calibration, where)
                if not is_rigid(pose):
                    raise InputError(f"{self.path / _EXTRINSICS}: the pose of {folder.name} is not rigid")
                camera = dataclasses.replace(camera, world_from_camera=pose)
            cameras.append(camera)
        return Rig(tuple(cameras), "y" if poses else "-y"), {name: list(self._frames[name]) for name in self._frames}

    def device_time(self, name: str, stamp: int) -> tuple[int, str]:
        return stamp, "recording"

    def raw(self, name: str, stamp: int) -> UInt16[ndarray, "h w"]:
        camera = self.rig[name]
        return read_picture(self._frames[name][stamp], "I;16", (camera.width, camera.height)).astype(np.uint16)

    def raw_background(self, name: str) -> UInt16[ndarray, "h w"] | None:
        return None

    def _where(self, name: str, what: str) -> str:
        return str(self._frames[name].get(int(what), what)) if what.isdecimal() else f"{self.path}: {what}"

    def _load_truth(self) -> TrueJoints | None:
        return None


def _clients(path: Path) -> list[Path]:
    """Folders of clients with depth pictures."""
    folders = [path, *path.glob("client_*")]
    named = (folder for folder in folders if re.fullmatch(r"client_\d{1,4}", folder.name) and folder.is_dir())
    return sorted(folder for folder in named if next(folder.glob("Depth_*.tiff"), None))


def _frames(folder: Path, number: int) -> dict[int, Path]:
    """Depth pictures by their times (ns), in order."""
    listing, frames = folder / f"Timestamps_Client{number}.txt", {}
    for line in read_text(listing, _LARGEST).splitlines():
        words = line.split()
        if len(words) != 2 or not all(word.isascii() and word.isdecimal() and len(word) < 17 for word in words):
            raise InputError(f"{listing}: a line must be a picture's number and microseconds, got {line[:80]!r}")
        file = folder / f"Depth_{int(words[0])}.tiff"
        if file.is_file():
            frames[int(words[1]) * 1000] = file
    if not frames:
        raise InputError(f"{listing} has no time of a depth picture that is there")
    return dict(sorted(frames.items()))


def _poses(file: Path) -> dict[int, Float[ndarray, "4 4"]]:
    """Poses of the colour cameras in the take's world (metres), by the number of the client; none without the file."""
    if not file.is_file():
        return {}
    words, poses = read_text(file, _LARGEST).split(), {}
    if len(words) % _WORDS:
        raise InputError(f"{file} must have three words and a 4×4 matrix for each camera")
    for start in range(0, len(words), _WORDS):
        number = words[start + 2]
        if not (number.isascii() and number.isdecimal() and len(number) < 5):
            raise InputError(f"{file}: {number[:80]!r} is no number of a client")
        values = [number_from_text(word, f"{file}: a pose") for word in words[start + 3 : start + _WORDS]]
        poses[int(number)] = np.array(values).reshape(4, 4)
    return poses
