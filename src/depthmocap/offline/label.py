"""``depthmocap label``: the body parts of one depth image."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import cv2
import numpy as np
import tyro
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from depthmocap.classify.classifier import Classifier
from depthmocap.core.locks import locks_outputs
from depthmocap.core.network_devices import NetworkSettings, networks_on
from depthmocap.core.output import check_outputs, write_file
from depthmocap.core.reading.image_files import read_picture
from depthmocap.core.settings import check_above_0
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry.depth_camera import DepthCamera

#: Focal length as a share of the width where none is given: a horizontal field of view of 70°, as Kinect 2's.
_FOCAL_SHARE = 0.715


@dataclasses.dataclass(frozen=True)
class LabelSettings(NetworkSettings):
    """Label one depth image.

    Attributes:
        depth: 16-bit grey PNG, or UBC3V's RGBA depth PNG with --ubc3v.
        out: 8-bit PNG of region indices 0–43, 0 is background, of the input's size.
        fx: focal length and principal point in pixels; a field of view of 70° is assumed where they are missing.
        depth_unit: metres of one depth unit.
        mask: image whose non-zero pixels are the person; without it every valid pixel is.
        preview: also write a coloured picture: under the name given, or beside the labels as NAME_preview.png.
        ubc3v: read UBC3V's 8-bit RGBA depth with its alpha as the mask.
        weights: a classifier.onnx of your own.
    """

    depth: tyro.conf.Positional[Path]
    out: Path
    fx: float | None = None
    fy: float | None = None
    cx: float | None = None
    cy: float | None = None
    depth_unit: float = 0.001
    mask: Path | None = None
    preview: tuple[Path, ...] | None = None
    ubc3v: bool = False
    weights: Path | None = None


def _preview_path(settings: LabelSettings) -> Path | None:
    if settings.preview is None:
        return None
    return settings.preview[0] if settings.preview else settings.out.with_stem(settings.out.stem + "_preview")


def _check(settings: LabelSettings) -> None:
    check_above_0({"--fx": settings.fx, "--fy": settings.fy, "--depth-unit": settings.depth_unit})
    for option, value in (("--cx", settings.cx), ("--cy", settings.cy)):
        if value is not None and not math.isfinite(value):
            raise InputError(f"{option} must be finite, got {value}")
    if settings.out.suffix.lower() != ".png":  # others lose what the labels are
        raise InputError(f"--out must end in .png, got {settings.out}")
    check_outputs(
        {"--out": settings.out, "--preview": _preview_path(settings)},
        {"the depth image": settings.depth, "the mask": settings.mask},
    )


def _read_depth(settings: LabelSettings) -> tuple[Float[ndarray, "h w"], Bool[ndarray, "h w"]]:
    image = read_picture(settings.depth)
    if settings.ubc3v:
        from depthmocap.datasets.ubc3v import decode_depth

        if image.ndim != 3 or image.shape[2] != 4 or image.dtype != np.uint8:
            raise InputError(f"{settings.depth}: --ubc3v needs an 8-bit RGBA picture, got shape {image.shape}")
        return decode_depth(image)
    if image.ndim != 2 or image.dtype not in (np.uint16, np.int32):
        raise InputError(
            f"{settings.depth}: depth must be a 16-bit grey PNG, got {image.dtype} of shape {image.shape}; "
            "UBC3V's RGBA pictures need --ubc3v"
        )
    depth = np.where(image >= 65535, 0, image).astype(np.float32) * np.float32(settings.depth_unit)
    return depth, depth > 0


def _camera(settings: LabelSettings, shape: tuple[int, ...]) -> DepthCamera:
    height, width = shape
    if settings.ubc3v and settings.fx is None:
        from depthmocap.datasets.ubc3v import KINECT2

        return KINECT2
    fx = settings.fx or settings.fy or _FOCAL_SHARE * width
    cx = settings.cx if settings.cx is not None else (width - 1) / 2
    cy = settings.cy if settings.cy is not None else (height - 1) / 2
    return DepthCamera("camera", width, height, fx, settings.fy or fx, cx, cy)


@locks_outputs(files=("out",))
def label_image(settings: LabelSettings) -> UInt8[ndarray, "h w"]:
    """Label the image and write the results; returns the labels.

    Raises:
        InputError: unreadable or unsuitable images, values out of range, results that would take the place of an
            input or of each other, or nobody in the picture.
    """
    _check(settings)
    depth, person = _read_depth(settings)
    if settings.mask is not None:
        mask = read_picture(settings.mask)
        mask = mask if mask.ndim == 2 else mask[..., 3] if mask.shape[2] == 4 else mask.max(2)
        if mask.shape != depth.shape:
            raise InputError(f"{settings.mask} is {mask.shape}, but the depth image is {depth.shape} (height, width)")
        person = person & (mask > 0)
    with networks_on(settings.device):
        classifier = Classifier(settings.weights)
    view = View(_camera(settings, depth.shape), depth)
    ((labels, *_),) = classifier.label_views([view], [person])
    if not labels.any():
        raise InputError(
            f"{settings.depth}: no person found; {np.count_nonzero(person)} pixels have valid depth: where they show "
            "more than a person, give the person's with --mask"
        )
    _write(settings.out, labels)
    if (preview := _preview_path(settings)) is not None:
        from depthmocap.report.drawing import colour_labels

        _write(preview, np.ascontiguousarray(colour_labels(labels, depth)[..., ::-1]))
    return labels


def _write(path: Path, image: ndarray) -> None:
    # Encoded in memory because OpenCV cannot open a path with non-ASCII letters on Windows.
    try:
        encoded, data = cv2.imencode(path.suffix, image)
    except cv2.error:
        encoded, data = False, None
    if not encoded or data is None:
        raise InputError(f"cannot write {path}: use a name that ends in .png")
    write_file(path, data.tobytes())
