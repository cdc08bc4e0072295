"""What every data set of real people with known joints gives to the evaluation, whatever its files are."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Protocol, runtime_checkable

from jaxtyping import Float
from numpy import ndarray

from depthmocap.frames import View


@dataclasses.dataclass(frozen=True, eq=False)
class AnnotatedFrame:
    """Views of one instant and the joints, in the set's own order (``AnnotatedSet.joints``).

    Attributes:
        views: every one with a mask of the person where the set knows it; without one all valid depth is the person's.
        joints_world: metres in the world of the cameras, NaN where unknown.
        subject: who is seen.
        action: what they do, or the sequence's name.
        frame: its number in the sequence.
    """

    views: tuple[View, ...]
    joints_world: Float[ndarray, "j 3"]
    subject: str
    action: str
    frame: int


@runtime_checkable
class AnnotatedSet(Protocol):
    """A data set, or a part of one; frames are read from disk as they are asked for.

    Attributes:
        name: as shown in tables.
        joints: names of the joints, as the set has them.
        ours: for some of these names, the joint of ``body.skeleton.JOINTS`` that is nearest to it in the body.
        up: the world's up axis: "z", "y" or "-y".
        fps: frames a second; None where frames do not follow each other.
        problems: what could not be read so far, one line each; frames are checked as they are read.
    """

    name: str
    joints: tuple[str, ...]
    ours: Mapping[str, str]
    up: str
    fps: float | None

    @property
    def problems(self) -> list[str]: ...

    def __iter__(self) -> Iterator[AnnotatedFrame]: ...
