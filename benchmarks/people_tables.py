"""Tables of docs/results/people.md."""

from __future__ import annotations

from typing import Any

from measurements import Measurement, Scale, share

from depthmocap.evaluate.posture_scenarios import ACTS

PAGES = ("docs/results/people.md",)
WAYS = ("auto", "network", "background")
#: Those that make use of the empty scene.
STATIC = ("auto", "background")
#: What happens in an act, where its name does not say it.
_ACTS = {
    "lies down": "lies down and gets up",
    "falls": "falls and lies",
    "sits on the floor": "sits down on the floor",
    "lies still": "lies still for 3 minutes (3 sets a second)",
    "stands still": "stands still for 3 minutes (3 sets a second)",
    "infant": "an infant on the floor",
    "apart 1 m": "two, 1 m apart",
    "apart 0.6 m": "two, 0.6 m apart",
    "embrace": "an embrace",
    "wheelchair": "in a wheelchair that rolls",
    "in bed": "in bed under a blanket",
    "close up": "one camera, 1 m from the breast",
    "carried": "one camera that is carried about",
}
_JOINTS = {
    "with true masks": "with true masks",
    "by all cameras": "by all cameras (the default)",
    "by each view": "by each view alone: its largest body",
    "alone": "by all cameras, the second person not there",
}
RETURNS = ("two, unlike", "two, alike", "three, unlike", "three, alike", "two and a newcomer")


def measurements(clips: str, scale: Scale) -> dict[str, Measurement]:
    """By name: the commands that these tables name."""
    people = ("evaluate", "people")
    static = ("--segment", *STATIC)
    slow = ("--rate-hz", "1" if scale.quick else "10")
    two = str(min(2, scale.meetings))
    words = {
        "people_postures": (*people, "--scenario", "postures", "--scenes", "1", "--segment", *WAYS),
        "people_rooms": (*people, "--scenario", "rooms", "--scenes", str(scale.rooms), *static),
        "people_meeting": (*people, "--scenes", str(scale.meetings), "--no-joints", *static),
        "people_joints": (*people, "--scenes", two, "--segment", "auto", *slow),
        "people_returns": (*people, "--scenario", "returns", "--scenes", "1", *static, *slow),
        "people_beside": (*people, "--scenario", "beside", "--scenes", two, *static, *slow),
    }
    return {name: Measurement(each) for name, each in words.items()}


def _overlap(row: dict[str, Any]) -> str:
    return f"{row['overlap_mean']:.3f} ({row['overlap_p5']:.2f}) | {share(row['found_share'])}"


def _seconds(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _first_mask(row: dict[str, Any]) -> str:
    return f"{_seconds(row['first_mask_s_p50'])} ({_seconds(row['first_mask_s_most'])})"


def postures(numbers: dict[str, Any]) -> list[str]:
    """One or two people in any posture, by every way of finding people."""
    rows = numbers["people_postures"]
    titles = {way: f"`{way}`" for way in WAYS} | {
        f"{way}, background known": f"`{way}`, the empty scene known" for way in STATIC
    }
    lines = [f"| Overlap with the truth; found | {' | '.join(titles.values())} |", "|---|" + "---|" * len(titles)]
    for act in ACTS:
        cells = [rows.get(f"{act}, {way}") for way in titles]
        shown = ("–" if row is None else f"{row['overlap_mean']:.2f}; {share(row['found_share'])}" for row in cells)
        lines.append(f"| {_ACTS.get(act, act)} | {' | '.join(shown)} |")
    times = [[rows[f"{act}, {way}"]["cpu_ms_per_view"] for act in ACTS if f"{act}, {way}" in rows] for way in titles]
    lines.append(f"| CPU ms a view | {' | '.join(f'{min(each):.1f} to {max(each):.1f}' for each in times)} |")
    return lines


def rooms(numbers: dict[str, Any]) -> list[str]:
    """Rooms without anybody."""
    rows = {way: numbers["people_rooms"][f"rooms without people, {way}"] for way in STATIC}
    return [
        f"| | {' | '.join(f'`{way}`' for way in rows)} |",
        "|---|---|---|",
        "| sets in which somebody is told of | "
        + " | ".join(f"{row['ghost_sets']} of {row['sets']}" for row in rows.values())
        + " |",
    ]


def meeting(numbers: dict[str, Any]) -> list[str]:
    """Two people who cross."""
    rows = {
        f"`{way}`, the empty scene {text}": numbers["people_meeting"][f"meeting, {way}{key}"]
        for text, key in (("known", ", background known"), ("learnt on the run", ""))
        for way in STATIC
    }
    known = next(iter(rows.values()))
    scenes = numbers["people_meeting"]["settings"]["scenes"]
    lines = [
        f"| Masks, {scenes} scenes ({known['sets']:,} sets, {known['arrivals']} arrivals) | overlap with the truth "
        "(5 % quantile) | found | another number | first mask after s, median (most) | sets with a ghost | "
        "CPU ms a view |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {name} | {_overlap(row)} | {row['switches']} times | {_first_mask(row)} | {row['ghost_sets']} | "
        f"{row['cpu_ms_per_view']:.1f} |"
        for name, row in rows.items()
    ]
    return lines


def joints(numbers: dict[str, Any]) -> list[str]:
    """The first person's joints beside another's."""
    settings, rows = numbers["people_joints"]["settings"], numbers["people_joints"]["first person's joints, cm"]
    lines = [
        f"| First person's joints, nothing smoothed (scenes: {settings['scenes']}) | error cm | second within 1.2 m |",
        "|---|---|---|",
    ]
    lines += [f"| {text} | {rows[name]['mean']:.2f} | {rows[name]['near']:.2f} |" for name, text in _JOINTS.items()]
    return lines


def returns(numbers: dict[str, Any]) -> list[str]:
    """Who gets the old number on return."""
    lines = [
        "| Old number, new, somebody else's; found; first mask of an arrival after s, median | "
        + " | ".join(f"`{way}`" for way in STATIC)
        + " |",
        "|---|---|---|",
    ]
    for name in RETURNS:
        cells = []
        for way in STATIC:
            row = numbers["people_returns"][f"{name}, {way}, background known"]
            counts = f"{row['returns_old']}, {row['returns_new']}, {row['returns_wrong']}"
            cells.append(f"{counts}; {share(row['found_share'])}; {_seconds(row['first_mask_s_p50'])}")
        text = f"{name} among them, unlike" if name.endswith("newcomer") else name
        lines.append(f"| {text} | {' | '.join(cells)} |")
    return lines


def beside(numbers: dict[str, Any]) -> list[str]:
    """Somebody who stands at furniture from the start."""
    rows, scenes = numbers["people_beside"], numbers["people_beside"]["settings"]["scenes"]
    lines = [
        f"| {scenes} scenes | overlap with the truth (5 % quantile) | found | first mask after s, median (most) | "
        "sets with a ghost |",
        "|---|---|---|---|---|",
    ]
    for way in STATIC:
        row = rows[f"beside furniture, {way}"]
        lines.append(f"| `{way}` | {_overlap(row)} | {_first_mask(row)} | {row['ghost_sets']} of {row['sets']} |")
    return lines


TABLES = {
    "people_postures": postures, "people_rooms": rooms, "people_meeting": meeting, "people_joints": joints,
    "people_returns": returns, "people_beside": beside,
}  # fmt: skip
