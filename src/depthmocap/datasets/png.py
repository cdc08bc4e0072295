"""PNG files of labels and depth, in memory.

Run lengths over rows filtered by "up" are made for such pictures, which are mostly flat or empty: several times as fast
as the usual setting, and no larger. The bytes depend on the picture and the version of OpenCV alone.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Integer, UInt8
from numpy import ndarray

_OPTIONS = [
    cv2.IMWRITE_PNG_COMPRESSION, 1,
    cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE,
    cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_UP,
]  # fmt: skip


def colour_png(values: Integer[ndarray, "h w"], colours: UInt8[ndarray, "n 4"]) -> bytes:
    """An RGBA picture of ``colours[values]``.

    Raises:
        ValueError: for a value beyond the colours.
    """
    if values.size and (values.max() >= len(colours) or values.min() < 0):
        raise ValueError(f"values must be 0 to {len(colours) - 1}")
    bgra = np.ascontiguousarray(colours[:, [2, 1, 0, 3]]).view(np.uint32)[:, 0]
    return _encoded(bgra[values].view(np.uint8).reshape(*values.shape, 4))


def grey_png(image: Integer[ndarray, "h w"]) -> bytes:
    """A grey picture of 8 or 16 bits.

    Raises:
        ValueError: when the image is neither uint8 nor uint16.
    """
    if image.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"a grey picture must be uint8 or uint16, got {image.dtype}")
    return _encoded(np.ascontiguousarray(image))


def _encoded(image: ndarray) -> bytes:
    done, data = cv2.imencode(".png", image, _OPTIONS)
    assert done
    return data.tobytes()
