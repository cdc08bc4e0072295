"""Two people who touch make one blob: which part of it is whose follows from where they were."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from depthmocap.kernels.segmentation import divide_voxels, fill_volume, mark_voxels, measure_divided
from depthmocap.segment.occupancy_map import CELL_M, Blobs, Foreground, Plan, extents
from depthmocap.segment.tracking import Part, Shared, Track

#: What is this near to where somebody is expected (metres) is theirs, and what is farther than that is not.
CORE_M, FAR_M = 0.15, 1.1
#: Whose voxels are kept for the next set: people nearer to each other than this (metres).
NEAR_M = 2.5

_NOTHING = np.zeros(1, np.uint8)


class Divider:
    """Divides shared blobs, voxel by voxel.

    Attributes:
        volume: labels of tracks by voxel (level · columns + column), of divided blobs at least.
    """

    def __init__(self) -> None:
        self.volume: UInt8[ndarray, " voxels"] = _NOTHING
        self._before: UInt8[ndarray, " voxels"] = _NOTHING
        self._then_m: dict[int, Float[ndarray, "2"]] = {}

    def divide(
        self, plan: Plan, blobs: Blobs, views: Sequence[Foreground], tracks: Sequence[Track], shared: Sequence[Shared]
    ) -> dict[int, Part]:
        """What is seen of each track in a shared blob, by label; fills ``volume``."""
        nx, ny, nz = plan.shape
        size = nx * ny * nz
        self._before, self.volume = self.volume, _NOTHING
        if not shared:
            return {}
        self.volume = np.zeros(size, np.uint8)
        if len(self._before) != size:
            self._before = np.zeros(size, np.uint8)
        by_label = {track.label: track for track in tracks}
        flat, measured = blobs.labels.ravel(), {}
        for each in shared:
            voxels, count = np.empty(sum(len(view.pixels) for view in views), np.int32), 0
            for view in views:
                count = mark_voxels(view.columns, view.levels, flat, each.blob + 1, nx * ny, self.volume, voxels, count)
            people = np.array([self._row(by_label[label]) for label in each.labels])
            divide_voxels(
                voxels[:count], self.volume, self._before, plan.shape, people, CORE_M / CELL_M, FAR_M / CELL_M,
                np.empty(count, np.int32),
            )  # fmt: skip
            areas, profiles = np.zeros((256, 3)), np.zeros((256, nz))
            for view in views:
                measure_divided(
                    view.depth_m, view.pixels, view.columns, view.levels, view.pixel_m2, flat, each.blob + 1,
                    self.volume, nx, areas, profiles,
                )  # fmt: skip
            tops, bottoms = extents(profiles)
            for label in each.labels:
                place = areas[label, 1:] / max(areas[label, 0], 1e-12) * CELL_M
                measured[label] = Part(place, float(tops[label]), float(bottoms[label]), float(areas[label, 0]))
        return measured

    def _row(self, track: Track) -> list[float | int]:
        moved = track.expected_m - self._then_m.get(track.label, track.expected_m)
        return [track.label, *(track.expected_m / CELL_M).tolist(), *np.round(moved / CELL_M).tolist()]

    def remember(
        self, plan: Plan, views: Sequence[Foreground], owners: UInt8[ndarray, " columns"], tracks: Sequence[Track]
    ) -> None:
        """Keep whose voxels are whose, if people are so near to each other that they may touch in the next set."""
        self._then_m = {track.label: track.place_m.copy() for track in tracks}
        places = np.array(list(self._then_m.values())).reshape(-1, 2)
        apart = np.linalg.norm(places[:, None] - places[None], axis=2) + np.diag(np.full(len(places), np.inf))
        if not (apart < NEAR_M).any():
            return
        if len(self.volume) == 1:
            self.volume = np.zeros(int(np.prod(plan.shape)), np.uint8)
        for view in views:
            fill_volume(view.columns, view.levels, owners, self.volume)
