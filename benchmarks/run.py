"""Speed of each stage, compared with a reference that a user would otherwise run.

    python benchmarks/run.py [--quick] [--json FILE]

Ours and the reference run in turns in one process, so that both see the same machine: trust the ratios more than the
milliseconds. On a busy machine trust neither, since code on several threads loses more there than code on one. Needs
the extras ``train`` and ``dev``; what is missing is left out and named. Informs only: the exit status is 0.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib.metadata
import json
import os
import platform
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import body_rows
import engine_rows
import label_rows
import pose_rows
import record_rows
import tyro
from rich.console import Console
from rich.table import Table
from timing import Bench, Row, Timing

from depthmocap.core.cores import usable_cores
from depthmocap.errors import InputError

#: Load per core at the start above which the numbers mean little.
_BUSY = 0.5
_PACKAGES = ("depthmocap", "numpy", "numba", "onnxruntime", "torch", "anny", "embreex")


@dataclasses.dataclass(frozen=True)
class Settings:
    """Time each stage beside a reference.

    Attributes:
        json: also write everything to this file.
        quick: few runs, for a look.
        runs: timed runs of each function.
        threads: of the networks, ours and the references'; 0 for as many as this process may use.
        seconds: how long four cameras run without rest.
        recording: a recording for the whole pipeline instead of the packaged one.
    """

    json: Path | None = None
    quick: bool = False
    runs: int = 40
    threads: int = 0
    seconds: float = 60.0
    recording: Path | None = None


def machine() -> dict[str, Any]:
    """The machine and the versions that the numbers depend on."""
    return {
        "platform": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "usable_cores": usable_cores(),
        "load_1min": round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
        **{name: _version(name) for name in _PACKAGES},
    }


def _processor() -> str:
    """The processor's name: Linux has it in a file, elsewhere Python may know it."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def measure(settings: Settings, folder: Path, console: Console) -> Bench:
    """Run every group of rows; one that cannot run becomes a note."""
    runs, warm_up = (8, 2) if settings.quick else (max(settings.runs, 1), 4)
    bench = Bench(runs, warm_up, settings.threads or usable_cores(), folder)
    groups: dict[str, Callable[[Bench], None]] = {
        "rendering": body_rows.rendering,
        "rendering beside Open3D": body_rows.rendering_open3d,
        "posing": body_rows.posing,
        "making frames": engine_rows.frames,
        "writing frames": engine_rows.written,
        "storing frames": engine_rows.storing,
        "labelling": label_rows.labelling,
        "segmentation": pose_rows.segmentation,
        "joints": pose_rows.joints,
        "recording": record_rows.rows,
        "four cameras": functools.partial(pose_rows.four_cameras, seconds=5.0 if settings.quick else settings.seconds),
        "whole pipeline": functools.partial(pose_rows.whole_pipeline, recording=settings.recording),
    }
    for name, group in groups.items():
        with console.status(f"measuring {name}"):
            try:
                group(bench)
            except (ImportError, InputError) as error:
                bench.notes.append(f"{name} left out: {error}")
            except Exception as error:  # a fault in one stage must not hide the others' numbers
                bench.notes.append(f"{name} FAILED: {type(error).__name__}: {error}")
    return bench


def table(bench: Bench, caption: str) -> Table:
    """The rows as a table."""
    rows_table = Table(title=f"milliseconds, median of {bench.runs} runs", caption=caption, caption_justify="left")
    rows_table.add_column("what")
    rows_table.add_column("ours", justify="right")
    rows_table.add_column("p95", justify="right")
    rows_table.add_column("goal", justify="right")
    rows_table.add_column("reference")
    rows_table.add_column("its ms", justify="right")
    rows_table.add_column("p95", justify="right")
    rows_table.add_column("ratio", justify="right")
    rows_table.add_column("same")
    rows_table.add_column("note", style="dim")
    before: Row | None = None
    for row in bench.rows:
        # Cells equal to those of the row above stay empty.
        what = "" if before and row.what == before.what else row.what
        note = "" if before and row.note == before.note else row.note
        before = row
        rows_table.add_row(
            what, *_times(row.ours), _goal(row), row.reference_name, *_times(row.reference),
            "" if row.ratio is None else f"{row.ratio:.2f}×",
            {None: "", True: "yes", False: "[red]NO"}[row.agrees], note,
        )  # fmt: skip
    return rows_table


def _times(timing: Timing | None) -> tuple[str, str]:
    return ("", "") if timing is None else (f"{timing.median_ms:.2f}", f"{timing.p95_ms:.2f}")


def _goal(row: Row) -> str:
    if row.goal_ms is None:
        return ""
    return f"[{'green' if row.goal_met else 'red'}]≤ {row.goal_ms:g} {'met' if row.goal_met else 'missed'}"


def as_json(bench: Bench, machine_before: dict[str, Any], load_after: float | None) -> dict[str, Any]:
    """Everything that was measured."""
    rows = [{**dataclasses.asdict(row), "ratio": row.ratio, "goal_met": row.goal_met} for row in bench.rows]
    return {
        "machine": {**machine_before, "load_1min_after": load_after},
        "runs": bench.runs,
        "warm_up": bench.warm_up,
        "threads": bench.threads,
        "rows": rows,
        "notes": bench.notes,
    }


def main(settings: Settings) -> None:
    """Measure, print and write."""
    console = Console()
    if not console.is_terminal:  # a file or a log has no width of its own
        console = Console(width=170)
    before = machine()
    with tempfile.TemporaryDirectory() as folder:
        bench = measure(settings, Path(folder), console)
    if (before["load_1min"] or 0) > _BUSY * before["usable_cores"]:
        bench.notes.append("the machine was BUSY before this began: neither times nor ratios are worth quoting")
    after = machine()["load_1min"]
    caption = (
        "ratio: the reference's median by ours, above 1 ours is faster. same: results agree.\n"
        f"{before['processor']}, {before['usable_cores']} of {before['cores']} cores, {before['platform']}; "
        f"load {before['load_1min']} before, {after} after\n"
        + ", ".join(f"{name} {before[name]}" for name in ("python", *_PACKAGES) if before[name])
    )
    console.print(table(bench, caption))
    for note in bench.notes:
        console.print(f"• {note}", markup=False, highlight=False)
    if settings.json is not None:
        settings.json.parent.mkdir(parents=True, exist_ok=True)
        settings.json.write_text(json.dumps(as_json(bench, before, after), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(tyro.cli(Settings))
