"""What every evaluation can leave behind: all numbers as JSON, a table of joints as CSV, and one HTML page.

Results are numbers by name, as ``metrics.joint_numbers`` and ``synthetic.measure`` make them: one evaluation may have
several, each with a name of its own ("35 joints", "29 joints").
"""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from depthmocap.core.output import atomic_write, check_outputs, write_json
from depthmocap.core.settings import plain_settings
from depthmocap.report.charts import joint_error_bars, precision_curve, reliability_diagram
from depthmocap.report.metrics import JointMetrics, Reliability
from depthmocap.report.page import Cell, ReportFigure, ReportSection, ReportTable, write_report

Numbers = Mapping[str, Any]

#: Single numbers that tables show, where a result has them: key, words, factor, unit.
_MEASURES = (
    ("frames", "frames", 1, ""),
    ("frames_left_out", "frames left out", 1, ""),
    ("frames_without_person", "frames in which nobody was found", 1, ""),
    ("mean_joint_error_cm", "mean joint error", 1, "cm"),
    ("deviation_cm", "its deviation", 1, "cm"),
    ("within_10cm", "joints within 10 cm", 100, "%"),
    ("mean_ap_10cm", "mean over joints of that share (mAP at 10 cm)", 100, "%"),
    ("joints_missing", "joints without an estimate", 1, ""),
    ("pixel_accuracy", "pixels labelled right", 100, "%"),
    ("class_accuracy", "the same, mean per region", 100, "%"),
    ("side_swap", "pixels on the other side", 100, "%"),
    ("ms_per_frame", "median time of a frame", 1, "ms"),
)
_CSV_COLUMNS = ("per_joint_error_cm", "per_joint_deviation_cm", "per_joint_within_10cm")


@dataclasses.dataclass(frozen=True, kw_only=True)
class JsonOutput:
    """The file that every evaluation leaves.

    Attributes:
        json: file for all numbers.
    """

    json: Path | None = None

    def write_numbers(self, numbers: Any) -> None:
        """Write the numbers, if they were asked for.

        Raises:
            InputError: when the file cannot be written.
        """
        if self.json is not None:
            write_json(self.json, numbers)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Outputs(JsonOutput):
    """Files that an evaluation of joints leaves.

    Attributes:
        csv: file for the numbers of each joint.
        report: file for a page with tables and charts (.html).
    """

    csv: Path | None = None
    report: Path | None = None

    def __post_init__(self) -> None:
        read = {
            f"what {name} names": value
            for name, value in vars(self).items()
            if isinstance(value, Path) and name not in FILES
        }
        check_outputs({f"--{name}": getattr(self, name) for name in FILES}, read)


#: The settings that are files.
FILES = tuple(field.name for field in dataclasses.fields(Outputs))


def about(settings: Outputs) -> dict[str, Any]:
    """What an evaluation's numbers depend on besides the data: the version, and all settings but its files."""
    from depthmocap.core.version import __version__

    kept = {key: value for key, value in plain_settings(settings).items() if key not in FILES}
    return {"depthmocap": __version__, **kept}


#: The numbers of a result that :func:`measures` tells.
MEASURE_KEYS: tuple[str, ...] = tuple(key for key, *_ in _MEASURES)


def measures(numbers: Numbers) -> dict[str, tuple[int | float, str]]:
    """The single numbers that a result has, in the units of the tables: by words, value and unit."""
    return {
        words: (float("nan") if numbers[key] is None else numbers[key] * factor, unit)
        for key, words, factor, unit in _MEASURES
        if key in numbers
    }


def write_outputs(outputs: Outputs, title: str, results: Mapping[str, Numbers], document: Any = None) -> None:
    """Write the files that were asked for.

    Args:
        document: what the JSON holds, where it is not the results by name.

    Raises:
        InputError: when a file cannot be written.
    """
    outputs.write_numbers(results if document is None else document)
    if outputs.csv is not None:
        _write_joints(outputs.csv, results)
    if outputs.report is not None:
        write_report(outputs.report, title, report_sections(results))


def finish_evaluation(
    settings: Outputs, title: str, numbers: Mapping[str, Numbers], console: Console, shown: str | None = None
) -> dict[str, dict[str, Any]]:
    """Write and print the numbers by name, and return them with what they depend on (:func:`about`).

    Args:
        shown: the title of what is printed, where it is not that of the files.

    Raises:
        InputError: when a file cannot be written.
    """
    results = {name: {"about": about(settings), **values} for name, values in numbers.items()}
    write_outputs(settings, title, results)
    print_results(shown or title, results, console)
    return results


def print_results(title: str, results: Mapping[str, Numbers], console: Console) -> None:
    """The single numbers of every result side by side."""
    table = Table("", *results, title=title)
    columns = [measures(numbers) for numbers in results.values()]
    for words in dict.fromkeys(words for column in columns for words in column):
        table.add_row(words, *(_cell(*column[words]) if words in column else "" for column in columns))
    console.print(table)
    for problem in dict.fromkeys(problem for numbers in results.values() for problem in numbers.get("problems", [])):
        console.print(f"noticed: {problem}")


def _cell(value: int | float, unit: str) -> str:
    if np.isnan(value):
        return "–"
    return f"{value:.2f} {unit}" if unit else f"{value:,.0f}"


def _write_joints(path: Path, results: Mapping[str, Numbers]) -> None:
    with atomic_write(path) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("result", "joint", "error_cm", "deviation_cm", "within_10cm"))
        for name, numbers in results.items():
            for joint in numbers["per_joint_error_cm"]:
                values = (numbers.get(column, {}).get(joint) for column in _CSV_COLUMNS)
                cells = ("" if value is None or np.isnan(value) else f"{value:.4f}" for value in values)
                writer.writerow((name, joint, *cells))


def _metrics(numbers: Numbers) -> JointMetrics:
    """The numbers as the charts take them."""

    def number(value: float | None) -> float:
        return float("nan") if value is None else value

    by_joint = {
        key: {joint: number(value) for joint, value in numbers.get(key, {}).items()} for key in _CSV_COLUMNS
    }  # fmt: skip
    return JointMetrics(
        frames=numbers["frames"],
        observed=numbers.get("joints_observed", 0),
        missing=numbers.get("joints_missing", 0),
        mean_joint_error_cm=number(numbers["mean_joint_error_cm"]),
        deviation_cm=number(numbers["deviation_cm"]),
        within_10cm=number(numbers["within_10cm"]),
        curve=tuple(number(value) for value in numbers["curve"]),
        **by_joint,
    )


def report_sections(results: Mapping[str, Numbers]) -> list[ReportSection]:
    """Sections of the page: all results side by side, then each of them."""
    metrics = {name: _metrics(numbers) for name, numbers in results.items()}
    columns = {name: measures(numbers) for name, numbers in results.items()}
    rows = {}
    for column in columns.values():
        for words, (_, unit) in column.items():
            rows[words] = f"{words} ({unit})" if unit else words
    table = ReportTable(
        ("", *results),
        [[label, *(column.get(words, (None, ""))[0] for column in columns.values())] for words, label in rows.items()],
    )
    curves = ReportFigure(
        precision_curve(metrics),
        "Share of the joints within each distance of the truth; a joint without an estimate is a miss.",
        chart=True,
    )
    sections = [ReportSection("Numbers", tables=(table,), figures=(curves,))]
    sections += [_section(name, numbers, metrics[name]) for name, numbers in results.items()]
    problems = dict.fromkeys(problem for numbers in results.values() for problem in numbers.get("problems", []))
    notes = ["Noticed while reading: " + "\n".join(problems)] if problems else []
    tables = _settings({name: numbers["about"] for name, numbers in results.items() if "about" in numbers})
    if notes or tables:
        sections.append(ReportSection("How it was measured", notes, tables))
    return sections


def _settings(by_result: Mapping[str, Mapping[str, Any]]) -> list[ReportTable]:
    """Settings that are set; one column where all results have the same."""
    columns = list(by_result.values())
    header = ("setting", *by_result)
    if columns and all(column == columns[0] for column in columns):
        header, columns = ("setting", "value"), columns[:1]
    keys = [
        key
        for key in dict.fromkeys(key for column in columns for key in column)
        if any(column.get(key) is not None for column in columns)
    ]
    rows = [[key.replace("_", " "), *(_setting(column.get(key)) for column in columns)] for key in keys]
    return [ReportTable(header, rows)] if rows else []


def _setting(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value))
    return "–" if value is None else str(value)


def _section(name: str, numbers: Numbers, metrics: JointMetrics) -> ReportSection:
    joints = ReportTable(
        ("joint", "error (cm)", "deviation (cm)", "within 10 cm (%)"),
        [
            [
                joint,
                error,
                metrics.per_joint_deviation_cm.get(joint),
                metrics.per_joint_within_10cm.get(joint, float("nan")) * 100,
            ]
            for joint, error in metrics.per_joint_error_cm.items()
        ],
    )
    tables = [joints]
    if parts := numbers.get("ap_10cm_by_part"):
        tables.append(ReportTable(("part", "mAP at 10 cm (%)"), [[k, v * 100] for k, v in parts.items()]))
    tables += [
        _groups(words, numbers[key])
        for words, key in (("person", "by_subject"), ("action", "by_action"))
        if numbers.get(key)
    ]
    figures = [ReportFigure(joint_error_bars(metrics), "Mean error of each joint, with its deviation.", chart=True)]
    confidence = numbers.get("reliability")
    if confidence and confidence["joints"]:
        figures.append(
            ReportFigure(
                reliability_diagram({name: Reliability(**confidence)}),
                "Joints by their confidence: the share of them within 10 cm. On the diagonal it is a probability.",
                chart=True,
            )
        )
    return ReportSection(name, tables=tables, figures=figures)


def _groups(words: str, groups: Mapping[str, Numbers]) -> ReportTable:
    rows: list[list[Cell]] = [
        [
            group,
            numbers["frames"],
            numbers["mean_joint_error_cm"],
            numbers["deviation_cm"],
            numbers["within_10cm"] * 100,
        ]
        for group, numbers in groups.items()
    ]
    return ReportTable((words, "frames", "error (cm)", "deviation (cm)", "within 10 cm (%)"), rows)
