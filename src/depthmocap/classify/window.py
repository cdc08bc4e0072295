"""The network's window: made from a masked depth image; its labels are transferred back to the image.

As in the paper (Sec. IV-A) the person's bounding box is scaled to a fixed size and the depth shifted to a fixed mean.
Our window has fewer empty pixels (180 of 192 pixels instead of 190 of 250, and the shorter side fits the person). Its
depth is in metres around the person's median instead of 8-bit levels, and one channel holds the size of a pixel. The
paper's network has the paper's window.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray
from PIL import Image

from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.geometry.transforms import transform_points
from depthmocap.kernels.box import bounding_box
from depthmocap.kernels.resample_window import (
    gather_depth,
    gather_labels,
    mark_supported,
    scatter_labels,
    turned_extents,
)

#: Longer side of the window (pixels).
WINDOW = 192
#: Longer side of the person's bounding box in the window (pixels).
PERSON = 180
#: Sides are multiples of this: the network halves them five times.
WINDOW_STEP = 32
#: Relative depth is divided by this (metres) and clipped to ±2.
DEPTH_SCALE_M = 0.5
#: A typical size of a window pixel on the person (metres): 0 of the third channel.
PIXEL_M = 0.01
#: A pixel belongs to a surface if at least this many neighbours are near it in depth. The others are flying pixels at a
#: silhouette; a few of them, far from the body, would disturb all labels.
SUPPORT_NEIGHBOURS = 2
#: Neighbours are near within this difference in depth (metres),
SUPPORT_M = 0.03
#: plus this for each metre of depth, as depth noise grows.
SUPPORT_PER_M = 0.01
#: Side of the paper's window (pixels).
PAPER_WINDOW = 250
#: Longer side of the person's bounding box in the paper's window (pixels).
PAPER_PERSON = 190
#: The depth range of the paper's 255 levels (cm).
PAPER_RANGE_CM = (50.0, 800.0)
#: The level to which the paper's window shifts the person's mean depth.
PAPER_MEAN = 55.0
#: The level of the background.
_PAPER_FAR = 255.0
#: Least weight of the person's pixels in a resampled pixel; below it the nearest pixel is used.
_LEAST_WEIGHT = 0.25
#: A mask with fewer pixels than this contains no person.
MIN_PIXELS = 40


@dataclasses.dataclass(frozen=True, eq=False)
class Window:
    """A network's input, whose channel 1 is the mask, and its position in the image.

    Window pixel (i, j) shows the image pixel ``(top + (i + 0.5)·step, left + (j + 0.5)·step)``, rounded down. Our
    window also has the depth of its centre and the size of its pixels there (metres). They make positions in the window
    metric: right, down and forwards of the centre.

    Attributes:
        turn_rad: angle by which the window is turned clockwise against the image, as a camera that is turned about its
            axis sees it; ``left`` and ``top`` are in the turned image (``kernels.resample_window``).
    """

    inputs: Float[ndarray, "c h w"]
    left: float
    top: float
    step: float
    centre_m: float = float("nan")
    pixel_m: float = float("nan")
    turn_rad: float = 0.0

    @property
    def _turn(self) -> tuple[float, float]:
        return math.cos(self.turn_rad), math.sin(self.turn_rad)

    def positions_from_world(self, points_world: Float[ndarray, "n 3"], camera: DepthCamera) -> Float[ndarray, "n 3"]:
        """Positions of world points in our window (metres); NaN for points behind the camera."""
        u, v, z = camera.project(points_world).T
        height, width = self.inputs.shape[1:]
        cosine, sine = self._turn
        u, v = cosine * (u + 0.5) + sine * (v + 0.5), cosine * (v + 0.5) - sine * (u + 0.5)
        right = ((u - self.left) / self.step - width / 2) * self.pixel_m
        down = ((v - self.top) / self.step - height / 2) * self.pixel_m
        return np.stack([right, down, z - self.centre_m], -1)

    def positions_to_world(self, positions: Float[ndarray, "n 3"], camera: DepthCamera) -> Float[ndarray, "n 3"]:
        """World points (metres) of positions in our window."""
        height, width = self.inputs.shape[1:]
        u = (positions[:, 0] / self.pixel_m + width / 2) * self.step + self.left
        v = (positions[:, 1] / self.pixel_m + height / 2) * self.step + self.top
        cosine, sine = self._turn
        pixels = np.stack([cosine * u - sine * v - 0.5, sine * u + cosine * v - 0.5], -1)
        rays = camera.rays_through(pixels.astype(np.float64))
        z = positions[:, 2:] + self.centre_m
        return transform_points(camera.world_from_camera, np.concatenate([rays * z, z], -1))

    def labels_from_image(self, labels: UInt8[ndarray, "_ _"], fill: int = 0) -> UInt8[ndarray, "h w"]:
        """The window's labels from an image of labels; ``fill`` outside the image."""
        out = np.full(self.inputs.shape[1:], fill, dtype=np.uint8)
        gather_labels(labels, self.left, self.top, self.step, self._turn, out)
        return out

    def labels_to_image(
        self, labels: UInt8[ndarray, "h w"], confidence: Float[ndarray, "h w"], mask: Bool[ndarray, "rows columns"]
    ) -> tuple[UInt8[ndarray, "rows columns"], Float[ndarray, "rows columns"]]:
        """The image's labels and confidences from those of the window at the masked pixels, 0 elsewhere."""
        out_labels = np.zeros(mask.shape, dtype=np.uint8)
        out_confidence = np.zeros(mask.shape, dtype=np.float32)
        scatter_labels(
            labels, confidence, mask, self.left, self.top, self.step, self._turn, out_labels, out_confidence
        )  # fmt: skip
        return out_labels, out_confidence


def make_window(
    depth_m: Float[ndarray, "h w"], mask: Bool[ndarray, "h w"], camera: DepthCamera, turn_rad: float = 0.0
) -> Window | None:
    """The person's window; None if the mask contains no person.

    ``inputs`` (3, h, w) are relative depth, mask and log2 of the pixel size. The longer side has 192 pixels, the other
    the smallest multiple of 32 that leaves 6 pixels on both sides of the person.

    Args:
        depth_m: metres along z.
        mask: the person's pixels; pixels without depth and flying pixels are left out.
        turn_rad: as of ``Window``.
    """
    box = bounding_box(mask)
    if box is None:
        return None
    # Only the bounding box from here on: full images would take most of the time.
    depth = depth_m[box]
    solid = np.zeros(depth.shape, bool)
    mark_supported(depth, mask[box] & (depth > 0), SUPPORT_M, SUPPORT_PER_M, SUPPORT_NEIGHBOURS, solid)
    depths = depth[solid]
    if len(depths) < MIN_PIXELS:
        return None
    corner = box[0].start, box[1].start
    turn = math.cos(turn_rad), math.sin(turn_rad)
    left, top, right, bottom = turned_extents(solid, corner, turn)
    centre_m = float(np.median(depths))
    step = max(bottom - top, right - left) / PERSON
    # On real images a silhouette that touches the window's border costs 2 % of the labels at joints.
    height, width = (int(extent / step + WINDOW - PERSON - 1) // WINDOW_STEP * WINDOW_STEP + WINDOW_STEP
                     for extent in (bottom - top, right - left))  # fmt: skip
    x0 = (left + right) / 2 - width / 2 * step
    y0 = (top + bottom) / 2 - height / 2 * step
    inputs = np.zeros((3, height, width), dtype=np.float32)
    gather_depth(depth, solid, corner, x0, y0, step, turn, centre_m, DEPTH_SCALE_M, inputs)
    pixel_m = float(centre_m * step / camera.fx)
    inputs[2] = np.log2(pixel_m / PIXEL_M)
    return Window(inputs, float(x0), float(y0), float(step), centre_m, pixel_m, turn_rad)


def make_paper_window(depth_m: Float[ndarray, "h w"], mask: Bool[ndarray, "h w"], camera: DepthCamera) -> Window | None:
    """The paper's window of a person; None if the mask contains no person.

    ``inputs`` (2, 250, 250) are the depth level divided by 255, which is 1 around the person, and the mask. Depth is
    resampled by a Lanczos kernel over the person's pixels only, so that it does not mix with the background. Flying
    pixels are kept: the paper does not remove them.

    Args:
        depth_m: metres along z.
        mask: the person's pixels; pixels without depth are left out.
    """
    mask = mask & (depth_m > 0) & np.isfinite(depth_m)
    if np.count_nonzero(mask) < MIN_PIXELS:
        return None
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    top, left = rows[0], columns[0]
    box = slice(top, rows[-1] + 1), slice(left, columns[-1] + 1)
    height, width = mask[box].shape
    side = max(height, width)
    down, across = (side - height) // 2, (side - width) // 2
    near_cm, far_cm = PAPER_RANGE_CM
    levels = np.zeros(mask.shape, np.uint8)
    depth_cm = np.where(mask[box], depth_m[box], 0) * 100
    levels[box] = np.rint(np.clip((depth_cm - near_cm) / (far_cm - near_cm), 0, 1) * 255)
    square = np.zeros((2, side, side), np.float32)
    middle = slice(down, down + height), slice(across, across + width)
    square[0][middle] = levels[box]
    square[1][middle] = mask[box]
    total, weight = (_lanczos(channel) for channel in square)

    step = side / PAPER_PERSON
    margin = (PAPER_WINDOW - PAPER_PERSON) // 2
    window = Window(
        np.zeros((2, PAPER_WINDOW, PAPER_WINDOW), np.float32),
        float(left - across - margin * step), float(top - down - margin * step), float(step),
    )  # fmt: skip
    inner = slice(margin, margin + PAPER_PERSON), slice(margin, margin + PAPER_PERSON)
    person = window.labels_from_image(mask.view(np.uint8))[inner] > 0
    if not person.any():  # pixels so scattered that the window shows none
        return None
    # Where mostly the kernel's negative lobes meet the person, as on a finger a pixel wide, the nearest pixel is used.
    nearest = window.labels_from_image(levels)[inner]
    level = np.where(weight > _LEAST_WEIGHT, total / np.maximum(weight, _LEAST_WEIGHT), nearest)[person]
    level += PAPER_MEAN - level.mean()
    window.inputs[0] = 1.0
    window.inputs[0][inner][person] = np.clip(level, 0, _PAPER_FAR - 1) / _PAPER_FAR
    window.inputs[1][inner] = person
    return window


def _lanczos(square: Float[ndarray, "s s"]) -> Float[ndarray, "190 190"]:
    image = Image.fromarray(square).resize((PAPER_PERSON, PAPER_PERSON), Image.Resampling.LANCZOS)
    return np.asarray(image, dtype=np.float32)


NetworkName = Literal["fast", "paper"]
WindowMaker = Callable[[ndarray, ndarray, DepthCamera], Window | None]
#: The function that makes each network's window.
WINDOW_MAKERS: dict[NetworkName, WindowMaker] = {
    "fast": make_window,
    "paper": make_paper_window,
}
