"""Writer of UBC3V sections, in the layout that the authors' toolkit and :mod:`depthmocap.datasets.ubc3v` read."""

from __future__ import annotations

import dataclasses
import io
import re
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray
from scipy.io import savemat

from depthmocap.body.regions import REGION_COUNT
from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.core.output import open_new
from depthmocap.datasets.png import colour_png
from depthmocap.datasets.ubc3v import (
    DEPTH_SCALE,
    FAR_CM,
    FRAMES_PER_SECTION,
    KINECT2,
    MAYA_JOINTS,
    NEAR_CM,
    UNLABELLED,
    encode_labels,
    image_paths,
    maya_angles,
    read_ground_truth,
)
from depthmocap.frames import View
from depthmocap.geometry.transforms import z_up_from
from depthmocap.kernels.levels import depth_levels

#: Maya joints that hold no target joint, and the joint they get: the nearest to where their parent's frame sits.
_FILLED = {
    "HipsPGX": "Hip", "LeftUpLegPGX": "Hip",
    "LeftShoulderPGX": "Spine2", "NeckPGX": "Spine2", "LeftArmPGX": "Neck", "RightArmPGX": "Neck",
    "LeftInHandIndexPGX": "LHand", "LeftInHandThumbPGX": "LHand",
    "RightInHandIndexPGX": "RHand", "RightInHandThumbPGX": "RHand",
}  # fmt: skip
#: Sorted names are the toolkit's order.
_JOINT_OF_MAYA = dict(sorted(({maya: joint for joint, maya in MAYA_JOINTS.items()} | _FILLED).items()))

#: ``groundtruth.mat`` of a full section takes half a second to write, so it is written only this often.
_SAVE_EVERY_S = 20.0
#: Text of the file's header. By default it would hold the time; so equal data gives equal bytes.
_HEADER = b"MATLAB 5.0 MAT-file, written by depthmocap".ljust(116)
#: RGBA of depth levels (0: not the person) and of labels.
_GREYS = np.zeros((257, 4), np.uint8)
_GREYS[1:, :3] = np.arange(256)[:, None]
_GREYS[1:, 3] = 255
_COLOURS = np.zeros((256, 4), np.uint8)
_KNOWN = np.array([*range(REGION_COUNT + 1), UNLABELLED], np.uint8)
_COLOURS[_KNOWN] = encode_labels(_KNOWN[None])[0]
#: The label stored for every label of a person's pixel.
_IMPOSSIBLE = REGION_COUNT + 1
_STORED = np.full(256, _IMPOSSIBLE, np.uint8)
_STORED[_KNOWN] = np.where(_KNOWN == 0, UNLABELLED, _KNOWN)


@dataclasses.dataclass(frozen=True, eq=False)
class FrameTruth:
    """A frame's values in ``groundtruth.mat``, in its units: cm, degrees, Y up; ``poses`` by camera name."""

    joints_cm: Float[ndarray, "18 3"]
    poses: dict[str, Float[ndarray, "2 3"]]


def frame_truth(views: Sequence[View], joints_world: Float[ndarray, "18 3"]) -> FrameTruth:
    """The truth of a sample (see :meth:`SectionWriter.write`).

    Raises:
        ValueError: when a value is one that the format cannot hold.
    """
    if joints_world.shape != (len(JOINTS), 3) or not np.isfinite(joints_world).all():
        raise ValueError(f"joints_world must be {len(JOINTS)}×3 finite numbers")
    names = [view.camera.name for view in views]
    if not names or len(set(names)) < len(names) or not all(re.fullmatch(r"Cam[1-9]\d*", name) for name in names):
        raise ValueError(f"the views' cameras must be named Cam1, Cam2, …, each once; got {names}")
    for view in views:
        _check_intrinsics(view)
    poses = {view.camera.name: np.stack(maya_angles(view.camera.world_from_camera)) for view in views}
    return FrameTruth(joints_world.astype(np.float64) @ z_up_from("y") * 100, poses)


def write_images(section: Path, i: int, views: Sequence[View]) -> None:
    """Write the images of frame ``i``, from 0, of a section, over what an interrupted run left."""
    for view in views:
        mask = view.mask
        if mask is None:
            mask = view.depth_m > 0 if view.labels is None else view.labels > 0
        depth_path, labels_path = image_paths(section, view.camera.name, i)
        if view.labels is None:
            labels_path.unlink(missing_ok=True)
        else:
            _write(labels_path, _labels_png(view.labels, mask))
        _write(depth_path, _depth_png(view.depth_m, mask))


class SectionWriter:
    """Appends samples to ``root/subset/split/section``. Use it as a context manager.

    Images are written at once, ``groundtruth.mat`` every 20 seconds, when full and on closing, from a temporary file:
    it never refers to a missing image. A writer opened on an existing section continues after the last
    frame in ``groundtruth.mat``: ``len(writer)`` frames are done.

    Raises:
        InputError: when an existing ``groundtruth.mat`` cannot be read.
    """

    def __init__(self, root: Path, subset: str, split: str, section: int) -> None:
        self.path = Path(root) / subset / split / str(section)
        self._truth_path = self.path / "groundtruth.mat"
        self._frames: list[FrameTruth] = []
        if self._truth_path.exists():
            truth = read_ground_truth(self._truth_path)
            self._frames = [
                # A camera without a pose has no view of the frame.
                FrameTruth(joints, {k: v[i] for k, v in truth.cameras.items() if np.isfinite(v[i]).all()})
                for i, joints in enumerate(truth.joints_cm)
            ]
        self._saved = len(self)
        self._saved_s = time.monotonic()

    def __len__(self) -> int:
        return len(self._frames)

    def __enter__(self) -> SectionWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def full(self) -> bool:
        """Whether the section has its 1001 frames."""
        return len(self) >= FRAMES_PER_SECTION

    def write(self, views: Sequence[View], joints_world: Float[ndarray, "18 3"]) -> None:
        """Append one sample.

        Args:
            views: of cameras named Cam1, Cam2, … with UBC3V's intrinsics (see ``ubc3v.kinect2_camera``) and no roll.
                The person is ``mask``, else the labelled pixels, else those with depth. Person pixels labelled 0 are
                stored as unlabelled. Depth outside 0.515–8.24 m is clipped. Without ``labels``, no groundtruth image
                is written, and the mask then loses the pixels without depth.
            joints_world: metres, Z up, in the order of ``body.skeleton.JOINTS``.

        Raises:
            ValueError: when the section is full, or a value is one that the format cannot hold.
        """
        self._check_room()
        truth = frame_truth(views, joints_world)
        write_images(self.path, len(self), views)
        self.append(truth)

    def append(self, truth: FrameTruth) -> None:
        """Append a sample whose images :func:`write_images` has written, as frame ``len(writer)``.

        Raises:
            ValueError: when the section is full.
        """
        self._check_room()
        self._frames.append(truth)
        if self.full or time.monotonic() - self._saved_s >= _SAVE_EVERY_S:
            self._save()

    def close(self) -> None:
        """Write what ``groundtruth.mat`` does not hold yet. The writer stays usable."""
        if len(self) > self._saved:
            self._save()

    def _check_room(self) -> None:
        if self.full:
            raise ValueError(f"{self.path} is full: a section holds {FRAMES_PER_SECTION} frames; open the next one")

    def _save(self) -> None:
        cameras = sorted({name for frame in self._frames for name in frame.poses}, key=lambda name: int(name[3:]))
        unknown = np.full((2, 3), np.nan)
        document = {
            "cameras": {
                name: {
                    "frames": _cell_array(
                        dict(zip(("translate", "rotate"), frame.poses.get(name, unknown), strict=True))
                        for frame in self._frames
                    )
                }
                for name in cameras
            },
            "joints": _cell_array(_maya_joints(frame.joints_cm) for frame in self._frames),
        }
        file = io.BytesIO()
        savemat(file, document, do_compression=True, oned_as="row")
        file.seek(0)
        file.write(_HEADER)
        unfinished = self._truth_path.with_suffix(".mat.part")
        try:
            with open_new(unfinished) as written:
                written.write(file.getbuffer())
            unfinished.replace(self._truth_path)
        except OSError:
            unfinished.unlink(missing_ok=True)  # a full disk
            raise
        self._saved, self._saved_s = len(self), time.monotonic()


def _depth_png(depth_m: Float[ndarray, "h w"], mask: Bool[ndarray, "h w"]) -> bytes:
    """The PNG of ``ubc3v.encode_depth``."""
    levels = np.empty(depth_m.shape, np.uint16)
    depth_levels(depth_m, mask, DEPTH_SCALE, NEAR_CM, FAR_CM, levels)
    return colour_png(levels, _GREYS)


def _labels_png(labels: UInt8[ndarray, "h w"], mask: Bool[ndarray, "h w"]) -> bytes:
    """The PNG of ``ubc3v.encode_labels``; the person's pixels without a label are unlabelled."""
    values = cv2.LUT(labels, _STORED)
    values *= mask
    if (values == _IMPOSSIBLE).any():
        raise ValueError(f"labels must be 0 to {REGION_COUNT}, or {UNLABELLED} for unlabelled person pixels")
    return colour_png(values, _COLOURS)


def _write(path: Path, data: bytes) -> None:
    try:
        file = open_new(path)
    except FileNotFoundError:  # the first of a section
        path.parent.mkdir(parents=True, exist_ok=True)
        file = open_new(path)
    with file:
        file.write(data)


def _check_intrinsics(view: View) -> None:
    camera = view.camera
    size = (KINECT2.height, KINECT2.width)
    for image in (view.depth_m, view.mask, view.labels):
        if image is not None and image.shape != size:
            raise ValueError(f"camera {camera.name}: images must be {size}, got {image.shape}")
    intrinsics = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    expected = (KINECT2.width, KINECT2.height, KINECT2.fx, KINECT2.fy, KINECT2.cx, KINECT2.cy)
    if not np.allclose(intrinsics, expected, rtol=0, atol=1e-3) or any(camera.distortion):
        raise ValueError(
            f"camera {camera.name}: UBC3V holds no intrinsics, so width, height, fx, fy, cx, cy must be {expected} "
            f"without distortion, got {intrinsics}; make the camera with ubc3v.kinect2_camera"
        )


def _maya_joints(joints_cm: Float[ndarray, "18 3"]) -> dict[str, ndarray]:
    """Every Maya joint as a flattened 4×4 matrix; rotations are not known and left out."""
    matrices = {}
    for maya, joint in _JOINT_OF_MAYA.items():
        matrix = np.eye(4)
        matrix[3, :3] = joints_cm[JOINT_INDEX[joint]]
        matrices[maya] = matrix.ravel()
    return matrices


def _cell_array(items: Iterable[Any]) -> ndarray:
    items = list(items)
    cells = np.empty((1, len(items)), dtype=object)
    for i, item in enumerate(items):
        cells[0, i] = item
    return cells
