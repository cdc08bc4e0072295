"""What flows between the stages: views of one instant, and the pose found in them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from depthmocap.geometry.cameras import DepthCamera


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """One camera's depth image. ``mask`` marks the person where it is known, ``labels`` the true regions 0–43."""

    camera: DepthCamera
    depth_m: Float[ndarray, "h w"]
    mask: Bool[ndarray, "h w"] | None = None
    labels: UInt8[ndarray, "h w"] | None = None

    def turned(self, quarters: int) -> View:
        """The view turned anticlockwise by so many quarters, with its camera: the same of the world is seen."""
        pictures = (None if each is None else np.ascontiguousarray(np.rot90(each, quarters))
                    for each in (self.depth_m, self.mask, self.labels))  # fmt: skip
        return View(self.camera.turned(quarters), *pictures)  # pyright: ignore[reportArgumentType]


@dataclasses.dataclass(frozen=True, eq=False)
class FrameSet:
    """Views of one instant, of the cameras that delivered a frame. ``true_joints`` in the world, metres, if known."""

    timestamp_ns: int
    views: tuple[View, ...]
    true_joints: Float[ndarray, "18 3"] | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Pose:
    """Joints of one instant in the world, metres; an unobserved joint is NaN with confidence 0."""

    timestamp_ns: int
    joints: Float[ndarray, "18 3"]
    confidence: Float[ndarray, "18"]


@runtime_checkable
class FrameSource(Protocol):
    """A recording or any other sequence of frame sets. ``up`` is the world's up axis: "z", "y" or "-y"."""

    up: str

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[FrameSet]: ...
