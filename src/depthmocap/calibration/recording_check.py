"""What is wrong with the pictures and the extrinsics of a recording, by the people in it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from rich.console import Console

from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.picture_faults import PictureFault, find_picture_faults, mirrored, scaled
from depthmocap.calibration.pose_faults import PoseFault, find_pose_faults
from depthmocap.calibration.sighting import see_person
from depthmocap.calibration.turned_pictures import as_turned, find_turned_pictures, turned_words
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, check_extrinsics
from depthmocap.recordings.recording import Recording

#: Most frames of each camera that are looked at.
MOST_SETS = 200
#: And most a second.
_RATE_HZ = 10.0


@dataclasses.dataclass(frozen=True)
class RecordingCheck:
    """What the people in a recording tell of its cameras.

    Attributes:
        frames: of each camera in which somebody is found, and those that were looked at.
        faults: what is wrong, a line each.
        unknown: what could not be told, a line each.
    """

    frames: dict[str, tuple[int, int]]
    faults: list[str]
    unknown: list[str]


def check_recording(
    recording: Recording,
    console: Console,
    most_sets: int = MOST_SETS,
    segment: Literal["auto", "none"] = "auto",
    weights: Path | None = None,
) -> RecordingCheck:
    """Look at up to ``most_sets`` frames of each camera.

    Raises:
        InputError: when the weights cannot be read, or tell no joints.
    """
    seconds = np.ptp(recording.set_stamps_ns) / 1e9 if len(recording) else 0.0
    rate_hz = min(_RATE_HZ, most_sets / max(seconds, 1e-3))
    rng = np.random.default_rng(0)
    sighting = see_person(recording, segment, weights, rate_hz, rng, console)
    cameras = recording.rig.cameras
    frames = {
        camera.name: (len(observation.track.times_s), observation.frames)
        for camera, observation in zip(cameras, sighting.observations, strict=True)
    }
    faults, unknown = fault_lines(cameras, sighting.tracks, sighting.faults, recording.up, rng)
    missing = [
        f"camera {name!r} never sees a person: nothing can be told of it" for name, (n, _) in frames.items() if n < 2
    ]
    return RecordingCheck(frames, faults, [*missing, *([] if faults else sighting.small), *unknown])


def check_tracks(cameras: Sequence[DepthCamera], tracks: Sequence[JointTrack], up: str) -> list[str]:
    """What is wrong with cameras, a line each, by the joints that each of them sees, in its own frame."""
    rng = np.random.default_rng(0)
    faults = find_picture_faults(cameras, tracks, rng)
    faults += find_turned_pictures(cameras, tracks, faults, rng)
    return fault_lines(cameras, tracks, faults, up, rng)[0]


def fault_lines(
    cameras: Sequence[DepthCamera],
    tracks: Sequence[JointTrack],
    faults: Sequence[PictureFault],
    up: str,
    rng: np.random.Generator,
) -> tuple[list[str], list[str]]:
    """Faults of pictures in words, and what is wrong with the extrinsics once these are mended; and what cannot be
    told; a line each."""
    unknown = []
    lines = [fault.text for fault in faults]
    if len(cameras) == 1:
        unknown.append(
            "one camera alone cannot tell whether its picture is mirrored, or its depth off by less than half"
        )
    elif not faults:
        unknown.append("pictures that are all mirrored alike cannot be told")
    try:
        check_extrinsics(cameras)
    except InputError:
        where = "where the cameras stand is not known: depthmocap calibrate RECORDING --out rig.json"
        return lines, [*unknown, where]
    if not _known(cameras, faults):
        return lines, [*unknown, "whether the extrinsics are right cannot be told before the pictures are"]
    turned = {fault.cameras: i for i, fault in enumerate(faults) if fault.kind == "turned"}
    for pose in pose_faults_of(cameras, tracks, faults, up, rng):
        if pose.kind == "turned 180" and pose.cameras in turned:  # the picture was turned after all else was known
            (camera,) = (camera for camera in cameras if (camera.name,) == pose.cameras)
            lines[turned[pose.cameras]] = turned_words(camera, with_pose=True)
        else:
            lines.append(pose.text)
    return lines, unknown


def pose_faults_of(
    cameras: Sequence[DepthCamera],
    tracks: Sequence[JointTrack],
    faults: Sequence[PictureFault],
    up: str,
    rng: np.random.Generator,
) -> list[PoseFault]:
    """Faults of extrinsics with the pictures mended; none where it is not certain what mends them. A unit that all
    cameras share is told better by where they stand, and left as it is."""
    if not _known(cameras, faults):
        return []
    faults = [fault for fault in faults if not _is_common(cameras, fault)]
    mended = [_mended(camera, track, faults) for camera, track in zip(cameras, tracks, strict=True)]
    return find_pose_faults(cameras, mended, up, rng)


def _is_common(cameras: Sequence[DepthCamera], fault: PictureFault) -> bool:
    return fault.kind == "unit" and len(fault.cameras) == len(cameras) > 1 and fault.common


def _known(cameras: Sequence[DepthCamera], faults: Sequence[PictureFault]) -> bool:
    """Whether it is certain what mends the pictures of each camera, or all share the same unit."""
    return all(fault.certain or _is_common(cameras, fault) for fault in faults)


def _mended(camera: DepthCamera, track: JointTrack, faults: Sequence[PictureFault]) -> JointTrack:
    for fault in faults:
        if fault.certain and camera.name in fault.cameras:
            if fault.kind == "turned":
                track = as_turned(camera, track)
            else:
                track = mirrored(camera, track) if fault.kind == "mirror" else scaled(track, fault.factor)
    return track
