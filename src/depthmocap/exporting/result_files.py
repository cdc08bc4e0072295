"""The result files of a take of unknown length: poses are written as they come, the other files at the end."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from depthmocap.body.skeleton import JOINTS
from depthmocap.core.interrupts import deferred_interrupts
from depthmocap.core.output import make_inner_folder, writing
from depthmocap.errors import InputError
from depthmocap.exporting.bvh import write_bvh
from depthmocap.exporting.edits import EDITS_FILE
from depthmocap.exporting.pose_csv import CsvWriter
from depthmocap.exporting.summary import PoseStatistics, Summary, Take, frame_ranges, make_summary, write_summary
from depthmocap.exporting.trc import write_trc
from depthmocap.frames import Pose
from depthmocap.recordings.point_table import POINTS_FILE, read_poses
from depthmocap.recordings.pose_table import TIME

#: The files that ``run`` and ``live`` write into the folder of results and into the folder of each person.
RESULT_FILES = ("pose.csv", "pose.trc", "pose.bvh", "summary.json")
#: The files that they write besides, where they are told to.
MORE_FILES = (
    POINTS_FILE,
    "pose.npz",
    "model.osim",
    "ik.mot",
    "pose.c3d",
    "pose.glb",
    "pose.usd",
    "pose.fbx",
    "export.json",
)
#: The formats that :class:`PoseFiles` writes at its end.
WRITTEN_FORMATS = ("trc", "bvh")
#: The files that ``run`` also writes.
PICTURE_FILES = ("report.html", "preview.webp")
#: Corrections of results that were written over.
EARLIER_EDITS = "edits-earlier.json"
#: Most files of people open at a time: systems limit open files.
MOST_OPEN = 16
#: Most people with a folder: false tracks must not fill a disk with folders.
MOST_FOLDERS = 1000
NO_PERSON = "no person was found in any set"
_PERSON = re.compile(r"person-\d+")


def remove_results(folder: Path) -> None:
    """Remove the results of an earlier ``run`` or ``live`` from a folder, so that they do not mix with new results or
    remain if writing fails. Pictures are removed only beside a ``pose.csv`` of depthmocap, and folders of people only
    with one in them. Corrections of the earlier results are put aside under another name. All other files stay.

    Raises:
        InputError: when something cannot be removed.
    """
    with writing(folder):
        if (folder / EDITS_FILE).is_file():
            (folder / EDITS_FILE).replace(folder / EARLIER_EDITS)
        for path in (folder, *folder.iterdir()):
            if path != folder and (not _PERSON.fullmatch(path.name) or path.is_symlink() or not path.is_dir()):
                continue
            has_poses = _is_poses(path / "pose.csv")
            removed = RESULT_FILES if path == folder else ()
            for name in (*RESULT_FILES, *MORE_FILES, *PICTURE_FILES) if has_poses else removed:
                (path / name).unlink(missing_ok=True)
            if has_poses and path != folder:
                with contextlib.suppress(OSError):  # it holds something else
                    path.rmdir()


def _is_poses(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(TIME) + 1) == f"{TIME},".encode()


class PoseFiles:
    """Writes pose.csv while running, and pose.trc, pose.bvh and summary.json at the end, also after an error. A context
    manager.

    Attributes:
        numbers: values of summary.json that do not follow from the poses, by its keys; add to it before the end.
    """

    def __init__(self, folder: Path | None, take: Take, person: int | None = None) -> None:
        """
        Args:
            folder: None writes nothing, and only makes the summary.
            person: the number of the person, if several people are tracked.

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
        self._statistics = PoseStatistics(take.least_confidence)
        self._summary: Summary | None = None
        self.numbers: dict[str, Any] = {}

    @property
    def summary(self) -> Summary:
        """The content of summary.json, available at the end."""
        assert self._summary is not None, "the files are still open"
        return self._summary

    def __enter__(self) -> PoseFiles:
        if self._folder is not None:
            self._csv = CsvWriter(self._folder / "pose.csv").__enter__()
        return self

    def write(self, pose: Pose) -> None:
        """Append a pose; a pose that is not later than the last is skipped."""
        if self._last_ns is None or pose.timestamp_ns > self._last_ns:
            origin_ns = self._take.begin(pose.timestamp_ns)
            if self._csv is not None:
                self._csv.origin_ns = origin_ns
                self._csv.write(pose)
            self._statistics.add(pose)
            self._last_ns = pose.timestamp_ns

    def release(self) -> None:
        """Close the file until the next pose."""
        if self._csv is not None:
            self._csv.release()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with deferred_interrupts():
            if self._csv is not None:
                self._csv.__exit__(kind, error, trace)
            self._finish(kind is not None)

    def _finish(self, cut_off: bool) -> None:
        problems = dict(self.numbers.pop("problems", {}))
        numbers = {**self.numbers, **self._statistics.summary()}
        numbers["interrupted"] = self.numbers.get("interrupted", False) or cut_off
        if self._last_ns is not None:
            try:
                numbers |= self._write_animations()
            except InputError as error:  # pose.csv is complete in any case
                problems[str(error)] = 1
        self._summary = make_summary(self._take, {**numbers, "problems": problems}, self._person)
        if self._folder is not None:
            write_summary(self._folder, self._summary)

    def _write_animations(self) -> dict[str, Any]:
        """Write the animations; returns their values of the summary."""
        if self._statistics.gaps == self._statistics.frames:
            raise InputError(NO_PERSON)
        if self._folder is None:
            return {}
        # Read back rather than kept, because hours of poses would fill the memory.
        poses, take = read_poses(self._folder).poses(), self._take
        files = take.files
        if "trc" in files.formats:
            write_trc(
                self._folder / "pose.trc", poses, take.up, files.least_confidence, take.origin_ns,
                fill_s=files.fill_s, landmarks=files.landmarks,
            )  # fmt: skip
        if "bvh" not in files.formats:
            return {}
        try:
            held = write_bvh(
                self._folder / "pose.bvh",
                poses,
                take.up,
                files.least_confidence,
                fill_s=files.fill_s,
                skeleton=files.skeleton,
                rest=files.rest,
                unit=files.bvh_unit,
            )
        except InputError as error:
            raise InputError(f"no pose.bvh: {error}") from None
        by_joint = {joint: frame_ranges(held[:, i]) for i, joint in enumerate(JOINTS)}
        return {
            "bvh_start_s": (poses[0].timestamp_ns - take.begin(poses[0].timestamp_ns)) * 1e-9,
            "bvh_held": {joint: ranges for joint, ranges in by_joint.items() if ranges},
        }


class PeopleFiles:
    """A folder ``person-N`` of :class:`PoseFiles` for each tracked person. A context manager.

    Attributes:
        problems: for the user, one line each.
    """

    def __init__(self, folder: Path, take: Take) -> None:
        self._folder, self._take = folder, take
        self._files: dict[int, PoseFiles] = {}  # the one written last is at the end
        self.problems: list[str] = []

    def __enter__(self) -> PeopleFiles:
        return self

    def write(self, poses: Mapping[int, Sequence[Pose]]) -> None:
        """Append final poses, by number.

        Raises:
            InputError: when a file cannot be written.
        """
        for number, person_poses in poses.items():
            if number not in self._files and len(self._files) == MOST_FOLDERS:
                self.problems = [f"more than {MOST_FOLDERS} people were followed: those who came last have no folder"]
                continue
            files = self._files.pop(number, None)
            if files is None:
                folder = self._folder / f"person-{number}"
                make_inner_folder(folder)
                files = PoseFiles(folder, self._take, number).__enter__()
            self._files[number] = files
            for pose in person_poses:
                files.write(pose)
            if len(self._files) > MOST_OPEN:
                list(self._files.values())[-1 - MOST_OPEN].release()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with (
            deferred_interrupts(),
            contextlib.ExitStack() as stack,
        ):  # closes all, even if one cannot be written
            for files in self._files.values():
                stack.callback(files.__exit__, kind, error, trace)
