"""What each camera sees by itself: the person's skeleton and surface in its own frame, and the empty scene."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.calibration.joint_tracks import Track
from depthmocap.calibration.surfaces import Surface, surface_of
from depthmocap.classify.classifier import Classifier
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera
from depthmocap.recordings.recording import Recording
from depthmocap.segment.static_scene import PersonSegmenter

#: Somebody shows so much surface across the line of sight, or the view tells too little of them (m²).
LEAST_PERSON_M2 = 0.12
#: The person's surface is kept at moments this far apart (s), of so many points at most.
MOMENT_S, _POINTS = 0.4, 400
#: So many points of the empty scene side by side; the person is looked at more closely.
_ACROSS, _EVERY_PERSON = 160, 2


@dataclasses.dataclass(frozen=True, eq=False)
class Observation:
    """What one camera saw in a recording.

    Attributes:
        camera: at the origin, whatever the recording says.
        track: the person.
        person: the person's surface and its time (s), by the number of the moment.
        empty_m: depth of the empty scene (metres), 0 where it is not known.
        frames: that were looked at.
    """

    camera: DepthCamera
    track: Track
    person: dict[int, tuple[float, Surface]]
    empty_m: Float[ndarray, "h w"]
    frames: int

    def empty_surface(self) -> Surface:
        """Of the room."""
        return surface_of(self.camera, self.empty_m, max(round(self.camera.width / _ACROSS), 1))


def observe(
    recording: Recording, classifier: Classifier, segmenter: PersonSegmenter, rate_hz: float, looked: Callable[[], None]
) -> list[Observation]:
    """What every camera sees by itself.

    Args:
        rate_hz: frames a second that are looked at, at most.
        looked: called after every frame.
    """
    seen = []
    for camera in recording.rig.cameras:
        placed = dataclasses.replace(camera, world_from_camera=np.eye(4))
        times, joints, person = [], [], {}
        stamps = thinned(recording.stamps(camera.name), rate_hz)
        for stamp in stamps:
            view = _view(recording, placed, stamp)
            if view is not None:
                mask = segmenter(view)
                area_m2 = float((view.depth_m[mask] ** 2).sum()) / (camera.fx * camera.fy)
                if area_m2 >= LEAST_PERSON_M2:
                    (found,) = classifier.label_views([view], [mask])
                    times.append(stamp / 1e9)
                    joints.append(found.joints)
                    moment = int(times[-1] // MOMENT_S)
                    if moment not in person:
                        surface = surface_of(placed, view.depth_m, _EVERY_PERSON, mask)
                        person[moment] = times[-1], surface.thinned(_POINTS)
            looked()
        places = np.stack(joints) if joints else np.empty((0, 18, 4))
        track = Track(np.array(times), places[..., :3], places[..., 3])
        empty_m = segmenter.backgrounds_m.get(camera.name, np.zeros((camera.height, camera.width), np.float32))
        seen.append(Observation(placed, track, person, empty_m, len(stamps)))
    return seen


def thinned(stamps: list[int], rate_hz: float) -> list[int]:
    """Timestamps (ns) of a camera, at most so many a second, evenly."""
    if len(stamps) < 2:
        return stamps
    period_ns = float(np.median(np.diff(stamps)))
    # A rate just above the wanted one is kept, so that it is not halved.
    return stamps[:: max(round(1e9 / rate_hz / period_ns), 1)]


def _view(recording: Recording, camera: DepthCamera, stamp: int) -> View | None:
    """A frame, or nothing where it cannot be read."""
    try:
        return View(camera, camera.to_metres(recording.raw(camera.name, stamp)))
    except InputError:
        return None
