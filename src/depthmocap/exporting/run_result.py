"""What a run or a live capture comes to, for programs."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from depthmocap.errors import InputError
from depthmocap.exporting.summary import Summary, problem_lines
from depthmocap.frames import Pose
from depthmocap.recordings.pose_table import read_table


@dataclasses.dataclass(frozen=True, eq=False)
class RunResult:
    """The results of ``run`` or ``live``.

    Attributes:
        folder: where pose.csv, pose.trc, pose.bvh and summary.json lie; None where nothing was written.
        summary: what summary.json holds.
    """

    folder: Path | None
    summary: Summary

    @property
    def frames(self) -> int:
        """Poses that were made, those without a person among them."""
        return self.summary["frames"]

    @property
    def gaps(self) -> int:
        """Poses in which nobody was found."""
        return self.summary["gaps"]

    @property
    def problems(self) -> list[str]:
        """What a user should know, one line each."""
        return problem_lines(self.summary["problems"])

    def poses(self) -> list[Pose]:
        """The poses, read from pose.csv.

        Raises:
            InputError: when nothing was written, or the file is not there any more.
        """
        if self.folder is None:
            raise InputError("no poses were written: give a folder for them (out)")
        return read_table(self.folder / "pose.csv").poses()
