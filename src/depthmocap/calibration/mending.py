"""A rig with what mends what is wrong with its cameras' pictures and poses."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.picture_faults import PictureFault
from depthmocap.calibration.pose_faults import TURNED_PICTURE, PoseFault, find_pose_faults
from depthmocap.calibration.turned_pictures import turned_camera
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig, check_extrinsics
from depthmocap.recordings.open_recording import open_recording
from depthmocap.recordings.recording import Recording, TurnedPicturesError


def open_mending(path: Path, mend: bool) -> tuple[Recording, list[str]]:
    """A recording; with ``mend``, cameras whose pictures are on their side against their intrinsics have these turned,
    too, and are told, a line each.

    Raises:
        InputError: when it cannot be read, or is not to be mended.
    """
    rig, lines = None, []
    while True:
        try:
            return open_recording(path, rig), lines
        except TurnedPicturesError as error:
            if not mend:
                raise
            rig = error.rig
            lines.append(f"mended: the pictures of camera {error.camera!r} are on their side against the intrinsics")


def mended_rig(rig: Rig, faults: Sequence[PictureFault]) -> Rig:
    """The rig with what mends the faults of pictures that are certain."""
    cameras = {camera.name: camera for camera in rig.cameras}
    for fault in faults:
        for name in fault.cameras if fault.certain else ():
            cameras[name] = mended_camera(cameras[name], fault)
    return dataclasses.replace(rig, cameras=tuple(cameras.values()))


def mended_camera(camera: DepthCamera, fault: PictureFault) -> DepthCamera:
    """A camera with what mends the fault of its pictures."""
    if fault.kind == "mirror":
        return dataclasses.replace(camera, mirrored=not camera.mirrored)
    if fault.kind == "turned":
        return turned_camera(camera)
    return dataclasses.replace(camera, depth_factor=camera.depth_factor * fault.factor)


def mend_poses(rig: Rig, tracks: Sequence[JointTrack], rng: np.random.Generator) -> tuple[Rig, list[str], list[str]]:
    """A rig whose pictures are right with what mends its poses and its world's axis.

    Args:
        tracks: each camera's joints in its own frame.

    Returns:
        The rig, what is mended, and what is not because it is in no known way or another camera's fault; a line each.
    """
    try:
        check_extrinsics(rig.cameras)
    except InputError as error:
        return rig, [], [str(error)]
    mended, left = [], []
    for fault in find_pose_faults(rig.cameras, tracks, rig.up, rng):
        changed = _with_mended_poses(rig, fault)
        if changed is None:
            left.append(fault.text)
        else:
            rig = changed
            mended.append(fault.text)
    return rig, mended, left


def _with_mended_poses(rig: Rig, fault: PoseFault) -> Rig | None:
    """None where it is not known what mends it; a camera that stands elsewhere wants a calibration."""
    if fault.up:
        return dataclasses.replace(rig, up=fault.up)
    if not fault.certain or fault.kind == "elsewhere":
        return None
    cameras = {camera.name: camera for camera in rig.cameras}
    for name in fault.cameras:
        camera = cameras[name]
        if fault.kind == "unit":
            cameras[name] = dataclasses.replace(camera, depth_factor=camera.depth_factor * fault.factor)
        elif fault.kind == TURNED_PICTURE:
            cameras[name] = camera.turned(2)
        elif name in fault.poses:
            cameras[name] = dataclasses.replace(camera, world_from_camera=fault.poses[name])
    return dataclasses.replace(rig, cameras=tuple(cameras.values()))
