"""The coarse grid on which people are found: a cell has the same size in angle for every camera."""

from __future__ import annotations

import functools

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from depthmocap.geometry import DepthCamera
from depthmocap.kernels.grid_cells import box_of_full_cells, describe_cells, sample_depth, spread_outputs

#: Focal length in cells. At 3 m a cell is 5 cm wide, a sample half of that.
CELL_FOCAL_PX = 62.0
#: Both sides of a grid are multiples of this (cells): the network halves it three times.
GRID_STEP = 8
#: Channels of the network's input.
CHANNELS = 8
#: Depth beyond this is not used (metres).
FARTHEST_M = 12.0


class DepthGrid:
    """A camera's image on the grid: 2×2 samples in each cell.

    The network sees the grid turned by a multiple of 90°, so that up in the world is up there.

    Attributes:
        shape: rows and columns of cells that the network sees, both multiples of ``GRID_STEP``.
    """

    def __init__(self, camera: DepthCamera, quarter_turns: int = 0) -> None:
        """
        Args:
            quarter_turns: how often the image is turned by 90°, anticlockwise.
        """
        self.camera, self._turns = camera, quarter_turns % 4
        self._rows, self.row_starts = _samples(camera.height, camera.fy)
        self._columns, self.column_starts = _samples(camera.width, camera.fx)
        rows, columns = len(self._rows) // 2, len(self._columns) // 2
        self.shape = (columns, rows) if self._turns % 2 else (rows, columns)

    @functools.cached_property
    def rays(self) -> Float[ndarray, "rows2 columns2 2"]:
        """x/z and y/z of every sample; NaN beyond the image and where the lens model has none."""
        rays = self.camera.rays[np.maximum(self._rows, 0)][:, np.maximum(self._columns, 0)]
        beyond = (self._rows < 0)[:, None] | (self._columns < 0)
        return np.where(beyond[..., None], np.float32(np.nan), rays)

    def samples(self, image: Float[ndarray, "h w"]) -> Float[ndarray, "rows2 columns2"]:
        """The image at the samples, as the camera has them; 0 beyond its edges."""
        out = np.empty((len(self._rows), len(self._columns)), np.float32)
        sample_depth(image, self._rows, self._columns, out)
        return out

    def samples_at(self, pixels: Float[ndarray, "n 2"]) -> tuple[Int[ndarray, " n"], Int[ndarray, " n"]]:
        """Row and column of the samples nearest to pixels (u, v); -1 for pixels outside the image."""
        indices = []
        for axis, starts in ((1, self.row_starts), (0, self.column_starts)):
            inside = (pixels[:, axis] >= 0) & (pixels[:, axis] < starts[-1])
            places = np.searchsorted(starts, np.where(inside, pixels[:, axis], 0), "right") - 1
            indices.append(np.where(inside, np.minimum(places, len(starts) - 2), -1))
        rows, columns = indices
        outside = (rows < 0) | (columns < 0)
        return np.where(outside, -1, rows), np.where(outside, -1, columns)

    def inputs(self, samples_m: Float[ndarray, "rows2 columns2"]) -> Float[ndarray, "channels rows columns"]:
        """The network's input from depth samples (metres), of the whole grid or a part of it."""
        turned = np.ascontiguousarray(np.rot90(samples_m, self._turns)) if self._turns else samples_m
        out = np.empty((CHANNELS, turned.shape[0] // 2, turned.shape[1] // 2), np.float32)
        describe_cells(turned, CELL_FOCAL_PX, FARTHEST_M, out)
        return out

    def part_around(
        self, marked: Bool[ndarray, "rows2 columns2"], around: int, largest_share: float
    ) -> tuple[slice, slice] | None:
        """Rows and columns of the cells that the network sees around those of which all four samples are marked.

        Args:
            around: so many more cells on each side.

        Returns:
            Multiples of ``GRID_STEP``; empty slices where no cell is marked; None for more than this share of the grid.
        """
        turned = np.ascontiguousarray(np.rot90(marked, self._turns)) if self._turns else marked
        top, bottom, left, right = box_of_full_cells(turned)
        if not bottom:
            return slice(0, 0), slice(0, 0)
        sides = []
        for begin, end, size in ((top, bottom, self.shape[0]), (left, right, self.shape[1])):
            first = max(begin - around, 0) // GRID_STEP * GRID_STEP
            sides.append(slice(first, -(-min(end + around, size) // GRID_STEP) * GRID_STEP))
        rows, columns = sides
        share = (rows.stop - rows.start) * (columns.stop - columns.start) / (self.shape[0] * self.shape[1])
        return None if share > largest_share else (rows, columns)

    def to_camera(
        self, outputs: Float[ndarray, "7 rows columns"]
    ) -> tuple[Float[ndarray, "rows2 columns2"], Float[ndarray, "3 rows0 columns0"]]:
        """The network's outputs as the camera has its image: logits of the samples, and offsets of the cells (metres,
        in the camera's axes)."""
        rows, columns = outputs.shape[1:]
        logits = np.empty((2 * rows, 2 * columns), np.float32)
        offsets = np.empty((3, rows, columns), np.float32)
        spread_outputs(np.ascontiguousarray(outputs, np.float32), logits, offsets)
        for _ in range(self._turns):
            # Right in the turned image is down in the one before, and down there is left.
            right, down, forwards = offsets
            offsets = np.stack([-down, right, forwards])
        if self._turns:
            logits, offsets = np.rot90(logits, -self._turns), np.rot90(offsets, -self._turns, axes=(1, 2))
        return np.ascontiguousarray(logits), np.ascontiguousarray(offsets)


def _samples(size: int, focal_px: float) -> tuple[Int[ndarray, " n"], Int[ndarray, " m"]]:
    """Along one side of an image: the pixel of each sample, -1 beyond its end; and the first pixel of each sample's
    share of the side, with the end of the last."""
    step = focal_px / (2 * CELL_FOCAL_PX)
    # A strip of less than a quarter of a step at the end goes to the last sample.
    steps = max(int(np.ceil(size / (2 * step) / GRID_STEP - 0.25)), 1)
    places = np.arange(2 * steps * GRID_STEP + 1)
    pixels = np.floor((places[:-1] + 0.5) * step).astype(np.int64)
    starts = np.minimum(np.floor(places * step), size).astype(np.int64)
    starts[-1] = size
    return np.where(pixels < size, pixels, -1), starts
