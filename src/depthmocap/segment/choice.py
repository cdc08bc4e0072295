"""Who of the people in view is followed: those in an area, and the one who is the subject before others."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Literal, Protocol, TypeAlias, TypeVar, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, z_up_from
from depthmocap.geometry.floor_area import check_area

#: Whom to follow first: who shows most surface, who is nearest to the middle, who came first, or a person's number.
Subject: TypeAlias = Literal["largest", "middle", "first"] | int
#: A camera alone looks at what is so far before it (metres).
_LOOKS_AT_M = 2.5


@dataclasses.dataclass(frozen=True)
class Choice:
    """Who is followed.

    Attributes:
        subject: of the people in view, who is followed first; who is followed stays so until they leave.
        area: corners of an area on the floor, x and y of one after the other in metres (x and z where y is up); who is
            outside is nobody. Empty for everywhere.
    """

    subject: Subject = "largest"
    area: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if len(self.area) % 2 or len(self.area) in (2, 4):
            raise InputError(f"--area takes x and y of at least three corners, got {len(self.area)} numbers")
        check_area(list(itertools.pairwise(self.area))[::2], "--area")
        if isinstance(self.subject, int) and self.subject < 1:
            raise InputError(f"--subject takes largest, middle, first or a number from 1, got {self.subject}")

    @property
    def corners(self) -> Float[ndarray, "n 2"]:
        """Of the area."""
        return np.array(self.area, np.float32).reshape(-1, 2)

    def holds(self, place: Float[ndarray, "2"]) -> bool:
        """Whether a place on the floor (metres) is in the area."""
        return not self.area or cv2.pointPolygonTest(self.corners, place.astype(float).tolist(), False) >= 0


#: Everywhere, and who shows most first.
ANYBODY = Choice()


def place_on_floor(point: Float[ndarray, "3"], up: str) -> Float[ndarray, "2"]:
    """The two coordinates of a point in the world (metres) that are not height: x and y, or x and z where y is up."""
    return np.asarray(point)[[0, 1] if up == "z" else [0, 2]]


def middle_of(cameras: Sequence[DepthCamera]) -> Float[ndarray, "3"]:
    """The point nearest to the optical axes of all cameras, in the world (metres)."""
    eyes = np.array([camera.world_from_camera[:3, 3] for camera in cameras])
    axes = np.array([camera.world_from_camera[:3, 2] for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    # Parallel axes meet nowhere: what they leave open is before the cameras.
    before = (eyes + _LOOKS_AT_M * axes).mean(0)
    moved = np.einsum("nij,nj->i", across, eyes - before)
    return before + np.linalg.lstsq(across.sum(0), moved, rcond=1e-3)[0]


@runtime_checkable
class _Numbered(Protocol):
    """What is needed of a track to choose who is followed."""

    number: int
    area_m2: float


_Track = TypeVar("_Track", bound=_Numbered)


class Follower:
    """Keeps who is followed."""

    def __init__(self, choice: Choice, up: str) -> None:
        """
        Args:
            up: the world's up axis.

        Raises:
            ValueError: for an axis that is none.
        """
        z_up_from(up)
        self._choice, self._up = choice, up
        self._numbers: list[int] = []

    def reset(self) -> None:
        """Follow nobody."""
        self._numbers = []

    def __call__(
        self,
        tracks: Sequence[_Track],
        most: int,
        point: Callable[[_Track], Float[ndarray, "3"]],
        cameras: Sequence[DepthCamera],
    ) -> list[_Track]:
        """The visible ones of those who are followed: those who already were, then others by the choice.

        Args:
            most: so many are followed.
            point: where a track is in the world (metres).

        Raises:
            InputError: for an area where the cameras stand nowhere.
        """
        choice = self._choice
        if choice.area and all(np.array_equal(camera.world_from_camera, np.eye(4)) for camera in cameras):
            raise InputError(
                "an area is on the floor of the rig, and this rig does not tell where its cameras stand: depthmocap "
                "calibrate RECORDING --out rig.json"
            )
        places = {id(track): place_on_floor(point(track), self._up) for track in tracks if track.number}
        people = {track.number: track for track in tracks if track.number and choice.holds(places[id(track)])}
        numbered = {track.number for track in tracks}
        # Who leaves the area for a moment is still the one who was followed.
        self._numbers = [number for number in self._numbers if number in numbered]
        others = sorted(set(people) - set(self._numbers), key=lambda number: -people[number].area_m2)
        if choice.subject == "middle" and others:
            middle = choice.corners.mean(0) if choice.area else place_on_floor(middle_of(cameras), self._up)
            others.sort(key=lambda number: float(np.linalg.norm(places[id(people[number])] - middle)))
        elif choice.subject == "first":
            others.sort()
        elif isinstance(choice.subject, int):
            if choice.subject in self._numbers:
                self._numbers.sort(key=lambda number: number != choice.subject)
            others = [number for number in others if number == choice.subject or most > 1]
            others.sort(key=lambda number: number != choice.subject)
            if choice.subject in others and len(self._numbers) >= most:
                self._numbers = self._numbers[: most - 1]
        self._numbers += others[: max(most - len(self._numbers), 0)]
        return [people[number] for number in self._numbers if number in people and people[number].area_m2 > 0]
