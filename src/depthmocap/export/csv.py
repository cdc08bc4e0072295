"""``pose.csv`` (and ``truth.csv``): one row per pose, in the rig's own world, metres."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINTS
from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.output import LineFile

TIME = "time_s"
_POSITION_COLUMNS = [f"{joint}_{axis}" for joint in JOINTS for axis in "xyz"]
_CONFIDENCE_COLUMNS = [f"{joint}_confidence" for joint in JOINTS]
HEADER: tuple[str, ...] = (TIME, *(f"{joint}_{field}" for joint in JOINTS for field in ("x", "y", "z", "confidence")))


class CsvWriter:
    """Writes poses one by one, each at once and whole, so that a run that is cut off keeps what was done.

    ``time_s`` counts from the first pose. An unobserved joint is written ``nan``.

    Raises:
        InputError: when the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: LineFile | None = None
        self._first_ns: int | None = None

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

    def write(self, pose: Pose) -> None:
        """Append one pose."""
        if self._first_ns is None:
            self._first_ns = pose.timestamp_ns
        cells = [f"{(pose.timestamp_ns - self._first_ns) * 1e-9:.9f}"]
        for (x, y, z), confidence in zip(pose.joints.tolist(), pose.confidence.tolist(), strict=True):
            cells.append(f"{x:.6f},{y:.6f},{z:.6f},{confidence:.4f}")
        self._write_line(",".join(cells))

    def _write_line(self, line: str) -> None:
        if self._file is None:
            raise ValueError("CsvWriter is closed: use it as `with CsvWriter(path) as writer:`")
        self._file.add(line)


def write_csv(path: Path, poses: Sequence[Pose]) -> None:
    """Write all poses (see :class:`CsvWriter`).

    Raises:
        InputError: when the file cannot be written.
    """
    with CsvWriter(path) as writer:
        for pose in poses:
            writer.write(pose)


def read_csv(path: Path) -> tuple[Float[ndarray, " t"], Float[ndarray, "t 18 3"], Float[ndarray, "t 18"]]:
    """Times (s), joints (m, NaN where unobserved) and confidences of a file with the columns of ``write_csv``.

    Columns are found by name, in any order; others are ignored. An empty cell is NaN. Without the confidence
    columns an observed joint has confidence 1 and an unobserved one 0.

    Raises:
        InputError: when the file is missing or empty, lacks a column, or has a cell that is not a number or times
            that go back.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if row]
    except FileNotFoundError:
        raise InputError(f"{path} not found") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path} cannot be read as CSV: {error}") from error
    if len(rows) < 2:
        raise InputError(f"{path} holds no rows: expected a header line and one line per pose")
    columns = {name.strip(): i for i, name in enumerate(rows[0])}
    if absent := [name for name in (TIME, *_POSITION_COLUMNS) if name not in columns]:
        more = f" and {len(absent) - 3} more" if len(absent) > 3 else ""
        raise InputError(
            f"{path} lacks the columns {', '.join(absent[:3])}{more}; expected {HEADER[0]}, {HEADER[1]}, …"
        )
    given = [name for name in _CONFIDENCE_COLUMNS if name in columns]
    if given and len(given) < len(JOINTS):
        raise InputError(f"{path} has a confidence column for {len(given)} of {len(JOINTS)} joints: all or none")

    wanted = [columns[name] for name in (TIME, *_POSITION_COLUMNS, *given)]
    table = np.empty((len(rows) - 1, len(wanted)))
    for i, row in enumerate(rows[1:]):
        if len(row) != len(rows[0]):
            raise InputError(f"{path}, row {i + 2}: {len(row)} cells where the header has {len(rows[0])}")
        try:
            table[i] = [float(row[column].strip() or "nan") for column in wanted]
        except ValueError as error:
            raise InputError(f"{path}, row {i + 2}: {error}") from None
    times_s, joints = table[:, 0], table[:, 1:55].reshape(-1, len(JOINTS), 3)
    if not np.isfinite(times_s).all() or (np.diff(times_s) < 0).any():
        raise InputError(f"{path}: {TIME} must be a number in every row and must not go back")
    if np.isinf(table).any():
        raise InputError(f"{path} holds an infinite number; write nan for an unobserved joint")
    observed = np.asarray(~np.isnan(joints).any(-1))
    joints = np.where(observed[..., None], joints, np.nan)
    confidence = table[:, 55:] if given else observed.astype(np.float64)
    confidence = np.where(np.isnan(confidence), 0.0, confidence)
    return times_s, joints, confidence
