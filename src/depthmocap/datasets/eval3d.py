"""Reader of EVAL (Ganapathi et al. 2012): one person before a depth camera; 24 sequences of 3 people, 16 joints.

A sequence is a file ``seq_<person>_<number>.bin`` of equal records, little endian: a magic number and the frame's; a
cloud of 240 × 320 points in the order of the sensor's pixels, metres; up to 32 markers and up to 32 joints, each joint
an id and a point. The set has no calibration: intrinsics and the directions of
the axes follow from the cloud, whose pixels are known.
"""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.core.reading.input_files import check_file, open_file
from depthmocap.core.reading.json_text import read_json
from depthmocap.datasets.annotated import AnnotatedFrame, near_joints
from depthmocap.errors import InputError
from depthmocap.frames import FrameSet, FrameSource, View
from depthmocap.geometry import DepthCamera
from depthmocap.segment.static_scene import PersonSegmenter
from depthmocap.text import joined

#: Segmentation of the person: by the sequence's background, by a box around the true joints, or none.
Mask = Literal["background", "box", "all"]

#: Columns of a depth picture.
WIDTH = 320
#: Rows of a depth picture.
HEIGHT = 240
#: Joints or markers of a record, at most.
_MOST = 32
RECORD = np.dtype(
    [
        ("magic", "<i4"), ("frame", "<i4"), ("points", "<f4", (HEIGHT, WIDTH, 3)),
        ("marker_count", "<i4"), ("markers", [("name", "S256"), ("at", "<f4", 3)], _MOST),
        ("joint_count", "<i4"), ("joints", [("id", "<i4"), ("at", "<f4", 3)], _MOST),
    ]
)  # fmt: skip
#: Largest median distance of the points from the fitted camera's rays, pixels.
_OFF_PX = 1.0
#: Least number of points to fit the camera to.
_FEWEST = 1000


def joint_table(path: Path) -> dict[int, str]:
    """Names of joint ids, from a JSON file such as ``{"0": "Head", "1": "Neck"}``.

    Raises:
        InputError: when it is not of this form, or two ids share a name.
    """
    example = '{"0": "Head", "1": "Neck"}'
    document = read_json(path, f"--names takes a JSON file such as {example}")
    if not isinstance(document, dict) or not all(re.fullmatch("[0-9]{1,9}", number) for number in document):
        raise InputError(f"{path} must be JSON such as {example}")
    table = {int(number): str(name) for number, name in document.items()}
    if not table or len(set(table.values())) < len(table):
        raise InputError(f"{path}: joint ids need names of their own, got {', '.join(table.values()) or 'none'}")
    return table


class Eval:
    """The frames of all sequences of a folder; see ``AnnotatedSet``. Subjects and actions are by the files' names.

    Args:
        names: names of joint ids (see :func:`joint_table`); a name of one of our joints makes the two correspond.
            Without it joints are named by their ids, and none corresponds to ours.
        mask: see :data:`Mask`.
    """

    name = "EVAL"
    up, fps = "-y", 30.0

    def __init__(self, root: Path, names: Mapping[int, str] | None = None, mask: Mask = "background") -> None:
        """Open the files.

        Raises:
            InputError: when there is no sequence, none can be read, or no joint has a name of the table.
        """
        self._problems: dict[str, None] = {}
        self._mask: Mask = mask
        paths = sorted(Path(root).glob("seq_*.bin"))
        if not paths:
            raise InputError(f"{root} holds no seq_*.bin: expected EVAL's sequences, such as seq_a_0.bin")
        self._sequences = [sequence for path in paths if (sequence := self._open(path)) is not None]
        if not self._sequences:
            raise InputError(f"{root}: no sequence can be read: {joined(self._problems)}")
        ids = sorted({number for sequence in self._sequences for number in sequence.ids})
        table = dict(names) if names is not None else {number: f"joint {number}" for number in ids}
        self._ids = [number for number in table if number in ids]
        if not self._ids:
            raise InputError(f"{root}: none of the joint ids {', '.join(map(str, ids))} has a name in the table")
        if unknown := [number for number in ids if number not in table]:
            self._problems[f"joints of the ids {', '.join(map(str, unknown))} have no name and are left out"] = None
        self.joints: tuple[str, ...] = tuple(table[number] for number in self._ids)
        self.correspondence: dict[str, str] = {name: name for name in self.joints if name in JOINT_INDEX}

    @property
    def problems(self) -> list[str]:
        """What could not be read so far, one line each."""
        return list(self._problems)

    def __len__(self) -> int:
        return sum(map(len, self._sequences))

    def __iter__(self) -> Iterator[AnnotatedFrame]:
        for sequence in self._sequences:
            segment = None
            if self._mask == "background":
                segment = PersonSegmenter.from_recording(sequence)
                for problem in segment.problems:
                    self._problems[f"{sequence.path}: {problem.partition(';')[0]}; try --mask box"] = None
            for row in range(len(sequence)):
                joints = sequence.joints(row, self._ids)
                if not sequence.whole(row):
                    self._problems[f"{sequence.path}: record {row} is damaged and left out"] = None
                    yield AnnotatedFrame((), joints, sequence.subject, sequence.action, row)
                    continue
                view = sequence.view(row)
                if segment is not None:
                    view = dataclasses.replace(view, mask=segment(view))
                elif self._mask == "box":
                    view = dataclasses.replace(view, mask=near_joints(view, joints))
                yield AnnotatedFrame((view,), joints, sequence.subject, sequence.action, sequence.number(row))

    def _open(self, path: Path) -> _Sequence | None:
        try:
            size = check_file(path).st_size
        except InputError as error:
            self._problems[str(error)] = None
            return None
        count, rest = divmod(size, RECORD.itemsize)
        if rest:
            self._problems[
                f"{path} ends within a record (of {RECORD.itemsize} bytes): its {count} whole ones are read; "
                "download it again"
            ] = None
        if not count:
            return None
        try:
            with open_file(path) as file:
                return _Sequence(path, np.memmap(file, RECORD, "r", shape=(count,)))
        except InputError as error:
            self._problems[str(error)] = None
            return None


class _Sequence(FrameSource):
    """One file: a source of frames (see ``FrameSource``) for learning the background, and the joints."""

    up = "-y"

    def __init__(self, path: Path, records: Any) -> None:
        self.path, self._records = path, records
        self.action = path.stem.removeprefix("seq_")
        self.subject = self.action.rsplit("_", 1)[0]
        self._magic = int(np.median(records["magic"]))
        good = [row for row in range(len(records)) if self.whole(row)]
        if not good:
            raise InputError(f"{path}: no record holds a plausible number of joints: is it EVAL's .bin?")
        self._axes, self.camera = _camera(path, records["points"][good[0]])
        self.ids = {int(number) for row in good for number in self._joint_ids(row)}

    def __len__(self) -> int:
        return len(self._records)

    def __getitem__(self, row: int) -> FrameSet:
        return FrameSet(row, (self.view(row),) if self.whole(row) else ())

    def whole(self, row: int) -> bool:
        """Whether a record's numbers are plausible."""
        record = self._records[row]
        return int(record["magic"]) == self._magic and 0 <= int(record["joint_count"]) <= _MOST

    def number(self, row: int) -> int:
        """The frame's number, as the file has it."""
        return int(self._records["frame"][row])

    def view(self, row: int) -> View:
        """The depth image that the cloud came from."""
        z = self._records["points"][row, ..., 2] * np.float32(self._axes[2])
        return View(self.camera, np.where(np.isfinite(z) & (z > 0), z, np.float32(0)))

    def joints(self, row: int, ids: list[int]) -> Float[ndarray, "j 3"]:
        """Joints of these ids in the camera's frame, NaN where the record has none."""
        record = self._records[row]
        points = np.full((len(ids), 3), np.nan)
        record_ids = self._joint_ids(row)
        for i, number in enumerate(ids):
            rows = np.flatnonzero(record_ids == number)
            if len(rows):
                points[i] = record["joints"]["at"][rows[0]] * self._axes
        # A joint at the camera's position was not tracked.
        points[~np.isfinite(points).all(1) | (points == 0).all(1)] = np.nan
        return points

    def _joint_ids(self, row: int) -> ndarray:
        record = self._records[row]
        return record["joints"]["id"][: max(0, min(int(record["joint_count"]), _MOST))]


@functools.cache
def _pixels() -> tuple[ndarray, ndarray]:
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    return u, v


def _camera(path: Path, points: Float[ndarray, "h w 3"]) -> tuple[Float[ndarray, "3"], DepthCamera]:
    """Signs of the cloud's axes against the camera's (x right, y down, z forward), and the camera that projects every
    point to its own pixel: by least squares, ``u = fx x / z + cx`` and the same for ``v``.

    Raises:
        InputError: when the points are not those of a camera's pixels, row by row.
    """
    valid = np.isfinite(points).all(-1) & (points[..., 2] != 0)
    fault = f"{path}: its first cloud is not one of {HEIGHT} × {WIDTH} pixels of a camera, row by row"
    if valid.sum() < _FEWEST:
        raise InputError(f"{fault}: it has {valid.sum()} points")
    x, y, z = points[valid].astype(np.float64).T
    forward = np.sign(np.median(z))
    fits = []
    for across, pixel in zip((x, y), _pixels(), strict=True):
        ray = across / (z * forward)
        focal, centre = np.polyfit(ray, pixel[valid], 1) if np.ptp(ray) > 0 else (0.0, 0.0)
        off_px = float(np.median(np.abs(ray * focal + centre - pixel[valid])))
        if off_px > _OFF_PX or not focal:
            raise InputError(f"{fault}: points are {off_px:.0f} pixels off")
        fits.append((focal, centre))
    (fx, cx), (fy, cy) = fits
    axes = np.array([np.sign(fx), np.sign(fy), forward])
    return axes, DepthCamera("eval", WIDTH, HEIGHT, float(abs(fx)), float(abs(fy)), float(cx), float(cy))
