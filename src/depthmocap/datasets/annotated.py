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
    """A data set, or a part of one; frames are read from disk as they are asked for."""

    @property
    def name(self) -> str:
        """As shown in tables."""
        ...

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, as the set has them."""
        ...

    @property
    def ours(self) -> Mapping[str, str]:
        """For some of these names, the joint of ``body.skeleton.JOINTS`` that is nearest to it in the body."""
        ...

    @property
    def up(self) -> str:
        """The world's up axis: "z", "y" or "-y"."""
        ...

    @property
    def fps(self) -> float | None:
        """Frames a second; None where frames do not follow each other."""
        ...

    @property
    def problems(self) -> list[str]:
        """What could not be read so far, one line each; frames are checked as they are read."""
        ...

    def __iter__(self) -> Iterator[AnnotatedFrame]: ...
