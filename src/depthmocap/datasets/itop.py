"""Reader of ITOP (Haque et al. 2016): one person before a depth camera at the side or above, 15 joints.

A part of the set is two HDF5 files of a folder, matched by the ids of their frames (``PP_FFFFF``: person, frame)::

    ITOP_<side|top>_<train|test>_depth_map.h5    data (n, 240, 320) metres; id (n)
    ITOP_<side|top>_<train|test>_labels.h5       id, is_valid (n); real_world_coordinates (n, 15, 3) metres;
                                                 segmentation (n, 240, 320), negative outside the person

Its coordinates are x right, y up, z forward: ``x = (u - 160) z 0.0035``, ``y = (120 - v) z 0.0035``.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.datasets.annotated import AnnotatedFrame, near_joints
from depthmocap.errors import InputError, missing_extra
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera, transform_points
from depthmocap.geometry.depth_camera import LARGEST_RIG_M

Side = Literal["side", "top"]
Split = Literal["train", "test"]
#: Segmentation of the person: the set's own, or a box around the true joints.
Mask = Literal["segmentation", "box"]

JOINTS: tuple[str, ...] = (
    "Head", "Neck", "RShoulder", "LShoulder", "RElbow", "LElbow", "RHand", "LHand", "Torso",
    "RHip", "LHip", "RKnee", "LKnee", "RFoot", "LFoot",
)  # fmt: skip
#: Our joint for each of them.
CORRESPONDENCE: dict[str, str] = {joint: "Spine1" if joint == "Torso" else joint for joint in JOINTS}
#: Parts of the body that are reported separately.
PARTS: dict[str, tuple[str, ...]] = {"upper body": JOINTS[:8], "lower body": JOINTS[8:]}

#: Columns of a depth picture.
WIDTH = 320
#: Rows of a depth picture.
HEIGHT = 240
_FOCAL = 1 / 0.0035
#: Rows of a file, at most.
_MOST_FRAMES = 1_000_000
#: Largest chunk of a file, bytes; chunks are unpacked as a whole.
_LARGEST_CHUNK = 1 << 28
#: Digits of a frame's number, at most.
_DIGITS = 16
#: Frames per second of the videos that the frames come from.
FPS = 30.0
#: From ITOP's axes to the camera's: y is down.
_CAMERA_FROM_ITOP = np.diag([1.0, -1.0, 1.0, 1.0])
#: The camera above looks down; the one at the side is assumed level. Columns: the camera's axes in the world.
_WORLD_FROM_CAMERA = {"top": np.diag([1.0, -1.0, -1.0, 1.0]), "side": np.eye(4)}
_UP = {"top": "z", "side": "-y"}


def camera(view: Side) -> DepthCamera:
    """The camera, in a world that is its own frame for the side, and turned Z-up for the top."""
    return DepthCamera(view, WIDTH, HEIGHT, _FOCAL, _FOCAL, WIDTH / 2, HEIGHT / 2, _WORLD_FROM_CAMERA[view])


class Itop:
    """The valid frames of one view and split; see ``AnnotatedSet``. Only their joints
    were checked by hand. Iteration reads the frames from disk.
    """

    def __init__(self, root: Path, view: Side = "side", split: Split = "test", mask: Mask = "segmentation") -> None:
        """Open the files and match their frames.

        Raises:
            InputError: when a file is missing, cut short, or not of this layout, or no frame is valid.
        """
        self.name = f"ITOP {view} {split}"
        self.joints, self.correspondence = JOINTS, CORRESPONDENCE
        self.up, self.fps = _UP[view], FPS
        self._camera, self._mask = camera(view), mask
        # Ordered sets: reading a frame twice reports it once.
        self._problems: dict[str, None] = {}
        self._empty: dict[str, None] = {}
        base = Path(root) / f"ITOP_{view}_{split}"
        self._depth_path, self._labels_path = (
            base.with_name(f"{base.name}_{kind}.h5") for kind in ("depth_map", "labels")
        )
        self._depth_file, self._labels_file = _open(self._depth_path), _open(self._labels_path)
        self._depth = _dataset(self._depth_file, self._depth_path, "data", (HEIGHT, WIDTH), "fiu")
        self._segmentation = _dataset(self._labels_file, self._labels_path, "segmentation", (HEIGHT, WIDTH), "fiu")
        joints = _dataset(self._labels_file, self._labels_path, "real_world_coordinates", (len(JOINTS), 3), "fiu")
        self._joints = _read(self._labels_path, joints, slice(None)).astype(np.float64)
        valid = _read(
            self._labels_path, _dataset(self._labels_file, self._labels_path, "is_valid", (), "fiub"), slice(None)
        )
        self._frames = self._match(np.asarray(valid) > 0)
        if not self._frames:
            raise InputError(
                f"{self._labels_path}: no frame is valid and has a depth map of its id in {self._depth_path.name}: "
                "are both of the same download?"
            )

    @property
    def problems(self) -> list[str]:
        """What could not be read so far, one line each."""
        if not self._empty:
            return list(self._problems)
        what = f"{self._labels_path}: {len(self._empty)} frames have no pixel of the person, such as"
        return [*self._problems, f"{what} {next(iter(self._empty))}: their joints count as not found"]

    def __len__(self) -> int:
        return len(self._frames)

    def __iter__(self) -> Iterator[AnnotatedFrame]:
        for frame in self._frames:
            joints = self._joints_world(frame.label_row)
            try:
                views = (self._view(frame, joints),)
            except InputError as error:
                self._problems[str(error)] = None
                views = ()
            yield AnnotatedFrame(views, joints, frame.person, "", frame.number)

    def _view(self, frame: _Frame, joints_world: Float[ndarray, "15 3"]) -> View:
        with np.errstate(over="ignore"):  # distances beyond 32 bits become infinite
            depth_m = _read(self._depth_path, self._depth, frame.depth_row).astype(np.float32)
        view = View(self._camera, np.where(np.isfinite(depth_m) & (depth_m > 0), depth_m, np.float32(0)))
        if self._mask == "box":
            mask = near_joints(view, joints_world)
        else:
            mask = np.asarray(_read(self._labels_path, self._segmentation, frame.label_row) >= 0)
        if not (mask & (view.depth_m > 0)).any():
            self._empty[frame.id] = None
        return dataclasses.replace(view, mask=mask)

    def _joints_world(self, row: int) -> Float[ndarray, "15 3"]:
        joints = self._joints[row]
        # A joint at the camera's position was not marked; one very far away is an error.
        marked = (np.abs(joints) > 0).any(1) & (np.abs(joints) < LARGEST_RIG_M).all(1)
        joints = np.where(marked[:, None], joints, np.nan)
        return transform_points(self._camera.world_from_camera @ _CAMERA_FROM_ITOP, joints)

    def _match(self, valid: ndarray) -> list[_Frame]:
        """Valid frames with a depth map, matched by id."""
        depth_ids, label_ids = _ids(self._depth_file, self._depth_path), _ids(self._labels_file, self._labels_path)
        if len(depth_ids) != len(self._depth):
            raise InputError(f"{self._depth_path}: id and data differ in length")
        if not len(label_ids) == len(valid) == len(self._joints) == len(self._segmentation):
            raise InputError(
                f"{self._labels_path}: id, is_valid, real_world_coordinates and segmentation differ in length"
            )
        depth_rows = {name: row for row, name in enumerate(depth_ids)}
        valid_rows = [(row, name) for row, name in enumerate(label_ids) if valid[row]]
        absent = [name for _, name in valid_rows if name not in depth_rows]
        if absent:
            self._problems[
                f"{self._depth_path} lacks {len(absent)} of {len(valid_rows)} valid frames of "
                f"{self._labels_path.name}, such as {absent[0]}: they are left out"
            ] = None
        frames = []
        for row, name in valid_rows:
            person, _, number = name.partition("_")
            if name in depth_rows and number.isdecimal() and len(number) < _DIGITS:
                frames.append(_Frame(name, person, int(number), depth_rows[name], row))
        return frames


@dataclasses.dataclass(frozen=True)
class _Frame:
    id: str
    person: str
    number: int
    depth_row: int
    label_row: int


def _open(path: Path) -> Any:
    try:
        import h5py
    except ModuleNotFoundError:
        raise missing_extra("h5py", "datasets") from None
    packed = path.with_name(path.name + ".gz")
    if not path.is_file():
        fix = f"unpack it: gunzip {packed}" if packed.is_file() else "the folder must hold ITOP's unpacked .h5 files"
        raise InputError(f"{path} not found: {fix}")
    try:
        return h5py.File(path, "r")
    except OSError as error:
        reason = str(error).split("(", 1)[-1].rstrip(")")
        raise InputError(f"{path} is not a complete HDF5 file ({reason}): download and unpack it again") from None


def _dataset(file: Any, path: Path, name: str, shape: tuple[int, ...], kinds: str) -> Any:
    """A data set with rows of a shape and one of NumPy's kinds of numbers, checked to be of a size that can be read."""
    import h5py

    expected = ", ".join(map(str, ("n", *shape)))
    try:
        data = file.get(name)
        if not isinstance(data, h5py.Dataset) or data.shape is None:
            fault = "is missing" if data is None else "is no array"
        elif data.ndim != 1 + len(shape) or data.shape[1:] != shape:
            fault = f"is {data.shape}"
        elif data.dtype.kind not in kinds:
            fault = f"is of the type {data.dtype}"
        elif len(data) > _MOST_FRAMES or math.prod(data.chunks or ()) * data.dtype.itemsize > _LARGEST_CHUNK:
            fault = f"is too large ({len(data):,} rows in chunks of {data.chunks})"
        else:
            return data
    except Exception as error:  # h5py raises many types for damaged files
        fault = f"cannot be read ({_line(error)})"
    raise InputError(f"{path}: the data set {name!r} {fault}, expected ({expected})")


def _read(path: Path, data: Any, rows: int | slice) -> Any:
    try:
        return data[rows]
    except Exception as error:  # h5py raises many types for damaged files
        raise InputError(f"{path}: {data.name} cannot be read at {rows} ({_line(error)}): download it again") from None


def _line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]


def _ids(file: Any, path: Path) -> list[str]:
    ids: Mapping[int, Any] = _read(path, _dataset(file, path, "id", (), "SO"), slice(None))
    return [name.decode("ascii", "replace") if isinstance(name, bytes) else str(name) for name in ids]
