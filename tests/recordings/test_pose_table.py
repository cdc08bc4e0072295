"""A table is read the same at once as row by row."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from depthmocap.errors import InputError
from depthmocap.exporting import write_csv
from depthmocap.frames import Pose
from depthmocap.recordings import pose_table
from depthmocap.recordings.pose_table import read_table


@pytest.fixture
def path(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    joints = rng.normal(size=(20, 18, 3)).round(6)
    joints[3, 4:7] = np.nan
    confidence = np.where(np.isnan(joints[..., 0]), 0.0, 0.5)
    stamps = 1_700_000_000_003_728_001 + np.arange(20) * 33_333_333
    write_csv(tmp_path / "pose.csv", [Pose(*row) for row in zip(stamps.tolist(), joints, confidence, strict=True)])
    return tmp_path / "pose.csv"


def test_at_once_as_row_by_row(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    at_once = read_table(path)
    monkeypatch.setattr(pose_table, "_own_table", lambda text: None)
    by_row = read_table(path)
    assert at_once.on_clock and by_row.on_clock and at_once.stamps_ns[-1] % 10 == 8
    for key in ("stamps_ns", "times_s", "joints", "confidence"):
        assert np.array_equal(getattr(at_once, key), getattr(by_row, key), equal_nan=True), key


@pytest.mark.parametrize("cell", ["inf", "1,2", "one", "", "0x10", '"1"', "1_0", " 1"])
def test_other_cells_are_read_row_by_row(path: Path, cell: str, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second, *rest = path.read_text().split("\n")
    path.write_text("\n".join([first, ",".join([*second.split(",")[:5], cell, *second.split(",")[6:]]), *rest]))

    def answer() -> str:
        try:
            return repr(read_table(path).joints[0].tolist())
        except InputError as error:
            return str(error)

    at_once = answer()
    monkeypatch.setattr(pose_table, "_own_table", lambda text: None)
    assert at_once == answer()
