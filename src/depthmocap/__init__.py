"""Real-time markerless human motion capture from several depth cameras.

    import depthmocap

    recording = depthmocap.open_recording("recording")
    pipeline = depthmocap.load_pipeline(recording)
    for frames in recording:
        pose = pipeline(frames).pose

What this module names is public: it keeps its meaning from one version to the next, and a change of it is told in the
changelog. So are the commands, their options, and the files that they write. Everything else may move.

Importing this loads neither torch nor a camera SDK; heavier parts are loaded on first use.
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

# Before anything of this package can load ONNX Runtime, which otherwise looks up a host of its maker and keeps a
# database for it in the user's cache; nothing that is called later ends that. Worker processes inherit it.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

from depthmocap.core.version import __version__
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, FrameSource, Pose, View
from depthmocap.geometry import DepthCamera, Rig, load_rig, save_rig

if TYPE_CHECKING:
    from depthmocap.analysis.analyse_command import AnalyseSettings, analyse
    from depthmocap.body.skeleton import JOINTS
    from depthmocap.calibration.calibrate import CalibrateSettings, Calibration, calibrate
    from depthmocap.cameras.registry import open_camera
    from depthmocap.cameras.source import CameraError, DepthFrame, DepthSource, FrameTimeoutError
    from depthmocap.exporting import read_csv, write_bvh, write_csv, write_trc
    from depthmocap.exporting.export_command import ExportSettings, export
    from depthmocap.exporting.run_result import RunResult
    from depthmocap.offline.pipeline import PersonResult, Pipeline, Result
    from depthmocap.offline.pipeline_settings import PipelineSettings, load_pipeline, open_source
    from depthmocap.offline.run import RunSettings, run
    from depthmocap.pose.cloud import LabelledCloud
    from depthmocap.pose.estimators import JointEstimator
    from depthmocap.realtime.live_capture import LiveCapture, LivePose, live
    from depthmocap.recordings.open_recording import open_recording
    from depthmocap.recordings.recording import Recording
    from depthmocap.recordings.recording_writer import RecordingWriter
    from depthmocap.rigging.setup_command import SetupSettings, setup
    from depthmocap.smooth.pose_filter import PoseFilter
    from depthmocap.streaming.stream_protocol import Marker, Sample, Stream, StreamSetup

#: What is loaded on first use, by module.
_LAZY = {
    "depthmocap.analysis.analyse_command": ("AnalyseSettings", "analyse"),
    "depthmocap.body.skeleton": ("JOINTS",),
    "depthmocap.calibration.calibrate": ("CalibrateSettings", "Calibration", "calibrate"),
    "depthmocap.cameras.registry": ("open_camera",),
    "depthmocap.cameras.source": ("CameraError", "DepthFrame", "DepthSource", "FrameTimeoutError"),
    "depthmocap.exporting": ("read_csv", "write_bvh", "write_csv", "write_trc"),
    "depthmocap.exporting.export_command": ("ExportSettings", "export"),
    "depthmocap.exporting.run_result": ("RunResult",),
    "depthmocap.offline.pipeline": ("PersonResult", "Pipeline", "Result"),
    "depthmocap.offline.pipeline_settings": ("PipelineSettings", "load_pipeline", "open_source"),
    "depthmocap.offline.run": ("RunSettings", "run"),
    "depthmocap.realtime.live_capture": ("LiveCapture", "LivePose", "live"),
    "depthmocap.pose.cloud": ("LabelledCloud",),
    "depthmocap.pose.estimators": ("JointEstimator",),
    "depthmocap.recordings.recording": ("Recording",),
    "depthmocap.recordings.recording_writer": ("RecordingWriter",),
    "depthmocap.recordings.open_recording": ("open_recording",),
    "depthmocap.rigging.setup_command": ("SetupSettings", "setup"),
    "depthmocap.smooth.pose_filter": ("PoseFilter",),
    "depthmocap.streaming.stream_protocol": ("Marker", "Sample", "Stream", "StreamSetup"),
}
_MODULE = {name: module for module, names in _LAZY.items() for name in names}

__all__ = [
    "JOINTS",
    "AnalyseSettings",
    "CalibrateSettings",
    "Calibration",
    "CameraError",
    "DepthCamera",
    "DepthFrame",
    "DepthSource",
    "ExportSettings",
    "FrameSet",
    "FrameSource",
    "FrameTimeoutError",
    "InputError",
    "JointEstimator",
    "LabelledCloud",
    "LiveCapture",
    "LivePose",
    "Marker",
    "PersonResult",
    "Pipeline",
    "PipelineSettings",
    "Pose",
    "PoseFilter",
    "Recording",
    "RecordingWriter",
    "Result",
    "Rig",
    "RunResult",
    "RunSettings",
    "Sample",
    "SetupSettings",
    "Stream",
    "StreamSetup",
    "View",
    "__version__",
    "analyse",
    "calibrate",
    "export",
    "live",
    "load_pipeline",
    "load_rig",
    "open_camera",
    "open_recording",
    "open_source",
    "read_csv",
    "run",
    "save_rig",
    "setup",
    "write_bvh",
    "write_csv",
    "write_trc",
]


def __getattr__(name: str) -> Any:
    if name in _MODULE:
        return getattr(importlib.import_module(_MODULE[name]), name)
    raise AttributeError(f"module 'depthmocap' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
