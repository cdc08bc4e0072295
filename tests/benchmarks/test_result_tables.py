"""The tables of results, and the pages that they are written into."""

from __future__ import annotations

from typing import Any

import pytest
import results

from depthmocap.errors import InputError


def _row(error_cm: float) -> dict[str, Any]:
    return {
        "frames": 200, "labels": "network", "mean_joint_error_cm": error_cm, "within_10cm": 0.987,
        "pixel_accuracy": 0.8271, "class_accuracy": 0.7979, "side_swap": 0.0245, "turned_round": 0.05,
        "turned_round_surely": 0.01, "reliability": {"joints": [40, 160], "within_10cm": [0.5, 0.991]},
    }  # fmt: skip


@pytest.fixture
def numbers() -> dict[str, dict[str, Any]]:
    """Every measurement, each with an error of its own."""
    names = results.measurements(results.Settings(results.ROOT), results.ROOT)
    bench = {name: _row(i + 1.234) for i, name in enumerate((*results.ORDINARY, *results.RARE))}
    return {name: {**bench, **_row(9.876)} for name in names}


def test_tables_fill_the_marks_of_the_pages(numbers: dict[str, dict[str, Any]]) -> None:
    tables = {name: make(numbers) for name, make in results.TABLES.items()}
    for name in results.PAGES:
        page = (results.ROOT / name).read_text(encoding="utf-8")
        filled = results.fill(page, tables)
        assert filled != page and results.fill(filled, tables) == filled
        assert filled.count("\n|") == page.count("\n|")  # the tables of the page have the rows that are made
    assert "| mean joint error, 3 views (within 10 cm) | 1.23 cm (98.7 %) | 9.88 cm (98.7 %) |" in tables["headline"]
    assert tables["rare"][2].startswith("| `floor` | 82.7 % | 6.23 cm (98.7 %) | 80 % (99.1 %) | 6.23 cm (98.7 %) |")


@pytest.mark.parametrize("page", ["<!-- results: joy -->\n\n<!-- end -->", "<!-- results: rare -->\n"])
def test_marks_that_cannot_be_right(page: str) -> None:
    with pytest.raises(InputError, match=r"no table 'joy'|no end"):
        results.fill(page, {"rare": []})
