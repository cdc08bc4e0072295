"""Tables of docs/results/time.md: what the filters do to joints over time."""

from __future__ import annotations

import functools
import math
import statistics
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
    # The skeletons are of the same estimates.
    skeleton = (
        "evaluate", "skeleton", "--out", "{out}/motion", "--postures", clips, "--sequences", str(scale.sequences),
        "--seed", "1",
    )  # fmt: skip
    quick = ("--seconds", "1") if scale.quick else ()
    return {"motion": Measurement((*words, *quick)), "skeleton": Measurement((*skeleton, *quick))}


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


#: Rows of the table of skeletons: key of the numbers, words, digits, factor.
SKELETON_ROWS = (
    ("limb_swing_deg", "limbs: direction, °", 1, 1),
    ("limb_twist_deg", "limbs: twist, °", 1, 1),
    ("pelvis_deg", "pelvis, °", 1, 1),
    ("spine_deg", "spine, °", 1, 1),
    ("neck_deg", "neck, °", 1, 1),
    ("head_deg", "head, °", 1, 1),
    ("trunk_head_deg", "trunk and head together, °", 1, 1),
    ("hands_deg", "hands, °", 1, 1),
    ("feet_deg", "feet, °", 1, 1),
    ("joint_error_cm", "joints, cm", 2, 1),
    ("told_joint_error_cm", "joints that were told, cm", 2, 1),
    ("free_joint_error_cm", "these before, cm", 2, 1),
    ("foot_skate_mm", "skate of standing feet, mm a frame", 2, 1),
    ("free_foot_skate_mm", "skate before, mm a frame", 2, 1),
    ("held_in_swing", "feet held in swing, %", 1, 100),
    ("length_variation_mm", "range of bones' lengths, mm", 1, 1),
    ("knee_rms_deg", "knee flexion, RMS °", 1, 1),
    ("elbow_rms_deg", "elbow flexion, RMS °", 1, 1),
    ("landmarks_head_cm", "surface landmarks: head, cm", 1, 1),
    ("landmarks_trunk_cm", "– trunk, cm", 1, 1),
    ("landmarks_pelvis_cm", "– pelvis, cm", 1, 1),
    ("landmarks_arms_cm", "– elbows and wrists, cm", 1, 1),
    ("landmarks_hands_cm", "– knuckles, cm", 1, 1),
    ("landmarks_tips_cm", "– finger tips, cm", 1, 1),
    ("landmarks_legs_cm", "– knees and ankles, cm", 1, 1),
    ("landmarks_feet_cm", "– heels and toes, cm", 1, 1),
)


def skeletons(numbers: dict[str, Any]) -> list[str]:
    """Of true and estimated joints, as files have them and as they are made live."""
    numbers = numbers["skeleton"]
    columns = [name for name, row in numbers.items() if isinstance(row, dict) and "limb_swing_deg" in row]
    seen = columns[-2]  # of files
    lines = [f"| | {' | '.join(columns)} | {seen}, median of sequences |", "|---" * (len(columns) + 2) + "|"]
    for key, words, digits, factor in SKELETON_ROWS:
        values = [numbers[name].get(key, math.nan) for name in columns]
        each = [row.get(key, math.nan) for row in numbers[seen]["sequences"]]
        median = statistics.median(each) if not any(math.isnan(value) for value in each) else math.nan
        cells = ["–" if math.isnan(value) else f"{factor * value:.{digits}f}" for value in (*values, median)]
        lines.append(f"| {words} | {' | '.join(cells)} |")
    return lines


TABLES = {
    "time_3_views": functools.partial(filters, views=3),
    "time_1_view": functools.partial(filters, views=1),
    "time_skeleton": skeletons,
}
