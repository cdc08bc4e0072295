"""What cameras have seen so far of a person who walks about: the same observations as of a recording, set by set."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Mapping

from jaxtyping import Bool, Float, UInt16
from numpy import ndarray

from depthmocap.calibration.observations import CameraObserver, Observation
from depthmocap.classify.classifier import Classifier
from depthmocap.geometry import DepthCamera
from depthmocap.segment.background import estimate_background
from depthmocap.segment.static_scene import PersonSegmenter

#: Frames that the empty scene of a camera is estimated from: as many as this, and up to twice as many.
SAMPLES = 20
#: Fewest frames for an estimate.
FEWEST_SAMPLES = 6
#: Growth of their number from one estimate to the next.
GROWTH = 1.3


@dataclasses.dataclass(frozen=True, eq=False)
class Sight:
    """A camera's last frame (metres), and the person in it; None while the empty scene is not known, or nobody is
    seen."""

    depth_m: Float[ndarray, "h w"]
    mask: Bool[ndarray, "h w"] | None


class _EmptyScene:
    """Frames spread evenly over the time so far, and the empty scene behind whoever moves in them."""

    def __init__(self, camera: DepthCamera) -> None:
        self._camera = camera
        self._samples: list[UInt16[ndarray, "h w"]] = []
        self._every, self._frames, self._estimated = 1, 0, 0

    def add(self, raw: UInt16[ndarray, "h w"]) -> Float[ndarray, "h w"] | None:
        """Take a frame of raw depth; gives the empty scene (metres) where it is estimated anew."""
        self._frames += 1
        if self._frames % self._every:
            return None
        self._samples.append(raw)
        if len(self._samples) > 2 * SAMPLES:
            self._samples, self._every = self._samples[1::2], 2 * self._every
        if len(self._samples) < FEWEST_SAMPLES or self._frames < GROWTH * self._estimated:
            return None
        self._estimated = self._frames
        return estimate_background([self._camera.to_metres(sample) for sample in self._samples])


class WalkObserver:
    """Takes sets of frames from one thread; any thread may ask what was seen."""

    def __init__(self, classifier: Classifier, empty_m: Mapping[str, Float[ndarray, "_ _"]]) -> None:
        """``empty_m``: the empty scenes that are known (metres), by camera; others are estimated meanwhile."""
        self._classifier, self._lock = classifier, threading.Lock()
        self._empty_m: dict[str, ndarray] = dict(empty_m)
        self._observers: dict[str, CameraObserver] = {}
        self._scenes: dict[str, _EmptyScene] = {}
        self._sights: dict[str, Sight] = {}

    def add(self, camera: DepthCamera, raw: UInt16[ndarray, "h w"], time_s: float) -> None:
        """Look at a frame of raw depth, exposed at a time that all cameras share (seconds, their offset added)."""
        name, depth_m = camera.name, camera.to_metres(raw)
        if name not in self._observers:
            known = {name: self._empty_m[name]} if name in self._empty_m else {}
            observer = CameraObserver(camera, self._classifier, PersonSegmenter(known))
            if not known:
                self._scenes[name] = _EmptyScene(camera)
            with self._lock:
                self._observers[name] = observer
        observer = self._observers[name]
        if name in self._scenes and (empty_m := self._scenes[name].add(raw)) is not None:
            observer.segmenter = PersonSegmenter({name: empty_m})
        with self._lock:
            mask = observer.add(depth_m, time_s)
            self._sights[name] = Sight(depth_m, mask)

    @property
    def sights(self) -> dict[str, Sight]:
        """The last frame of each camera."""
        with self._lock:
            return dict(self._sights)

    @property
    def seen(self) -> dict[str, tuple[int, int]]:
        """By camera, the number of frames that show the person, and of all."""
        with self._lock:
            return {name: (len(each.times_s), each.frames) for name, each in self._observers.items()}

    def observations(self) -> list[Observation]:
        """What each camera has seen so far."""
        with self._lock:
            return [observer.observation() for observer in self._observers.values()]
