"""Tables of the README and of docs/results/index.md: the bench, and its paper-like set."""

from __future__ import annotations

from typing import Any

from measurements import Measurement, Scale, share

PAGES = ("README.md", "docs/results/index.md")
ORDINARY = ("seen", "new clothes", "new sensor", "seated", "hands on body")
RARE = (
    "leaning", "floor", "acrobatic", "overhead", "cut knees", "cut hips", "cut chest", "cut waist", "cut side",
    "cut edge",
)  # fmt: skip
_MISPLACED = ("--misplaced-mm", "10", "--misplaced-deg", "0.5")


def measurements(clips: str, scale: Scale) -> dict[str, Measurement]:
    """By name: the commands that these tables name."""
    bench = ("evaluate", "bench", "--postures", clips, "--workers", "0")
    seen = (*bench, "--samples", str(scale.samples), "--sets")
    rare = (*bench, "--samples", str(scale.rare), "--sets", *RARE)
    made = (
        "synth", "--out", "{folder}", "--subset", "hard", "--split", "test", "--samples", str(scale.hard), "--seed",
        "1", "--noise", "sensor", "--postures", clips,
    )  # fmt: skip
    hard = ("evaluate", "ubc3v", "{out}/hard_set")
    numbers = {
        "bench": (*seen, *ORDINARY),
        "bench_2_views": (*seen, "seen", "--views", "2"),
        "bench_1_view": (*seen, "seen", "--views", "1"),
        "bench_misplaced": (*seen, "seen", *_MISPLACED),
        "bench_ridge": (*seen, "seen", "--estimator", "ridge"),
        "bench_true": (*seen, "seen", "--labels", "true"),
        "rare": rare,
        "rare_1_view": (*rare, "--views", "1"),
        "hard": (*hard, "--views", "3"),
        "hard_2_views": (*hard, "--views", "2"),
        "hard_1_view": (*hard, "--views", "1"),
        "hard_ridge": (*hard, "--views", "3", "--estimator", "ridge"),
        "hard_true": (*hard, "--views", "3", "--labels", "true"),
    }
    return {"hard_set": Measurement(made, None)} | {name: Measurement(words) for name, words in numbers.items()}


def error(numbers: dict[str, Any]) -> str:
    return f"{numbers['mean_joint_error_cm']:.2f} cm ({share(numbers['within_10cm'])})"


def labels(numbers: dict[str, Any]) -> str:
    return f"{share(numbers['pixel_accuracy'])} ({share(numbers['class_accuracy'])})"


def headline(numbers: dict[str, dict[str, Any]]) -> list[str]:
    """What counts most, on both sets."""
    bench, hard = numbers["bench"], numbers["hard"]
    seen = {name: numbers[name]["seen"] for name in numbers if name.startswith("bench")}
    fewer = [f"{error(seen['bench_2_views'])}; {error(seen['bench_1_view'])}",
             f"{error(numbers['hard_2_views'])}; {error(numbers['hard_1_view'])}"]  # fmt: skip
    rows = [
        ("pixels labelled right, of 43 regions (mean per region)", labels(seen["bench"]), labels(hard)),
        ("mean joint error, 3 views (within 10 cm)", error(seen["bench"]), error(hard)),
        ("the same by ridge regression from the paper's features, on the same labels", error(seen["bench_ridge"]),
         error(numbers["hard_ridge"])),
        ("mean joint error, 2 views; 1 view", *fewer),
        ("with true labels, 3 views: the pose stage at its best", error(seen["bench_true"]),
         error(numbers["hard_true"])),
        ("cameras off by 10 mm and 0.5°", error(seen["bench_misplaced"]), ""),
        ("clothes never trained on (coats), 3 views", error(bench["new clothes"]), ""),
        ("a sensor never trained on (Kinect 1), 3 views", error(bench["new sensor"]), ""),
        ("people who sit; who lay hands on themselves, 3 views",
         f"{error(bench['seated'])}; {error(bench['hands on body'])}", ""),
    ]  # fmt: skip
    lines = ["| | `bench` | its paper-like `hard` |", "|---|---|---|"]
    return lines + [f"| {what} | {first} | {second} |".replace("|  |", "| |") for what, first, second in rows]


def sets(numbers: dict[str, dict[str, Any]]) -> list[str]:
    """Every set and estimator, 3 views where nothing else is told."""
    bench = numbers["bench"]
    rows = [
        (f"`bench`, {bench['seen']['frames']} postures", "votes", bench["seen"]),
        ("`bench`", "ridge", numbers["bench_ridge"]["seen"]),
        ("… coats, never trained on", "votes", bench["new clothes"]),
        ("… Kinect 1, never trained on", "votes", bench["new sensor"]),
        ("… people who sit", "votes", bench["seated"]),
        ("… people who lay hands on themselves", "votes", bench["hands on body"]),
        ("… cameras off by 10 mm and 0.5°", "votes", numbers["bench_misplaced"]["seen"]),
        ("… 2 views", "votes", numbers["bench_2_views"]["seen"]),
        ("… 1 view", "votes", numbers["bench_1_view"]["seen"]),
        ("`bench`, true labels", "votes", numbers["bench_true"]["seen"]),
        (f"`hard`, {numbers['hard']['frames']} postures", "votes", numbers["hard"]),
        ("`hard`", "ridge", numbers["hard_ridge"]),
        ("… 2 views", "votes", numbers["hard_2_views"]),
        ("… 1 view", "votes", numbers["hard_1_view"]),
        ("`hard`, true labels", "votes", numbers["hard_true"]),
    ]
    lines = [
        "| test set, 3 views | estimator | pixels | regions (mean) | other side | joint error | within 10 cm |",
        "|---|---|---|---|---|---|---|",
    ]
    for what, estimator, row in rows:
        labels = [share(row["pixel_accuracy"]), share(row["class_accuracy"]), f"{100 * row['side_swap']:.2f} %"]
        cells = labels if row["labels"] == "network" else ["", "", ""]
        joints = [f"{row['mean_joint_error_cm']:.2f} cm", share(row["within_10cm"])]
        lines.append(" ".join(f"| {cell}" if cell else "|" for cell in (what, estimator, *cells, *joints)) + " |")
    return lines


def rare(numbers: dict[str, dict[str, Any]]) -> list[str]:
    """People who are cut off, low or seen from overhead."""
    lines = [
        "| set | pixels | 3 views | told at 0.9 or more (within 10 cm) | 1 view | turned round, 1 view (surely) |",
        "|---|---|---|---|---|---|",
    ]
    for name in RARE:
        row, one = numbers["rare"][name], numbers["rare_1_view"][name]
        told = row["reliability"]  # its last bin is that of 0.9 and more
        told = f"{100 * told['joints'][-1] / sum(told['joints']):.0f} % ({share(told['within_10cm'][-1])})"
        turned = f"{share(one['turned_round'])} ({share(one['turned_round_surely'])})"
        cells = (f"`{name}`", share(row["pixel_accuracy"]), error(row), told, error(one), turned)
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def readme(numbers: dict[str, dict[str, Any]]) -> list[str]:
    """The few numbers of the first page."""
    bench = numbers["bench"]
    seen = {name: numbers[name]["seen"] for name in numbers if name.startswith("bench")}
    cells = [error(seen[name]) for name in ("bench", "bench_2_views", "bench_1_view")]
    unseen = [f"{bench[name]['mean_joint_error_cm']:.2f} cm" for name in ("new clothes", "new sensor")]
    return [
        "| Measured on our own generated test set `bench` (not UBC3V) | 3 views | 2 views | 1 view |",
        "|---|---|---|---|",
        f"| mean joint error (within 10 cm) | {' | '.join(cells)} |",
        f"| ridge regression from the paper's features, on the same labels | {error(seen['bench_ridge'])} | | |",
        f"| cameras off by 10 mm and 0.5° | {error(seen['bench_misplaced'])} | | |",
        f"| clothes; a sensor never trained on | {'; '.join(unseen)} | | |",
        f"| pixels labelled right, of 43 regions | {share(seen['bench']['pixel_accuracy'])} | | |",
    ]


TABLES = {"readme": readme, "headline": headline, "sets": sets, "rare": rare}
