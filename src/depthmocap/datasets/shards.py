"""Tar shards in WebDataset's layout: many samples a file, read from front to back, for sets too large for many files.

A sample is the members that share a key, its index in nine digits, one after another::

    000000042.cam1.depth.png     grey, 16 bits: millimetres along z, 0 is invalid
    000000042.cam1.labels.png    grey, 8 bits: regions 1–43, 0 background, 255 unlabelled; absent where not known
    000000042.cam1.mask.png      grey, 8 bits: 255 is the person; only where it is not what the labels mark
    000000042.json               {"index", "group", "joints", "cameras", …}: as ``rig.json`` has cameras

``cam1`` is the first camera of the JSON's list. The ``webdataset`` package reads shards as they are; so does
:class:`ShardReader` with Python's own tar reader.
"""

from __future__ import annotations

import dataclasses
import io
import json
import os
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINTS
from depthmocap.core.output import open_new
from depthmocap.core.reading.image_files import LARGEST_PICTURE, decode_png
from depthmocap.core.reading.input_files import open_file
from depthmocap.core.reading.json_text import array, number, parse_json, whole_number
from depthmocap.datasets.png import grey_png
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry.depth_camera import DepthCamera, check_camera

SAMPLES_PER_SHARD = 250
_CAMERA_NUMBERS = ("width", "height", "fx", "fy", "cx", "cy")
_UNIT_M = 0.001
_END_OF_TAR = 1024
_MOST = 65_534  # 65535 is a saturated reading


def shard_path(folder: Path, number: int) -> Path:
    """The file of a shard, counted from 0."""
    return Path(folder) / f"shard-{number:06d}.tar"


def shards(path: Path) -> list[Path]:
    """The shards of a folder, in order; of a file, itself.

    Raises:
        InputError: when there is none.
    """
    path = Path(path)
    paths = [path] if path.is_file() else sorted(path.glob("shard-*.tar"))
    if not paths:
        raise InputError(f"{path} holds no shards: expected shard-000000.tar, shard-000001.tar, …")
    return paths


@dataclasses.dataclass(frozen=True, eq=False)
class ShardSample:
    """One sample of a shard. ``about`` is its JSON: the seed, the settings' hash, what else the writer noted."""

    index: int
    views: tuple[View, ...]
    joints: Float[ndarray, "18 3"]
    group: int
    about: dict[str, Any]


class ShardWriter:
    """Writes one shard under a temporary name, and renames it when complete. Use it as a context manager: after an
    error nothing of the shard is left. Equal samples give equal bytes."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._unfinished = self.path.with_name(f"{self.path.name}.part-{os.getpid()}")

    def __enter__(self) -> ShardWriter:
        self._file = open_new(self._unfinished)
        self._tar = tarfile.open(fileobj=self._file, mode="w", format=tarfile.USTAR_FORMAT)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            with self._file:
                if error is not None:
                    return
                self._tar.close()
                self._file.flush()
                os.fsync(self._file.fileno())  # so that a power failure leaves no incomplete shard with a final name
            self._unfinished.replace(self.path)
        finally:
            self._unfinished.unlink(missing_ok=True)

    def write(
        self,
        index: int,
        views: Sequence[View],
        joints_world: Float[ndarray, "18 3"],
        group: int,
        about: Mapping[str, Any] | None = None,
    ) -> None:
        """Append a sample; ``about`` goes into its JSON. Depth is kept to the millimetre, up to 65.5 m.

        Raises:
            ValueError: when there are no views or the joints are not 18 finite points.
        """
        if not views or joints_world.shape != (len(JOINTS), 3) or not np.isfinite(joints_world).all():
            raise ValueError(f"a sample needs at least one view and {len(JOINTS)} finite joints")
        key = f"{index:09d}"
        for i, view in enumerate(views, 1):
            depth_mm = np.rint(view.depth_m / np.float32(_UNIT_M))
            depth_mm[~(depth_mm <= _MOST)] = 0
            self._add(f"{key}.cam{i}.depth.png", grey_png(depth_mm.astype(np.uint16)))
            if view.labels is not None:
                self._add(f"{key}.cam{i}.labels.png", grey_png(view.labels))
            if view.mask is not None and (view.labels is None or not np.array_equal(view.mask, view.labels > 0)):
                self._add(f"{key}.cam{i}.mask.png", grey_png(view.mask.astype(np.uint8) * np.uint8(255)))
        document = {
            "index": index,
            "group": group,
            **(about or {}),
            "joints": {name: xyz for name, xyz in zip(JOINTS, joints_world.tolist(), strict=True)},
            "cameras": [_camera_entry(view.camera) for view in views],
        }
        self._add(f"{key}.json", json.dumps(document).encode())

    def _add(self, name: str, data: bytes) -> None:
        member = tarfile.TarInfo(name)  # time 0 and no owner: nothing of the machine
        member.size = len(data)
        self._tar.addfile(member, io.BytesIO(data))


class ShardReader:
    """The samples of one shard or of a folder of shards, in order.

    Raises:
        InputError: when there is no shard; as samples are read, when one is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.paths = shards(path)

    def __iter__(self) -> Iterator[ShardSample]:
        for path in self.paths:
            yield from _read_shard(path)


def count_samples(path: Path) -> int:
    """Samples of a shard, without reading their pictures.

    Raises:
        InputError: when the shard is damaged.
    """
    with _reading(path), _whole(path) as tar:
        return sum(name.endswith(".json") for name in tar.getnames())


def _whole(path: Path) -> tarfile.TarFile:
    """The archive, if its end is there: Python reads a truncated one without an error."""
    with open_file(path) as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(size - _END_OF_TAR, 0))
        if file.read() != bytes(_END_OF_TAR):
            raise EOFError("its end is missing")
    return tarfile.open(path, "r:")


class _reading:  # noqa: N801 - used as a function
    """Turns the errors of a damaged tar file into an ``InputError`` that names it."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, FileNotFoundError):
            raise InputError(f"{self._path} not found: expected a tar shard") from None
        if isinstance(error, tarfile.TarError | EOFError | OSError):
            raise InputError(f"{self._path} is damaged: {error}; {_MEND}") from None


_MEND = "fetch it again, or remove it and run the command that made the set once more"


def _read_shard(path: Path) -> Iterator[ShardSample]:
    key, members = "", {}
    with _reading(path), _whole(path) as tar:
        for member in tar:
            file = tar.extractfile(member)
            if file is None:
                continue
            if member.size > LARGEST_PICTURE:
                raise tarfile.ReadError(f"{member.name} has {member.size:,} bytes")
            data = file.read()
            if len(data) < member.size:
                raise EOFError(f"{member.name} is cut off")
            member_key, _, kind = member.name.partition(".")
            if members and member_key != key:
                yield _sample(path, key, members)
                members = {}
            key, members[kind] = member_key, data
    if members:
        yield _sample(path, key, members)


def _sample(path: Path, key: str, members: Mapping[str, bytes]) -> ShardSample:
    try:
        document = parse_json(members["json"], "its JSON")
        joints = array([document["joints"][name] for name in JOINTS], (len(JOINTS), 3), "joints", unknown=True)
        cameras = [_camera(entry) for entry in document["cameras"]]
        views = tuple(_view(camera, f"cam{i}", members) for i, camera in enumerate(cameras, 1))
        index, group = (whole_number(document[key], key) for key in ("index", "group"))
        return ShardSample(index, views, joints, group, document)
    except (KeyError, TypeError, ValueError) as error:
        reason = f"has no {error}" if isinstance(error, KeyError) else str(error)
        raise InputError(f"{path}: sample {key} is damaged: {reason}; {_MEND}") from None


def _view(camera: DepthCamera, name: str, members: Mapping[str, bytes]) -> View:
    depth = _picture(members[f"{name}.depth.png"], camera, np.uint16)
    labels = members.get(f"{name}.labels.png")
    labels = None if labels is None else _picture(labels, camera, np.uint8)
    mask = members.get(f"{name}.mask.png")
    if mask is not None:
        mask = _picture(mask, camera, np.uint8) > 0
    elif labels is not None:
        mask = labels > 0
    return View(camera, camera.to_metres(depth), mask, labels)


def _picture(data: bytes, camera: DepthCamera, dtype: type) -> ndarray:
    image = decode_png(data, "a picture")
    if image.dtype != dtype or image.shape != (camera.height, camera.width):
        raise ValueError(f"a picture is {image.dtype} {image.shape}, not {dtype.__name__} of its camera's size")
    return image


def _camera_entry(camera: DepthCamera) -> dict[str, Any]:
    return {
        "name": camera.name,
        **{key: getattr(camera, key) for key in _CAMERA_NUMBERS},
        "distortion": list(camera.distortion),
        "depth_unit_m": _UNIT_M,
        "world_from_camera": camera.world_from_camera.tolist(),
    }


def _camera(entry: Mapping[str, Any]) -> DepthCamera:
    k1, k2, p1, p2, k3 = array(entry["distortion"], (5,), "distortion").tolist()
    fx, fy, cx, cy = (number(entry[key], key) for key in ("fx", "fy", "cx", "cy"))
    camera = DepthCamera(
        str(entry["name"]),
        whole_number(entry["width"], "width"),
        whole_number(entry["height"], "height"),
        fx, fy, cx, cy,
        world_from_camera=array(entry["world_from_camera"], (4, 4), "world_from_camera"),
        distortion=(k1, k2, p1, p2, k3),
        depth_unit_m=number(entry["depth_unit_m"], "depth_unit_m"),
    )  # fmt: skip
    check_camera(camera, f"camera {camera.name}")
    return camera
