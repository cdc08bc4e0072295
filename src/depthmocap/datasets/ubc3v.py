"""Reader of UBC3V (Shafaei & Little 2016, section 4): synthetic people in front of three Kinect 2.

A section is a folder ``<root>/<subset>/<split>/<number>`` of up to 1001 frames::

    groundtruth.mat                                         joints and camera poses, cm, Y up
    images/depthRender/Cam1/mayaProject.000001.png          RGBA 512×424, depth in R
    images/groundtruth/Cam1/mayaProject.000001.png          RGBA 512×424, region by colour

Everything returned is in this project's conventions: metres, a Z-up world, cameras x right, y down, z forward.
"""

from __future__ import annotations

import dataclasses
import logging
import operator
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Num, UInt8
from numpy import ndarray

from depthmocap.body.regions import REGION_COUNT, UBC3V_COLOURS, UNLABELLED
from depthmocap.body.skeleton import JOINTS
from depthmocap.core.reading.image_files import read_picture
from depthmocap.core.reading.matlab_files import read_mat
from depthmocap.datasets.ubc3v_camera import KINECT2, camera_pose, kinect2_camera, load_ray_table, maya_angles
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, FrameSource, View
from depthmocap.geometry.transforms import z_up_from

_LOG = logging.getLogger(__name__)

__all__ = [
    "CAMERAS",
    "DEPTH_SCALE",
    "FAR_CM",
    "FRAMES_PER_SECOND",
    "FRAMES_PER_SECTION",
    "KINECT2",
    "MAYA_JOINTS",
    "NEAR_CM",
    "SPLITS",
    "SUBSETS",
    "UNLABELLED",
    "GroundTruth",
    "Section",
    "camera_pose",
    "decode_depth",
    "decode_labels",
    "encode_depth",
    "encode_labels",
    "image_paths",
    "iterate",
    "kinect2_camera",
    "maya_angles",
    "read_ground_truth",
    "sections",
]

SUBSETS = ("easy-pose", "inter-pose", "hard-pose")
SPLITS = ("train", "valid", "test")
CAMERAS = ("Cam1", "Cam2", "Cam3")
FRAMES_PER_SECTION = 1001
FRAMES_PER_SECOND = 30

NEAR_CM, FAR_CM = 50.0, 800.0
#: Scale of the stored depth, from the authors' toolkit.
DEPTH_SCALE = 1.03
#: The Maya joint that holds each target joint. ``XPGX`` is the frame of X's parent, hence the shifted names.
MAYA_JOINTS: dict[str, str] = {
    "Head": "HeadPGX", "Neck": "Neck1PGX", "Spine2": "RightShoulderPGX", "Spine1": "Spine1PGX", "Spine": "SpinePGX",
    "Hip": "RightUpLegPGX",
    "RHip": "RightLegPGX", "RKnee": "RightFootPGX", "RFoot": "RightToeBasePGX",
    "LHip": "LeftLegPGX", "LKnee": "LeftFootPGX", "LFoot": "LeftToeBasePGX",
    "RShoulder": "RightForeArmPGX", "RElbow": "RightHandPGX", "RHand": "RightFingerBasePGX",
    "LShoulder": "LeftForeArmPGX", "LElbow": "LeftHandPGX", "LHand": "LeftFingerBasePGX",
}  # fmt: skip

_COLOUR_TOLERANCE = 2
_LAYOUT = "ROOT/<subset>/<split>/<section number>/groundtruth.mat"


def decode_depth(
    rgba: UInt8[ndarray, "h w 4"], scale: float = DEPTH_SCALE
) -> tuple[Float[ndarray, "h w"], Bool[ndarray, "h w"]]:
    """Depth (float32 metres, 0 outside the mask) and the person's mask of a ``depthRender`` image.

    Only R counts: G and B are dithered. Silhouettes are antialiased, so a partial alpha is not the person.
    """
    mask = rgba[..., 3] == 255
    levels = np.arange(256) / 255 * (FAR_CM - NEAR_CM) + NEAR_CM
    depth_m = (levels * scale / 100).astype(np.float32)[rgba[..., 0]]
    return np.where(mask, depth_m, np.float32(0)), mask


def encode_depth(
    depth_m: Float[ndarray, "h w"], mask: Bool[ndarray, "h w"], scale: float = DEPTH_SCALE
) -> UInt8[ndarray, "h w 4"]:
    """Inverse of :func:`decode_depth`, to the nearest of 255 steps of ``750 / 255 * scale`` cm.

    Depth outside 50–800 cm (times ``scale``) is clipped. Masked pixels without depth get alpha 0.
    """
    valid = mask & (depth_m > 0)
    levels = (np.where(valid, depth_m, 1).astype(np.float64) * 100 / scale - NEAR_CM) / (FAR_CM - NEAR_CM) * 255
    rgba = np.zeros((*depth_m.shape, 4), np.uint8)
    rgba[..., :3] = np.where(valid, np.clip(np.rint(levels), 0, 255), 0)[..., None]
    rgba[..., 3] = valid * np.uint8(255)
    return rgba


def _region_bits() -> ndarray:
    """For each channel and value, a bit set of the regions with a fitting colour."""
    bits = np.zeros((3, 256), np.uint64)
    for region in range(1, REGION_COUNT + 1):
        for channel, value in enumerate(UBC3V_COLOURS[region].astype(int)):
            fits = slice(max(value - _COLOUR_TOLERANCE, 0), value + _COLOUR_TOLERANCE + 1)
            bits[channel, fits] |= np.uint64(1 << (region - 1))
    return bits


def _label_colours() -> ndarray:
    """RGBA of every label; rows of impossible labels stay 0."""
    colours = np.zeros((256, 4), np.uint8)
    colours[1 : REGION_COUNT + 1, :3] = UBC3V_COLOURS[1:]
    colours[1 : REGION_COUNT + 1, 3] = 255
    colours[UNLABELLED] = (128, 128, 128, 255)  # fits no region
    return colours


_REGION_BITS = _region_bits()
_LABEL_COLOURS = _label_colours()


def decode_labels(rgba: UInt8[ndarray, "h w 4"]) -> UInt8[ndarray, "h w"]:
    """Regions 1–43 of a ``groundtruth`` image, 0 for background, 255 (``UNLABELLED``) for other person pixels.

    A colour fits a region within ±2 per channel; no two regions are that close.
    """
    mask = rgba[..., 3] == 255
    red, green, blue, _ = rgba[mask].T
    bits = _REGION_BITS[0][red] & _REGION_BITS[1][green] & _REGION_BITS[2][blue]
    _, region = np.frexp(bits.astype(np.float64))  # one bit at most: the exponent of 2**(region - 1) is the region
    labels = np.zeros(mask.shape, np.uint8)
    labels[mask] = np.where(bits == 0, UNLABELLED, region)
    return labels


def encode_labels(labels: UInt8[ndarray, "h w"]) -> UInt8[ndarray, "h w 4"]:
    """Inverse of :func:`decode_labels`.

    Raises:
        ValueError: for a label that is neither 0–43 nor 255.
    """
    if ((labels > REGION_COUNT) & (labels != UNLABELLED)).any():
        raise ValueError(f"labels must be 0 to {REGION_COUNT}, or {UNLABELLED} for unlabelled person pixels")
    return _LABEL_COLOURS[labels]


def _load_mat(path: Path, **options: Any) -> dict[str, Any]:
    return read_mat(path, f"expected {_LAYOUT}", squeeze_me=True, **options)


@dataclasses.dataclass(frozen=True, eq=False)
class GroundTruth:
    """A ``groundtruth.mat`` in its own units: cm, degrees, Y up. ``cameras`` holds translate and rotate."""

    joints_cm: Float[ndarray, "n 18 3"]
    cameras: dict[str, Float[ndarray, "n 2 3"]]


def _vector(path: Path, owner: Any, name: str, where: str, size: int) -> Num[ndarray, " n"]:
    """A numeric field of a MATLAB struct, in MATLAB's own linear order."""
    if not hasattr(owner, name):
        raise InputError(f"{path}: {where} has no field {name}; is it a groundtruth.mat of UBC3V?")
    try:
        value = np.asarray(getattr(owner, name), np.float64).ravel(order="F")
    except (TypeError, ValueError):
        raise InputError(f"{path}: {where}.{name} is not numeric") from None
    if value.size != size:
        raise InputError(f"{path}: {where}.{name} must hold {size} numbers, got {value.size}")
    return value


def _cells(value: Any) -> ndarray:
    """A cell array as an object array; scipy's squeeze strips the array from a single cell."""
    return np.atleast_1d(np.asarray(value, dtype=object)).ravel()


def read_ground_truth(path: Path) -> GroundTruth:
    """Read a ``groundtruth.mat``.

    Raises:
        InputError: when it is missing, damaged, or lacks an expected field.
    """
    mat = _load_mat(path, struct_as_record=False)
    if absent := [name for name in ("joints", "cameras") if name not in mat]:
        raise InputError(f"{path} has no variable {' and no '.join(absent)}; is it a groundtruth.mat of UBC3V?")
    joints = [
        # The last column of a flattened 4×4 matrix.
        [_vector(path, frame, MAYA_JOINTS[joint], f"joints{{{i}}}", 16)[12:15] for joint in JOINTS]
        for i, frame in enumerate(_cells(mat["joints"]), 1)
    ]
    cameras = {}
    for name in getattr(mat["cameras"], "_fieldnames", []):
        camera = getattr(mat["cameras"], name)
        if not hasattr(camera, "frames"):
            raise InputError(f"{path}: cameras.{name} has no field frames; is it a groundtruth.mat of UBC3V?")
        frames = [
            [_vector(path, frame, field, f"cameras.{name}.frames{{{i}}}", 3) for field in ("translate", "rotate")]
            for i, frame in enumerate(_cells(camera.frames), 1)
        ]
        if len(frames) != len(joints):
            raise InputError(f"{path}: {len(joints)} joints but {len(frames)} frames of cameras.{name}")
        cameras[name] = np.array(frames).reshape(-1, 2, 3)
    return GroundTruth(np.array(joints).reshape(-1, len(JOINTS), 3), cameras)


def _read_png(path: Path) -> UInt8[ndarray, "h w 4"]:
    return read_picture(path, "RGBA", (KINECT2.width, KINECT2.height))


class Section(FrameSource):
    """One section; images are read when a frame is asked for.

    A view is absent where its depth image is missing, one of its images is damaged (a line in ``problems``), or the
    file gives it no (finite) pose. Its mask is the alpha
    of the groundtruth image, or of the depth image where there is no groundtruth image; ``labels`` are then None.

    Args:
        path: the section's folder.
        cameras: the cameras to read.
        ray_table: the toolkit's ``mapper.mat``; without it, rays are those of a pinhole fitted to that table.

    Raises:
        InputError: when groundtruth.mat is missing or malformed, or there are no images.
    """

    up: str = "z"
    continuous = False

    def __init__(self, path: Path, cameras: Sequence[str] = CAMERAS, ray_table: Path | None = None) -> None:
        self.path = Path(path)
        self.cameras = tuple(cameras)
        self._problems: dict[str, None] = {}  # an ordered set: reading a frame twice reports it once
        self._truth = read_ground_truth(self.path / "groundtruth.mat")
        if not any(name in self._truth.cameras for name in self.cameras):
            raise InputError(
                f"{self.path / 'groundtruth.mat'} has no camera {', '.join(self.cameras)}; "
                f"it has {', '.join(self._truth.cameras) or 'none'}"
            )
        folder = self.path / "images" / "depthRender"
        if not any((folder / name).is_dir() for name in self.cameras):
            raise InputError(f"{folder} has no folder {', '.join(self.cameras)}; unpack the depth images there")
        self._camera = KINECT2 if ray_table is None else load_ray_table(ray_table)

    @property
    def problems(self) -> list[str]:
        """Problems with the images read so far, one line each."""
        return list(self._problems)

    def __len__(self) -> int:
        return len(self._truth.joints_cm)

    def __getitem__(self, index: int) -> FrameSet:
        """Frame ``index``, from 0; its joints and poses are in metres, Z up.

        Raises:
            IndexError: past the end.
        """
        i = range(len(self))[operator.index(index)]
        joints = self._truth.joints_cm[i] @ z_up_from("y").T / 100
        views = tuple(view for name in self.cameras if (view := self._view(name, i)) is not None)
        return FrameSet(round(i * 1e9 / FRAMES_PER_SECOND), views, joints)

    def _view(self, name: str, i: int) -> View | None:
        depth_path, labels_path = image_paths(self.path, name, i)
        if name not in self._truth.cameras or not depth_path.exists():
            return None
        translate, rotate = self._truth.cameras[name][i]
        if not np.isfinite([translate, rotate]).all():
            return None
        camera = dataclasses.replace(self._camera, name=name, world_from_camera=camera_pose(translate, rotate))
        try:
            depth_m, mask = decode_depth(_read_png(depth_path))
            if not labels_path.exists():
                return View(camera, depth_m, mask)
            labels = decode_labels(_read_png(labels_path))
        except InputError as error:
            self._problems[str(error)] = None
            return None
        return View(camera, depth_m, labels > 0, labels)


def image_paths(section: Path, camera: str, i: int) -> tuple[Path, Path]:
    """Depth and groundtruth image of a camera's frame ``i``, from 0 (files count from 1)."""
    file = f"mayaProject.{i + 1:06d}.png"
    return section / "images" / "depthRender" / camera / file, section / "images" / "groundtruth" / camera / file


def sections(root: Path, subset: str, split: str) -> list[Path]:
    """The section folders of a split, in numerical order.

    Raises:
        InputError: when the root, subset or split is missing or holds no section.
    """
    folder = Path(root)
    for part in ("", subset, split):
        parent, folder = folder, folder / part
        if not folder.is_dir():
            names = sorted(entry.name for entry in parent.iterdir()) if part else []
            beside = f"; {parent} holds {', '.join(names[:20]) or 'nothing'}" if part else ""
            raise InputError(f"{folder} not found: expected {_LAYOUT}{beside}")
    numbered = [entry for entry in folder.iterdir() if entry.is_dir() and entry.name.isdecimal()]
    if not numbered:
        raise InputError(f"{folder} has no numbered sections: expected {_LAYOUT}")
    return sorted(numbered, key=lambda entry: int(entry.name))


def iterate(
    root: Path,
    subset: str,
    split: str,
    limit: int | None = None,
    ray_table: Path | None = None,
    problems: list[str] | None = None,
) -> Iterator[FrameSet]:
    """Frames of a split, section after section, at most ``limit``. Timestamps start anew in each section.
    Problems with images are logged, and appended to ``problems``.

    Raises:
        InputError: as :func:`sections` and :class:`Section`.
    """
    for path in sections(root, subset, split):
        section = Section(path, ray_table=ray_table)
        count = len(section) if limit is None else min(limit, len(section))
        yield from (section[i] for i in range(count))
        for problem in section.problems:
            _LOG.warning("left out: %s", problem)
        if problems is not None:
            problems += section.problems
        if limit is not None and (limit := limit - count) <= 0:
            return
