"""The tables of results, made anew by the commands that they name: ``make results CLIPS=folder``.

The numbers of each measurement are kept as JSON in ``out/results``; what is there is not measured again, so that the
hours that all of them take may be spent in parts. Then the tables between the marks ``<!-- results: NAME -->`` and
``<!-- end -->`` are written into the pages. Times (``--only speed``) want a machine that does nothing else.
"""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, get_args

import analysis_tables
import bench_tables
import calibration_tables
import people_tables
import speed_tables
import time_tables
import tyro
from measurements import QUICK, ROOT, Measurement, Scale

import depthmocap
from depthmocap.errors import InputError

Numbers = dict[str, Any]
Group = Literal["bench", "people", "time", "analysis", "calibration", "speed"]


@dataclasses.dataclass(frozen=True)
class Tables:
    """Tables that are made together: the pages with their marks, the measurements, and a function for each mark."""

    pages: tuple[str, ...]
    measurements: Callable[[str, Scale], dict[str, Measurement]]
    tables: dict[str, Callable[[Numbers], list[str]]]

    def make(self, numbers: Numbers) -> dict[str, list[str]]:
        """The lines of each table."""
        return {name: make(numbers) for name, make in self.tables.items()}


GROUPS: dict[Group, Tables] = {
    "bench": Tables(bench_tables.PAGES, bench_tables.measurements, bench_tables.TABLES),
    "people": Tables(people_tables.PAGES, people_tables.measurements, people_tables.TABLES),
    "time": Tables(time_tables.PAGES, time_tables.measurements, time_tables.TABLES),
    "analysis": Tables(analysis_tables.PAGES, analysis_tables.measurements, analysis_tables.TABLES),
    "calibration": Tables(calibration_tables.PAGES, calibration_tables.measurements, calibration_tables.TABLES),
    "speed": Tables(speed_tables.PAGES, speed_tables.measurements, speed_tables.TABLES),
}


@dataclasses.dataclass(frozen=True)
class Settings:
    """Measure what the tables of results tell, and write them.

    Attributes:
        clips: folder of the motion capture clips, as for ``depthmocap evaluate bench --postures``.
        only: which tables; those of the README are of bench.
        out: folder for the numbers of each measurement.
        quick: measure little and print the tables instead, to see that all works; the numbers mean nothing.
    """

    clips: tyro.conf.Positional[Path]
    only: tuple[Group, ...] = get_args(Group)
    out: Path = ROOT / "out" / "results"
    scale: tyro.conf.OmitArgPrefixes[Scale] = dataclasses.field(default_factory=Scale)
    quick: bool = False


def folder_of(settings: Settings, scale: Scale) -> Path:
    """The folder for numbers of these networks and this scale."""
    weights = hashlib.sha256()
    for path in sorted(Path(depthmocap.__file__).parent.rglob("weights/*.onnx")):
        weights.update(path.read_bytes())
    sizes = "-".join(f"{value:g}" for value in dataclasses.astuple(scale))
    return settings.out / f"{weights.hexdigest()[:12]}-{sizes}"


def fill(page: str, tables: dict[str, list[str]]) -> str:
    """A page with its marked tables replaced.

    Raises:
        InputError: when a mark names no table, or has no end.
    """

    def table(mark: re.Match[str]) -> str:
        if mark[1] not in tables:
            raise InputError(f"there is no table {mark[1]!r}: there are {', '.join(tables)}")
        return "\n".join([f"<!-- results: {mark[1]} -->", "", *tables[mark[1]], "", "<!-- end -->"])

    filled, count = re.subn(r"<!-- results: (\w+) -->\n.*?<!-- end -->", table, page, flags=re.DOTALL)
    if count != page.count("<!-- results:"):
        raise InputError("a table's mark has no end: <!-- end -->")
    return filled


def main(settings: Settings) -> None:
    """Measure, and write the tables into the pages."""
    scale = QUICK if settings.quick else settings.scale
    out = folder_of(settings, scale)
    out.mkdir(parents=True, exist_ok=True)
    for group in (GROUPS[name] for name in settings.only):
        measurements = group.measurements(str(settings.clips), scale)
        tables = group.make({name: measurement.read(name, out) for name, measurement in measurements.items()})
        if settings.quick:
            print("\n\n".join("\n".join(lines) for lines in tables.values()))
            continue
        for name in group.pages:
            path = ROOT / name
            path.write_text(fill(path.read_text(encoding="utf-8"), tables), encoding="utf-8")
            print(f"wrote {name}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
