"""How people are found: by a network, by what differs from the empty scene, or not at all."""

from __future__ import annotations

from typing import Literal, TypeAlias

from depthmocap.errors import InputError
from depthmocap.frames import FrameSource
from depthmocap.segment.choice import ANYBODY, Choice
from depthmocap.segment.network_segmenter import NetworkSegmenter
from depthmocap.segment.people_segmenter import PeopleSegmenter

#: See :func:`load_segmenter`.
Segmentation: TypeAlias = Literal["auto", "network", "background", "none"]


def load_segmenter(
    source: FrameSource, segment: Segmentation = "auto", people: int = 1, choice: Choice = ANYBODY
) -> PeopleSegmenter | NetworkSegmenter:
    """The segmenter for a source.

    Args:
        segment: "network" finds people by their shape, in any posture, without an empty scene. "auto" does so too, and
            learns the empty scene meanwhile, which sharpens the masks. "background" takes for people what differs from
            the empty scene, stands upright and moves; where the source has none, it is estimated from its frames.
            "none" takes every valid pixel for one person.
        people: the most people that are followed.
        choice: who is followed.

    Raises:
        InputError: when ``people`` is less than one, or the source cannot be read.
    """
    if people < 1:
        raise InputError(f"--people must be at least 1, got {people}")
    if segment in ("background", "none"):
        return PeopleSegmenter.from_recording(source, "auto" if segment == "background" else "none", people, choice)
    return NetworkSegmenter.for_source(source, people, segment == "auto", choice)
