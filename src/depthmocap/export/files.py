"""Files of a run whose length nobody knows: poses go to disk as they come, and the rest is made of them at the end."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from depthmocap.ending import finishing
from depthmocap.errors import InputError
from depthmocap.export.bvh import write_bvh
from depthmocap.export.csv import TIME, CsvWriter, read_csv
from depthmocap.export.trc import write_trc
from depthmocap.frames import Pose
from depthmocap.output import make_inner_folder, write_json, writing

#: What ``run`` and ``live`` write into a folder and into those of people; ``run`` pictures, too.
RESULTS = ("pose.csv", "pose.trc", "pose.bvh", "summary.json")
PICTURES = ("report.html", "preview.webp")
#: Files of somebody who was not seen for longer than this are closed (s): people have their numbers back for a minute.
CLOSED_AFTER_S = 65.0
_PERSON = re.compile(r"person-\d+")


def remove_results(folder: Path) -> None:
    """Remove what an earlier ``run`` or ``live`` wrote into a folder, so that nothing of it stands beside what is
    written now, or alone should that fail. Pictures and folders of people are its where a ``pose.csv`` of ours is
    beside or in them; all else stays.

    Raises:
        InputError: when something cannot be removed.
    """
    with writing(folder):
        for each in (folder, *folder.iterdir()):
            if each != folder and (not _PERSON.fullmatch(each.name) or each.is_symlink() or not each.is_dir()):
                continue
            ours = _is_poses(each / "pose.csv")
            for name in (*RESULTS, *PICTURES) if ours else RESULTS if each == folder else ():
                (each / name).unlink(missing_ok=True)
            if ours and each != folder:
                with contextlib.suppress(OSError):  # it holds something else
                    each.rmdir()


def _is_poses(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(TIME) + 1) == f"{TIME},".encode()


class PoseFiles:
    """pose.csv while running; pose.trc, pose.bvh and summary.json at the end, however it comes. A context manager.

    Attributes:
        summary: what summary.json gets; add to it before the end.
    """

    def __init__(self, folder: Path, up: str) -> None:
        """
        Raises:
            InputError: when the folder cannot be written.
        """
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot write to {folder}: {error.strerror}") from None
        self._folder, self._up = folder, up
        self._csv = CsvWriter(folder / "pose.csv")
        self._last_ns: int | None = None
        self.summary: dict[str, Any] = {}

    def __enter__(self) -> PoseFiles:
        self._csv.__enter__()
        return self

    def write(self, pose: Pose) -> None:
        """Append a pose; one that is not later than the last is not written."""
        if self._last_ns is None or pose.timestamp_ns > self._last_ns:
            if self._last_ns is None:
                self.summary["first_timestamp_ns"] = pose.timestamp_ns
            self._csv.write(pose)
            self._last_ns = pose.timestamp_ns

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with finishing():
            self._csv.__exit__(kind, error, trace)
            self._finish(kind is not None)

    def _finish(self, cut_off: bool) -> None:
        self.summary["interrupted"] = self.summary.get("interrupted", False) or cut_off
        if self._last_ns is not None:
            self._animate()
        write_json(self._folder / "summary.json", self.summary)

    def _animate(self) -> None:
        # Read back instead of kept: hours of poses do not belong into memory.
        times_s, joints, confidence = read_csv(self._folder / "pose.csv")
        if not np.isfinite(joints).any():
            self.summary["problems"] = [*self.summary.get("problems", []), "no person was found in any set"]
            return
        poses = [
            Pose(round(time_s * 1e9), own, sure) for time_s, own, sure in zip(times_s, joints, confidence, strict=True)
        ]
        try:
            write_trc(self._folder / "pose.trc", poses, self._up)
            self.summary["bvh_held_frames"] = write_bvh(self._folder / "pose.bvh", poses, self._up)
        except InputError as error:  # pose.csv is whole in any case
            self.summary["problems"] = [*self.summary.get("problems", []), str(error)]


class PeopleFiles:
    """A folder ``person-N`` of :class:`PoseFiles` for everybody who is followed. A context manager."""

    def __init__(self, folder: Path, up: str) -> None:
        self._folder, self._up = folder, up
        self._files: dict[int, PoseFiles] = {}
        #: How many poses each has had.
        self.poses: dict[int, int] = {}
        self._last_ns: dict[int, int] = {}

    def __enter__(self) -> PeopleFiles:
        return self

    def write(self, poses: Mapping[int, Pose], delay_frames: int = 0) -> None:
        """Append the poses of one set, by number; ``delay_frames`` is of their filter, whose first are not final.

        Raises:
            InputError: when a folder cannot be written.
        """
        for number, pose in poses.items():
            self.poses[number] = self.poses.get(number, 0) + 1
            self._last_ns[number] = pose.timestamp_ns
            if number not in self._files:
                folder = self._folder / f"person-{number}"
                make_inner_folder(folder)
                self._files[number] = PoseFiles(folder, self._up).__enter__()
            if self.poses[number] > delay_frames:
                self._files[number].write(pose)
        newest_ns = max(self._last_ns.values(), default=0)
        for number in [n for n in self._files if newest_ns - self._last_ns[n] > CLOSED_AFTER_S * 1e9]:
            self._files.pop(number).__exit__(None, None, None)

    def finish(self, poses: Mapping[int, Sequence[Pose]]) -> None:
        """Append what filters held back."""
        for number, own in poses.items():
            for pose in own if number in self._files else ():
                self._files[number].write(pose)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with finishing(), contextlib.ExitStack() as stack:  # all of them, also where one cannot be written
            for files in self._files.values():
                stack.callback(files.__exit__, kind, error, trace)
