"""An area of the floor in which people are followed, as ``rig.json`` and ``--area`` tell it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import cv2
import numpy as np

from depthmocap.core.reading.json_text import number
from depthmocap.errors import InputError

#: Corners on the floor, one after the other: x and y in the world (metres), or x and z where y is up. Empty for
#: everywhere.
FloorArea: TypeAlias = tuple[tuple[float, float], ...]
#: Most corners.
_MOST_CORNERS = 1000
#: Largest coordinate (metres).
_LARGEST_M = 1e6
#: What encloses less is nothing (m²).
_LEAST_M2 = 1e-4


def check_area(corners: Sequence[Sequence[float]], what: str) -> None:
    """Check the corners of an area.

    Args:
        what: tells them, for the message.

    Raises:
        InputError: when they are too few, not numbers of metres, or enclose nothing.
    """
    if not corners:
        return
    if len(corners) < 3:
        raise InputError(f"{what} needs at least three corners, got {len(corners)}")
    if not (np.abs(np.array(corners, float)) < _LARGEST_M).all():
        raise InputError(f"{what} takes numbers of metres")
    if cv2.contourArea(np.array(corners, np.float32)) < _LEAST_M2:
        raise InputError(f"{what} has corners that enclose nothing")


def parse_area(entry: Any, where: str) -> FloorArea:
    """The corners in a document: a list of pairs of numbers (metres).

    Raises:
        InputError: when it is something else, or encloses nothing.
    """
    what = f"{where}: area_m"
    pairs = isinstance(entry, list) and all(isinstance(corner, list) and len(corner) == 2 for corner in entry)
    if not pairs or len(entry) > _MOST_CORNERS:
        raise InputError(f"{what} must be a list of at most {_MOST_CORNERS} corners on the floor, [x, y] in metres")
    corners = tuple((number(x, what), number(y, what)) for x, y in entry)
    check_area(corners, what)
    return corners
