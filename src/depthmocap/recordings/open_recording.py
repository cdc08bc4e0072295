"""Opens any recording by its path."""

from __future__ import annotations

import importlib.resources
from pathlib import Path

from depthmocap.errors import InputError
from depthmocap.geometry import Rig
from depthmocap.recordings.mcap_recording import McapRecording
from depthmocap.recordings.mkv_recording import MkvRecording
from depthmocap.recordings.recording import Recording

#: Readers of files, by the ending of their names.
RECORDING_FILES: dict[str, type[Recording]] = {".mcap": McapRecording, ".mkv": MkvRecording}
#: Files that only a camera back end can read.
_BY_SDK = {".oni": "openni", ".bag": "orbbec"}


def packaged_recording() -> Path:
    """The recording of the demo, which comes with the package."""
    return Path(str(importlib.resources.files("depthmocap") / "demo_recording"))


def open_recording(path: Path | str, rig: Rig | None = None) -> Recording:
    """Open a recording: an MCAP file, an Azure Kinect's MKV file, or a recording folder.

    Args:
        rig: the poses of the cameras; by default the recording's own.

    Raises:
        InputError: when the path is no recording.
    """
    path = Path(path)
    if back_end := _BY_SDK.get(path.suffix.lower()):
        raise InputError(
            f"{path} is read by its camera's SDK: name it as a camera, as in "
            f"depthmocap record {back_end}:{path} --out take.mcap"
        )
    return RECORDING_FILES.get(path.suffix.lower(), Recording)(path, rig)
