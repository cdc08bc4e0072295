"""From a masked depth image to the network's window, and from the window's labels back.

As in the paper (Sec. IV-A) the person's bounding box is scaled to a fixed size and the depth shifted to a fixed mean.
Our window is tighter (180 of 192 pixels instead of 190 of 250, and across its longer side just as wide as the person:
fewer empty pixels), depth stays in metres around the person's median instead of 8-bit levels, and the scale of a pixel
is told to the network. The paper's own window is made for its network.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray
from PIL import Image

from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.geometry.transforms import transform_points
from depthmocap.kernels.box import box_of
from depthmocap.kernels.resample_window import gather, gather_labels, scatter, supported

#: Longer side of the window, and of the person's bounding box in it (pixels).
WINDOW, PERSON = 192, 180
#: Sides are multiples of this: the network halves them five times.
WINDOW_STEP = 32
#: Relative depth is divided by this (metres) and clipped to ±2.
DEPTH_SCALE_M = 0.5
#: A typical size of a window pixel on the person (metres), the origin of the third channel.
PIXEL_M = 0.01
#: A pixel belongs to a surface if so many of its neighbours are within this of it; others fly at a silhouette, and a
#: few of them, far from the body, would confuse the network about all of it.
NEIGHBOURS, NEAR_M, NEAR_PER_M = 2, 0.03, 0.01
#: The paper's window, and the person's bounding box in it (pixels).
PAPER_WINDOW, PAPER_PERSON = 250, 190
#: Its depth has 255 levels between these (cm); the person's mean is shifted to this level, and background is 255.
PAPER_RANGE_CM, PAPER_MEAN, _PAPER_FAR = (50.0, 800.0), 55.0, 255.0
#: Least share of a resampled pixel that must be of the person's own pixels.
_LEAST_WEIGHT = 0.25
#: Masks with fewer pixels than this hold no person.
MIN_PIXELS = 40


@dataclasses.dataclass(frozen=True, eq=False)
class Window:
    """What a network reads, of which channel 1 is always the mask, and where it lies: window pixel (i, j) shows the
    picture at ``(top + (i + 0.5)·step, left + (j + 0.5)·step)``, rounded down.

    Our window also knows the depth of its middle and the size of its pixels there (metres), which make places in it
    metric: right, down and forwards of the middle.
    """

    inputs: Float[ndarray, "c h w"]
    left: float
    top: float
    step: float
    centre_m: float = float("nan")
    pixel_m: float = float("nan")

    def places_from_world(self, points_world: Float[ndarray, "n 3"], camera: DepthCamera) -> Float[ndarray, "n 3"]:
        """Places of world points in our window (metres); NaN for points behind the camera."""
        u, v, z = camera.project(points_world).T
        height, width = self.inputs.shape[1:]
        right = ((u + 0.5 - self.left) / self.step - width / 2) * self.pixel_m
        down = ((v + 0.5 - self.top) / self.step - height / 2) * self.pixel_m
        return np.stack([right, down, z - self.centre_m], -1)

    def places_to_world(self, places: Float[ndarray, "n 3"], camera: DepthCamera) -> Float[ndarray, "n 3"]:
        """World points (metres) of places in our window."""
        height, width = self.inputs.shape[1:]
        u = (places[:, 0] / self.pixel_m + width / 2) * self.step + self.left - 0.5
        v = (places[:, 1] / self.pixel_m + height / 2) * self.step + self.top - 0.5
        rays = camera.rays_through(np.stack([u, v], -1).astype(np.float64))
        z = places[:, 2:] + self.centre_m
        return transform_points(camera.world_from_camera, np.concatenate([rays * z, z], -1))

    def labels_from_image(self, labels: UInt8[ndarray, "_ _"], fill: int = 0) -> UInt8[ndarray, "h w"]:
        """Labels of the picture in the window."""
        out = np.full(self.inputs.shape[1:], fill, dtype=np.uint8)
        gather_labels(labels, self.left, self.top, self.step, out)
        return out

    def labels_to_image(
        self, labels: UInt8[ndarray, "h w"], confidence: Float[ndarray, "h w"], mask: Bool[ndarray, "rows columns"]
    ) -> tuple[UInt8[ndarray, "rows columns"], Float[ndarray, "rows columns"]]:
        """Labels and confidences of the window at the picture's masked pixels, 0 elsewhere."""
        out_labels = np.zeros(mask.shape, dtype=np.uint8)
        out_confidence = np.zeros(mask.shape, dtype=np.float32)
        scatter(labels, confidence, mask, self.left, self.top, self.step, out_labels, out_confidence)
        return out_labels, out_confidence


def make_window(depth_m: Float[ndarray, "h w"], mask: Bool[ndarray, "h w"], camera: DepthCamera) -> Window | None:
    """The person's window, or None where the mask holds nobody: ``inputs`` (3, h, w) are relative depth, mask and log2
    of the pixel size. The longer side has 192 pixels, the other as many steps of 32 as show all of the person and 6
    pixels on both sides.

    Args:
        depth_m: metres along z.
        mask: the person's pixels; those without depth, and stray ones beside no surface, are left out.
    """
    box = box_of(mask)
    if box is None:
        return None
    # From here on in the box alone: full pictures would take most of the time.
    depth = depth_m[box]
    solid = np.zeros(depth.shape, bool)
    supported(depth, mask[box] & (depth > 0), NEAR_M, NEAR_PER_M, NEIGHBOURS, solid)
    depths = depth[solid]
    if len(depths) < MIN_PIXELS:
        return None
    rows, columns = box_of(solid) or box
    corner = box[0].start, box[1].start
    top, bottom = corner[0] + rows.start, corner[0] + rows.stop
    left, right = corner[1] + columns.start, corner[1] + columns.stop
    centre_m = float(np.median(depths))
    step = max(bottom - top, right - left) / PERSON
    # On real pictures, a silhouette that touches the window's border cost 2 % of the joints' labels.
    height, width = (int(extent / step + WINDOW - PERSON - 1) // WINDOW_STEP * WINDOW_STEP + WINDOW_STEP
                     for extent in (bottom - top, right - left))  # fmt: skip
    x0 = (left + right) / 2 - width / 2 * step
    y0 = (top + bottom) / 2 - height / 2 * step
    inputs = np.zeros((3, height, width), dtype=np.float32)
    gather(depth, solid, corner, x0, y0, step, centre_m, DEPTH_SCALE_M, inputs)
    pixel_m = float(centre_m * step / camera.fx)
    inputs[2] = np.log2(pixel_m / PIXEL_M)
    return Window(inputs, float(x0), float(y0), float(step), centre_m, pixel_m)


def make_paper_window(depth_m: Float[ndarray, "h w"], mask: Bool[ndarray, "h w"], camera: DepthCamera) -> Window | None:
    """The paper's window of a person, or None where the mask holds nobody: ``inputs`` (2, 250, 250) are the level of
    depth divided by 255, which is 1 around the person, and the mask.

    Depth is resampled by Lanczos's kernel among the person's own pixels, so that none is mixed with what is behind.
    Pixels that stray are not left out, as the paper knows none.

    Args:
        depth_m: metres along z.
        mask: the person's pixels; those without depth are left out.
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
    total, weight = (_lanczos(each) for each in square)

    step = side / PAPER_PERSON
    margin = (PAPER_WINDOW - PAPER_PERSON) // 2
    window = Window(
        np.zeros((2, PAPER_WINDOW, PAPER_WINDOW), np.float32),
        float(left - across - margin * step), float(top - down - margin * step), float(step),
    )  # fmt: skip
    inner = slice(margin, margin + PAPER_PERSON), slice(margin, margin + PAPER_PERSON)
    person = window.labels_from_image(mask.view(np.uint8))[inner] > 0
    if not person.any():  # pixels strewn so wide that the window shows none
        return None
    # Where the kernel finds little but its negative lobes, as on a finger a pixel wide, the nearest pixel serves.
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
#: How the window of each network is made.
WINDOW_MAKERS: dict[NetworkName, WindowMaker] = {
    "fast": make_window,
    "paper": make_paper_window,
}
