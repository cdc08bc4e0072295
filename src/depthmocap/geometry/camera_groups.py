"""Which cameras agree with each other, of pairs that do."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeVar

_Camera = TypeVar("_Camera")


def largest_group(cameras: Sequence[_Camera], links: Iterable[tuple[_Camera, _Camera]]) -> list[_Camera]:
    """The largest set of cameras that links connect, in the order given; none where two sets are equally large.

    Cameras are names or indices. Links of others count nothing.
    """
    groups = [{camera} for camera in cameras]
    for a, b in links:
        one, other = (next((group for group in groups if camera in group), None) for camera in (a, b))
        if one is not None and other is not None and one is not other:
            one |= other
            groups.remove(other)
    groups.sort(key=len, reverse=True)
    if not groups or (len(groups) > 1 and len(groups[0]) == len(groups[1])):
        return []
    return [camera for camera in cameras if camera in groups[0]]
