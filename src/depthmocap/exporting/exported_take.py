"""What files of a take are made of: everybody's joints over time, as corrected, from one start."""

from __future__ import annotations

import dataclasses
import re

import numpy as np

from depthmocap.exporting.stored_result import StoredPerson, StoredResult
from depthmocap.exporting.timeline import Timeline, timeline

#: What names in files are made of; other characters mean something in one format or another.
_NO_NAME = re.compile(r"[^\w-]+")


@dataclasses.dataclass(frozen=True, eq=False)
class ExportedTake:
    """A take, or one person of it.

    Attributes:
        up: the world's up axis: "z", "y" or "-y".
        origin_ns: the timestamp of ``time_s`` = 0.
        several: whether people have numbers, and names in files.
        markers: instants with names, in seconds from the start.
    """

    up: str
    origin_ns: int
    people: tuple[StoredPerson, ...]
    several: bool
    markers: tuple[tuple[float, str], ...]

    def of(self, person: StoredPerson) -> ExportedTake:
        """One person alone."""
        return dataclasses.replace(self, people=(person,))

    def name(self, person: StoredPerson) -> str:
        """What a person is called in files: letters, digits, "_" and "-"; "" where there is only one."""
        return _NO_NAME.sub("-", person.label) if self.several or person.name else ""

    def rows(self, person: StoredPerson, least_confidence: float) -> Timeline:
        """A person's joints (Y up) at the times of the poses; those with less confidence are NaN.

        Raises:
            InputError: when none remains.
        """
        return timeline(person.table.poses(), self.up, least_confidence, self.origin_ns)


def exported_take(result: StoredResult) -> ExportedTake:
    """A result as it goes into files."""
    first_ns = result.summary["first_timestamp_ns"] if result.summary else None
    if first_ns is None:  # the summary is missing: time_s counts from it
        table = next(iter(result.original.values()))
        first_ns = int(table.stamps_ns[0] - np.rint(table.times_s[0] * 1e9))
    several = len(result.people) > 1 or not (len(result.original) == 1 and 1 in result.original)
    markers = tuple(((marker.timestamp_ns - first_ns) * 1e-9, marker.text) for marker in result.markers)
    return ExportedTake(result.up, first_ns, result.people, several, markers)
