"""Cost of a large set: the table of docs/guides/data.md, from rates measured on this machine.

    python benchmarks/planning.py [--frames 6000000] [--noise sensor] [--samples 2002]

Writes ``--samples`` of the paper's hard set in both layouts, prints the rates, then the table. Rates are assumed to
grow with the cores, up to the measured rate of the one process that stores the ground truth.
"""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path

import engine_rows
import tyro
from engine_rows import Written

from depthmocap.core.cores import usable_cores
from depthmocap.datasets.shards import SAMPLES_PER_SHARD
from depthmocap.datasets.ubc3v import FRAMES_PER_SECTION
from depthmocap.synth.sample import Noise
from depthmocap.synth.writing.units import Layout

_MACHINES = (2, 16, 64)
_CLUSTER = 8 * 16
_VIEWS = 3
_TITLES: dict[Layout, str] = {"ubc3v": "UBC3V's layout", "shards": "shards"}


@dataclasses.dataclass(frozen=True)
class Settings:
    """Measure, and plan.

    Attributes:
        frames: number of frames of the planned set, three per sample.
        noise: of the depth.
        samples: number of samples written for the measurement.
        workers: number of processes; by default one per usable core.
        core_hour: price of an hour of a core.
        gigabyte_month: price of storing a gigabyte for a month.
    """

    frames: int = 6_000_000
    noise: Noise = "none"
    samples: int = 2002
    workers: int | None = None
    core_hour: float = 0.05
    gigabyte_month: float = 0.02


def duration(seconds: float) -> str:
    """A time in minutes or hours."""
    return f"{seconds / 3600:.1f} h" if seconds >= 5400 else f"{seconds / 60:.0f} min"


def column(settings: Settings, layout: Layout, rate: Written) -> list[str]:
    """A layout's cells, below its title."""
    core_ms = 1000 * rate.workers / rate.frames_a_second
    core_s = settings.frames * core_ms / 1000
    driver_s = settings.frames * rate.driver_s / rate.all_frames
    size = rate.size_bytes / rate.all_frames
    gigabytes = settings.frames * size / 1e9
    if layout == "shards":
        files = settings.frames / _VIEWS / SAMPLES_PER_SHARD
    else:
        files = 2 * settings.frames + settings.frames / _VIEWS / FRAMES_PER_SECTION

    def on(cores: int) -> str:
        return duration(rate.start_s + max(core_s / cores, driver_s))

    return [
        f"{rate.frames_a_second:.0f}",
        f"{core_ms:.1f}",
        f"{rate.start_s:.1f}",
        f"{1000 * rate.driver_s / rate.all_frames:.2f}",
        f"{size:,.0f}",
        f"{core_s / 3600:.1f}",
        ", ".join(on(cores) for cores in _MACHINES),
        on(_CLUSTER),
        f"{gigabytes:.0f} GB, {files:,.0f} files",
        f"{core_s / 3600 * settings.core_hour:.2f} $, {gigabytes * settings.gigabyte_month:.2f} $ a month",
    ]


def table(settings: Settings, rates: dict[Layout, Written]) -> str:
    """The table in Markdown."""
    workers = next(iter(rates.values())).workers
    heads = [
        f"frames a second on {workers} cores, by the clock",
        "core milliseconds a frame",
        "start of a process, seconds",
        "of the one process that stores truths: milliseconds a frame",
        "bytes a frame",
        f"{settings.frames:,} frames: core hours",
        f"on one machine of {', '.join(str(cores) for cores in _MACHINES)} cores",
        f"on a cluster of {_CLUSTER} cores",
        "disk",
        f"to make at {settings.core_hour} $ a core hour, to keep at {settings.gigabyte_month} $ a GB and month",
    ]
    columns = [column(settings, layout, rate) for layout, rate in rates.items()]
    lines = ["| | " + " | ".join(_TITLES[layout] for layout in rates) + " |", "|---" * (len(rates) + 1) + "|"]
    lines += [f"| {head} | " + " | ".join(cells) + " |" for head, *cells in zip(heads, *columns, strict=True)]
    return "\n".join(lines)


def main(settings: Settings) -> None:
    """Measure and print."""
    workers = settings.workers or usable_cores()
    layouts: tuple[Layout, ...] = ("ubc3v", "shards")
    with tempfile.TemporaryDirectory() as folder:
        rates: dict[Layout, Written] = {
            layout: engine_rows.write_set(Path(folder) / layout, layout, settings.noise, settings.samples, workers)
            for layout in layouts
        }
    for layout, rate in rates.items():
        print(f"{layout}: {rate.frames} frames in {rate.seconds:.1f} s")
    print(table(settings, rates))


if __name__ == "__main__":
    main(tyro.cli(Settings))
