"""Opens any recording by its path, and tells of files that others read what they are."""

from __future__ import annotations

import importlib.resources
from pathlib import Path

from depthmocap.cameras.sdk_files import sdk_of
from depthmocap.core.reading.input_files import open_file
from depthmocap.errors import InputError
from depthmocap.geometry import Rig
from depthmocap.recordings.livescan_recording import LiveScanRecording
from depthmocap.recordings.mcap_recording import McapRecording
from depthmocap.recordings.mkv_recording import MkvRecording
from depthmocap.recordings.recording import Recording
from depthmocap.recordings.tum_recording import TumRecording

#: Readers of files, by the ending of their names.
RECORDING_FILES: dict[str, type[Recording]] = {".mcap": McapRecording, ".mkv": MkvRecording}
#: Readers of folders of others, by what is in them.
_FOLDERS: tuple[type[TumRecording] | type[LiveScanRecording], ...] = (TumRecording, LiveScanRecording)
#: Files that only a camera's SDK can read.
_OF_SDKS = (".oni", ".bag", ".db3")
#: How LiveScan3D's files of point clouds begin.
_LIVESCAN_CLOUDS = (b"n_points", b"n_vertices")


def packaged_recording() -> Path:
    """The recording of the demo, which comes with the package."""
    return Path(str(importlib.resources.files("depthmocap") / "demo_recording"))


def open_recording(path: Path | str, rig: Rig | None = None) -> Recording:
    """Open a recording: an MCAP file, an Azure Kinect's MKV file, a recording folder, or a folder in the layout of the
    sets of TUM and ICL or of a raw take of LiveScan3D.

    Args:
        rig: the poses of the cameras; by default the recording's own.

    Raises:
        InputError: when the path is no recording.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if path.is_dir() and not (path / "rig.json").exists():
        if reader := next((reader for reader in _FOLDERS if reader.is_one(path)), None):
            return reader(path, rig)
    elif suffix in _OF_SDKS:
        raise InputError(_advice(path))
    elif suffix in (".bin", ".ply") and path.is_file():
        raise InputError(_cloud(path))
    elif suffix == ".mcap" and path.is_file() and sdk_of(path) == "orbbec":
        raise InputError(_advice(path))
    return RECORDING_FILES.get(suffix, Recording)(path, rig)


def _advice(path: Path) -> str:
    """What a camera maker's file is, and how it is read."""
    back_end = sdk_of(path)
    if not back_end:
        return (
            f"{path} is a bag that neither the RealSense SDK nor Orbbec's recorded: extract its depth pictures, and "
            "make a recording folder of them (rig.json and <camera>/<timestamp in ns>.png)"
        )
    return (
        f"{path} is read by its camera's SDK: name it as a camera, as in "
        f"depthmocap record {back_end}:{path} --out take.mcap"
    )


def _cloud(path: Path) -> str:
    with open_file(path) as file:
        start = file.read(16)
    if start.startswith(_LIVESCAN_CLOUDS):
        return (
            f"{path} holds LiveScan3D's point clouds, without the depth pictures that are needed: record raw frames "
            "there, and name the take's folder (with client_0, client_1, …)"
        )
    return f"{path} is a point cloud or something else without depth pictures, which are needed"
