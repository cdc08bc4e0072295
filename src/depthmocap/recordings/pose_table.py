"""Tables of joints over time in CSV: the columns of ``pose.csv`` and a recording's ``truth.csv``, and their reader."""

from __future__ import annotations

import csv
import dataclasses
import io
from decimal import Decimal
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from depthmocap.body.skeleton import JOINTS
from depthmocap.core.reading.input_files import read_text
from depthmocap.errors import InputError
from depthmocap.frames import Pose

#: Column of the seconds since the first row.
TIME = "time_s"
#: Column of the timestamps on the frames' clock.
STAMP = "timestamp_ns"
_POSITION_COLUMNS = [f"{joint}_{axis}" for joint in JOINTS for axis in "xyz"]
_CONFIDENCE_COLUMNS = [f"{joint}_confidence" for joint in JOINTS]
#: The columns of pose.csv.
HEADER: tuple[str, ...] = (
    TIME, *(f"{joint}_{field}" for joint in JOINTS for field in ("x", "y", "z", "confidence")), STAMP,
)  # fmt: skip
_OWN_HEADER = ",".join(HEADER)
#: As floats, nanoseconds since 1970 are not exact.
_OWN_ROW = np.dtype([("numbers", np.float64, len(HEADER) - 1), ("stamp", np.int64)])
#: What no file of depthmocap's has in its rows, but a reader of numbers may take.
_NOT_WRITTEN = '"_ \t\r#+'
#: Up to so many seconds a float is exact to a nanosecond.
_EXACT_S = 1e6
#: The columns of truth.csv. It has no time_s, because deleting the first frames would shift such times.
TRUTH_HEADER: tuple[str, ...] = (STAMP, *_POSITION_COLUMNS)
#: Largest absolute value of a timestamp (ns).
_MOST_NS = 2**63 - 1


@dataclasses.dataclass(frozen=True, eq=False)
class PoseTable:
    """Rows of a file with the columns of pose.csv or truth.csv.

    Attributes:
        stamps_ns: times on the frames' clock if the file has them (``on_clock``), otherwise the column ``time_s``,
            whose origin is unknown.
        on_clock: whether ``stamps_ns`` is on the frames' clock.
        times_s: the column ``time_s``; without it, seconds since the first row.
        joints: metres, NaN where unobserved.
        confidence: 0 to 1, 0 where unobserved.
        points, points_confidence: the same of points of the skin (``body.landmarks.POINTS``), where a file tells them.
    """

    stamps_ns: Int[ndarray, " t"]
    on_clock: bool
    times_s: Float[ndarray, " t"]
    joints: Float[ndarray, "t 18 3"]
    confidence: Float[ndarray, "t 18"]
    points: Float[ndarray, "t 18 3"] | None = None
    points_confidence: Float[ndarray, "t 18"] | None = None

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def poses(self) -> list[Pose]:
        """The rows as poses."""
        columns = [self.stamps_ns.tolist(), self.joints, self.confidence]
        if self.points is not None and self.points_confidence is not None:
            columns += [self.points, self.points_confidence]
        return [Pose(*row) for row in zip(*columns, strict=True)]


def read_csv(path: Path) -> tuple[Float[ndarray, " t"], Float[ndarray, "t 18 3"], Float[ndarray, "t 18"]]:
    """Times (s), joints (m, NaN where unobserved) and confidences of a file, read by :func:`read_table`.

    Raises:
        InputError: when :func:`read_table` raises it.
    """
    table = read_table(path)
    return table.times_s, table.joints, table.confidence


def read_table(path: Path) -> PoseTable:
    """Read a file with the columns of pose.csv or of a recording's truth.csv.

    The columns may be in any order, and other columns are ignored. ``time_s`` or ``timestamp_ns`` alone is enough. An
    empty cell is NaN. Without confidence columns an observed joint has confidence 1, and an unobserved one has 0.

    Raises:
        InputError: when the file is missing or empty, lacks a column, or has a cell that is not a number or times
            that go back.
    """
    text = read_text(path)
    if (table := _own_table(text)) is not None:
        return table
    try:
        rows = [row for row in csv.reader(io.StringIO(text)) if row]
    except csv.Error as error:
        raise InputError(f"{path} cannot be read as CSV: {error}") from None
    if len(rows) < 2:
        raise InputError(f"{path} holds no rows: expected a header line and one line per pose")
    columns = {name.strip(): i for i, name in enumerate(rows[0])}
    clocks = [name for name in (STAMP, TIME) if name in columns]
    absent = [] if clocks else [f"{TIME} or {STAMP}"]
    if absent := absent + [name for name in _POSITION_COLUMNS if name not in columns]:
        more = f" and {len(absent) - 3} more" if len(absent) > 3 else ""
        raise InputError(
            f"{path} lacks the columns {', '.join(absent[:3])}{more}; expected {HEADER[0]}, {HEADER[1]}, …"
        )
    confidence_columns = [name for name in _CONFIDENCE_COLUMNS if name in columns]
    if confidence_columns and len(confidence_columns) < len(JOINTS):
        raise InputError(
            f"{path} has a confidence column for {len(confidence_columns)} of {len(JOINTS)} joints: all or none"
        )

    value_columns = [columns[name] for name in (*_POSITION_COLUMNS, *confidence_columns)]
    table = np.empty((len(rows) - 1, len(value_columns)))
    stamps: dict[str, list[int]] = {name: [] for name in clocks}
    for i, row in enumerate(rows[1:]):
        if len(row) != len(rows[0]):
            raise InputError(f"{path}, row {i + 2}: {len(row)} cells where the header has {len(rows[0])}")
        try:
            table[i] = [float(row[column].strip() or "nan") for column in value_columns]
        except ValueError as error:
            raise InputError(f"{path}, row {i + 2}: {error}") from None
        for name in clocks:
            stamps[name].append(_nanoseconds(path, i + 2, name, row[columns[name]].strip()))
    stamps_ns = np.array(stamps[clocks[0]], np.int64)
    for name in clocks:
        if (np.diff(np.array(stamps[name], np.int64)) < 0).any():
            raise InputError(f"{path}: {name} must not go back from row to row")
    if np.isinf(table).any():
        raise InputError(f"{path} holds an infinite number; write nan for an unobserved joint")
    times_s = np.array(stamps[TIME], np.int64) if TIME in stamps else stamps_ns - stamps_ns[0]
    joints = table[:, :54].reshape(-1, len(JOINTS), 3)
    observed = np.asarray(~np.isnan(joints).any(-1))
    joints = np.where(observed[..., None], joints, np.nan)
    confidence = table[:, 54:] if confidence_columns else observed.astype(np.float64)
    confidence = np.where(np.isnan(confidence), 0.0, confidence)
    return PoseTable(stamps_ns, clocks[0] == STAMP, times_s * 1e-9, joints, confidence)


def _own_table(text: str) -> PoseTable | None:
    """The table of a file as depthmocap writes it, read all at once; None for any other file, and for one with a fault,
    which is found and told row by row."""
    header, _, body = text.partition("\n")
    if header != _OWN_HEADER or not body or any(letter in body for letter in _NOT_WRITTEN):
        return None
    try:
        rows = np.loadtxt(body.splitlines(), _OWN_ROW, delimiter=",", ndmin=1, comments=None)
    except (ValueError, OverflowError):
        return None
    numbers, stamps_ns = rows["numbers"], rows["stamp"].copy()
    if not (np.abs(numbers[:, 0]) < _EXACT_S).all():
        return None
    times_ns = np.rint(numbers[:, 0] * 1e9).astype(np.int64)
    values = numbers[:, 1:].reshape(-1, len(JOINTS), 4)
    if np.isinf(values).any() or (np.diff(times_ns) < 0).any() or (np.diff(stamps_ns) < 0).any():
        return None
    observed = np.asarray(~np.isnan(values[..., :3]).any(-1))
    joints = np.where(observed[..., None], values[..., :3], np.nan)
    confidence = np.where(np.isnan(values[..., 3]), 0.0, values[..., 3])
    return PoseTable(stamps_ns, True, times_ns * 1e-9, joints, confidence)


def _nanoseconds(path: Path, row: int, column: str, cell: str) -> int:
    """The exact time in a cell (ns): as a float, seconds since 1970 are not exact to a nanosecond."""
    try:
        number = Decimal(cell)
        stamp = round(number * (1 if column == STAMP else 10**9)) if abs(number) <= _MOST_NS else None
        if stamp is not None and abs(stamp) <= _MOST_NS:
            return stamp
    except (ArithmeticError, ValueError):  # Decimal raises both
        pass
    raise InputError(f"{path}, row {row}: {column} must be a number in every row, got {cell[:40]!r}")
