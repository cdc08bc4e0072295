"""A closer look at what may be a person: the network sees it again, as a camera half as far away would.

What is small or far shows too few samples to tell a child on the floor from a bag, or who lies under a blanket from the
blanket. The image has more pixels than the grid has samples; with twice the samples and the depth that a camera nearer
by half would measure, what the network sees is as large as it is at that distance.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.kernels.unsure_regions import mark_around, mark_cells, most_doubtful, number_regions
from depthmocap.segment.depth_grid import CELL_FOCAL_PX, GRID_STEP, DepthGrid

#: So many times nearer, and so many times finer samples.
NEARER = 2
#: A sample may show a person if its logit is above this,
_MAYBE_LOGIT = -3.5
#: and a region of these is not sure if their mean is below this.
_UNSURE_LOGIT = 1.5
#: Regions of a smaller surface (m²) are no people.
_LEAST_M2 = 0.02
#: What is nearer than this (metres) is large enough.
_NEAREST_M = 1.0
#: So many cells around a region are seen with it.
_AROUND_CELLS = 10
#: Depth below this (metres), of the camera that is nearer, is not used.
_LEAST_DEPTH_M = 0.25
#: One region of every second image is looked at. A look holds for so many images, its own among them,
_LASTS = 6
#: unless this share of its samples
_CHANGED_SHARE = 0.2
#: changed by more than this (metres).
_CHANGED_M = 0.05

Network = Callable[[Float[ndarray, "channels rows columns"]], Float[ndarray, "7 rows columns"]]


class UnsureRegion(NamedTuple):
    """Connected cells that may show a person, as the camera has them.

    Attributes:
        mask: these, and the cells next to them.
        rows: that they cover.
        columns: that they cover.
        depth_m: their median depth (metres).
    """

    mask: Bool[ndarray, "rows0 columns0"]
    rows: slice
    columns: slice
    depth_m: float


@dataclasses.dataclass(frozen=True, eq=False)
class CloserLook:
    """What a closer look at a region showed, within the rows and columns of cells around it.

    Attributes:
        rows: of cells.
        columns: of cells.
        mask: which of these cells are the region's.
        samples_m: depth of their samples at that time (metres).
        logits: that these show a person.
        offsets: of the cells to the centre of their person (metres, in the camera's axes).
        images: so many images that it held for.
    """

    rows: slice
    columns: slice
    mask: Bool[ndarray, "h w"]
    samples_m: Float[ndarray, "h2 w2"]
    logits: Float[ndarray, "h2 w2"]
    offsets: Float[ndarray, "3 h w"]
    images: int = 1

    def holds(self, samples_m: Float[ndarray, "rows2 columns2"]) -> bool:
        """Whether it is recent, and the region looks as it did."""
        if self.images >= _LASTS:
            return False
        changed = np.abs(samples_m[_twice(self.rows), _twice(self.columns)] - self.samples_m) > _CHANGED_M
        return bool(np.mean(changed[_of_samples(self.mask)]) < _CHANGED_SHARE)

    def put_into(self, logits: Float[ndarray, "rows2 columns2"], offsets: Float[ndarray, "3 rows0 columns0"]) -> None:
        """Replace logits and offsets (metres) of an image by what the look showed."""
        np.copyto(logits[_twice(self.rows), _twice(self.columns)], self.logits, where=_of_samples(self.mask))
        np.copyto(offsets[:, self.rows, self.columns], self.offsets, where=self.mask)

    def cover(self, samples: Bool[ndarray, "rows2 columns2"]) -> None:
        """Mark the samples of the region."""
        samples[_twice(self.rows), _twice(self.columns)] |= _of_samples(self.mask)


def look_closer(
    grid: DepthGrid,
    depth_m: Float[ndarray, "h w"],
    network: Network,
    samples_m: Float[ndarray, "rows2 columns2"],
    logits: Float[ndarray, "rows2 columns2"],
    offsets: Float[ndarray, "3 rows0 columns0"],
    empty: Bool[ndarray, "rows2 columns2"],
    last: Sequence[CloserLook] = (),
) -> list[CloserLook]:
    """Look at the region that is least sure, unless one of the image before was looked at, and put what this and the
    last looks that still hold showed into the logits and offsets.

    Args:
        depth_m: the camera's image.
        network: gives its outputs for the cells of a part of a grid.
        samples_m: of the image (metres).
        logits: that its samples show a person, as the camera has them; changed.
        offsets: of its cells (metres), likewise.
        empty: samples that show the empty scene.
        last: looks at the camera's last image.

    Returns:
        The looks that hold for this image.
    """
    looks = [dataclasses.replace(look, images=look.images + 1) for look in last if look.holds(samples_m)]
    known = empty.copy()
    for look in looks:
        look.cover(known)
    # A look that has just been taken was what there was to do: the next image is left alone.
    rests = any(look.images == 2 for look in looks)
    region = None if rests else unsure_region(samples_m, logits, known)
    if region is not None:
        looks.append(_look_at(grid, depth_m, region, network, samples_m))
    for look in looks:
        look.put_into(logits, offsets)
    return looks


def unsure_region(
    samples_m: Float[ndarray, "rows2 columns2"],
    logits: Float[ndarray, "rows2 columns2"],
    empty: Bool[ndarray, "rows2 columns2"],
) -> UnsureRegion | None:
    """The region of which it is least known whether it shows a person; None where everything is sure or small.

    Args:
        samples_m: depth of every sample (metres).
        logits: that it shows a person.
        empty: samples that show the empty scene.
    """
    marked = np.zeros((logits.shape[0] // 2, logits.shape[1] // 2), np.bool_)
    if not mark_cells(samples_m, logits, empty, _MAYBE_LOGIT, marked):
        return None
    labels = np.zeros(marked.shape, np.int32)
    count = number_regions(marked, labels)
    depths_m = np.empty(logits.size, np.float32)
    best, samples = most_doubtful(
        samples_m, logits, empty, labels, count, _MAYBE_LOGIT, _UNSURE_LOGIT, _LEAST_M2, 1 / (2 * CELL_FOCAL_PX),
        depths_m,
    )  # fmt: skip
    if not best or (median_m := float(np.median(depths_m[:samples]))) < _NEAREST_M:
        return None
    beside = np.zeros(marked.shape, np.bool_)
    top, bottom, left, right = mark_around(labels, best, beside)
    return UnsureRegion(beside, slice(top, bottom + 1), slice(left, right + 1), median_m)


def _look_at(
    grid: DepthGrid,
    depth_m: Float[ndarray, "h w"],
    region: UnsureRegion,
    network: Network,
    samples_m: Float[ndarray, "rows2 columns2"],
) -> CloserLook:
    windows = [
        _window(cells, count) for cells, count in zip((region.rows, region.columns), region.mask.shape, strict=True)
    ]
    starts, counts = zip(*windows, strict=True)
    nearer_m = _nearer_depth(grid, depth_m, region.depth_m, starts, counts)
    logits, offsets = grid.to_camera(network(grid.inputs(nearer_m)))
    # As far as the look goes, and the grid.
    sides = [
        slice(max(start, 0), min(start + count // NEARER, size))
        for start, count, size in zip(starts, counts, region.mask.shape, strict=True)
    ]
    seen = [slice(side.start - start, side.stop - start) for side, start in zip(sides, starts, strict=True)]
    return CloserLook(
        sides[0], sides[1], region.mask[sides[0], sides[1]], samples_m[_twice(sides[0]), _twice(sides[1])],
        _coarser(logits[None])[0, _twice(seen[0]), _twice(seen[1])], _coarser(offsets)[:, seen[0], seen[1]],
    )  # fmt: skip


def _twice(cells: slice) -> slice:
    """The samples of cells."""
    return slice(2 * cells.start, 2 * cells.stop)


def _of_samples(cells: Bool[ndarray, "rows columns"]) -> Bool[ndarray, "rows2 columns2"]:
    return cells.repeat(2, 0).repeat(2, 1)


def _window(cells: slice, size: int) -> tuple[int, int]:
    """First cell of the grid that is seen around a region's cells, and the number of finer cells."""
    wanted = NEARER * (cells.stop - cells.start) + 2 * _AROUND_CELLS
    count = min(-(-wanted // GRID_STEP), size // GRID_STEP) * GRID_STEP
    return int(np.floor((cells.start + cells.stop) / 2 - count / (2 * NEARER))), count


def _nearer_depth(
    grid: DepthGrid, depth_m: Float[ndarray, "h w"], region_m: float, starts: Sequence[int], counts: Sequence[int]
) -> Float[ndarray, "rows2 columns2"]:
    """Finer samples, of the depth that a camera measures that is nearer to the region; 0 beyond the image."""
    camera = grid.camera
    pixels, inside = [], []
    for start, count, focal_px, pixel_count in zip(starts, counts, (camera.fy, camera.fx), depth_m.shape, strict=True):
        places = 2 * start + (np.arange(2 * count) + 0.5) / NEARER
        at = np.floor(places * focal_px / (2 * CELL_FOCAL_PX)).astype(np.int64)
        inside.append((at >= 0) & (at < pixel_count))
        pixels.append(np.clip(at, 0, pixel_count - 1))
    samples_m = depth_m[np.ix_(*pixels)]
    nearer_m = samples_m - np.float32(region_m * (1 - 1 / NEARER))
    seen = inside[0][:, None] & inside[1] & (samples_m > 0) & (nearer_m > _LEAST_DEPTH_M)
    return np.where(seen, nearer_m, np.float32(0))


def _coarser(values: Float[ndarray, "k rows columns"]) -> Float[ndarray, "k rows2 columns2"]:
    """Means of ``NEARER`` × ``NEARER`` values."""
    count, rows, columns = values.shape
    return values.reshape(count, rows // NEARER, NEARER, columns // NEARER, NEARER).mean((2, 4))
