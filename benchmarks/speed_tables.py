"""Tables of docs/results/speed.md. They are of the machine that they were measured on, and name its processor."""

from __future__ import annotations

import re
from typing import Any

import people_tables
import time_tables
from measurements import Measurement, Scale

PAGES = ("docs/results/speed.md",)
#: Shown beside the names that ``record_rows.py`` prints: what a coding is called here.
_CODINGS = {
    "delta-zstd (ours)": "**`delta-zstd`**",
    "RVL": "RVL (in Numba)",
    "png (Huffman, up; ours)": '`png` (Huffman only, filter "up")',
    "png (OpenCV's default)": "PNG, OpenCV's default",
    "delta, planes, lz4": "delta and byte planes, lz4",
    "zstd 3": "zstd 3 of raw depth",
    "zstd 1": "zstd 1 of raw depth",
    "lz4": "lz4 of raw depth",
}


def measurements(clips: str, scale: Scale) -> dict[str, Measurement]:
    """By name: the commands that these tables name."""
    minutes = str(scale.minutes), str(scale.minutes / 3)
    quick = ("--quick",) if scale.quick else ()
    others = {**time_tables.measurements(clips, scale), **people_tables.measurements(clips, scale)}
    return {
        "demo": Measurement(("demo", "--out", "{folder}"), "summary.json"),
        "benchmark": Measurement(("run.py", *quick)),
        **{name: others[name] for name in ("motion", "people_meeting")},
        "soak_faults": Measurement(("soak.py", "--minutes", minutes[0]), cores=1),
        "soak_perfect": Measurement(("soak.py", "--minutes", minutes[1], "--no-faults"), cores=2),
        **_views(scale),
        "codings": Measurement(("record_rows.py", *(("--samples", "1", "--rounds", "1") if quick else ()))),
    }


#: Runs with a viewer and streams: name, heading, and what their command has besides.
_VIEWED = {
    "view_one": ("one person", ()),
    "view_two": ("two people", ("--people", "2")),
    "view_core": ("one person, `live` on one core", ("--live-cores", "0", "--other-cores", "1")),
}


def _views(scale: Scale) -> dict[str, Measurement]:
    short = ("live_figures.py", "--minutes", str(max(scale.minutes / 3, 0.3)))
    runs = {name: Measurement((*short, *words)) for name, (_, words) in _VIEWED.items()}
    return {**runs, "view_memory": Measurement(("live_figures.py", "--minutes", str(scale.minutes)))}


def _row(numbers: dict[str, Any], what: str) -> dict[str, Any]:
    return next(row for row in numbers["benchmark"]["rows"] if row["what"] == what)


def _machine(numbers: dict[str, Any]) -> str:
    machine = numbers["benchmark"]["machine"]
    return f"{machine['usable_cores']} cores of {machine['processor']}"


def stages(numbers: dict[str, Any]) -> list[str]:
    """What each stage takes."""
    machine, summary = _machine(numbers), numbers["demo"]
    four, label = (
        _row(numbers, "Pipeline, a set of 4 masked Kinects"),
        _row(numbers, "Label a view (fast), 4 views a call"),
    )
    rate = re.match(r"([\d.]+) sets a second over (\d+) s", four["note"])
    assert rate is not None
    filters = numbers["motion"]["views 3"]
    free = {name: row["us_per_frame"] / 1e3 for name, row in filters.items() if name.endswith("free bones")}
    steady = [filters[name.replace("free", "steady")]["us_per_frame"] / 1e3 - ms for name, ms in free.items()]
    people = [row["cpu_ms_per_view"] for row in numbers["people_meeting"].values() if "cpu_ms_per_view" in row]
    written = [
        1e3 / _row(numbers, f"Write a frame: hard, {layout}")["ours"]["median_ms"] for layout in ("ubc3v", "shards")
    ]
    rows = {
        f"the demo recording, {len(summary['frames_by_camera'])} cameras, files read (`make demo`)":
            f"{summary['frames_per_second']:.0f} sets a second",
        f"masked depth of four 512×424 cameras to joints, {rate[2]} s without rest (`make benchmark`)":
            f"{float(rate[1]):.0f} sets a second, 95 % within {four['ours']['p95_ms']:.0f} ms",
        "labelling a view, window and all, four views a call (`make benchmark`)":
            f"{label['ours']['median_ms']:.1f} ms; the paper's network takes {label['ratio']:.1f} times as long",
        "a filter over time (`evaluate motion`)":
            f"{min(free.values()):.1f}–{max(free.values()):.1f} ms of CPU a frame, steady bones "
            f"{sum(steady) / len(steady):.1f} ms",
        "finding people (`evaluate people`)": f"{min(people):.1f} to {max(people):.1f} ms of CPU a view",
        "the data engine to disk (`make benchmark`)":
            f"{written[0]:.0f} frames a second in UBC3V's layout, {written[1]:.0f} in shards: "
            "[the plan of a large set](../guides/data.md#planning-six-million-frames)",
    }  # fmt: skip
    return [f"| {machine} | |", "|---|---|", *(f"| {what} | {cell} |" for what, cell in rows.items())]


def _at(memory: dict[str, Any], minutes: float) -> float:
    """Resident memory (MB) nearest to a time."""
    return min(memory["mb"], key=lambda look: abs(look[0] - 60 * minutes))[1]


def live(numbers: dict[str, Any]) -> list[str]:
    """Long runs with and without faults."""
    runs = numbers["soak_faults"], numbers["soak_perfect"]
    titles = (
        f"{title}, {run['settings']['minutes']:g} minutes, {cores}"
        for title, run, cores in zip(("with all faults", "perfect"), runs, ("**one** core", "two cores"), strict=True)
    )
    sent = [sum(run["frames_sent"].values()) // len(run["frames_sent"]) for run in runs]
    rows = {
        f"sets a second, of {runs[0]['settings']['rate_hz']:g}": [f"{run['sets_per_second']:.1f}" for run in runs],
        "latency from the last frame's arrival, p50; p95":
            [f"{run['latency_ms']['p50']:.1f}; {run['latency_ms']['p95']:.1f} ms" for run in runs],
        "sets left out": [f"{run['sets_dropped']:,} of {sets:,}" for run, sets in zip(runs, sent, strict=True)],
        "frames not recorded; compression": [
            f"{run['recording']['lost']:,} of {sum(run['recording']['offered'].values()):,}; "
            f"{run['recording']['ratio']:.2f}:1"
            for run in runs
        ],
        "cores used, cameras and recording included": [f"{run['cpu_cores']:.2f}" for run in runs],
        "memory": [
            f"{_at(run['memory'], 1):,.0f} MB after a minute, {run['memory']['mb_at_the_end']:,.0f} at the end: "
            f"{run['memory']['mb_a_minute']:.2f} MB a minute over the second half"
            for run in runs
        ],
    }  # fmt: skip
    head = f"| Four cameras, one person, recording on; {numbers['benchmark']['machine']['processor']} | "
    lines = [head + " | ".join(titles) + " |", "|---|---|---|"]
    return lines + [f"| {what} | {' | '.join(cells)} |" for what, cells in rows.items()]


def _of_streams(run: dict[str, Any], key: str) -> str:
    """A number (ms) of each stream."""
    return ", ".join(f"{scheme} {stream[key]:.0f}" for scheme, stream in run["streams"].items()) + " ms"


def views(numbers: dict[str, Any]) -> list[str]:
    """Runs of the command with a page that is looked at and streams."""
    runs = [numbers[name] for name in _VIEWED]
    headings = [
        f"{title}, {run['settings']['minutes']:g} minutes"
        for (title, _), run in zip(_VIEWED.values(), runs, strict=True)
    ]
    unrecorded = [f"{run['frames_unrecorded']:,} of {sum(run['frames']['offered'].values()):,}" for run in runs]
    rows: dict[str, tuple[str, list[str]]] = {
        "sets a second, of 30": ("≥ 29.5; two people 24; one core 20",
            [f"{run['sets_per_second']:.1f}" for run in runs]),
        "sets left out": ("", [f"{run['sets_dropped']:,} of {run['sets_dropped'] + run['sets']:,}" for run in runs]),
        "sets labelled in some of the views only": ("", [f"{run.get('sets_labelled_in_part', 0):,}" for run in runs]),
        "frames not recorded": ("0", unrecorded),
        "last exposure of a set to the arrival of its packet, beyond the cameras' transport, p50":
            ("", [_of_streams(run, "p50_ms") for run in runs]),
        "the same, p95": ("≤ 45 ms", [_of_streams(run, "p95_ms") for run in runs]),
        "memory of `live`, most": ("≤ 500 MB", [f"{run['memory']['mb_most']:.0f} MB" for run in runs]),
        "the command to the first joint": ("≤ 3 s", [f"{run['start_s']:.1f} s" for run in runs]),
        "cores used by `live`; by the cameras": ("",
            [f"{run['cores']['live']:.2f}; {run['cores']['cameras']:.2f}" for run in runs]),
    }  # fmt: skip
    lines = [f"| | wanted | {' | '.join(headings)} |", "|---|---|" + "---|" * len(runs)]
    lines += [f"| {what} | {goal} | {' | '.join(cells)} |" for what, (goal, cells) in rows.items()]
    long, memory = numbers["view_memory"], numbers["view_memory"]["memory"]
    grown = (
        f"{_at(memory, 1):.0f} MB after a minute, {memory['mb_at_the_end']:.0f} MB at the end: "
        f"{memory['mb_a_minute']:+.2f} MB a minute over the later half"
    )
    what = f"memory over {long['settings']['minutes']:g} minutes, one person"
    return [*lines, f"| {what} | no growth | {grown} | | |"]


def codings(numbers: dict[str, Any]) -> list[str]:
    """Codings of depth."""
    lines = ["| Coding | Ratio | Coded a second | Decoded a second |", "|---|---|---|---|"]
    for name, text in _CODINGS.items():
        row = numbers["codings"]["codings"][name]
        decoded = "" if row["decoded_a_second"] is None else f" {row['decoded_a_second']:.0f}"
        lines.append(f"| {text} | {row['ratio']:.2f} | {row['coded_a_second']:.0f} |{decoded} |")
    return lines


TABLES = {"speed": stages, "live": live, "views": views, "codings": codings}
