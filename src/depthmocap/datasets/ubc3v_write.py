"""Writer of UBC3V sections, in the layout that the authors' toolkit and :mod:`depthmocap.datasets.ubc3v` read."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from PIL import Image
from scipy.io import savemat

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.datasets.ubc3v import (
    FRAMES_PER_SECTION,
    KINECT2,
    MAYA_JOINTS,
    UNLABELLED,
    encode_depth,
    encode_labels,
    image_paths,
    maya_angles,
    read_ground_truth,
)
from depthmocap.frames import View
from depthmocap.geometry.transforms import z_up_from

#: Maya joints that hold no target joint, and the joint they get: the nearest to where their parent's frame sits.
_FILLED = {
    "HipsPGX": "Hip", "LeftUpLegPGX": "Hip",
    "LeftShoulderPGX": "Spine2", "NeckPGX": "Spine2", "LeftArmPGX": "Neck", "RightArmPGX": "Neck",
    "LeftInHandIndexPGX": "LHand", "LeftInHandThumbPGX": "LHand",
    "RightInHandIndexPGX": "RHand", "RightInHandThumbPGX": "RHand",
}  # fmt: skip
#: Sorted names are the toolkit's order.
_JOINT_OF_MAYA = dict(sorted(({maya: joint for joint, maya in MAYA_JOINTS.items()} | _FILLED).items()))

_SAVE_EVERY = 100
_PNG_COMPRESSION = 3


class SectionWriter:
    """Appends samples to ``root/subset/split/section``. Use it as a context manager.

    Images are written at once, ``groundtruth.mat`` every 100 samples and on closing. A writer opened on an existing
    section continues after the last frame in ``groundtruth.mat``: ``len(writer)`` frames are done.

    Raises:
        InputError: when an existing ``groundtruth.mat`` cannot be read.
    """

    def __init__(self, root: Path, subset: str, split: str, section: int) -> None:
        self.path = Path(root) / subset / split / str(section)
        self._truth_path = self.path / "groundtruth.mat"
        self._joints_cm: list[ndarray] = []
        self._poses: list[dict[str, ndarray]] = []  # by camera: translate and rotate, of the cameras of that frame
        if self._truth_path.exists():
            truth = read_ground_truth(self._truth_path)
            self._joints_cm = list(truth.joints_cm)
            self._poses = [{name: poses[i] for name, poses in truth.cameras.items()} for i in range(len(self))]
        self._saved = len(self)

    def __len__(self) -> int:
        return len(self._joints_cm)

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
        if self.full:
            raise ValueError(f"{self.path} is full: a section holds {FRAMES_PER_SECTION} frames; open the next one")
        if joints_world.shape != (len(JOINTS), 3) or not np.isfinite(joints_world).all():
            raise ValueError(f"joints_world must be {len(JOINTS)}×3 finite numbers")
        names = [view.camera.name for view in views]
        if not names or len(set(names)) < len(names) or not all(re.fullmatch(r"Cam[1-9]\d*", name) for name in names):
            raise ValueError(f"the views' cameras must be named Cam1, Cam2, …, each once; got {names}")
        for view in views:
            _check_intrinsics(view)
        poses = {view.camera.name: np.stack(maya_angles(view.camera.world_from_camera)) for view in views}
        for view in views:
            self._write_images(view)
        self._joints_cm.append(joints_world.astype(np.float64) @ z_up_from("y") * 100)
        self._poses.append(poses)
        if len(self) - self._saved >= _SAVE_EVERY:
            self._save()

    def close(self) -> None:
        """Write what ``groundtruth.mat`` does not hold yet. The writer stays usable."""
        if len(self) > self._saved:
            self._save()

    def _write_images(self, view: View) -> None:
        mask = view.mask
        if mask is None:
            mask = view.depth_m > 0 if view.labels is None else view.labels > 0
        depth_path, labels_path = image_paths(self.path, view.camera.name, len(self))
        _save_png(encode_depth(view.depth_m, mask), depth_path)
        if view.labels is None:
            labels_path.unlink(missing_ok=True)  # of an interrupted run
        else:
            labels = np.where(view.labels == 0, np.uint8(UNLABELLED), view.labels)
            _save_png(encode_labels(np.where(mask, labels, np.uint8(0))), labels_path)

    def _save(self) -> None:
        cameras = sorted({name for poses in self._poses for name in poses}, key=lambda name: int(name[3:]))
        unknown = np.full((2, 3), np.nan)
        document = {
            "cameras": {
                name: {
                    "frames": _cell_array(
                        dict(zip(("translate", "rotate"), poses.get(name, unknown), strict=True))
                        for poses in self._poses
                    )
                }
                for name in cameras
            },
            "joints": _cell_array(_maya_joints(joints_cm) for joints_cm in self._joints_cm),
        }
        unfinished = self._truth_path.with_suffix(".mat.part")
        savemat(unfinished, document, appendmat=False, do_compression=True, oned_as="row")
        unfinished.replace(self._truth_path)
        self._saved = len(self)


def _check_intrinsics(view: View) -> None:
    camera = view.camera
    size = (KINECT2.height, KINECT2.width)
    for image in (view.depth_m, view.mask, view.labels):
        if image is not None and image.shape != size:
            raise ValueError(f"camera {camera.name}: images must be {size}, got {image.shape}")
    given = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    wanted = (KINECT2.width, KINECT2.height, KINECT2.fx, KINECT2.fy, KINECT2.cx, KINECT2.cy)
    if not np.allclose(given, wanted, rtol=0, atol=1e-3) or any(camera.distortion):
        raise ValueError(
            f"camera {camera.name}: UBC3V holds no intrinsics, so width, height, fx, fy, cx, cy must be {wanted} "
            f"without distortion, got {given}; make the camera with ubc3v.kinect2_camera"
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


def _save_png(rgba: ndarray, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(rgba).save(path, compress_level=_PNG_COMPRESSION)
