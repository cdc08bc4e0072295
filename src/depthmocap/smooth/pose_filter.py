"""The interface of the filters over time: one pose out for each pose in."""

from __future__ import annotations

import abc
import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from depthmocap.frames import Pose

#: After a gap this long (seconds) a filter forgets what was before.
MAX_GAP_S = 0.5


class PoseFilter(abc.ABC):
    """Filters the poses of a stream, given in order of time; missing joints are NaN, and timestamps may be irregular.

    A missing joint stays missing unless the filter fills gaps. A timestamp before the last one starts a new stream.

    Attributes:
        delay_frames: each pose returned belongs to so many frames ago; its timestamp says which. Until there are so
            many frames, it is the first frame's and not final. :meth:`finish` returns the last ones.
    """

    delay_frames: int = 0

    @property
    @abc.abstractmethod
    def latency_s(self) -> float:
        """Latency of the result (seconds): the delay at the present frame rate, plus the lag behind a steady movement
        of 1 m/s."""

    @property
    @abc.abstractmethod
    def settings(self) -> Any:
        """The filter's settings, a frozen dataclass."""

    @abc.abstractmethod
    def __call__(self, pose: Pose) -> Pose:
        """The filtered pose of ``delay_frames`` frames ago."""

    @abc.abstractmethod
    def reset(self) -> None:
        """Forget the past, for another person or another recording."""

    def finish(self) -> list[Pose]:
        """The last ``delay_frames`` poses of a stream (all, if there were fewer). Forgets the past."""
        self.reset()
        return []

    def describe(self) -> dict[str, Any]:
        """Name, settings and latency, for files of results."""
        return {
            "filter": type(self).__name__, **dataclasses.asdict(self.settings),
            "delay_frames": self.delay_frames, "latency_s": self.latency_s,
        }  # fmt: skip


def observed_joints(pose: Pose) -> Bool[ndarray, "18"]:
    """Mask of the joints that are not missing."""
    return np.asarray(np.isfinite(pose.joints).all(1))
