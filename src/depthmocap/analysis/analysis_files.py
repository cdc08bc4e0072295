"""The CSV files of an analysis."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from depthmocap.analysis.measures import Measure, Movement, Trial
from depthmocap.analysis.quantities import quantity_of
from depthmocap.analysis.strides import STRIDE_QUANTITIES
from depthmocap.core.output import write_file
from depthmocap.exporting.timeline import y_up_from

#: Columns of the table over all results.
PARAMETER_COLUMNS = (
    "result", "take", "person", "trial", "quantity", "side", "value", "unit", "error", "standard_deviation", "n",
    "smallest", "largest",
)  # fmt: skip
PARAMETERS_FILE = "parameters.csv"


def parameter_row(place: Mapping[str, str], trial: Trial, measure: Measure) -> dict[str, Any]:
    """A row of the table.

    Args:
        place: result, take and person.
    """
    quantity = quantity_of(measure.quantity)
    return {
        **place,
        "trial": trial.name,
        "quantity": measure.quantity,
        "side": measure.side,
        "value": measure.value,
        "unit": quantity.unit,
        "error": quantity.error,
        "standard_deviation": measure.deviation,
        "n": measure.n,
        "smallest": measure.low,
        "largest": measure.high,
    }


def write_parameters(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write rows of :func:`parameter_row`.

    Raises:
        InputError: when the file cannot be written.
    """
    write_table(path, PARAMETER_COLUMNS, [[row[name] for name in PARAMETER_COLUMNS] for row in rows])


def write_series(path: Path, moved: Movement, up: str) -> None:
    """Write angles (degrees) and the centre of mass (m, in the rig's world) over time; empty where not seen."""
    mass_centre = moved.mass_centre @ y_up_from(up)
    columns = ("time_s", *moved.angles, *(f"mass_centre_{axis}" for axis in "xyz"))
    rows = zip(moved.steady.times_s, *moved.angles.values(), *mass_centre.T, strict=True)
    write_table(path, columns, rows)


def write_events(path: Path, moved: Movement) -> None:
    """Write heel strikes, toe-offs and transfers in the order of time."""
    rows: list[tuple[float, str, str]] = []
    for swing in moved.swings:
        rows += [(swing.toe_off_s, "toe off", swing.side), (swing.heel_strike_s, "heel strike", swing.side)]
    for transfer in moved.transfers:
        name = transfer.kind.replace("_", " ")
        rows += [(transfer.start_s, f"{name}, start", ""), (transfer.end_s, f"{name}, end", "")]
    write_table(path, ("time_s", "event", "side"), sorted(rows))


def write_strides(path: Path, moved: Movement) -> None:
    """Write every stride with its numbers."""
    rows = [
        (stride.side, stride.start_s, stride.end_s, *(stride.values[name] for name in STRIDE_QUANTITIES))
        for stride in moved.strides
    ]
    write_table(path, ("side", "start_s", "end_s", *STRIDE_QUANTITIES), rows)


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a CSV file; NaN and None are empty cells."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_cell(value) for value in row] for row in rows)
    write_file(path, text.getvalue())


def _cell(value: Any) -> Any:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return f"{value:.4f}" if isinstance(value, float) else value
