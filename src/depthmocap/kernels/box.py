"""The part of a picture in which something is."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, UInt8
from numpy import ndarray


def box_of(picture: Bool[ndarray, "h w"] | UInt8[ndarray, "h w"]) -> tuple[slice, slice] | None:
    """Rows and columns around the pixels that are not 0, None where all are."""
    marked = picture.view(bool)  # whose any() is the fastest
    rows = np.flatnonzero(marked.any(1))
    if not len(rows):
        return None
    band = slice(int(rows[0]), int(rows[-1]) + 1)
    columns = np.flatnonzero(marked[band].any(0))
    return band, slice(int(columns[0]), int(columns[-1]) + 1)
