"""From a masked depth image to the network's square window, and from the window's labels back.

As in the paper (Sec. IV-A) the person's bounding box is scaled to a fixed size and the depth shifted to a fixed mean.
The window is tighter (180 of 192 pixels instead of 190 of 250: the same person, fewer empty pixels), depth stays in
metres around the person's median instead of 8-bit levels, and the scale of a pixel is told to the network.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from depthmocap.geometry.cameras import DepthCamera
from depthmocap.kernels.window import gather, gather_labels, scatter, supported

#: Side of the window, and of the person's bounding box in it (pixels).
WINDOW, PERSON = 192, 180
#: Relative depth is divided by this (metres) and clipped to ±2.
DEPTH_SCALE_M = 0.5
#: A typical size of a window pixel on the person (metres), the origin of the third channel.
PIXEL_M = 0.01
#: A pixel belongs to a surface if so many of its neighbours are within this of it; others fly at a silhouette, and a
#: few of them, far from the body, would confuse the network about all of it.
NEIGHBOURS, NEAR_M, NEAR_PER_M = 2, 0.03, 0.01
#: Masks with fewer pixels than this hold no person.
MIN_PIXELS = 40


@dataclasses.dataclass(frozen=True, eq=False)
class Window:
    """``inputs`` (3, 192, 192): relative depth, mask, log2 of the pixel size; and where the window lies."""

    inputs: Float[ndarray, "3 s s"]
    left: float
    top: float
    step: float

    def labels_from_image(self, labels: UInt8[ndarray, "h w"], fill: int = 0) -> UInt8[ndarray, "s s"]:
        """Labels of the picture in the window."""
        out = np.full(self.inputs.shape[1:], fill, dtype=np.uint8)
        gather_labels(labels, self.left, self.top, self.step, out)
        return out

    def labels_to_image(
        self, labels: UInt8[ndarray, "s s"], confidence: Float[ndarray, "s s"], mask: Bool[ndarray, "h w"]
    ) -> tuple[UInt8[ndarray, "h w"], Float[ndarray, "h w"]]:
        """Labels and confidences of the window at the picture's masked pixels, 0 elsewhere."""
        out_labels = np.zeros(mask.shape, dtype=np.uint8)
        out_confidence = np.zeros(mask.shape, dtype=np.float32)
        scatter(labels, confidence, mask, self.left, self.top, self.step, out_labels, out_confidence)
        return out_labels, out_confidence


def make_window(depth_m: Float[ndarray, "h w"], mask: Bool[ndarray, "h w"], camera: DepthCamera) -> Window | None:
    """The person's window, or None where the mask holds nobody.

    Args:
        depth_m: metres along z.
        mask: the person's pixels; those without depth, and stray ones beside no surface, are left out.
    """
    mask = mask & (depth_m > 0)
    rows = np.flatnonzero(mask.any(1))
    if not len(rows):
        return None
    columns = np.flatnonzero(mask.any(0))
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    solid = np.zeros_like(mask)
    supported(depth_m[box], mask[box], NEAR_M, NEAR_PER_M, NEIGHBOURS, solid[box])
    rows, columns = np.flatnonzero(solid.any(1)), np.flatnonzero(solid.any(0))
    depths = depth_m[solid]
    if len(depths) < MIN_PIXELS:
        return None
    top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
    centre_m = float(np.median(depths))
    step = max(bottom - top, right - left) / PERSON
    x0 = (left + right) / 2 - WINDOW / 2 * step
    y0 = (top + bottom) / 2 - WINDOW / 2 * step
    inputs = np.zeros((3, WINDOW, WINDOW), dtype=np.float32)
    gather(depth_m, solid, x0, y0, step, centre_m, DEPTH_SCALE_M, inputs)
    inputs[2] = np.log2(centre_m * step / camera.fx / PIXEL_M)
    return Window(inputs, float(x0), float(y0), float(step))
