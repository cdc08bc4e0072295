"""The network's windows for batches on a GPU (extra: train): from pictures, or drawn at once at their own size."""

from __future__ import annotations

import dataclasses

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from depthmocap.body.regions import UNLABELLED
from depthmocap.classify.preprocess import (
    DEPTH_SCALE_M,
    MIN_PIXELS,
    NEAR_M,
    NEAR_PER_M,
    NEIGHBOURS,
    PERSON,
    PIXEL_M,
    WINDOW,
)
from depthmocap.synth.gpu.torch_raster import project
from depthmocap.synth.gpu.torch_render import TorchCameras, TorchLayers, TorchRendering, render_people
from depthmocap.synth.render import NEAR_M as NEAR_PLANE_M


@dataclasses.dataclass(frozen=True, eq=False)
class TorchWindows:
    """Windows of a batch, as ``classify.preprocess.Window``; those of pictures that hold nobody are zero.

    Attributes:
        inputs: relative depth, mask, log2 of the pixel size.
        left, top, step: where the windows lie in their pictures.
        found: whether a picture holds a person.
    """

    inputs: Float[Tensor, "b 3 s s"]
    left: Float[Tensor, "b"]
    top: Float[Tensor, "b"]
    step: Float[Tensor, "b"]
    found: Bool[Tensor, "b"]

    def labels_from_images(self, labels: UInt8[Tensor, "b h w"], fill: int = 0) -> UInt8[Tensor, "b s s"]:
        """Labels of the pictures in the windows, ``fill`` beyond their borders and where nobody was found."""
        place, within = self._places(*labels.shape[1:])
        values = labels.flatten(1).gather(1, place.flatten(1)).view_as(place)
        return torch.where(within & self.found[:, None, None], values, fill).to(torch.uint8)

    def _places(self, height: int, width: int) -> tuple[Tensor, Tensor]:
        return _places(self.left, self.top, self.step, self.inputs.shape[-1], height, width)


def _places(left: Tensor, top: Tensor, step: Tensor, side: int, height: int, width: int) -> tuple[Tensor, Tensor]:
    """Flat index into the picture of every window pixel (b, s, s), and whether it lies within the picture.

    Window pixel (i, j) reads the picture at ``(top + (i + 0.5)·step, left + (j + 0.5)·step)``, rounded down.
    """
    middle = torch.arange(side, device=left.device, dtype=torch.float64) + 0.5
    x = (left[:, None] + middle * step[:, None]).floor().long()
    y = (top[:, None] + middle * step[:, None]).floor().long()
    within = ((y >= 0) & (y < height))[:, :, None] & ((x >= 0) & (x < width))[:, None, :]
    return y.clamp(0, height - 1)[:, :, None] * width + x.clamp(0, width - 1)[:, None, :], within


def make_windows(
    depth_m: Float[Tensor, "b h w"],
    mask: Bool[Tensor, "b h w"],
    fx: Float[Tensor, "b"],
    window: int = WINDOW,
    person: int = PERSON,
) -> TorchWindows:
    """What ``classify.preprocess.make_window`` makes of every picture.

    Args:
        depth_m: metres along z.
        mask: the people's pixels; those without depth, and stray ones beside no surface, are left out.
        fx: focal lengths (pixels).
        window, person: side of the window and of the person's box in it (the paper: 250 and 190 pixels).
    """
    solid = _supported(depth_m, mask & (depth_m > 0))
    top, bottom = _extent(solid.any(2))
    left, right = _extent(solid.any(1))
    found = solid.flatten(1).sum(1) >= MIN_PIXELS
    centre_m = _median(depth_m.flatten(1), solid.flatten(1))
    step = torch.maximum(bottom - top, right - left).double().clamp(min=1) / person
    x0, y0 = (left + right) / 2 - window / 2 * step, (top + bottom) / 2 - window / 2 * step
    place, within = _places(x0, y0, step, window, *depth_m.shape[1:])
    shown = within & solid.flatten(1).gather(1, place.flatten(1)).view_as(place) & found[:, None, None]
    depth = depth_m.flatten(1).gather(1, place.flatten(1)).view_as(place)
    relative = ((depth - centre_m[:, None, None]) / DEPTH_SCALE_M).clamp(-2, 2)
    scale = torch.where(found, torch.log2(centre_m * step / fx / PIXEL_M), 0.0).float()
    inputs = torch.stack(
        [torch.where(shown, relative, 0.0), shown.float(), scale[:, None, None].expand_as(relative)], 1
    )
    return TorchWindows(inputs, x0, y0, step, found)


def _supported(depth: Tensor, mask: Tensor) -> Tensor:
    """Masked pixels with enough masked neighbours near them in depth (see ``kernels.window.supported``)."""
    nowhere = torch.where(mask, depth, torch.nan)  # a comparison with NaN is false
    padded = torch.nn.functional.pad(nowhere, (1, 1, 1, 1), value=torch.nan)
    height, width = depth.shape[1:]
    tolerance = NEAR_M + NEAR_PER_M * nowhere
    count = torch.zeros(depth.shape, dtype=torch.uint8, device=depth.device)
    for v in range(3):
        for u in range(3):
            if (v, u) != (1, 1):
                count += (padded[:, v : v + height, u : u + width] - nowhere).abs() < tolerance
    return count >= NEIGHBOURS


def _extent(line: Tensor) -> tuple[Tensor, Tensor]:
    """First true index of every row (b, n), and one past the last; both 0 where none is true."""
    index = torch.arange(line.shape[1], device=line.device)
    some = line.any(1)
    first = torch.where(line, index, line.shape[1]).amin(1)
    return torch.where(some, first, 0), torch.where(line, index + 1, 0).amax(1)


def _median(values: Tensor, chosen: Tensor) -> Tensor:
    """Median of the chosen values ≥ 0 of every row (b, n); of an even number the mean of the middle two.

    Bits of positive floats are in the order of the floats: 31 halvings of their range find a rank exactly, which is
    cheaper than to sort.
    """
    bits = torch.where(chosen, values, torch.inf).view(torch.int32)
    count = chosen.sum(1, keepdim=True)
    low, high = torch.zeros_like(count), torch.full_like(count, 0x7F800000)
    for _ in range(31):  # the least number that so many do not exceed lies in low..high
        middle = (low + high) // 2
        enough = (bits <= middle).sum(1, keepdim=True) >= (count + 1) // 2
        low, high = torch.where(enough, low, middle + 1), torch.where(enough, middle, high)
    lower = high.int()
    above = torch.where(bits > lower, bits, 0x7F800000).amin(1, keepdim=True)
    upper = torch.where((bits <= lower).sum(1, keepdim=True) > count // 2, lower, above)
    return ((lower.view(torch.float32) + upper.view(torch.float32)) / 2)[:, 0]


@dataclasses.dataclass(frozen=True, eq=False)
class WindowView:
    """A view drawn around the person alone, before normalisation: square pictures at most as fine as the sensor's.

    Attributes:
        rendering: what is seen, nothing beyond the sensor's borders.
        left, top, step: where the pictures lie in the sensor's, and the size of their pixels in its.
        fx: focal lengths (pixels of these pictures).
    """

    rendering: TorchRendering
    left: Float[Tensor, "b"]
    top: Float[Tensor, "b"]
    step: Float[Tensor, "b"]
    fx: Float[Tensor, "b"]

    def windows(
        self, depth_m: Float[Tensor, "b s s"], mask: Bool[Tensor, "b s s"], fill: int = UNLABELLED, person: int = PERSON
    ) -> tuple[TorchWindows, UInt8[Tensor, "b s s"]]:
        """Windows of a depth and mask made from this view (by noise, say), placed in the sensor's pictures, and their
        labels: ``fill`` where the person has none and around it."""
        found = make_windows(depth_m, mask, self.fx, depth_m.shape[-1], person)
        labels = self.rendering.labels
        labels = found.labels_from_images(torch.where(labels > 0, labels, fill).to(torch.uint8), fill)
        left, top = self.left + found.left * self.step, self.top + found.top * self.step
        return dataclasses.replace(found, left=left, top=top, step=found.step * self.step), labels


def view_windows(
    vertices: Float[Tensor, "b v 3"],
    faces: Int[Tensor, "f 3"],
    face_regions: UInt8[Tensor, "f"],
    cameras: TorchCameras,
    sizes: Int[Tensor, "b 2"],
    layers: TorchLayers | None = None,
    window: int = WINDOW,
    person: int = PERSON,
) -> WindowView:
    """Draw only what the windows need. A person that fits a window is drawn at the sensor's own pixels; a larger one
    at the window's, each of which then sees its exact middle instead of the sensor's pixel there.

    Args:
        sizes: width and height of the sensors' pictures (pixels).
    """
    left, right, top, bottom = _boxes(vertices, cameras, sizes, layers)
    size = torch.maximum(right - left, bottom - top).double()
    step = (size / person).clamp(min=1)
    x0, y0 = (left + right) / 2 - window / 2 * step, (top + bottom) / 2 - window / 2 * step
    # Pixels of size 1 are the sensor's own.
    x0, y0 = (torch.where(step > 1, start, start.floor()) for start in (x0, y0))
    crop = cameras.cropped(x0, y0, step)
    seen = render_people(vertices, faces, face_regions, crop, window, window, layers)
    middle = torch.arange(window, device=step.device, dtype=torch.float64) + 0.5
    x, y = ((start[:, None] + middle * step[:, None]).floor() for start in (x0, y0))
    columns, rows = (x >= 0) & (x < sizes[:, :1]), (y >= 0) & (y < sizes[:, 1:])
    within = rows[:, :, None] & columns[:, None, :]
    rendering = TorchRendering(seen.depth_m * within, seen.labels * within, seen.material * within)
    return WindowView(rendering, x0, y0, step, crop.intrinsics[:, 0])


def _boxes(
    vertices: Tensor, cameras: TorchCameras, sizes: Tensor, layers: TorchLayers | None
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The people's boxes on the sensors' pictures: first columns and rows, and one past the last."""
    points = project(cameras.points(vertices), cameras.intrinsics[:, None], NEAR_PLANE_M)
    infinite = torch.where(points[..., 2:] > 0, points[..., :2], torch.inf)
    low = infinite.amin(1)
    high = torch.where(infinite.isinf(), -torch.inf, infinite).amax(1)
    if layers is not None and len(layers.vertices):
        picture = layers.picture_of_vertex
        worn = project(cameras.packed_points(layers.vertices, picture), cameras.intrinsics[picture], NEAR_PLANE_M)
        index, ahead = picture[:, None].expand(-1, 2), worn[:, 2:] > 0
        low = low.scatter_reduce(0, index, torch.where(ahead, worn[:, :2], torch.inf), "amin")
        high = high.scatter_reduce(0, index, torch.where(ahead, worn[:, :2], -torch.inf), "amax")
    zero = torch.zeros_like(low)
    low = torch.minimum(low.ceil().maximum(zero), sizes.float())
    high = torch.maximum((high.floor() + 1).minimum(sizes.float()), low)
    return low[:, 0], high[:, 0], low[:, 1], high[:, 1]
