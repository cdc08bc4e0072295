"""Bird's-eye occupancy map: the foreground of all cameras in columns over the floor, and its connected blobs."""

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
#: Lowest height in the map (metres over the floor): far below it, because the floor may be estimated wrongly.
LOWEST_M = -1.5
#: Highest height in the map (metres over the floor): a person with an arm raised.
HIGHEST_M = 2.6
#: Where no background is known, anything lower than this (metres) may be the floor and is left out.
CLEAR_M = 0.07
#: How far in front of a camera the map reaches (metres): the range of the sensors.
REACH_M = 7.0
#: Greatest width of the map (metres): bounds memory and time.
WIDEST_M = 18.0
#: A column with less surface than this is empty (m²).
LEAST_M2 = 0.0006
#: A candidate pixel with fewer candidates than this in its 3×3 is noise. A majority would erode noisy silhouettes.
FEWEST_TOGETHER = 3
#: A flying pixel at a silhouette is at least this far behind one surface and in front of another (metres).
FLYING_M = 0.08
#: A blob longer than this (metres), a body on a chair, is furniture while the background is still being learnt.
SEATED_M = 1.3
#: What rises above furniture over this height (metres) is a person beside it.
FURNITURE_M = 1.05
#: A surface nearer to a camera than a position by this (metres) occludes it: more than half a head.
OCCLUDER_M = 0.2
#: The surface (m²) above a blob's top and below its bottom: less is noise.
_TIP_M2 = 0.006

_NO_RAYS = np.empty((0, 0, 2), np.float32)


@dataclasses.dataclass(frozen=True, eq=False)
class Foreground:
    """One camera's foreground.

    Attributes:
        depth_m: the camera's depth image (metres).
        pixels: index of each foreground pixel in the flat image.
        columns, levels: its column and level in the map.
        certain: 1 where the background is known to be behind the pixel, or out of range.
        pixel_m2: surface that a pixel shows at a metre (m²).
        trusted: False while the camera still learns its background.
    """

    depth_m: Float[ndarray, "h w"]
    pixels: Int[ndarray, " n"]
    columns: Int[ndarray, " n"]
    levels: UInt8[ndarray, " n"]
    certain: UInt8[ndarray, " n"]
    pixel_m2: float
    trusted: bool = True

    def without_uncertain(self, near: Bool[ndarray, " columns"]) -> Foreground:
        """Without the uncertain pixels, except in the columns ``near`` people: elsewhere an uncertain pixel is the
        background itself, seen for the first time. A camera that still learns its background is left as it is."""
        keep = self.certain.view(np.bool_)
        if not self.trusted or keep.all():
            return self
        keep = keep | near[self.columns]
        return dataclasses.replace(
            self,
            pixels=self.pixels[keep],
            columns=self.columns[keep],
            levels=self.levels[keep],
            certain=self.certain[keep],
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Blobs:
    """Connected components of the foreground, seen from above. Entry i belongs to label i + 1.

    Attributes:
        labels: of every column, 0 where it is empty.
        areas_m2: surface that all cameras together see.
        centres_m: x and y, from the map's corner.
        sizes_m: the longer and the shorter side of the bounding box along the map's axes.
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


class OccupancyMap:
    """Columns over the part of the floor that the cameras can see.

    Attributes:
        shape: columns in x and y, levels.
        map_from_world: 4×4; in the map Z is up, the floor z = 0 and a corner x = y = 0.
    """

    def __init__(self, cameras: Sequence[DepthCamera], floor_from_world: Float[ndarray, "4 4"]) -> None:
        """A map that covers the view frusta of the cameras."""
        frusta = []
        for camera in cameras:
            tips = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, REACH_M]])
            half_x, half_y = REACH_M * camera.width / camera.fx / 2, REACH_M * camera.height / camera.fy / 2
            corners = np.array([[x, y, REACH_M] for x in (-half_x, half_x) for y in (-half_y, half_y)])
            frusta.append(
                transform_points(floor_from_world @ camera.world_from_camera, np.concatenate([tips, corners]))
            )
        positions = np.concatenate(frusta)[:, :2]
        low, high = positions.min(0), positions.max(0)
        middle = positions.mean(0)
        low, high = np.maximum(low, middle - WIDEST_M / 2), np.minimum(high, middle + WIDEST_M / 2)
        nx, ny = np.ceil((high - low) / CELL_M).astype(int) + 2
        self.shape = (int(nx), int(ny), round((HIGHEST_M - LOWEST_M) / CELL_M))
        self.map_from_world = floor_from_world.copy()
        self.map_from_world[:2, 3] -= low - CELL_M

    def foreground(
        self, camera: DepthCamera, depth_m: Float[ndarray, "h w"], limit_m: Float[ndarray, "h w"], trusted: bool
    ) -> Foreground:
        """The pixels nearer than the limit (metres along z), without noise and flying pixels."""
        candidate = np.empty(depth_m.shape, np.uint8)
        count = find_candidates(depth_m, limit_m, candidate)
        pixels, columns = np.empty(count, np.int32), np.empty(count, np.int32)
        levels, certain = np.empty(count, np.uint8), np.empty(count, np.uint8)
        nx, ny, nz = self.shape
        kept = place_candidates(
            candidate, depth_m, limit_m, camera.rays if any(camera.distortion) else _NO_RAYS,
            (float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy)),
            self.map_from_world @ camera.world_from_camera, (nx, ny, nz, CELL_M, LOWEST_M, CLEAR_M),
            FEWEST_TOGETHER, FLYING_M, float(FAR_M), pixels, columns, levels, certain,
        )  # fmt: skip
        area_m2 = 1 / (camera.fx * camera.fy)
        return Foreground(depth_m, pixels[:kept], columns[:kept], levels[:kept], certain[:kept], area_m2, trusted)

    def blobs(self, views: Sequence[Foreground]) -> Blobs:
        """Connected components of the foreground of all trusted cameras.

        Without a trusted camera all cameras count. Then furniture is foreground as well, and what rises above it is
        separated from it.
        """
        nx, _, nz = self.shape
        learning = not any(view.trusted for view in views)
        if not learning:
            views = [view for view in views if view.trusted]
        filled = self._filled(views, LOWEST_M)
        labels, sizes_m = _connected_components(filled)
        if learning:
            long = np.append(False, sizes_m[:, 0] > SEATED_M)
            high, high_sizes_m = _connected_components(self._filled(views, FURNITURE_M) & long[labels])
            high[np.append(False, high_sizes_m[:, 0] > SEATED_M)[high]] = 0  # walls and cupboards
            labels, sizes_m = _connected_components(filled & (high == 0))
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
        """Columns with surface higher than ``lowest_m``."""
        nx, ny, _ = self.shape
        area_m2 = np.zeros(ny * nx, np.float32)
        for view in views:
            high = view.levels >= round((lowest_m - LOWEST_M) / CELL_M)
            add_area(view.depth_m, view.pixels[high], view.columns[high], view.pixel_m2, area_m2)
        return (area_m2 > LEAST_M2).reshape(ny, nx)

    def is_visible(self, views: Sequence[View], position_m: Float[ndarray, "2"], height_m: float) -> bool:
        """Whether at least two views (or the only one) see a position at a height (metres) without an occluder.

        Then no edge of an image, door frame or lamp cuts off what is lower there.
        """
        point = transform_points(rigid_inverse(self.map_from_world), np.array([*position_m, height_m]))
        count = 0
        for view in views:
            u, v, z = view.camera.project(point).tolist()
            if 0 <= u < view.camera.width - 1 and 0 <= v < view.camera.height - 1:  # False for NaN, behind a camera
                depth_m = float(view.depth_m[round(v), round(u)])
                count += depth_m == 0 or depth_m > z - OCCLUDER_M
        return count >= min(len(views), 2)

    def columns_near(self, positions_m: Sequence[Float[ndarray, "2"]], radius_m: float) -> Bool[ndarray, " columns"]:
        """Columns within a radius of any of the positions (metres, from the map's corner)."""
        nx, ny, _ = self.shape
        x, y = (np.arange(nx) + 0.5) * CELL_M, (np.arange(ny)[:, None] + 0.5) * CELL_M
        near = np.zeros((ny, nx), np.bool_)
        for position in positions_m:
            near |= (x - position[0]) ** 2 + (y - position[1]) ** 2 < radius_m**2
        return near.ravel()


def _connected_components(filled: Bool[ndarray, "ny nx"]) -> tuple[Int[ndarray, "ny nx"], Float[ndarray, "b 2"]]:
    """Labels of the connected columns, and the sides of their bounding boxes, the longer first (metres)."""
    # Dilation by one column on every side bridges gaps of two.
    dilated = cv2.dilate(filled.view(np.uint8), np.ones((3, 3), np.uint8))
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(dilated, connectivity=4)
    return labels, np.sort((boxes[1:, 2:4] - 2) * CELL_M, axis=1)[:, ::-1]


def extents(profiles: Float[ndarray, "b levels"]) -> tuple[Float[ndarray, " b"], Float[ndarray, " b"]]:
    """Heights (metres over the floor) of the tops and bottoms of the surface in each level (m²); 0 without any."""
    tip_heights = []
    for counts in (profiles[:, ::-1], profiles):
        passed = np.cumsum(counts, 1)
        level = np.minimum((passed < _TIP_M2).sum(1), passed.shape[1] - 1)[:, None]
        # Surface is assumed to be spread evenly within a level, which makes heights finer than levels.
        inside = np.take_along_axis(counts, level, 1)
        share = (_TIP_M2 - (np.take_along_axis(passed, level, 1) - inside)) / np.maximum(inside, 1e-12)
        tip_heights.append((level + np.clip(share, 0, 1))[:, 0] * CELL_M)
    empty = profiles.sum(1) < _TIP_M2
    tops = profiles.shape[1] * CELL_M + LOWEST_M - tip_heights[0]
    return np.where(empty, 0.0, tops), np.where(empty, 0.0, tip_heights[1] + LOWEST_M)
