"""The page of an analysis: one HTML file, on which every number has its error."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from depthmocap.analysis.analysis_settings import AnalyseSettings
from depthmocap.analysis.joint_angles import UNKNOWN
from depthmocap.analysis.quantities import ANGLES, GAIT, TRANSFERS, Quantity, quantity_of
from depthmocap.report.page import Cell, ReportFigure, ReportSection, ReportTable, write_report

PAGE_FILE = "analysis.html"
#: The numbers that the table over all has.
_OVERVIEW = ("walking_speed", "stride_length", "cadence", "double_support", "sit_to_stand")
NO_DEVICE = (
    "This is no medical device. Its numbers were neither made nor tested for diagnosis, therapy or any decision about "
    "a person's health."
)
#: What the column says.
_ERRORS = (
    "Error is the mean difference of one value from the truth, as measured on generated people who were seen by three "
    "cameras (Results, Analysis, in the documentation). With fewer cameras, or limbs that are half hidden, errors are "
    "larger. A dash: not measured."
)
Row = Mapping[str, Any]


def write_page(
    out: Path, settings: AnalyseSettings, done: Mapping[str, Mapping[str, Any]], problems: Mapping[str, str]
) -> None:
    """Write analysis.html.

    Args:
        done: of every result what its analysis.json has.
        problems: why other results were left out.

    Raises:
        InputError: when it cannot be written.
    """
    sections = [_about(settings, done, problems)]
    for name, document in done.items():
        for person in document["people"]:
            rows = [row for row in document["rows"] if row["person"] == person["person"]]
            heading = name if len(document["people"]) == 1 else f"{name}: {person['person']}"
            sections.append(_of_a_person(out / name, heading, person, document, rows))
    sections.append(_definitions(settings))
    write_report(out / PAGE_FILE, "Movement analysis", sections)


def _about(
    settings: AnalyseSettings, done: Mapping[str, Mapping[str, Any]], problems: Mapping[str, str]
) -> ReportSection:
    header = ["result", "person", "trial", *(_name(quantity_of(name)) for name in _OVERVIEW)]
    table: dict[tuple[str, str, str], dict[str, float]] = {}
    for document in done.values():
        for row in document["rows"]:
            numbers = table.setdefault((row["result"], row["person"], row["trial"]), {})
            if not row["side"]:
                numbers[row["quantity"]] = row["value"]
    quantities = {name: quantity_of(name) for name in _OVERVIEW}
    rows: list[list[Cell]] = [
        [*key, *(_text(numbers.get(name), quantity) for name, quantity in quantities.items())]
        for key, numbers in table.items()
    ]
    errors: list[Cell] = ["error of one value", "", "", *map(_error, quantities.values())]
    text = [NO_DEVICE, _ERRORS]
    text += [f"Left out: {name}: {problem}" for name, problem in problems.items()]
    return ReportSection("All results", text, (ReportTable(header, [*rows, errors], "Both sides."),))


def _of_a_person(
    folder: Path, heading: str, person: Row, document: Mapping[str, Any], rows: Sequence[Row]
) -> ReportSection:
    tables = []
    for trial in document["trials"]:
        of_trial = [row for row in rows if row["trial"] == trial]
        where = "" if trial == "all" else f"{trial}. "
        if walking := _walking(of_trial):
            header = ("walking", "left", "right", "both", "± strides", "strides", "error")
            caption = f"{where}Means of strides, and the standard deviation between them."
            tables.append(ReportTable(header, walking, caption))
        if transfers := [_transfer(row) for row in of_trial if row["quantity"] in TRANSFERS]:
            tables.append(ReportTable(("transfer", "mean", "shortest", "longest", "times", "error"), transfers, where))
        if angles := _angles(of_trial):
            header = ("angle (°)", "side", "smallest", "largest", "range", "error")
            tables.append(
                ReportTable(
                    header,
                    angles,
                    f"{where}Smallest and largest angle that was seen; the error is that of the range.",
                    1,
                )
            )
    text = [f"{person['seconds']:.1f} s at {person['frames_per_second']:.1f} poses a second; `{document['result']}`."]
    if not person["strides"]:
        text.append("No stride was seen as a whole, so that there is no number of walking.")
    text += document["problems"]
    pictures = [folder / name for name in person["pictures"] if (folder / name).is_file()]
    figures = [ReportFigure(picture.read_bytes(), chart=True) for picture in pictures]
    return ReportSection(heading, text, tables, figures)


def _walking(rows: Sequence[Row]) -> list[list[Cell]]:
    values = {(row["quantity"], row["side"]): row for row in rows}
    result: list[list[Cell]] = []
    names = [*GAIT, *(f"{name}_asymmetry" for name in GAIT), "mass_centre_range"]
    for name in names:
        both = values.get((name, ""))
        if both is None:
            continue
        quantity = quantity_of(name)
        sides = [values.get((name, side)) for side in ("left", "right")]
        cells = [_text(row["value"] if row else None, quantity) for row in (*sides, both)]
        spread = _text(both["standard_deviation"], quantity)
        result.append([_name(quantity), *cells, spread, both["n"], _error(quantity)])
    return result


def _transfer(row: Row) -> list[Cell]:
    quantity = quantity_of(row["quantity"])
    numbers = [_text(row[key], quantity) for key in ("value", "smallest", "largest")]
    return [_name(quantity), *numbers, row["n"], _error(quantity)]


def _angles(rows: Sequence[Row]) -> list[list[Cell]]:
    return [
        [quantity_of(row["quantity"]).label, row["side"], row["smallest"], row["largest"], row["value"],
         _error(quantity_of(row["quantity"]))]
        for row in rows if row["quantity"] in ANGLES
    ]  # fmt: skip


def _name(quantity: Quantity) -> str:
    return f"{quantity.label} ({quantity.unit})"


def _text(value: float | None, quantity: Quantity) -> str:
    """A number with its own digits, for columns whose rows have different units."""
    if value is None or math.isnan(value):
        return "–"
    return f"{value:.{quantity.decimals}f}".replace("-", "−")


def _error(quantity: Quantity) -> str:
    return "–" if quantity.error is None else f"{quantity.error:.2g}"


def _definitions(settings: AnalyseSettings) -> ReportSection:
    text = (
        f"Joints with a confidence below {settings.least_confidence:g} count as not seen; gaps up to "
        f"{settings.fill_s:g} s are filled, longer ones stay gaps, and no number is made of them. Joints are low-pass "
        f"filtered at {settings.cutoff_hz:g} Hz (0: not at all).",
        "Heel strikes are told by the ankles' speed, toe-offs by how legs move, and by the toes' speed where these are "
        "told. Angles follow the conventions of the International Society of Biomechanics on joint centres, so that "
        "zeros may differ by a "
        f"constant few degrees. Joints do not tell: {UNKNOWN}. Centre of mass: segment masses of de Leva 1996 "
        f"({settings.anthropometry}).",
    )
    rows = [(quantity.label, quantity.unit, quantity.meaning) for quantity in (*GAIT.values(), *TRANSFERS.values())]
    return ReportSection("How it is measured", text, (ReportTable(("number", "unit", "what it is"), rows),))
