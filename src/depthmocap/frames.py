"""What flows between the stages: views of one instant, and the pose found in them."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Float64, UInt8
from numpy import ndarray

from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.geometry.floor_area import FloorArea


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """One camera's depth image. ``mask`` marks the person where it is known, ``labels`` the true regions 0–43."""

    camera: DepthCamera
    depth_m: Float[ndarray, "h w"]
    mask: Bool[ndarray, "h w"] | None = None
    labels: UInt8[ndarray, "h w"] | None = None

    def turned(self, quarters: int) -> View:
        """The view turned anticlockwise by so many quarters, with its camera: the same of the world is seen."""

        def turned(picture: ndarray) -> ndarray:
            return np.ascontiguousarray(np.rot90(picture, quarters))

        mask, labels = (None if picture is None else turned(picture) for picture in (self.mask, self.labels))
        return View(self.camera.turned(quarters), turned(self.depth_m), mask, labels)


@dataclasses.dataclass(frozen=True, eq=False)
class FrameSet:
    """Views of one instant, of the cameras that delivered a frame. ``true_joints`` in the world, metres, if known."""

    timestamp_ns: int
    views: tuple[View, ...]
    true_joints: Float[ndarray, "18 3"] | None = None


#: Mean error of joints (metres) at a confidence: of 2,560 clouds of one or three cameras, of all sets of ``evaluate
#: bench`` but those of clothes and sensors that training never shows, of validation clips
#: (``benchmarks/make_error_curve.py``).
_ERROR_AT = np.array([
    (0.0, 0.478), (0.05, 0.3061), (0.1, 0.2237), (0.2, 0.1953), (0.3, 0.1649), (0.5, 0.1237), (0.7, 0.0947),
    (0.8, 0.0771), (0.9, 0.0601), (0.95, 0.045), (0.98, 0.0416), (0.99, 0.028), (0.998, 0.0252), (0.999, 0.0214),
    (0.9995, 0.0187), (1.0, 0.0109),
])  # fmt: skip


def expected_error_m(confidence: Float[ndarray, "*n"]) -> Float64[ndarray, "*n"]:
    """The mean distance from the truth (metres) of joints of such a confidence, as the estimator ``votes`` tells it."""
    return np.interp(confidence, *_ERROR_AT.T)


@dataclasses.dataclass(frozen=True, eq=False)
class Pose:
    """Joints of one instant in the world, metres; an unobserved joint is NaN with confidence 0.

    ``points`` are points of the skin, ``body.landmarks.POINTS``, and their confidence, where the estimator tells them.
    """

    timestamp_ns: int
    joints: Float[ndarray, "18 3"]
    confidence: Float[ndarray, "18"]
    points: Float[ndarray, "18 3"] | None = None
    points_confidence: Float[ndarray, "18"] | None = None

    @property
    def expected_error_m(self) -> Float64[ndarray, "18"]:
        """Expected distance of each joint from the truth (metres), by its confidence; NaN of an unobserved joint."""
        return np.where(np.isnan(self.joints).any(-1), np.nan, expected_error_m(self.confidence))

    def doubted(self, doubt: float) -> Pose:
        """The pose with less confidence, by a share of it (0–1)."""
        points = None if self.points_confidence is None else self.points_confidence * (1 - doubt)
        return dataclasses.replace(self, confidence=self.confidence * (1 - doubt), points_confidence=points)


class FrameSource(abc.ABC):
    """A recording or any other sequence of frame sets.

    Attributes:
        up: the world's up axis: "z", "y" or "-y".
        area_m: corners of the area of the floor in which people are followed; empty for everywhere.
        continuous: whether frame sets follow each other in time, so that poses may be smoothed.
        camera_names: of the cameras that are known before a frame is read.
    """

    up: str = "z"
    area_m: FloorArea = ()
    continuous: bool = True
    camera_names: tuple[str, ...] = ()

    @abc.abstractmethod
    def __len__(self) -> int: ...

    @abc.abstractmethod
    def __getitem__(self, index: int) -> FrameSet: ...

    def __iter__(self) -> Iterator[FrameSet]:
        """All of them, in order."""
        return (self[i] for i in range(len(self)))

    @property
    def problems(self) -> list[str]:
        """What was wrong with what was read so far, one line each."""
        return []

    def background(self, name: str) -> Float[ndarray, "h w"] | None:
        """Depth of a camera's empty scene in metres, 0 where invalid; None where the source does not know it."""
        return None
