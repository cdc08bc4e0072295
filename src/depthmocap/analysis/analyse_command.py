"""``depthmocap analyse``: joint angles, gait, standing up and sitting down, of one result or many."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console

from depthmocap.analysis.analysis_files import (
    PARAMETERS_FILE,
    parameter_row,
    write_events,
    write_parameters,
    write_series,
    write_strides,
)
from depthmocap.analysis.analysis_page import PAGE_FILE, write_page
from depthmocap.analysis.analysis_settings import AnalyseSettings
from depthmocap.analysis.measures import measure, movement, trials
from depthmocap.analysis.movement_charts import angle_charts, cycle_chart
from depthmocap.analysis.steady_joints import steady_joints
from depthmocap.core.console import Terminal
from depthmocap.core.interrupts import deferred_interrupts
from depthmocap.core.locks import locks_outputs
from depthmocap.core.output import make_inner_folder, plain_json, write_file, write_json
from depthmocap.core.reading.json_text import read_json
from depthmocap.core.version import __version__
from depthmocap.errors import InputError
from depthmocap.exporting.exported_take import exported_take
from depthmocap.exporting.stored_result import StoredResult, is_result, read_result

#: Version of what an analysis leaves in a result's folder.
SCHEMA = 1
DONE_FILE = "analysis.json"
#: With fewer poses a second the times of events are coarse.
_EVENT_RATE = 20.0
_PERSON = re.compile(r"person-\d+")
_NO_NAME = re.compile(r"[^\w.-]+")


@locks_outputs(folder="out")
def analyse(settings: AnalyseSettings, console: Console | None = None) -> list[dict[str, Any]]:
    """Analyse every result; returns the rows of parameters.csv.

    A result that cannot be read is told and left out, and the others are done.

    Raises:
        InputError: when there is no result, and at the end when one could not be analysed.
    """
    console = console or Terminal(stderr=True)
    settings.check()
    named = dict(named_results(settings))
    done: dict[str, dict[str, Any]] = {}
    problems: dict[str, InputError] = {}
    for name, folder in named.items():
        try:
            with console.status(f"analysing {name}"):
                done[name] = _analysed(name, folder, settings)
        except InputError as error:
            if len(named) == 1:
                raise
            problems[name] = error
            console.print(f"{name}: {error}")
    if not done:
        raise next(iter(problems.values()))
    rows = [row for document in done.values() for row in document["rows"]]
    with deferred_interrupts():
        write_parameters(settings.out / PARAMETERS_FILE, rows)
        if settings.report:
            write_page(settings.out, settings, done, {name: str(error) for name, error in problems.items()})
    shown = PAGE_FILE if settings.report else PARAMETERS_FILE
    console.print(f"{len(done)} results analysed; look at {settings.out / shown}")
    for name, error in problems.items():
        raise InputError(
            f"{len(problems)} of {len(named)} results could not be analysed, the others were: {name}: {error}"
        )
    return rows


def named_results(settings: AnalyseSettings) -> Iterator[tuple[str, Path]]:
    """The results by names of their own, which are their folders' in ``out``.

    Raises:
        InputError: for a folder without results, and when ``out`` is one.
    """
    if is_result(settings.out):
        raise InputError(f"--out must not be a folder of results, got {settings.out}: choose another name")
    taken: set[str] = set()
    for path in settings.results:
        if is_result(path):
            folders = {path.resolve().name: path}
        else:
            folders = {"-".join(folder.relative_to(path).parts): folder for folder in _within(path)}
        if not folders:
            raise InputError(f"{path} is no folder of results, nor has any: depthmocap run and live write them (--out)")
        for plain, folder in folders.items():
            base = _NO_NAME.sub("-", plain).strip(".") or "result"
            name, number = base, 1
            while name.casefold() in taken:
                number += 1
                name = f"{base}-{number}"
            taken.add(name.casefold())
            yield name, folder


def _within(path: Path) -> list[Path]:
    """Folders of results below a folder; those of people belong to the result that they are in."""
    folders = sorted({file.parent for file in path.rglob("pose.csv") if file.is_file()})
    return [folder for folder in folders if not (_PERSON.fullmatch(folder.name) and is_result(folder.parent))]


def _analysed(name: str, folder: Path, settings: AnalyseSettings) -> dict[str, Any]:
    """What was found in a result, now or before."""
    result = read_result(folder)
    key = _key(name, result, settings)
    path = settings.out / name / DONE_FILE
    if path.is_file():
        try:
            document = read_json(path)
        except InputError:
            document = None
        if isinstance(document, dict) and document.get("key") == key:
            return document
    make_inner_folder(settings.out / name)
    path.unlink(missing_ok=True)
    document = plain_json({"key": key, "result": str(folder), **_analyse(name, result, settings)})
    write_json(path, document)
    return document


def _key(name: str, result: StoredResult, settings: AnalyseSettings) -> str:
    """Changes whenever something that an analysis depends on does."""
    options = dataclasses.asdict(settings)
    del options["results"], options["out"]
    parts = [SCHEMA, __version__, name, result.up, dataclasses.asdict(result.edits), options]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _analyse(name: str, result: StoredResult, settings: AnalyseSettings) -> dict[str, Any]:
    """Write the files of a result; returns its rows of the table, its people with their pictures, and problems."""
    take = exported_take(result)
    parts = trials(take.markers)
    out, rows, people, problems = settings.out / name, [], [], []
    for person in take.people:
        try:
            line = take.rows(person, settings.least_confidence)
            steady = steady_joints(line, settings.cutoff_hz, settings.fill_s)
        except InputError as error:
            problems.append(f"{person.label}: {error}")
            continue
        moved = movement(steady, settings.anthropometry)
        stem = f"person-{person.number}-" if take.several else ""
        write_series(out / f"{stem}series.csv", moved, result.up)
        write_events(out / f"{stem}events.csv", moved)
        write_strides(out / f"{stem}strides.csv", moved)
        pictures = [*angle_charts(moved, parts), *filter(None, [cycle_chart(moved)])] if settings.report else []
        for i, picture in enumerate(pictures):
            write_file(out / f"{stem}chart-{i + 1}.png", picture)
        place = {"result": name, "take": result.name, "person": person.label}
        of_result = [parameter_row(place, trial, value) for trial in parts for value in measure(moved, trial)]
        rows += of_result
        frames_per_second = 1 / moved.steady.frame_s
        if frames_per_second < _EVENT_RATE:
            problems.append(
                f"{person.label}: only {frames_per_second:.1f} poses a second: heel strikes and toe-offs are coarse, "
                "and the errors that are told, measured at 30, do not hold for times."
            )
        people.append(
            {
                "person": person.label,
                "seconds": float(moved.steady.times_s[-1] - moved.steady.times_s[0]),
                "frames_per_second": frames_per_second,
                "strides": len(moved.strides),
                "pictures": [f"{stem}chart-{i + 1}.png" for i in range(len(pictures))],
            }
        )
    if not people:
        raise InputError(problems[0] if problems else f"{result.folder}: nobody is left after the corrections")
    return {"rows": rows, "people": people, "trials": [trial.name for trial in parts], "problems": problems}
