"""The result of a run or a live capture, for programs."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from depthmocap.errors import InputError
from depthmocap.exporting.summary import Summary, problem_lines
from depthmocap.frames import Pose
from depthmocap.recordings.point_table import read_poses


@dataclasses.dataclass(frozen=True, eq=False)
class RunResult:
    """The results of ``run`` or ``live``.

    Attributes:
        folder: contains pose.csv, pose.trc, pose.bvh and summary.json; None if nothing was written.
        summary: the content of summary.json.
    """

    folder: Path | None
    summary: Summary

    @property
    def frames(self) -> int:
        """Number of poses, including those without a person."""
        return self.summary["frames"]

    @property
    def gaps(self) -> int:
        """Number of poses without a person."""
        return self.summary["gaps"]

    @property
    def problems(self) -> list[str]:
        """Problems for the user, one line each."""
        return problem_lines(self.summary["problems"])

    def poses(self) -> list[Pose]:
        """The poses, read from pose.csv and points.csv.

        Raises:
            InputError: when nothing was written, or the file no longer exists.
        """
        if self.folder is None:
            raise InputError("no poses were written: give a folder for them (out)")
        return read_poses(self.folder).poses()
