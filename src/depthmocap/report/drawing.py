"""Pictures of views, point clouds and skeletons, as RGB arrays, and animations of them. Charts are in ``charts.py``."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, Integer, UInt8
from numpy import ndarray
from PIL import Image, ImageDraw, ImageFont

from depthmocap.body.regions import DISPLAY_COLOURS, REGION_COUNT
from depthmocap.body.skeleton import BONES, JOINT_INDEX
from depthmocap.core.output import atomic_write
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry import z_up_from
from depthmocap.text import harmless, shortened

#: The paper's colours (Fig. 7), lightened for a dark background.
TRUTH_COLOUR = (92, 160, 255)
ESTIMATE_COLOUR = (255, 84, 70)
_GROUND = (18, 20, 24)
_TEXT = (214, 218, 224)
_FLOOR = (64, 70, 78)
_UNLABELLED = (120, 120, 120)
#: Gap between the two sides of a cloud (pixels).
_GAP = 4
#: Margin above and below it (pixels).
_MARGIN = 22
#: Most points of a cloud that are drawn.
_POINTS_SHOWN = 15_000


@functools.cache
def _palette() -> UInt8[ndarray, "256 3"]:
    """Colours of labels 0–255; labels that are no region are grey."""
    palette = np.full((256, 3), _UNLABELLED, dtype=np.uint8)
    palette[: REGION_COUNT + 1] = DISPLAY_COLOURS
    return palette


def _lighten(colours: UInt8[ndarray, "*n 3"]) -> UInt8[ndarray, "*n 3"]:
    """Lighter colours, so that dark regions stay visible when they are shaded."""
    return (45 + colours * (210 / 255)).astype(np.uint8)


@functools.cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    import matplotlib  # here, because live capture shows pictures without text and shall start soon

    # matplotlib's font: the same everywhere, with more letters than ASCII.
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf", size)


def _write_texts(
    picture: UInt8[ndarray, "h w 3"],
    texts: Sequence[tuple[tuple[int, int], str, tuple[int, int, int]]],
    size: int = 15,
) -> UInt8[ndarray, "h w 3"]:
    """The picture with texts, each given by its top left corner (x, y), text and colour."""
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    for corner, text, colour in texts:
        draw.text(corner, text, fill=colour, font=_font(size))
    return np.array(image)


def _near_to_far(depth_m: Float[ndarray, "h w"], where: Bool[ndarray, "h w"]) -> Float[ndarray, "h w"]:
    """Depth scaled to 0 at the nearest and 1 at the farthest of the depths in ``where``, without outliers."""
    if not where.any():
        return np.zeros(depth_m.shape)
    near, far = np.percentile(depth_m[where], [1, 99])
    return np.clip((depth_m - near) / max(far - near, 1e-3), 0, 1)


def colour_labels(
    labels: UInt8[ndarray, "h w"], depth_m: Float[ndarray, "h w"] | None = None
) -> UInt8[ndarray, "h w 3"]:
    """Regions in their display colours; unlabelled pixels (255) are grey.

    With depth (m), farther parts of the person are darker, and the surroundings are dark grey.
    """
    picture = _palette()[labels]
    if depth_m is None:
        return picture
    person = labels > 0
    shade = 1 - 0.3 * _near_to_far(depth_m, person & (depth_m > 0))
    around = 60 - 35 * _near_to_far(depth_m, depth_m > 0)
    around = np.where(depth_m > 0, around, 0)[..., None]
    return np.where(person[..., None], _lighten(picture) * shade[..., None], around).astype(np.uint8)


def depth_picture(depth_m: Float[ndarray, "h w"], mask: Bool[ndarray, "h w"] | None = None) -> UInt8[ndarray, "h w 3"]:
    """Depth (m) in colour, red near and blue far; invalid pixels are black, and pixels outside the mask grey."""
    valid = depth_m > 0
    shown = valid if mask is None else valid & mask
    level = (255 * (0.95 - 0.85 * _near_to_far(depth_m, shown))).astype(np.uint8)
    turbo = cv2.applyColorMap(level, cv2.COLORMAP_TURBO)
    picture = np.where(shown[..., None], turbo[..., ::-1], 0)
    if mask is not None:
        around = np.where(valid & ~mask, 110 - 70 * _near_to_far(depth_m, valid), 0)
        picture = np.where(shown[..., None], picture, around[..., None])
    return picture.astype(np.uint8)


def _fit(picture: UInt8[ndarray, "h w 3"], width: int, height: int) -> UInt8[ndarray, "height width 3"]:
    """The picture scaled to fit and centred on the background colour."""
    scale = min(width / picture.shape[1], height / picture.shape[0])
    size = (max(round(picture.shape[1] * scale), 1), max(round(picture.shape[0] * scale), 1))
    scaled = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST)
    canvas = np.full((height, width, 3), _GROUND, dtype=np.uint8)
    left, top = (width - size[0]) // 2, (height - size[1]) // 2
    canvas[top : top + size[1], left : left + size[0]] = scaled
    return canvas


def _person_window(person: Bool[ndarray, "h w"]) -> tuple[slice, slice]:
    """Rows and columns of the person with a margin, in the image's proportions; the whole image without a person."""
    height, width = person.shape
    rows, columns = np.flatnonzero(person.any(1)), np.flatnonzero(person.any(0))
    if not len(rows):
        return slice(0, height), slice(0, width)
    tall, wide = rows[-1] - rows[0] + 1, columns[-1] - columns[0] + 1
    share = min(1.3 * max(tall / height, wide / width), 1.0)
    tall, wide = round(share * height), round(share * width)
    top = int(np.clip((rows[0] + rows[-1] - tall) // 2, 0, height - tall))
    left = int(np.clip((columns[0] + columns[-1] - wide) // 2, 0, width - wide))
    return slice(top, top + tall), slice(left, left + wide)


def labelled_depth_strip(
    views: Sequence[View], labels: Sequence[UInt8[ndarray, "_h _w"] | None], width: int = 320
) -> UInt8[ndarray, "h w 3"]:
    """A column for each camera, ``width`` pixels wide: its name, its depth, and its labels if any.

    Where a mask or labels show the person, the pictures are cropped to it.

    Raises:
        InputError: when there are no views, or the number of labels differs.
    """
    if not views or len(views) != len(labels):
        raise InputError(f"expected labels (or None) for each of at least one view, got {len(views)} and {len(labels)}")
    gap, line = 6, 26
    height = max(round(width * view.depth_m.shape[0] / view.depth_m.shape[1]) for view in views)
    rows = 1 if all(image is None for image in labels) else 2
    strip = np.full((line + rows * (height + gap), len(views) * (width + gap) - gap, 3), _GROUND, dtype=np.uint8)
    texts = []
    for i, (view, image) in enumerate(zip(views, labels, strict=True)):
        left = i * (width + gap)
        name = shortened(harmless(view.camera.name), max(width // 10, 4))
        texts.append(((left + 6, 4), name, _TEXT))
        pictures = [depth_picture(view.depth_m, view.mask)]
        if image is not None:
            pictures.append(colour_labels(image, view.depth_m))
        if view.mask is not None:
            person = view.mask
        else:
            person = np.zeros(view.depth_m.shape, bool) if image is None else image > 0
        window = _person_window(person)
        for row, picture in enumerate(pictures):
            top = line + row * (height + gap)
            strip[top : top + height, left : left + width] = _fit(picture[window], width, height)
    return _write_texts(strip, texts)


def _splat(
    canvas: UInt8[ndarray, "h w 3"],
    pixels: Float[ndarray, "n 2"],
    depth: Float[ndarray, " n"],
    colours: UInt8[ndarray, "n 3"],
    diameter: int,
) -> None:
    """Draw points as squares, near points (small depth) over far ones."""
    height, width = canvas.shape[:2]
    order = np.argsort(-depth, kind="stable")
    steps = np.arange(diameter) - (diameter - 1) // 2
    square = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    u, v = (np.rint(pixels[order]).astype(np.int64)[:, None] + square).reshape(-1, 2).T
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    flat = canvas.reshape(-1, 3)
    # The last value assigned to a pixel stays: the nearest point's.
    flat[v[inside] * width + u[inside]] = np.repeat(colours[order], len(square), axis=0)[inside]


def _draw_skeleton(
    canvas: UInt8[ndarray, "h w 3"], pixels: Float[ndarray, "18 2"], colour: tuple[int, int, int], thickness: int
) -> None:
    """Draw bones and joints, without those that are unobserved (NaN)."""
    shift = 4  # cv2's fractional bits: positions to a sixteenth of a pixel
    # Clipped far outside the canvas, to fit cv2's integers.
    fixed = [None if np.isnan(p).any() else tuple(int(x) for x in np.clip(p, -2000, 6000) * 2**shift) for p in pixels]
    for parent, child in BONES:
        a, b = fixed[JOINT_INDEX[parent]], fixed[JOINT_INDEX[child]]
        if a is not None and b is not None:
            cv2.line(canvas, a, b, colour, thickness, cv2.LINE_AA, shift)
    for centre in fixed:
        if centre is not None:
            cv2.circle(canvas, centre, (thickness + 1) * 2**shift, colour, -1, cv2.LINE_AA, shift)


def _bounds(points: Float[ndarray, "n 3"], joints: Sequence[Float[ndarray, "18 3"]]) -> Float[ndarray, "2 3"]:
    shown = np.concatenate([points, *joints])
    shown = shown[np.isfinite(shown).all(1)]
    if not len(shown):
        return np.array([[-1.0, -1, 0], [1, 1, 2]])
    corners = np.stack([shown.min(0), shown.max(0)])
    if len(points) > 100:
        # A few stray points must not make the person small.
        low, high = np.percentile(points, [0.5, 99.5], axis=0)
        body = np.stack([low, high])
        people = np.concatenate([body, *joints])
        corners = np.stack([np.nanmin(people, 0), np.nanmax(people, 0)])
    corners[0, 2] = min(corners[0, 2], 0.0) if corners[0, 2] < 0.5 else corners[0, 2]
    return corners + 0.12 * np.array([[-1.0], [1.0]])


def cloud_picture(
    points_world: Float[ndarray, "n 3"],
    labels: Integer[ndarray, " n"] | None = None,
    joints: Float[ndarray, "18 3"] | None = None,
    true_joints: Float[ndarray, "18 3"] | None = None,
    up: str = "z",
    *,
    size: tuple[int, int] = (640, 420),
    bounds_m: Float[ndarray, "2 3"] | None = None,
) -> UInt8[ndarray, "h w 3"]:
    """The labelled cloud (m) from two sides at right angles, with the true skeleton in blue and the estimate in red.

    The left half looks along +y of the Z-up world with x to the right, the right half along -x with y to the right,
    both without perspective.

    Args:
        size: width and height in pixels.
        bounds_m: lower and upper corner of the volume shown, in the Z-up world, to have all frames of an animation at
            one scale; by default it fits the person.
    """
    world = z_up_from(up).T
    points = points_world.astype(np.float64) @ world
    skeletons = [
        (skeleton.astype(np.float64) @ world, colour)
        for skeleton, colour in ((true_joints, TRUTH_COLOUR), (joints, ESTIMATE_COLOUR))
        if skeleton is not None
    ]
    finite = np.isfinite(points).all(1)
    points = points[finite]
    bounds = _bounds(points, [skeleton for skeleton, _ in skeletons]) if bounds_m is None else bounds_m
    if labels is None:
        colours = np.full((len(points), 3), 190, dtype=np.uint8)
    else:
        colours = _lighten(_palette()[np.clip(labels[finite], 0, 255)])
    step = -(-len(points) // _POINTS_SHOWN) or 1
    points, colours = points[::step], colours[::step]

    width, height = size
    panel_width = (width - _GAP) // 2
    extent = np.maximum(bounds[1] - bounds[0], 0.1)
    # One scale for both panels, so that a length is the same in both.
    scale = min((height - 2 * _MARGIN) / extent[2], (panel_width - 8) / max(extent[0], extent[1]))
    # Points touch each other when the person fills the panel.
    diameter = int(np.clip(round(scale * extent[2] / 110), 1, 4))
    picture = np.full((height, width, 3), _GROUND, dtype=np.uint8)
    for left, axis in ((0, 0), (width - panel_width, 1)):
        canvas = picture[:, left : left + panel_width]
        canvas[:] = _panel(points, colours, skeletons, axis, bounds.mean(0), scale, diameter, (panel_width, height))
    texts: list[tuple[tuple[int, int], str, tuple[int, int, int]]] = [
        ((8, 4), "front", _TEXT),
        ((width - panel_width + 8, 4), "side", _TEXT),
    ]
    names = {TRUTH_COLOUR: "truth", ESTIMATE_COLOUR: "estimate"}
    right = width - 8
    for _, colour in skeletons[::-1]:
        right -= round(_font(13).getlength(names[colour])) + 14
        texts.append(((right, 5), names[colour], colour))
    return _write_texts(picture, texts, 13)


def _panel(
    points: Float[ndarray, "n 3"],
    colours: UInt8[ndarray, "n 3"],
    skeletons: Sequence[tuple[Float[ndarray, "18 3"], tuple[int, int, int]]],
    axis: int,
    centre: Float[ndarray, "3"],
    scale: float,
    diameter: int,
    size: tuple[int, int],
) -> UInt8[ndarray, "h w 3"]:
    """The cloud and skeletons from one side, with ``axis`` (0: x, 1: y) to the right.

    Args:
        centre: the point (m) in the middle of the panel.
        scale: pixels per metre.
        diameter: of a point (pixels).
        size: width and height in pixels.
    """
    width, height = size

    def project(xyz: Float[ndarray, "k 3"]) -> Float[ndarray, "k 2"]:
        u = width / 2 + (xyz[:, axis] - centre[axis]) * scale
        return np.stack([u, height / 2 - (xyz[:, 2] - centre[2]) * scale], -1)

    canvas = np.full((height, width, 3), _GROUND, dtype=np.uint8)
    floor = round(height / 2 + centre[2] * scale)
    if 0 <= floor < height:
        canvas[floor : floor + 1] = _FLOOR
    depth = points[:, 1] if axis == 0 else -points[:, 0]
    if len(points):
        shade = 1 - 0.3 * np.clip((depth - depth.min()) / max(np.ptp(depth), 1e-3), 0, 1)
        shaded = (colours * shade[:, None]).astype(np.uint8)
        _splat(canvas, project(points), depth, shaded, diameter)
    for skeleton, colour in skeletons:
        _draw_skeleton(canvas, project(skeleton), colour, 2)
    return canvas


def animation(frames: Sequence[UInt8[ndarray, "h w 3"]], fps: float | int, path: Path) -> None:
    """Write frames as an endless animated WebP: all current browsers show it, and it has a tenth of a GIF's size.

    Raises:
        InputError: when there are no frames, their sizes differ, or the file cannot be written.
    """
    if not frames:
        raise InputError("an animation needs at least one frame")
    if fps <= 0:
        raise InputError(f"frames per second must be positive, got {fps}")
    if len({frame.shape for frame in frames}) > 1:
        raise InputError(f"all frames of an animation must be of one size, got {sorted({f.shape for f in frames})}")
    first, *rest = [Image.fromarray(frame) for frame in frames]
    with atomic_write(path) as unfinished:
        first.save(
            unfinished, "WEBP", save_all=True, append_images=rest, duration=round(1000 / fps), loop=0, quality=70,
            method=4,
        )  # fmt: skip
