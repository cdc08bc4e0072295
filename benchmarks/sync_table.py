"""The table of the trial of clocks that share nothing (``sync_trial.py``)."""

from __future__ import annotations

from typing import Any

import numpy as np

#: An error from here to here (seconds) is about a stride: one step, or two.
_STRIDE_S = (0.25, 1.8)
#: An offset that is further off than this (seconds) is wrong.
_WRONG_S = 0.04


def sync_table(rows: list[dict[str, Any]]) -> list[str]:
    """A row for each kind of movement and source of tracks."""
    lines = [
        "| | pairs | within 5 ms | within 40 ms | wrong, unsaid | a stride aside | cannot tell | ± held "
        "| false jumps |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for source, kind in dict.fromkeys((row["from"], row["kind"]) for row in rows):
        some = [row for row in rows if (row["from"], row["kind"]) == (source, kind)]
        told = [row for row in some if row["told"]]
        errors_s = np.array([abs(row["error_s"]) for row in told])
        wrong = errors_s > _WRONG_S
        stride = wrong & (errors_s > _STRIDE_S[0]) & (errors_s < _STRIDE_S[1])
        held = sum(abs(row["error_s"]) <= 3 * row["sigma_s"] for row in told)
        cells = (
            len(some), int((errors_s <= 0.005).sum()), int((~wrong).sum()), int(wrong.sum()), int(stride.sum()),
            len(some) - len(told), f"{held} of {len(told)}" if told else "–", sum(row["jump"] for row in told),
        )  # fmt: skip
        lines.append(f"| {kind}, {source} | {' | '.join(map(str, cells))} |")
    return lines
