"""The interface of data sets of real people with known joints, for all file formats."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.frames import View
from depthmocap.geometry import transform_points


@dataclasses.dataclass(frozen=True, eq=False)
class AnnotatedFrame:
    """Views at one time and the joints, in the order of ``AnnotatedSet.joints``.

    Attributes:
        views: with a mask of the person where the set has one; without a mask all valid depth is the person's.
        joints_world: metres in the world of the cameras, NaN where unknown.
        subject: the person.
        action: the action, or the name of the sequence.
        frame: number of the frame in the sequence.
    """

    views: tuple[View, ...]
    joints_world: Float[ndarray, "j 3"]
    subject: str
    action: str
    frame: int


@runtime_checkable
class AnnotatedSet(Protocol):
    """A data set, or a part of one; iteration reads the frames from disk."""

    @property
    def name(self) -> str:
        """Name in tables."""
        ...

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, as the set has them."""
        ...

    @property
    def correspondence(self) -> Mapping[str, str]:
        """Some of these names, with the nearest joint of ``body.skeleton.JOINTS``."""
        ...

    @property
    def up(self) -> str:
        """The world's up axis: "z", "y" or "-y"."""
        ...

    @property
    def fps(self) -> float | None:
        """Frames per second; None where frames are not consecutive."""
        ...

    @property
    def problems(self) -> list[str]:
        """What could not be read so far, one line each; frames are checked as they are read."""
        ...

    def __iter__(self) -> Iterator[AnnotatedFrame]: ...


class PassedOn:
    """The frames of another set as they are; a subclass looks at them on their way (``__iter__``)."""

    def __init__(self, source: AnnotatedSet) -> None:
        self.name, self.joints, self.correspondence, self.up, self.fps = (
            source.name, source.joints, source.correspondence, source.up, source.fps,
        )  # fmt: skip
        self._source = source

    @property
    def problems(self) -> list[str]:
        """As in ``AnnotatedSet``."""
        return self._source.problems


#: How far the body extends beyond its joints (hands, feet, the top of the head), metres.
REACH_M = 0.3


def near_joints(view: View, joints_world: Float[ndarray, "j 3"]) -> Bool[ndarray, "h w"]:
    """Mask for sets without one: pixels within ``REACH_M`` of the box around the known joints, along the camera's axes;
    empty where no joint is known. It replaces a person detector, like crops by the ground truth elsewhere in the
    field."""
    joints = transform_points(view.camera.camera_from_world, joints_world[np.isfinite(joints_world).all(1)])
    if not len(joints):
        return np.zeros(view.depth_m.shape, bool)
    low, high = joints.min(0) - REACH_M, joints.max(0) + REACH_M
    z = view.depth_m
    across = view.camera.rays * z[..., None]
    inside = (across >= low[:2]).all(-1) & (across <= high[:2]).all(-1)
    return inside & (z > 0) & (z >= low[2]) & (z <= high[2])
