"""Two people who touch make one blob. It is divided voxel by voxel, from where each of them was before."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from depthmocap.kernels.segmentation import divide_voxels, fill_volume, mark_voxels, measure_divided
from depthmocap.segment.occupancy_map import CELL_M, Blobs, Foreground, OccupancyMap, extents
from depthmocap.segment.track import Track
from depthmocap.segment.tracking import BlobPart, SharedBlob

#: Voxels this near to a person's predicted position (metres) are theirs.
CORE_M = 0.15
#: Voxels farther than this from it (metres) are not theirs.
FAR_M = 1.1
#: Voxels are remembered for the next set when two people are nearer to each other than this (metres): they may touch.
NEAR_M = 2.5

_NOTHING = np.zeros(1, np.uint8)


class BlobDivider:
    """Divides shared blobs, voxel by voxel.

    Attributes:
        volume: each voxel's track label (index: level · columns + column), at least in divided blobs.
    """

    def __init__(self) -> None:
        self.volume: UInt8[ndarray, " voxels"] = _NOTHING
        self._previous_volume: UInt8[ndarray, " voxels"] = _NOTHING
        self._previous_positions_m: dict[int, Float[ndarray, "2"]] = {}

    def divide(
        self,
        occupancy: OccupancyMap,
        blobs: Blobs,
        views: Sequence[Foreground],
        tracks: Sequence[Track],
        shared: Sequence[SharedBlob],
    ) -> dict[int, BlobPart]:
        """Measurements of each track in a shared blob, by label. Fills ``volume``."""
        nx, ny, nz = occupancy.shape
        size = nx * ny * nz
        self._previous_volume, self.volume = self.volume, _NOTHING
        if not shared:
            return {}
        self.volume = np.zeros(size, np.uint8)
        if len(self._previous_volume) != size:
            self._previous_volume = np.zeros(size, np.uint8)
        by_label = {track.label: track for track in tracks}
        flat, measured = blobs.labels.ravel(), {}
        for shared_blob in shared:
            blob = shared_blob.index + 1  # 0 is no blob
            voxels, count = np.empty(sum(len(view.pixels) for view in views), np.int32), 0
            for view in views:
                count = mark_voxels(view.columns, view.levels, flat, blob, nx * ny, self.volume, voxels, count)
            people = np.array([self._row(by_label[label]) for label in shared_blob.labels])
            divide_voxels(
                voxels[:count], self.volume, self._previous_volume, occupancy.shape, people, CORE_M / CELL_M,
                FAR_M / CELL_M, np.empty(count, np.int32),
            )  # fmt: skip
            areas, profiles = np.zeros((256, 3)), np.zeros((256, nz))
            for view in views:
                measure_divided(
                    view.depth_m, view.pixels, view.columns, view.levels, view.pixel_m2, flat, blob, self.volume, nx,
                    areas, profiles,
                )  # fmt: skip
            tops, bottoms = extents(profiles)
            for label in shared_blob.labels:
                position = areas[label, 1:] / max(areas[label, 0], 1e-12) * CELL_M
                measured[label] = BlobPart(position, float(tops[label]), float(bottoms[label]), float(areas[label, 0]))
        return measured

    def _row(self, track: Track) -> list[float | int]:
        """Label, predicted position and movement (columns): a row of ``people`` in ``divide_voxels``."""
        movement = track.predicted_m - self._previous_positions_m.get(track.label, track.predicted_m)
        return [track.label, *(track.predicted_m / CELL_M).tolist(), *np.round(movement / CELL_M).tolist()]

    def remember(
        self,
        occupancy: OccupancyMap,
        views: Sequence[Foreground],
        labels: UInt8[ndarray, " columns"],
        tracks: Sequence[Track],
    ) -> None:
        """Remember every voxel's track, if people are so near to each other that they may touch in the next set."""
        self._previous_positions_m = {track.label: track.position_m.copy() for track in tracks}
        positions = np.array(list(self._previous_positions_m.values())).reshape(-1, 2)
        distances = np.linalg.norm(positions[:, None] - positions[None], axis=2)
        if not (distances[~np.eye(len(positions), dtype=bool)] < NEAR_M).any():
            return
        if len(self.volume) == 1:
            self.volume = np.zeros(int(np.prod(occupancy.shape)), np.uint8)
        for view in views:
            fill_volume(view.columns, view.levels, labels, self.volume)
