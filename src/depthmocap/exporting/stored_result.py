"""Reads back what ``run`` and ``live`` have written: everybody's poses, with the corrections that were made since."""

from __future__ import annotations

import dataclasses
import hashlib
import re
from pathlib import Path

from depthmocap.errors import InputError
from depthmocap.exporting.edits import EDITS_FILE, Edits, TakeMarker, apply_edits, read_edits
from depthmocap.exporting.summary import SUMMARY_FILE, Summary, read_summary
from depthmocap.recordings.point_table import read_poses
from depthmocap.recordings.pose_table import PoseTable

_PERSON = re.compile(r"person-(\d+)")


@dataclasses.dataclass(frozen=True, eq=False)
class StoredPerson:
    """One person of a result.

    Attributes:
        number: by which they were followed; 1 where one person was followed.
        name: that a correction gave them; may be empty.
        table: their poses.
    """

    number: int
    name: str
    table: PoseTable

    @property
    def label(self) -> str:
        """Their name, or ``person N``."""
        return self.name or f"person {self.number}"


@dataclasses.dataclass(frozen=True, eq=False)
class StoredResult:
    """A folder of results.

    Attributes:
        folder: that holds pose.csv.
        summary: the content of summary.json; None where it is missing.
        up: the world's up axis.
        people: everybody, by number.
        name: of the take, that a correction gave it; may be empty.
        original: everybody's poses as they were written.
        edits: the corrections, which ``people`` has.
    """

    folder: Path
    summary: Summary | None
    up: str
    people: tuple[StoredPerson, ...]
    name: str
    original: dict[int, PoseTable]
    edits: Edits

    @property
    def markers(self) -> tuple[TakeMarker, ...]:
        """Named instants, in the order of time."""
        return tuple(sorted(self.edits.markers, key=lambda marker: marker.timestamp_ns))

    def edited(self, edits: Edits) -> StoredResult:
        """The same result with other corrections.

        Raises:
            InputError: when one of them does not fit the result.
        """
        after = apply_edits(self.original, edits)
        people = [
            StoredPerson(number, after.names.get(number, ""), table) for number, table in sorted(after.tables.items())
        ]
        return dataclasses.replace(self, people=tuple(people), name=after.take, edits=edits)


def is_result(path: Path) -> bool:
    """Whether a path is a folder of results."""
    return (path / "pose.csv").is_file()


def read_result(folder: Path, edited: bool = True) -> StoredResult:
    """Read a folder of results. Where several people were followed, these are the folders ``person-N`` in it, and
    otherwise its own pose.csv.

    Args:
        edited: apply the corrections in ``edits.json``.

    Raises:
        InputError: when it holds no poses, or a file of it is malformed.
    """
    if not is_result(folder):
        raise InputError(f"{folder} has no pose.csv: expected a folder that depthmocap run or live has written")
    files = {1: folder / "pose.csv"}
    matches = ((_PERSON.fullmatch(path.name), path / "pose.csv") for path in folder.iterdir())
    people = {int(match[1]): path for match, path in matches if match and path.is_file()}
    files = dict(sorted(people.items())) or files
    digest = hashlib.sha256()
    for path in files.values():
        with path.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
    tables = {number: read_poses(path.parent) for number, path in files.items()}
    summary = read_summary(folder) if (folder / SUMMARY_FILE).exists() else None
    edits = read_edits(folder, digest.hexdigest()) if edited else Edits(digest.hexdigest())
    result = StoredResult(folder, summary, summary["up"] if summary else "z", (), "", tables, edits)
    try:
        return result.edited(edits)
    except InputError as error:
        raise InputError(f"{folder / EDITS_FILE}: {error}") from None
