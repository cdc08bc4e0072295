"""Tables of docs/results/calibration.md: errors of calibration against the truth, and clocks put in step."""

from __future__ import annotations

from typing import Any

import numpy as np
from measurements import Measurement, Scale
from sync_table import sync_table

PAGES = ("docs/results/calibration.md",)
_KINDS = ("3 cameras", "2 cameras, 90° apart")


def measurements(clips: str, scale: Scale) -> dict[str, Measurement]:
    """By name: the commands that these tables name."""
    words, few = ("calibration_trial.py", "{folder}"), ("--seeds", "1", "--pairs", "1", "--depth-kinds", "line")
    sync = ("sync_trial.py", "{folder}")
    fast = (*sync, "--track-hz", "30", "--shared-s", "20", "--depth-kinds")
    return {
        "calibration": Measurement((*words, "--seconds", "10") if scale.quick else words, "trial.json"),
        "sync": Measurement((*sync, *few) if scale.quick else sync, "sync.json"),
        "sync_30_hz": Measurement((*fast, *few[:-2]) if scale.quick else fast, "sync.json"),
    }


def trial(numbers: dict[str, Any]) -> list[str]:
    """A row for each kind of scene: means over its pairs of cameras, and over its repeats."""
    lines = [
        "| | mm | degrees | ± | tilt; height of cameras | joints cm, true rig; found rig |",
        "|---|---|---|---|---|---|",
    ]
    for kind in _KINDS:
        rows = [row for row in numbers["calibration"] if row["scene"] == kind]
        mean = {name: float(np.mean([row[name] for row in rows])) for name, value in rows[0].items()
                if isinstance(value, float)}  # fmt: skip
        worst = {name: max(row[f"most {name}"] for row in rows) for name in ("mm", "degrees")}
        mm, degrees = f"{mean['mm']:.1f}", f"{mean['degrees']:.2f}"
        if not kind.startswith("2 cameras"):  # which are one pair
            mm, degrees = f"{mm} (worst {worst['mm']:.1f})", f"{degrees} ({worst['degrees']:.2f})"
        cells = (
            mm, degrees,
            f"{max(row['± mm'] for row in rows):.1f} mm, {max(row['± degrees'] for row in rows):.2f}°",
            f"{mean['tilt degrees']:.2f}°; {mean['height mm']:.1f} mm",
            f"{mean['joints cm, true rig']:.2f}; {mean['joints cm, found rig']:.2f}",
        )  # fmt: skip
        lines.append(f"| {kind} | {' | '.join(cells)} |")
    return lines


def clocks(numbers: dict[str, Any]) -> list[str]:
    """A row for each kind of movement."""
    return sync_table(numbers["sync"])


def fast_clocks(numbers: dict[str, Any]) -> list[str]:
    """The same for pictures as live cameras give them."""
    return sync_table(numbers["sync_30_hz"])


TABLES = {"calibration": trial, "sync": clocks, "sync_30_hz": fast_clocks}
