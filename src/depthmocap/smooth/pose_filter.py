"""What every filter over time is: poses in, poses out, one for one."""

from __future__ import annotations

import abc
import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from depthmocap.frames import Pose

#: After a pause this long nothing of before is used.
FORGET_S = 0.5


class PoseFilter(abc.ABC):
    """Give it every pose of a stream, in order of time, NaN joints where there are none; timestamps may be irregular.

    A joint that is missing stays missing unless a filter says that it bridges. A timestamp before the last one begins
    a new stream.

    Attributes:
        delay_frames: each pose given back is of so many frames ago; its timestamp tells which. Until there are so many,
            it is of the first, and not final. :meth:`finish` gives the last ones.
    """

    delay_frames: int = 0

    @property
    @abc.abstractmethod
    def latency_s(self) -> float:
        """How late the result is (seconds): frames waited for at the rate seen so far, and the lag behind steady
        movement of 1 m/s."""

    @property
    @abc.abstractmethod
    def settings(self) -> Any:
        """The filter's settings, a frozen dataclass."""

    @abc.abstractmethod
    def __call__(self, pose: Pose) -> Pose:
        """The filtered pose of ``delay_frames`` ago."""

    @abc.abstractmethod
    def reset(self) -> None:
        """Forget the past: when another person enters, or another recording begins."""

    def finish(self) -> list[Pose]:
        """The last ``delay_frames`` poses at the end of a stream (all, if there were fewer); forgets the past."""
        self.reset()
        return []

    def describe(self) -> dict[str, Any]:
        """Name, settings and latency, for the record."""
        return {
            "filter": type(self).__name__, **dataclasses.asdict(self.settings),
            "delay_frames": self.delay_frames, "latency_s": self.latency_s,
        }  # fmt: skip


def seen_joints(pose: Pose) -> Bool[ndarray, "18"]:
    """The joints that a pose has."""
    return np.asarray(np.isfinite(pose.joints).all(1))
