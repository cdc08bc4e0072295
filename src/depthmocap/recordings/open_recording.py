"""Any recording by its path."""

from __future__ import annotations

import importlib.resources
from pathlib import Path

from depthmocap.errors import InputError
from depthmocap.geometry import Rig
from depthmocap.recordings.folder import Recording
from depthmocap.recordings.mcap_recording import McapRecording
from depthmocap.recordings.mkv_recording import MkvRecording

_FILES: dict[str, type[Recording]] = {".mcap": McapRecording, ".mkv": MkvRecording}
#: Files that are played like cameras, by back ends.
_BY_SDK = {".oni": "openni", ".bag": "orbbec"}


def packaged_recording() -> Path:
    """The recording of the demo, which comes with the package."""
    return Path(str(importlib.resources.files("depthmocap") / "demo_recording"))


def open_recording(path: Path, rig: Rig | None = None) -> Recording:
    """An MCAP file or an Azure Kinect's MKV file, by the end of its name, or a recording folder; its
    cameras stand where ``rig`` says, if one is given.

    Raises:
        InputError: when it is none.
    """
    if back_end := _BY_SDK.get(path.suffix.lower()):
        raise InputError(
            f"{path} is read by its camera's SDK: name it as a camera, as in "
            f"depthmocap record {back_end}:{path} --out take.mcap"
        )
    return _FILES.get(path.suffix.lower(), Recording)(path, rig)
