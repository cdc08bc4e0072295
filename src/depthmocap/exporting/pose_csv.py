"""``pose.csv`` (and ``truth.csv``): one row per pose, in the rig's own world, metres."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from depthmocap.core.output import LineFile
from depthmocap.frames import Pose
from depthmocap.recordings.pose_table import HEADER


class CsvWriter:
    """Writes each pose at once as a whole line, so that an interrupted run keeps its poses.

    ``timestamp_ns`` is a pose's time on the frames' clock. ``time_s`` counts from ``origin_ns`` on that clock, by
    default from the first pose. An unobserved joint is written ``nan``.

    Attributes:
        origin_ns: can be set until the first pose is written.

    Raises:
        InputError: when the file cannot be written.
    """

    def __init__(self, path: Path, origin_ns: int | None = None) -> None:
        self._path = path
        self._file: LineFile | None = None
        self.origin_ns = origin_ns

    def __enter__(self) -> CsvWriter:
        self._file = LineFile(self._path)
        self._write_line(",".join(HEADER))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    def release(self) -> None:
        """Close the file until the next pose."""
        if self._file is not None:
            self._file.close()

    def write(self, pose: Pose) -> None:
        """Append one pose."""
        if self.origin_ns is None:
            self.origin_ns = pose.timestamp_ns
        self._write_line(pose_row(pose, self.origin_ns))

    def _write_line(self, line: str) -> None:
        if self._file is None:
            raise ValueError("CsvWriter is closed: use it as `with CsvWriter(path) as writer:`")
        self._file.add(line)


def pose_row(pose: Pose, origin_ns: int) -> str:
    """The line of a pose."""
    cells = [f"{(pose.timestamp_ns - origin_ns) * 1e-9:.9f}"]
    for (x, y, z), confidence in zip(pose.joints.tolist(), pose.confidence.tolist(), strict=True):
        cells.append(f"{x:.6f},{y:.6f},{z:.6f},{confidence:.4f}")
    cells.append(str(pose.timestamp_ns))
    return ",".join(cells)


def write_csv(path: Path, poses: Sequence[Pose]) -> None:
    """Write all poses, as :class:`CsvWriter` does.

    Raises:
        InputError: when the file cannot be written.
    """
    with CsvWriter(path) as writer:
        for pose in poses:
            writer.write(pose)
