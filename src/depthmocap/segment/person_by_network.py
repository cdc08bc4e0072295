"""The person in single views: by the empty scene, and by the network where a recording does not tell that scene."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.frames import FrameSet, View
from depthmocap.segment.network_segmenter import NetworkSegmenter
from depthmocap.segment.people_detector import PeopleDetector
from depthmocap.segment.people_segmenter import PersonMasks
from depthmocap.segment.static_scene import Mode, PersonSegmenter

#: Views are shown so often, that everybody certain is told of,
_TIMES = 3
#: so far apart in time (ns).
_APART_NS = 100_000_000


def people_at_once(views: tuple[View, ...], detector: PeopleDetector, people: int = 1) -> tuple[PersonMasks, ...]:
    """The people, at most so many, whom the network finds in one set of views by itself, without an empty scene."""
    segmenter = NetworkSegmenter({}, people=people, background=False, detector=detector)
    persons: tuple[PersonMasks, ...] = ()
    for i in range(_TIMES):
        persons = segmenter(FrameSet(i * _APART_NS, views))
    return persons


class PersonByNetwork(PersonSegmenter):
    """A :class:`PersonSegmenter` that takes the network for cameras whose empty scene was estimated from a recording
    in which the person hardly moved: they are a part of that scene.
    """

    def __init__(self, backgrounds_m: Mapping[str, Float[ndarray, "_ _"]], mode: Mode = "auto") -> None:
        super().__init__(backgrounds_m, mode)
        self._detector: PeopleDetector | None = None

    def __call__(self, view: View) -> Bool[ndarray, "h w"]:
        if view.mask is not None or view.camera.name not in self.doubtful:
            return super().__call__(view)
        self._detector = self._detector or PeopleDetector()
        people = people_at_once((view,), self._detector)
        return people[0].masks[0] if people else np.zeros(view.depth_m.shape, np.bool_)

    def scaled(self, name: str, factor: float) -> PersonSegmenter:
        return self if name in self.doubtful else super().scaled(name, factor)

    @property
    def problems(self) -> list[str]:
        """None: the network needs no empty scene."""
        return []
