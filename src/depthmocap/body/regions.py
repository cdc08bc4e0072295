"""The 43 body regions of the paper (Fig. 2), their UBC3V colours and their mirror images. 0 is background."""

from __future__ import annotations

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

#: (index, colour, name). Right and left are the subject's own.
_TABLE: tuple[tuple[int, tuple[int, int, int], str], ...] = (
    (1, (255, 106, 0), "chest R"),
    (2, (255, 0, 0), "chest L"),
    (3, (255, 178, 127), "belly R"),
    (4, (255, 127, 127), "belly L"),
    (5, (182, 255, 0), "upper back R"),
    (6, (218, 255, 127), "lower back R"),
    (7, (255, 216, 0), "upper back L"),
    (8, (255, 233, 127), "lower back L"),
    (9, (0, 148, 255), "collar L"),
    (10, (72, 0, 255), "collar R"),
    (11, (48, 48, 48), "neck front"),
    (12, (76, 255, 0), "shoulder front L"),
    (13, (0, 255, 33), "shoulder front R"),
    (14, (0, 255, 255), "shoulder back R"),
    (15, (0, 255, 144), "shoulder back L"),
    (16, (178, 0, 255), "nape"),
    (17, (127, 116, 63), "neck back L"),
    (18, (127, 63, 63), "neck back R"),
    (19, (127, 201, 255), "thigh R"),
    (20, (127, 255, 255), "thigh L"),
    (21, (165, 255, 127), "knee R"),
    (22, (127, 255, 197), "knee L"),
    (23, (214, 127, 255), "shin R"),
    (24, (161, 127, 255), "shin L"),
    (25, (107, 63, 127), "ankle R"),
    (26, (63, 73, 127), "ankle L"),
    (27, (63, 127, 127), "forefoot R"),
    (28, (109, 127, 63), "forefoot L"),
    (29, (255, 127, 237), "hand R"),
    (30, (127, 63, 118), "hand L"),
    (31, (0, 74, 127), "upper arm R"),
    (32, (255, 0, 110), "elbow R"),
    (33, (0, 127, 70), "forearm R"),
    (34, (127, 0, 0), "wrist R"),
    (35, (33, 0, 127), "upper arm L"),
    (36, (127, 0, 55), "elbow L"),
    (37, (38, 127, 0), "forearm L"),
    (38, (127, 51, 0), "wrist L"),
    (39, (64, 64, 64), "forehead"),
    (40, (73, 73, 73), "hair R"),
    (41, (0, 0, 0), "hair L"),
    (42, (191, 168, 247), "face R"),
    (43, (192, 192, 192), "face L"),
)

REGION_COUNT = 43
#: Label of a person's pixel whose region is unknown: in UBC3V its colour is no region's, nearly always at a border
#: between regions. Training and accuracy ignore it.
UNLABELLED = 255
REGION_NAMES: tuple[str, ...] = ("background", *(name for _, _, name in _TABLE))
REGION: dict[str, int] = {name: i for i, name in enumerate(REGION_NAMES)}

#: UBC3V's colours by region; row 0, background, is white here because black is region 41.
UBC3V_COLOURS = np.array([(255, 255, 255), *(colour for _, colour, _ in _TABLE)], dtype=np.uint8)


def _mirror(name: str) -> str:
    return name[:-1] + {"R": "L", "L": "R"}[name[-1]] if name[-2:] in (" R", " L") else name


#: ``MIRROR[labels]`` swaps left and right.
MIRROR = np.array([REGION[_mirror(name)] for name in REGION_NAMES], dtype=np.uint8)

#: Regions of the front and of the back that cover each other when a body turns round.
_BACKS = {
    "chest": "upper back", "belly": "lower back", "shoulder front": "shoulder back", "neck front": "nape",
    "face": "hair",
}  # fmt: skip
_TURNED_NAMES = {**_BACKS, **{back: front for front, back in _BACKS.items()}}


def _turn(name: str) -> str:
    part, side = (name[:-2], name[-2:]) if name[-2:] in (" R", " L") else (name, "")
    return _mirror(_TURNED_NAMES.get(part, part) + side)


#: ``TURNED[labels]`` takes front for back: the labels of a body whose outline is the same, but which faces the other
#: way. What covers the same place from both sides, as limbs do, changes sides alone.
TURNED = np.array([REGION[_turn(name)] for name in REGION_NAMES], dtype=np.uint8)


def _display_colours() -> UInt8[ndarray, "44 3"]:
    colours = UBC3V_COLOURS.copy()
    colours[0] = 0
    # The head's greys and black look alike on a dark page.
    for name, colour in (("forehead", (235, 235, 235)), ("hair R", (150, 105, 60)), ("hair L", (215, 165, 110))):
        colours[REGION[name]] = colour
    colours[REGION["neck front"]] = (90, 90, 160)
    return colours


#: Colours for pictures: UBC3V's, with lighter dark ones and a black background.
DISPLAY_COLOURS = _display_colours()
