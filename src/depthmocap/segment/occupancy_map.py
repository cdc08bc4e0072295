"""A plan of the room: foreground of all cameras in columns over the floor, and the blobs that it makes there."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray

from depthmocap.frames import View
from depthmocap.geometry import DepthCamera, rigid_inverse, transform_points
from depthmocap.kernels.segmentation import add_area, find_candidates, measure_blobs, place_candidates
from depthmocap.segment.background import FAR_M

#: Width of a column, and height of a level (metres).
CELL_M = 0.06
#: What is lower or higher over the floor is not looked at (metres). Floors may be wrong, so there is room below.
LOWEST_M, HIGHEST_M = -1.5, 2.6
#: Where no background is known, what is lower than this may be the floor (metres).
CLEAR_M = 0.07
#: How far before a camera the plan reaches, and its greatest width (metres).
REACH_M, WIDEST_M = 7.0, 18.0
#: A column with less surface than this in it is empty (m²).
LEAST_M2 = 0.0006
#: Fewer candidate pixels than this in 3×3 are noise. A majority would eat silhouettes that are full of lost pixels.
FEWEST_TOGETHER = 3
#: A stray pixel at a silhouette hangs at least this far behind one surface and before another.
FLYING_M = 0.08
#: What is longer than a body on a chair is furniture, with people beside it if it rises over this height (metres).
SEATED_M, FURNITURE_M = 1.3, 1.05
#: What is nearer to a camera than a place by this stands before it (metres): more than half a head.
BEFORE_M = 0.2
#: A blob begins and ends where this much surface is above and below (m²): less is noise.
_TIP_M2 = 0.006

_NO_RAYS = np.empty((0, 0, 2), np.float32)


@dataclasses.dataclass(frozen=True, eq=False)
class Foreground:
    """What one camera sees before the background: of each pixel its place in the flat picture, column and level."""

    depth_m: Float[ndarray, "h w"]
    pixels: Int[ndarray, " n"]
    columns: Int[ndarray, " n"]
    levels: UInt8[ndarray, " n"]
    #: 1 where the background is known to be behind, or to be out of range.
    sure: UInt8[ndarray, " n"]
    pixel_m2: float
    #: Whether it tells what stands in the room: not while the camera still learns what belongs to it.
    trusted: bool = True

    def without_unsure(self, near: Bool[ndarray, " columns"]) -> Foreground:
        """Of what is before an unknown background only that in these columns: elsewhere it is the background, come to
        light. A camera that still learns is left as it is."""
        keep = self.sure.view(np.bool_)
        if not self.trusted or keep.all():
            return self
        keep = keep | near[self.columns]
        return dataclasses.replace(
            self, pixels=self.pixels[keep], columns=self.columns[keep], levels=self.levels[keep], sure=self.sure[keep]
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Blobs:
    """Foreground that hangs together, seen from above; entry i is that of label i + 1.

    Attributes:
        labels: of every column, 0 where nothing is.
        areas_m2: surface that all cameras together see.
        centres_m: x and y, from the plan's corner.
        sizes_m: the longer and the shorter side of its box along the plan's axes.
        tops_m, bottoms_m: heights over the floor.
    """

    labels: Int[ndarray, "ny nx"]
    areas_m2: Float[ndarray, " b"]
    centres_m: Float[ndarray, "b 2"]
    sizes_m: Float[ndarray, "b 2"]
    tops_m: Float[ndarray, " b"]
    bottoms_m: Float[ndarray, " b"]

    def __len__(self) -> int:
        return len(self.areas_m2)


class Plan:
    """Columns over the floor that the cameras can see.

    Attributes:
        shape: columns in x and y, levels.
        plan_from_world: Z up, the floor at z = 0, the corner of the plan at x = y = 0.
    """

    def __init__(self, cameras: Sequence[DepthCamera], floor_from_world: Float[ndarray, "4 4"]) -> None:
        """A plan with room for what the cameras see."""
        ends = []
        for camera in cameras:
            tips = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, REACH_M]])
            half_x, half_y = REACH_M * camera.width / camera.fx / 2, REACH_M * camera.height / camera.fy / 2
            corners = np.array([[x, y, REACH_M] for x in (-half_x, half_x) for y in (-half_y, half_y)])
            ends.append(transform_points(floor_from_world @ camera.world_from_camera, np.concatenate([tips, corners])))
        places = np.concatenate(ends)[:, :2]
        low, high = places.min(0), places.max(0)
        middle = places.mean(0)
        low, high = np.maximum(low, middle - WIDEST_M / 2), np.minimum(high, middle + WIDEST_M / 2)
        nx, ny = np.ceil((high - low) / CELL_M).astype(int) + 2
        self.shape = (int(nx), int(ny), round((HIGHEST_M - LOWEST_M) / CELL_M))
        self.plan_from_world = floor_from_world.copy()
        self.plan_from_world[:2, 3] -= low - CELL_M

    def foreground(
        self, camera: DepthCamera, depth_m: Float[ndarray, "h w"], limit_m: Float[ndarray, "h w"], trusted: bool
    ) -> Foreground:
        """What is nearer than the limit (metres along z), without stray pixels."""
        candidate = np.empty(depth_m.shape, np.uint8)
        count = find_candidates(depth_m, limit_m, candidate)
        pixels, columns = np.empty(count, np.int32), np.empty(count, np.int32)
        levels, sure = np.empty(count, np.uint8), np.empty(count, np.uint8)
        nx, ny, nz = self.shape
        found = place_candidates(
            candidate, depth_m, limit_m, camera.rays if any(camera.distortion) else _NO_RAYS,
            (float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy)),
            self.plan_from_world @ camera.world_from_camera, (nx, ny, nz, CELL_M, LOWEST_M, CLEAR_M),
            FEWEST_TOGETHER, FLYING_M, float(FAR_M), pixels, columns, levels, sure,
        )  # fmt: skip
        area_m2 = 1 / (camera.fx * camera.fy)
        return Foreground(depth_m, pixels[:found], columns[:found], levels[:found], sure[:found], area_m2, trusted)

    def blobs(self, views: Sequence[Foreground]) -> Blobs:
        """What hangs together in the foreground of all cameras; those not trusted count where no other is. Then the
        furniture is foreground as well, and what rises over it is told from it."""
        nx, _, nz = self.shape
        learning = not any(view.trusted for view in views)
        if not learning:
            views = [view for view in views if view.trusted]
        filled = self._filled(views, LOWEST_M)
        labels, sizes_m = _components(filled)
        if learning:
            long = np.append(False, sizes_m[:, 0] > SEATED_M)
            high, high_sizes_m = _components(self._filled(views, FURNITURE_M) & long[labels])
            high[np.append(False, high_sizes_m[:, 0] > SEATED_M)[high]] = 0  # walls and cupboards
            labels, sizes_m = _components(filled & (high == 0))
            labels = np.where(high > 0, high, np.where(labels > 0, labels + len(high_sizes_m), 0))
            sizes_m = np.concatenate([high_sizes_m, sizes_m])
        count = len(sizes_m) + 1
        sums, profiles = np.zeros((count, 3)), np.zeros((count, nz))
        flat = labels.ravel()
        for view in views:
            measure_blobs(view.depth_m, view.pixels, view.columns, view.levels, view.pixel_m2, flat, nx, sums, profiles)
        tops, bottoms = extents(profiles[1:])
        return Blobs(
            labels, sums[1:, 0], sums[1:, 1:] / np.maximum(sums[1:, :1], 1e-12) * CELL_M, sizes_m, tops, bottoms
        )  # fmt: skip

    def _filled(self, views: Sequence[Foreground], lowest_m: float) -> Bool[ndarray, "ny nx"]:
        """Columns with surface in them higher than this."""
        nx, ny, _ = self.shape
        area_m2 = np.zeros(ny * nx, np.float32)
        for view in views:
            high = view.levels >= round((lowest_m - LOWEST_M) / CELL_M)
            add_area(view.depth_m, view.pixels[high], view.columns[high], view.pixel_m2, area_m2)
        return (area_m2 > LEAST_M2).reshape(ny, nx)

    def overlooked(self, views: Sequence[View], place_m: Float[ndarray, "2"], height_m: float) -> bool:
        """Whether two views at least (or the only one) show what is at a place and a height (metres), with nothing
        before it: what is lower there is not cut off by the edge of a picture, a door frame or a lamp."""
        point = transform_points(rigid_inverse(self.plan_from_world), np.array([*place_m, height_m]))
        shown = 0
        for view in views:
            u, v, z = view.camera.project(point).tolist()
            if 0 <= u < view.camera.width - 1 and 0 <= v < view.camera.height - 1:  # NaN behind a camera is not
                depth_m = float(view.depth_m[round(v), round(u)])
                shown += depth_m == 0 or depth_m > z - BEFORE_M
        return shown >= min(len(views), 2)

    def around(self, places_m: Sequence[Float[ndarray, "2"]], radius_m: float) -> Bool[ndarray, " columns"]:
        """Columns within a radius of any of the places (metres, from the plan's corner)."""
        nx, ny, _ = self.shape
        x, y = (np.arange(nx) + 0.5) * CELL_M, (np.arange(ny)[:, None] + 0.5) * CELL_M
        near = np.zeros((ny, nx), np.bool_)
        for place in places_m:
            near |= (x - place[0]) ** 2 + (y - place[1]) ** 2 < radius_m**2
        return near.ravel()


def _components(filled: Bool[ndarray, "ny nx"]) -> tuple[Int[ndarray, "ny nx"], Float[ndarray, "b 2"]]:
    """Labels of the columns that hang together, and the sides of their boxes, the longer first (metres)."""
    # Columns that touch when each is grown by one hang together: gaps of two are bridged.
    grown = cv2.dilate(filled.view(np.uint8), np.ones((3, 3), np.uint8))
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(grown, connectivity=4)
    return labels, np.sort((boxes[1:, 2:4] - 2) * CELL_M, axis=1)[:, ::-1]


def extents(profiles: Float[ndarray, "b levels"]) -> tuple[Float[ndarray, " b"], Float[ndarray, " b"]]:
    """Heights (metres over the floor) of the tops and bottoms of surface counted by level (m²); 0 without any."""
    ends = []
    for counts in (profiles[:, ::-1], profiles):
        passed = np.cumsum(counts, 1)
        level = np.minimum((passed < _TIP_M2).sum(1), passed.shape[1] - 1)[:, None]
        # Within the level surface is taken to be spread evenly, so that heights are finer than levels.
        inside = np.take_along_axis(counts, level, 1)
        share = (_TIP_M2 - (np.take_along_axis(passed, level, 1) - inside)) / np.maximum(inside, 1e-12)
        ends.append((level + np.clip(share, 0, 1))[:, 0] * CELL_M)
    empty = profiles.sum(1) < _TIP_M2
    tops = profiles.shape[1] * CELL_M + LOWEST_M - ends[0]
    return np.where(empty, 0.0, tops), np.where(empty, 0.0, ends[1] + LOWEST_M)
