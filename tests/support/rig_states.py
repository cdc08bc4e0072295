"""A rig that is being set up: cameras of the packaged recording, and somebody who walked along a line before them."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from depthmocap.calibration.calibrate import Calibration
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.observations import Observation
from depthmocap.calibration.verdict import PairVerdict
from depthmocap.frames import FrameSet
from depthmocap.geometry import Rig, rigid_inverse, transform_points
from depthmocap.realtime.status import CameraStatus
from depthmocap.rigging.floor_map import draw_map
from depthmocap.rigging.rig_session import RigState
from depthmocap.rigging.walk_observer import Sight


def pair(a: str, b: str, uncertainty_mm: float) -> PairVerdict:
    return PairVerdict((a, b), 80, 70, 12.0, 2.0, 900, 4.0, uncertainty_mm, 0.2)


def calibration(rig: Rig, *uncertain_mm: float, **changes: Any) -> Calibration:
    """The cameras in their true places; a number for each pair of the first camera and another."""
    first, *others = rig.names
    pairs = [pair(first, other, mm) for other, mm in zip(others, uncertain_mm, strict=True)]
    known = Calibration(rig, "floor", {}, pairs, [], {}, np.zeros((1, 3)), {})
    return dataclasses.replace(known, **changes)


def observations(rig: Rig, along_m: float = 0.6) -> list[Observation]:
    """What each camera has seen of somebody who went from the origin along x."""
    x = np.linspace(0.0, along_m, 30)
    hips = np.stack([x, np.zeros(30), np.full(30, 0.95)], 1)
    seen = []
    for camera in rig.cameras:
        joints = np.repeat(transform_points(rigid_inverse(camera.world_from_camera), hips)[:, None], 18, 1)
        track = JointTrack(np.arange(30) * 0.1, joints, np.full((30, 18), 0.02))
        empty_m = np.zeros((camera.height, camera.width), np.float32)
        seen.append(Observation(dataclasses.replace(camera, world_from_camera=np.eye(4)), track, {}, empty_m, 30))
    return seen


def rig_state(frames: FrameSet, *uncertain_mm: float, **changes: Any) -> RigState:
    """The state with a calibration of so good pairs."""
    rig = Rig(tuple(view.camera for view in frames.views))
    known = calibration(rig, *uncertain_mm)
    state = RigState(
        tuple(CameraStatus(name, "running", 30.0, 0.0, 0, {"missing": 0}) for name in rig.names),
        {camera.name: camera for camera in rig.cameras},
        {view.camera.name: Sight(view.depth_m, view.depth_m < 2.5) for view in frames.views},
        dict.fromkeys(rig.names, (30, 30)), {}, (), known, draw_map(known, observations(rig)), "walk on", 1,
        known.grade == "good", False,
    )  # fmt: skip
    return dataclasses.replace(state, **changes)
