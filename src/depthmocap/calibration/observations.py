"""The observations of each camera alone: the person's skeleton and surface in the camera's frame, and the empty
scene."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.calibration.first_look import FirstLook, joints_in
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
#: Of somebody smaller than this (metres), by as much less.
_GROWN_M = 1.4
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


class CameraObserver:
    """Gathers what one camera sees of the person, frame by frame.

    Attributes:
        camera: at the origin.
        segmenter: finds the person; another may take its place when more is known of the empty scene.
        frames: number of frames that were looked at.
        times_s: of the frames that show the person.
    """

    def __init__(
        self, camera: DepthCamera, classifier: Classifier, segmenter: PersonSegmenter, look: FirstLook | None = None
    ) -> None:
        """``look`` tells which way up the pictures are, and how tall the person is: by default upright and grown up."""
        look = look or FirstLook()
        self._quarters = look.quarters
        self._least_m2 = LEAST_PERSON_M2
        if look.stature_m < _GROWN_M:  # not where it is not known
            self._least_m2 *= (look.stature_m / _GROWN_M) ** 2
        self.camera = dataclasses.replace(camera, world_from_camera=np.eye(4))
        self.segmenter, self._classifier = segmenter, classifier
        self.frames = 0
        self.times_s: list[float] = []
        self._joints: list[Float[ndarray, "18 4"]] = []
        self._person: dict[int, tuple[float, Surface]] = {}

    def add(self, depth_m: Float[ndarray, "h w"], time_s: float) -> Bool[ndarray, "h w"] | None:
        """Look at a frame (metres); gives the person's mask, None if too little of them is seen."""
        self.frames += 1
        view = View(self.camera, depth_m)
        if (mask := _person_mask(view, self.segmenter, self._least_m2)) is None:
            return None
        self.times_s.append(time_s)
        self._joints.append(joints_in(view, mask, self._classifier, self._quarters))
        moment = int(time_s // MOMENT_S)
        if moment not in self._person:
            surface = extract_surface(self.camera, depth_m, _PERSON_STRIDE, mask)
            self._person[moment] = time_s, surface.subsampled(_POINTS)
        return mask

    def skip(self) -> None:
        """Count a frame that cannot be read."""
        self.frames += 1

    def observation(self) -> Observation:
        """Everything so far."""
        joints_and_errors = np.stack(self._joints) if self._joints else np.empty((0, 18, 4))
        track = JointTrack(np.array(self.times_s), joints_and_errors[..., :3], joints_and_errors[..., 3])
        unknown = np.zeros((self.camera.height, self.camera.width), np.float32)
        empty_m = self.segmenter.backgrounds_m.get(self.camera.name, unknown)
        return Observation(self.camera, track, dict(self._person), empty_m, self.frames)


def observe(
    recording: Recording,
    classifier: Classifier,
    segmenter: PersonSegmenter,
    rate_hz: float,
    on_frame: Callable[[], None],
    looks: Mapping[str, FirstLook] | None = None,
) -> list[Observation]:
    """The observations of every camera.

    Args:
        rate_hz: most frames per second that are processed.
        looks: which way up the pictures are, and how tall the person is, by camera; upright and grown up by default.
        on_frame: called after every frame.
    """
    observations = []
    for camera in recording.rig.cameras:
        observer = CameraObserver(camera, classifier, segmenter, looks[camera.name] if looks else None)
        for timestamp_ns in subsample_timestamps(recording.stamps(camera.name), rate_hz):
            try:
                depth_m = camera.to_metres(recording.raw(camera.name, timestamp_ns))
            except InputError:
                observer.skip()
            else:
                observer.add(depth_m, timestamp_ns / 1e9 + camera.time_offset_s)
            on_frame()
        observations.append(observer.observation())
    return observations


def _person_mask(view: View, segmenter: PersonSegmenter, least_m2: float) -> Bool[ndarray, "h w"] | None:
    """The person's mask; None if it shows too little of them."""
    mask = segmenter(view)
    area_m2 = float((view.depth_m[mask] ** 2).sum()) / (view.camera.fx * view.camera.fy)
    return mask if area_m2 >= least_m2 else None


def subsample_timestamps(timestamps: list[int], rate_hz: float) -> list[int]:
    """A camera's timestamps (ns), evenly reduced to about ``rate_hz``."""
    if len(timestamps) < 2:
        return timestamps
    period_ns = float(np.median(np.diff(timestamps)))
    # Rounding keeps a rate just above rate_hz, instead of halving it.
    return timestamps[:: max(round(1e9 / rate_hz / period_ns), 1)]
