"""What is shown of a take: a recording, the results of a run, or both, on one timeline."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from depthmocap.errors import InputError
from depthmocap.exporting.stored_result import StoredPerson, StoredResult, is_result, read_result
from depthmocap.frames import FrameSet
from depthmocap.geometry import Rig, load_rig
from depthmocap.recordings.open_recording import open_recording
from depthmocap.recordings.pose_table import PoseTable
from depthmocap.recordings.recording import Recording

#: Suffixes of recordings that are files.
_RECORDING_FILES = (".mcap", ".mkv")
#: Frame period (ns) where there is only one instant.
_SINGLE_NS = 33_333_333
#: Seconds within which only the worst instant counts as one.
WORST_APART_S = 0.5


def nearest_rows(
    stamps_ns: Int[ndarray, " t"], table_ns: Int[ndarray, " n"], tolerance_ns: float | int
) -> Int[ndarray, " t"]:
    """For every instant the nearest row of a table in time; -1 where none is within the tolerance."""
    if not len(table_ns):
        return np.full(len(stamps_ns), -1)
    after = np.clip(np.searchsorted(table_ns, stamps_ns), 1, max(len(table_ns) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(table_ns) - 1)
    nearest = np.where(np.abs(table_ns[after] - stamps_ns) < np.abs(table_ns[before] - stamps_ns), after, before)
    return np.where(np.abs(table_ns[nearest] - stamps_ns) <= tolerance_ns, nearest, -1)


@dataclasses.dataclass(frozen=True, eq=False)
class ViewedPerson:
    """Somebody's poses on the timeline.

    Attributes:
        rows: the row of the table at every instant, -1 where there is none.
    """

    number: int
    label: str
    table: PoseTable
    rows: Int[ndarray, " t"]

    def at(self, index: int) -> tuple[Float[ndarray, "18 3"], Float[ndarray, "18"]] | None:
        """Joints (m) and confidence at an instant; None where there is no pose, or no joint in it."""
        row = int(self.rows[index])
        if row < 0 or not np.isfinite(self.table.joints[row]).any():
            return None
        return self.table.joints[row], self.table.confidence[row]

    def series(self, first: int, end: int) -> tuple[Float[ndarray, "n 18 3"], Float[ndarray, "n 18"]]:
        """Joints (m) and confidence of a range of instants, NaN where there is no pose."""
        rows = self.rows[first:end]
        absent = np.asarray(rows < 0)
        joints = np.where(absent[:, None, None], np.nan, self.table.joints[rows])
        return joints, np.where(absent[:, None], np.nan, self.table.confidence[rows])

    def mean_confidence(self) -> Float[ndarray, " t"]:
        """The mean confidence of all joints at every instant, NaN where they were not seen."""
        by_row = self.table.confidence.mean(1)
        seen = np.asarray(np.isfinite(self.table.joints).any((1, 2)))
        return np.where((self.rows >= 0) & seen[self.rows], by_row[self.rows], np.nan)


def _on_timeline(
    people: tuple[StoredPerson, ...], stamps_ns: Int[ndarray, " t"], period_ns: int, shift_ns: int = 0
) -> tuple[ViewedPerson, ...]:
    return tuple(
        ViewedPerson(
            person.number, person.label, person.table,
            nearest_rows(stamps_ns, person.table.stamps_ns + shift_ns, period_ns / 2),
        )
        for person in people
        if len(person.table)
    )  # fmt: skip


class ViewedTake:
    """A take on its timeline: the instants of the result's poses or, without a result, of the recording's sets.

    Attributes:
        recording: that is shown; None without one.
        result: that is shown; None without one.
        stamps_ns: the instants.
        times_s: the same from the first.
        people: everybody in the result.
        beside: everybody in the result that is shown besides.
        notes: about what does not fit together, one line each.
    """

    def __init__(
        self, recording: Recording | None, result: StoredResult | None, beside: StoredResult | None = None
    ) -> None:
        """
        Raises:
            InputError: when there is nothing to show.
        """
        if recording is None and result is None:
            raise InputError("name a recording or a folder of results")
        self.recording, self.result, self._beside = recording, result, beside
        self.notes: list[str] = []
        self._set_timeline()

    def _set_timeline(self) -> None:
        result, recording = self.result, self.recording
        self.notes.clear()
        sets_ns = recording.set_stamps_ns if recording is not None else np.zeros(0, np.int64)
        of_people = [person.table.stamps_ns for person in result.people] if result is not None else []
        self.stamps_ns = np.unique(np.concatenate(of_people)) if of_people else sets_ns
        if not len(self.stamps_ns):
            raise InputError("there is no pose to show")
        steps = np.diff(self.stamps_ns)
        self.period_ns = int(np.median(steps)) if len(steps) else _SINGLE_NS
        self.times_s = (self.stamps_ns - self.stamps_ns[0]) * 1e-9
        tolerance_ns = max(self.period_ns, recording.period_ns if recording is not None else 0) / 2
        self._sets = nearest_rows(self.stamps_ns, sets_ns, tolerance_ns)
        if recording is not None and (self._sets < 0).all():
            self.notes.append("the recording has no frames at the times of the result: another take?")
        self.people: tuple[ViewedPerson, ...] = (
            () if result is None else _on_timeline(result.people, self.stamps_ns, self.period_ns)
        )
        self.beside: tuple[ViewedPerson, ...] = ()
        if self._beside is not None:
            self.beside = self._place_beside(self._beside)
        self._truth_rows, self._truth = self._find_truth(tolerance_ns)

    def _place_beside(self, beside: StoredResult) -> tuple[ViewedPerson, ...]:
        starts = [int(person.table.stamps_ns[0]) for person in beside.people if len(person.table)]
        ends = [int(person.table.stamps_ns[-1]) for person in beside.people if len(person.table)]
        shift_ns = 0
        if starts and (min(starts) > self.stamps_ns[-1] or max(ends) < self.stamps_ns[0]):
            shift_ns = int(self.stamps_ns[0]) - min(starts)
            self.notes.append("the result beside was taken at another time: both are shown from their first pose on")
        return _on_timeline(beside.people, self.stamps_ns, self.period_ns, shift_ns)

    def _find_truth(self, tolerance_ns: float | int) -> tuple[Int[ndarray, " t"], Float[ndarray, "n 18 3"]]:
        rows = self.recording.truth_rows() if self.recording is not None else []
        if not rows:
            return np.full(len(self.stamps_ns), -1), np.zeros((0, 18, 3))
        table_ns = np.array([stamp for stamp, _ in rows], np.int64)
        return nearest_rows(self.stamps_ns, table_ns, tolerance_ns), np.stack([joints for _, joints in rows])

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def rig(self) -> Rig | None:
        """The cameras of the recording."""
        return None if self.recording is None else self.recording.rig

    @property
    def up(self) -> str:
        """The world's up axis: the recording's, or the result's."""
        if self.recording is not None:
            return self.recording.up
        return self.result.up if self.result is not None else "z"

    @property
    def has_truth(self) -> bool:
        """Whether true joints are known at any instant."""
        return bool((self._truth_rows >= 0).any())

    def change_result(self, result: StoredResult) -> None:
        """Show the result with other corrections.

        Raises:
            InputError: when nothing is left of it; the earlier one is shown then.
        """
        before = self.result
        self.result = result
        try:
            self._set_timeline()
        except InputError:
            self.result = before
            self._set_timeline()
            raise

    def truth(self, first: int, end: int) -> Float[ndarray, "n 18 3"]:
        """The true joints (m) of a range of instants, NaN where they are not known."""
        rows = self._truth_rows[first:end]
        if not len(self._truth):
            return np.full((len(rows), 18, 3), np.nan)
        return np.where(rows[:, None, None] < 0, np.nan, self._truth[rows])

    def frames(self, index: int) -> FrameSet | None:
        """The frames at an instant, read from the recording."""
        row = int(self._sets[index])
        return None if self.recording is None or row < 0 else self.recording[row]

    def index_at(self, timestamp_ns: int) -> int:
        """The instant nearest to a time."""
        after = int(np.clip(np.searchsorted(self.stamps_ns, timestamp_ns), 0, len(self) - 1))
        before = max(after - 1, 0)
        nearer = abs(int(self.stamps_ns[after]) - timestamp_ns) < abs(int(self.stamps_ns[before]) - timestamp_ns)
        return after if nearer else before

    def confidence(self, number: int | None) -> Float[ndarray, " t"]:
        """The mean confidence of a person, or the lowest of everybody in view, at every instant; NaN where they are
        not seen."""
        people = [person for person in self.people if number is None or person.number == number]
        if not people:
            return np.full(len(self), np.nan)
        each = np.stack([person.mean_confidence() for person in people])
        lowest = np.where(np.isnan(each), np.inf, each).min(0)
        return np.where(np.isinf(lowest), np.nan, lowest)

    def error_m(self, number: int | None) -> Float[ndarray, " t"]:
        """The mean distance of the joints from the true ones at every instant, of a person or of whoever is nearest;
        NaN where either is not known."""
        people = [person for person in self.people if number is None or person.number == number]
        truth = self.truth(0, len(self))
        nearest = np.full(len(self), np.inf)
        for person in people:
            apart = np.linalg.norm(person.series(0, len(self))[0] - truth, axis=-1)
            known = np.isfinite(apart)
            mean = np.where(known, apart, 0).sum(1) / np.maximum(known.sum(1), 1)
            nearest = np.minimum(nearest, np.where(known.any(1), mean, np.inf))
        return np.where(np.isinf(nearest), np.nan, nearest)


def gap_starts(seen: Bool[ndarray, " t"]) -> Int[ndarray, " k"]:
    """The first instant of every stretch in which somebody is not seen."""
    return np.flatnonzero(~seen & np.concatenate([[True], seen[:-1]]))


def worst_instants(confidence: Float[ndarray, " t"], times_s: Float[ndarray, " t"], most: int = 20) -> list[int]:
    """Instants of the lowest confidence, the worst first, at least half a second apart."""
    found: list[int] = []
    for index in np.argsort(np.where(np.isnan(confidence), np.inf, confidence), kind="stable").tolist():
        if len(found) == most or np.isnan(confidence[index]):
            break
        if all(abs(times_s[index] - times_s[other]) >= WORST_APART_S for other in found):
            found.append(index)
    return found


def open_take(paths: tuple[Path, ...], beside: Path | None = None, rig: Path | None = None) -> ViewedTake:
    """A take from the paths of a recording, of a folder of results, or of both. With a folder of results alone, its
    recording is shown where it is still there.

    Args:
        beside: a second folder of results.
        rig: of the cameras, in place of the recording's own.

    Raises:
        InputError: when a path is neither, or there are two of a kind.
    """
    recording: Recording | None = None
    result: StoredResult | None = None
    placed = None if rig is None else load_rig(rig)
    for path in paths:
        if is_result(path) and not (path / "rig.json").exists():
            if result is not None:
                raise InputError(f"{path} is a second folder of results: --beside shows two over each other")
            result = read_result(path)
        elif recording is not None:
            raise InputError(f"{path} is a second recording: one is shown at a time")
        else:
            recording = open_recording(path, placed)
    if recording is None and result is not None and (source := _source(result)) is not None:
        recording = open_recording(source, placed)
    return ViewedTake(recording, result, None if beside is None else read_result(beside))


def _source(result: StoredResult) -> Path | None:
    """The recording that a result was made of, if it is there."""
    sources = [Path(source) for source in result.summary["sources"]] if result.summary else []
    if len(sources) != 1 or not (sources[0].suffix.lower() in _RECORDING_FILES or (sources[0] / "rig.json").is_file()):
        return None
    return sources[0] if sources[0].exists() else None
