"""``pose.csv`` (and ``truth.csv``) and ``points.csv``: one row per pose, in the rig's own world, metres."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.core.output import LineFile, writing
from depthmocap.frames import Pose
from depthmocap.recordings.point_table import POINT_HEADER, POINTS_FILE, POSE_FILE, is_points_file
from depthmocap.recordings.pose_table import HEADER


class CsvWriter:
    """Writes each pose at once as a whole line, so that an interrupted run keeps its poses.

    ``timestamp_ns`` is a pose's time on the frames' clock. ``time_s`` counts from ``origin_ns`` on that clock, by
    default from the first pose. An unobserved joint is written ``nan``. Points of the skin go to ``points.csv`` beside
    a ``pose.csv``, which is made with the first pose that has any; that of earlier poses is removed.

    Attributes:
        origin_ns: can be set until the first pose is written.

    Raises:
        InputError: when the file cannot be written.
    """

    def __init__(self, path: Path, origin_ns: int | None = None) -> None:
        self._path = path
        self._file: LineFile | None = None
        self._points: LineFile | None = None
        self.origin_ns = origin_ns

    def __enter__(self) -> CsvWriter:
        self._file = LineFile(self._path)
        if self._path.name == POSE_FILE and is_points_file(earlier := self._path.with_name(POINTS_FILE)):
            with writing(earlier):
                earlier.unlink()
        self._write_line(",".join(HEADER))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None
        if self._points is not None:
            self._points.close()
            self._points = None

    def release(self) -> None:
        """Close the file until the next pose."""
        for file in (self._file, self._points):
            if file is not None:
                file.close()

    def write(self, pose: Pose) -> None:
        """Append one pose."""
        if self.origin_ns is None:
            self.origin_ns = pose.timestamp_ns
        self._write_line(pose_row(pose, self.origin_ns))
        if pose.points is None or pose.points_confidence is None or self._path.name != POSE_FILE:
            return
        if np.isnan(pose.points).all():
            return
        if self._points is None:
            self._points = LineFile(self._path.with_name(POINTS_FILE))
            self._points.add(",".join(POINT_HEADER))
        self._points.add(f"{pose.timestamp_ns},{_cells(pose.points, pose.points_confidence)}")

    def _write_line(self, line: str) -> None:
        if self._file is None:
            raise ValueError("CsvWriter is closed: use it as `with CsvWriter(path) as writer:`")
        self._file.add(line)


def pose_row(pose: Pose, origin_ns: int) -> str:
    """The line of a pose."""
    time_s = (pose.timestamp_ns - origin_ns) * 1e-9
    return f"{time_s:.9f},{_cells(pose.joints, pose.confidence)},{pose.timestamp_ns}"


def _cells(places: Float[ndarray, "n 3"], confidence: Float[ndarray, " n"]) -> str:
    rows = zip(places.tolist(), confidence.tolist(), strict=True)
    return ",".join(f"{x:.6f},{y:.6f},{z:.6f},{sure:.4f}" for (x, y, z), sure in rows)


def write_csv(path: Path, poses: Sequence[Pose]) -> None:
    """Write all poses, as :class:`CsvWriter` does.

    Raises:
        InputError: when the file cannot be written.
    """
    with CsvWriter(path) as writer:
        for pose in poses:
            writer.write(pose)
