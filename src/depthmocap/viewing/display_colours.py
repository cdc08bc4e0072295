"""Colours of cameras, people, confidence and depth on a dark page."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

#: Of cameras and people, told apart by those who see fewer colours, too (Okabe and Ito's, lightened).
PALETTE = np.array(
    [(86, 180, 233), (230, 159, 0), (0, 190, 135), (240, 228, 66), (235, 130, 90), (204, 121, 167), (150, 150, 255)],
    np.uint8,
)
TRUTH = (92, 160, 255)
BESIDE = (190, 120, 255)
#: Confidence, and the colour there.
_CONFIDENCE = np.array([0.0, 0.2, 0.5, 0.8, 1.0])
_CONFIDENCE_COLOURS = np.array(
    [(225, 40, 40), (240, 70, 45), (250, 170, 50), (200, 215, 80), (70, 205, 110)], np.float64
)


def palette_colour(index: int) -> tuple[int, int, int]:
    """The colour of the camera or person with this index."""
    red, green, blue = PALETTE[index % len(PALETTE)].tolist()
    return red, green, blue


def confidence_colours(confidence: Float[ndarray, "*n"]) -> UInt8[ndarray, "*n 3"]:
    """Red where a joint is a guess, over yellow to green where it is sure."""
    channels = [np.interp(confidence, _CONFIDENCE, _CONFIDENCE_COLOURS[:, channel]) for channel in range(3)]
    return np.stack(channels, -1).astype(np.uint8)


def distance_colours(distance_m: Float[ndarray, " n"], nearest_m: float, farthest_m: float) -> UInt8[ndarray, "n 3"]:
    """Red at the nearest distance over green to blue at the farthest."""
    share = (distance_m - nearest_m) / max(farthest_m - nearest_m, 1e-3)
    level = (255 * (0.95 - 0.85 * np.clip(share, 0, 1))).astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(level[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1])


def line_colours(colours: UInt8[ndarray, "*n 3"]) -> UInt8[ndarray, "*n 3"]:
    """Colours as viser takes those of lines, which it does not convert to linear light, as it does points' colours."""
    return (255 * (colours / 255.0) ** 2.2).astype(np.uint8)
