"""The map of the floor as a picture."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from depthmocap.rigging.floor_map import CELL_M, ENOUGH, FloorMap

#: Side of a cell in the picture (pixels).
_CELL_PX = 12
_GROUND, _VISIBLE, _LINES = 23.0, 52.0, (75, 75, 85)
_WHITE = (255, 255, 255)


def floor_picture(drawn: FloorMap, colours: Mapping[str, tuple[int, int, int]]) -> UInt8[ndarray, "h w 3"]:
    """The floor from above, x to the right and y upwards: each cell in the colours of the cameras that have seen the
    person there, light where two could and dark where they could not; cameras as dots, the next place as a ring."""
    ny, nx = drawn.shape
    views = sum((visible.astype(int) for visible in drawn.visible.values()), np.zeros((ny, nx), int))
    ground = np.where(views >= 2, _VISIBLE, _GROUND)[..., None] * np.ones(3)
    shares = {name: np.minimum(count / ENOUGH, 1.0)[..., None] for name, count in drawn.seen.items()}
    total = sum(shares.values(), np.zeros((ny, nx, 1)))
    mixed = sum((share * np.array(colours[name], float) for name, share in shares.items()), np.zeros((ny, nx, 3)))
    cover = np.max(list(shares.values()), 0)
    cells = ground * (1 - cover) + cover * mixed / np.maximum(total, 1e-9)
    picture = np.kron(cells.clip(0, 255), np.ones((_CELL_PX, _CELL_PX, 1))).astype(np.uint8)
    metre = round(_CELL_PX / CELL_M)
    picture[::metre], picture[:, ::metre] = _LINES, _LINES
    for name, place in drawn.places_m.items():
        centre = _pixel(drawn, place)
        cv2.circle(picture, centre, _CELL_PX // 2 + 2, colours[name], -1, cv2.LINE_AA)
        cv2.circle(picture, centre, _CELL_PX // 2 + 2, _WHITE, 1, cv2.LINE_AA)
    if drawn.next_m is not None:
        cv2.circle(picture, _pixel(drawn, drawn.next_m), 2 * _CELL_PX, _WHITE, 2, cv2.LINE_AA)
    return np.ascontiguousarray(picture[::-1])


def _pixel(drawn: FloorMap, place_m: Float[ndarray, "2"]) -> tuple[int, int]:
    x, y = ((place_m - drawn.corner_m) / CELL_M * _CELL_PX).astype(int).tolist()
    return x, y
