"""Real-time markerless human motion capture from several depth cameras.

    import depthmocap

    pipeline = depthmocap.load_pipeline("recording")
    for frames in depthmocap.open_source("recording"):
        pose = pipeline(frames).pose

Importing this loads neither torch nor a camera SDK; heavier parts are loaded on first use.
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

# Before anything of this package can load ONNX Runtime, which otherwise looks up a host of its maker and keeps a
# database for it in the user's cache; nothing that is called later ends that. Worker processes inherit it.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, Pose, View
from depthmocap.geometry import DepthCamera, Rig, load_rig, save_rig

if TYPE_CHECKING:
    from depthmocap.body.skeleton import JOINTS as JOINTS
    from depthmocap.capture.recording import Recording as Recording
    from depthmocap.offline import RunSettings as RunSettings
    from depthmocap.offline import load_pipeline as load_pipeline
    from depthmocap.offline import open_source as open_source
    from depthmocap.offline import run as run
    from depthmocap.online.live import live as live
    from depthmocap.online.live import live_people as live_people
    from depthmocap.pipeline import Pipeline as Pipeline

__version__ = "0.1.0"

_LAZY = {
    "JOINTS": "depthmocap.body.skeleton",
    "Pipeline": "depthmocap.pipeline",
    "Recording": "depthmocap.capture.recording",
    "live": "depthmocap.online.live",
    "live_people": "depthmocap.online.live",
    "RunSettings": "depthmocap.offline",
    "load_pipeline": "depthmocap.offline",
    "open_source": "depthmocap.offline",
    "run": "depthmocap.offline",
}

__all__ = [
    "JOINTS",
    "DepthCamera",
    "FrameSet",
    "InputError",
    "Pipeline",
    "Pose",
    "Recording",
    "Rig",
    "RunSettings",
    "View",
    "live",
    "live_people",
    "load_pipeline",
    "load_rig",
    "open_source",
    "run",
    "save_rig",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(importlib.import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'depthmocap' has no attribute {name!r}")
