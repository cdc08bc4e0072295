"""The observations of each camera alone: the person's skeleton and surface in the camera's frame, and the empty
scene."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.surfaces import Surface, extract_surface
from depthmocap.classify.classifier import Classifier
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera
from depthmocap.recordings.recording import Recording
from depthmocap.segment.static_scene import PersonSegmenter

#: Least visible area of the person (m²): a view with less shows too little of them.
LEAST_PERSON_M2 = 0.12
#: The person's surface is kept once in each interval of this length (seconds),
MOMENT_S = 0.4
#: with at most this many points.
_POINTS = 400
#: Number of points of the empty scene in a row.
_POINTS_ACROSS = 160
#: Every so many-th pixel of the person is a point.
_PERSON_STRIDE = 2


@dataclasses.dataclass(frozen=True, eq=False)
class Observation:
    """One camera's observations in a recording.

    Attributes:
        camera: at the origin, wherever the recording's rig places it.
        track: the person's joints.
        person: time (seconds) and surface of the person, by the number of the interval of ``MOMENT_S``.
        empty_m: depth of the empty scene (metres), 0 where it is unknown.
        frames: number of processed frames.
    """

    camera: DepthCamera
    track: JointTrack
    person: dict[int, tuple[float, Surface]]
    empty_m: Float[ndarray, "h w"]
    frames: int

    def empty_surface(self) -> Surface:
        """The surface of the room."""
        return extract_surface(self.camera, self.empty_m, max(round(self.camera.width / _POINTS_ACROSS), 1))


def observe(
    recording: Recording,
    classifier: Classifier,
    segmenter: PersonSegmenter,
    rate_hz: float,
    on_frame: Callable[[], None],
) -> list[Observation]:
    """The observations of every camera.

    Args:
        rate_hz: most frames per second that are processed.
        on_frame: called after every frame.
    """
    observations = []
    for camera in recording.rig.cameras:
        camera_at_origin = dataclasses.replace(camera, world_from_camera=np.eye(4))
        times_s, joints, person = [], [], {}
        timestamps = subsample_timestamps(recording.stamps(camera.name), rate_hz)
        for timestamp_ns in timestamps:
            view = _view(recording, camera_at_origin, timestamp_ns)
            mask = None if view is None else _person_mask(view, segmenter)
            if view is not None and mask is not None:
                (prediction,) = classifier.label_views([view], [mask])
                times_s.append(timestamp_ns / 1e9 + camera.time_offset_s)
                joints.append(prediction.joints)
                moment = int(times_s[-1] // MOMENT_S)
                if moment not in person:
                    surface = extract_surface(camera_at_origin, view.depth_m, _PERSON_STRIDE, mask)
                    person[moment] = times_s[-1], surface.subsampled(_POINTS)
            on_frame()
        joints_and_errors = np.stack(joints) if joints else np.empty((0, 18, 4))
        track = JointTrack(np.array(times_s), joints_and_errors[..., :3], joints_and_errors[..., 3])
        empty_m = segmenter.backgrounds_m.get(camera.name, np.zeros((camera.height, camera.width), np.float32))
        observations.append(Observation(camera_at_origin, track, person, empty_m, len(timestamps)))
    return observations


def _person_mask(view: View, segmenter: PersonSegmenter) -> Bool[ndarray, "h w"] | None:
    """The person's mask; None if it shows too little of them."""
    mask = segmenter(view)
    area_m2 = float((view.depth_m[mask] ** 2).sum()) / (view.camera.fx * view.camera.fy)
    return mask if area_m2 >= LEAST_PERSON_M2 else None


def subsample_timestamps(timestamps: list[int], rate_hz: float) -> list[int]:
    """A camera's timestamps (ns), evenly reduced to about ``rate_hz``."""
    if len(timestamps) < 2:
        return timestamps
    period_ns = float(np.median(np.diff(timestamps)))
    # Rounding keeps a rate just above rate_hz, instead of halving it.
    return timestamps[:: max(round(1e9 / rate_hz / period_ns), 1)]


def _view(recording: Recording, camera: DepthCamera, timestamp_ns: int) -> View | None:
    """A frame; None if it cannot be read."""
    try:
        return View(camera, camera.to_metres(recording.raw(camera.name, timestamp_ns)))
    except InputError:
        return None
