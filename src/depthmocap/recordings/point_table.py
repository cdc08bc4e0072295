"""``points.csv``: points of the skin beside the joints of ``pose.csv``, where the estimator tells them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from depthmocap.body.landmarks import POINTS
from depthmocap.core.reading.input_files import read_text
from depthmocap.errors import InputError
from depthmocap.recordings.pose_table import STAMP, PoseTable, read_table

#: The columns of points.csv.
POINT_HEADER: tuple[str, ...] = (
    STAMP, *(f"{point}_{field}" for point in POINTS for field in ("x", "y", "z", "confidence")),
)  # fmt: skip
POINTS_FILE = "points.csv"
POSE_FILE = "pose.csv"
_ROW = np.dtype([("stamp", np.int64), ("numbers", np.float64, 4 * len(POINTS))])


def is_points_file(path: Path) -> bool:
    """Whether a file begins as ``points.csv`` does."""
    beginning = ",".join(POINT_HEADER[:2]).encode()
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(beginning)) == beginning


def read_poses(folder: Path) -> PoseTable:
    """A folder's ``pose.csv``, with the points of its ``points.csv`` if there is one.

    Raises:
        InputError: when a file cannot be read, or is no such file.
    """
    table, path = read_table(folder / POSE_FILE), folder / POINTS_FILE
    return _with_points(table, path) if path.is_file() else table


def _with_points(table: PoseTable, path: Path) -> PoseTable:
    header, _, body = read_text(path).partition("\n")
    if tuple(header.split(",")) != POINT_HEADER:
        raise InputError(f"{path} does not have the columns {', '.join(POINT_HEADER[:2])}, … of points of the skin")
    if not body.strip():
        return table
    try:
        rows = np.loadtxt(body.splitlines(), _ROW, delimiter=",", ndmin=1, comments=None)
    except (ValueError, OverflowError) as error:
        raise InputError(f"{path} cannot be read: {str(error).splitlines()[0]}") from None
    values = rows["numbers"].reshape(-1, len(POINTS), 4)
    if np.isinf(values).any():
        raise InputError(f"{path} holds an infinite number")
    order = np.argsort(rows["stamp"], kind="stable")
    values, stamps_ns = values[order], rows["stamp"][order]
    at = np.minimum(np.searchsorted(stamps_ns, table.stamps_ns), len(stamps_ns) - 1)
    known = (stamps_ns[at] == table.stamps_ns)[:, None] & ~np.isnan(values[at]).any(-1)
    return dataclasses.replace(
        table,
        points=np.where(known[..., None], values[at, :, :3], np.nan),
        points_confidence=np.where(known, values[at, :, 3], 0.0),
    )
