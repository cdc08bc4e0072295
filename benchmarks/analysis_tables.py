"""Tables of docs/results/analysis.md: how far the numbers of ``analyse`` are from the truth."""

from __future__ import annotations

import functools
from typing import Any

from measurements import Measurement, Scale

from depthmocap.evaluate.analysis_protocol import cells_of, quantities_in_order

PAGES = ("docs/results/analysis.md",)
#: Kinds of motion and their headings.
KINDS = {"walking": "straight on", "turning": "in turns", "seat": "chair", "clip": "captured walks", "all": "all"}


def measurements(clips: str, scale: Scale) -> dict[str, Measurement]:
    """By name: the command that these tables name."""
    words = ("evaluate", "analysis", "--out", "{folder}", "--postures", clips)
    few = ("--sequences", "1", "--clips", "1") if scale.quick else ("--sequences", "3", "--clips", "8")
    return {"analysis": Measurement((*words, *few))}


def errors(numbers: dict[str, Any], views: int, ranges: bool) -> list[str]:
    """Every quantity on so many views, with ranges of angles or without."""
    rows = numbers["analysis"][f"views {views}"]
    lines = [
        f"| {views} view{'s' * (views > 1)} | unit | {' | '.join(KINDS.values())} | 95 % within | found |",
        "|---" * (len(KINDS) + 4) + "|",
    ]
    for name in quantities_in_order(rows["all"]):
        if name.endswith(" range") and not ranges:
            continue
        unit, cells = cells_of(name, {kind: rows.get(kind, {}) for kind in KINDS})
        lines.append(f"| {name.replace('_', ' ')} | {unit} | {' | '.join(cells)} |")
    return lines


TABLES = {f"analysis_{views}": functools.partial(errors, views=views, ranges=views == 3) for views in (3, 2, 1)}
