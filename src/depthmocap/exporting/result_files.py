"""Files of a take whose length nobody knows: poses go to disk as they come, and the rest is made of them at the end."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from depthmocap.body.skeleton import JOINTS
from depthmocap.core.interrupts import finishing
from depthmocap.core.output import make_inner_folder, writing
from depthmocap.errors import InputError
from depthmocap.exporting.bvh import write_bvh
from depthmocap.exporting.pose_csv import CsvWriter
from depthmocap.exporting.summary import PoseNumbers, Summary, Take, make_summary, stretches, write_summary
from depthmocap.exporting.trc import write_trc
from depthmocap.frames import Pose
from depthmocap.recordings.pose_table import TIME, read_table

#: What ``run`` and ``live`` write into a folder and into those of people; ``run`` pictures, too.
RESULTS = ("pose.csv", "pose.trc", "pose.bvh", "summary.json")
PICTURES = ("report.html", "preview.webp")
#: So many files of people are open at a time, and so many people have a folder.
MOST_OPEN, MOST_FOLDERS = 16, 1000
NOBODY = "no person was found in any set"
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
        numbers: what summary.json gets besides what follows from the poses, by its keys; add to it before the end.
    """

    def __init__(self, folder: Path | None, take: Take, person: int | None = None) -> None:
        """
        Args:
            folder: None writes nothing, and makes the summary alone.
            person: the number of the one whose poses these are, where several people are followed.

        Raises:
            InputError: when the folder cannot be written.
        """
        try:
            if folder is not None:
                folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot write to {folder}: {error.strerror}") from None
        self._folder, self._take, self._person = folder, take, person
        self._csv: CsvWriter | None = None
        self._last_ns: int | None = None
        self._poses = PoseNumbers(take.least_confidence)
        self._summary: Summary | None = None
        self.numbers: dict[str, Any] = {}

    @property
    def summary(self) -> Summary:
        """What summary.json holds, at the end."""
        assert self._summary is not None, "the files are still open"
        return self._summary

    def __enter__(self) -> PoseFiles:
        if self._folder is not None:
            self._csv = CsvWriter(self._folder / "pose.csv").__enter__()
        return self

    def write(self, pose: Pose) -> None:
        """Append a pose; one that is not later than the last is not written."""
        if self._last_ns is None or pose.timestamp_ns > self._last_ns:
            origin_ns = self._take.begin(pose.timestamp_ns)
            if self._csv is not None:
                self._csv.origin_ns = origin_ns
                self._csv.write(pose)
            self._poses.add(pose)
            self._last_ns = pose.timestamp_ns

    def rest(self) -> None:
        """Hold no file open until the next pose."""
        if self._csv is not None:
            self._csv.rest()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with finishing():
            if self._csv is not None:
                self._csv.__exit__(kind, error, trace)
            self._finish(kind is not None)

    def _finish(self, cut_off: bool) -> None:
        problems = dict(self.numbers.pop("problems", {}))
        numbers = {**self.numbers, **self._poses.summary()}
        numbers["interrupted"] = self.numbers.get("interrupted", False) or cut_off
        if self._last_ns is not None:
            try:
                numbers |= self._animate()
            except InputError as error:  # pose.csv is whole in any case
                problems[str(error)] = 1
        self._summary = make_summary(self._take, {**numbers, "problems": problems}, self._person)
        if self._folder is not None:
            write_summary(self._folder, self._summary)

    def _animate(self) -> dict[str, Any]:
        """Write the animations; returns what the summary tells of them."""
        if self._poses.gaps == self._poses.frames:
            raise InputError(NOBODY)
        if self._folder is None:
            return {}
        # Read back instead of kept: hours of poses do not belong into memory.
        poses, take = read_table(self._folder / "pose.csv").poses(), self._take
        write_trc(self._folder / "pose.trc", poses, take.up, take.least_confidence, take.origin_ns)
        try:
            held = write_bvh(self._folder / "pose.bvh", poses, take.up, take.least_confidence)
        except InputError as error:
            raise InputError(f"no pose.bvh: {error}") from None
        by_joint = {joint: stretches(held[:, i]) for i, joint in enumerate(JOINTS)}
        return {
            "bvh_start_s": (poses[0].timestamp_ns - take.begin(poses[0].timestamp_ns)) * 1e-9,
            "bvh_held": {joint: found for joint, found in by_joint.items() if found},
        }


class PeopleFiles:
    """A folder ``person-N`` of :class:`PoseFiles` for everybody who is followed. A context manager.

    Attributes:
        problems: what a user should know, one line each.
    """

    def __init__(self, folder: Path, take: Take) -> None:
        self._folder, self._take = folder, take
        self._files: dict[int, PoseFiles] = {}  # in the order in which they were written last
        self.problems: list[str] = []

    def __enter__(self) -> PeopleFiles:
        return self

    def write(self, poses: Mapping[int, Sequence[Pose]]) -> None:
        """Append final poses, by number.

        Raises:
            InputError: when a file cannot be written.
        """
        for number, own in poses.items():
            if number not in self._files and len(self._files) == MOST_FOLDERS:
                self.problems = [f"more than {MOST_FOLDERS} people were followed: those who came last have no folder"]
                continue
            files = self._files.pop(number, None)
            if files is None:
                folder = self._folder / f"person-{number}"
                make_inner_folder(folder)
                files = PoseFiles(folder, self._take, number).__enter__()
            self._files[number] = files
            for pose in own:
                files.write(pose)
            if len(self._files) > MOST_OPEN:
                list(self._files.values())[-1 - MOST_OPEN].rest()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with finishing(), contextlib.ExitStack() as stack:  # all of them, also where one cannot be written
            for files in self._files.values():
                stack.callback(files.__exit__, kind, error, trace)
