"""The errors that the page tells are those of the results."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from depthmocap.analysis.measured_errors import ERRORS
from depthmocap.analysis.quantities import ANGLES, GAIT, TRANSFERS, quantity_of

PAGE = Path(__file__).parents[2] / "docs" / "results" / "analysis.md"
#: From the table's units into those of the files.
_UNITS = {"cm": 0.01, "ms": 0.001, "cm/s": 0.01}


def test_errors_are_those_of_the_page() -> None:
    found = re.search(r"<!-- results: analysis_3 -->(.*?)<!-- end -->", PAGE.read_text(encoding="utf-8"), re.S)
    assert found is not None
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in found[1].splitlines() if line.startswith("| ")]
    column = rows[0].index("all")
    table = {row[0].replace(" ", "_"): float(row[column]) * _UNITS.get(row[1], 1.0) for row in rows[1:]}
    assert set(ERRORS) == {*GAIT, *TRANSFERS, *ANGLES}
    for name, error in ERRORS.items():
        told = table[f"{name}_range" if name in ANGLES else name]
        step = _UNITS.get(next(row[1] for row in rows[1:] if row[0].replace(" ", "_") == name), 1.0)
        assert error == pytest.approx(told, rel=0.05, abs=0.06 * step), name
        assert quantity_of(name).error == error
    assert quantity_of("step_length_asymmetry").error is None
