"""Tables of docs/results/time.md: what the filters do to joints over time."""

from __future__ import annotations

import functools
from typing import Any

from measurements import Measurement, Scale

from depthmocap.smooth.filters import AUTO

PAGES = ("docs/results/time.md",)
_HEADINGS = (
    "error cm", "acceleration error mm/frame² (m/s²)", "jitter at rest mm", "foot skate cm/s", "bones ± mm",
    "flips per 1,000", "lag ms", "waits ms",
)  # fmt: skip


def measurements(clips: str, scale: Scale) -> dict[str, Measurement]:
    """By name: the command that these tables name."""
    words = (
        "evaluate", "motion", "--out", "{folder}", "--postures", clips, "--sequences", str(scale.sequences), "--seed",
        "1", "--out-of-step-ms", "16",
    )  # fmt: skip
    return {"motion": Measurement((*words, "--seconds", "1") if scale.quick else words)}


def filters(numbers: dict[str, Any], views: int) -> list[str]:
    """Every filter, on so many views."""
    lines = [
        f"| {views} view{'s' * (views > 1)} | {' | '.join(_HEADINGS)} |",
        "|---" * (len(_HEADINGS) + 1) + "|",
    ]
    for name, row in numbers["motion"][f"views {views}"].items():
        shown = f"**{name}** (`auto`)" if name == f"{AUTO}, steady bones" else name
        cells = (
            f"{row['mean_joint_error_cm']:.2f}",
            f"{row['acceleration_error_mm']:.1f} ({row['acceleration_error_mps2']:.1f})",
            f"{row['rest_jitter_mm']:.2f}",
            f"{row['foot_skate_cmps']:.1f}",
            f"{row['bone_deviation_mm']:.1f}",
            f"{row['flips_per_1000']:.1f}",
            f"{row['lag_ms']:.0f}",
            f"{row['waits_ms']:.0f}",
        )
        lines.append(f"| {shown} | {' | '.join(cells)} |")
    return lines


TABLES = {
    "time_3_views": functools.partial(filters, views=3),
    "time_1_view": functools.partial(filters, views=1),
}
