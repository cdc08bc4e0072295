"""The tables of results, made anew by the commands that they name: ``make results CLIPS=folder``.

Each measurement is one command of ``depthmocap``, whose JSON is kept in ``out/results``; what is there is not measured
again, so that the hours of one core that all of them take may be spent in parts. Then the tables between the marks
``<!-- results: NAME -->`` and ``<!-- end -->`` are written into the pages.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import tyro

from depthmocap.classify.classifier import packaged_weights
from depthmocap.errors import InputError

ROOT = Path(__file__).parents[1]
PAGES = ("README.md", "docs/results/index.md")
ORDINARY = ("seen", "new clothes", "new sensor", "seated", "hands on body")
RARE = ("floor", "acrobatic", "overhead", "cut knees", "cut hips", "cut chest", "cut waist", "cut side", "cut edge")
MISPLACED = ("--misplaced-mm", "10", "--misplaced-deg", "0.5")


@dataclasses.dataclass(frozen=True)
class Settings:
    """Measure what the tables of results tell, and write them.

    Attributes:
        clips: folder of the motion capture clips, as for ``depthmocap evaluate bench --postures``.
        out: folder for the numbers of each measurement.
        samples: postures of each ordinary set.
        rare: postures of each set of rare ones.
        hard: postures of ``hard``.
    """

    clips: tyro.conf.Positional[Path]
    out: Path = ROOT / "out" / "results"
    samples: int = 200
    rare: int = 60
    hard: int = 500


def measurements(settings: Settings, data: Path) -> dict[str, list[str]]:
    """Arguments of ``depthmocap``, by the name of the measurement.

    Args:
        data: where ``hard`` lies.
    """
    bench = ["evaluate", "bench", "--postures", str(settings.clips), "--workers", "0"]
    seen = [*bench, "--samples", str(settings.samples), "--sets"]
    rare = [*bench, "--samples", str(settings.rare), "--sets", *RARE]
    hard = ["evaluate", "ubc3v", str(data)]
    return {
        "bench": [*seen, *ORDINARY],
        "bench_2_views": [*seen, "seen", "--views", "2"],
        "bench_1_view": [*seen, "seen", "--views", "1"],
        "bench_misplaced": [*seen, "seen", *MISPLACED],
        "bench_ridge": [*seen, "seen", "--estimator", "ridge"],
        "bench_true": [*seen, "seen", "--labels", "true"],
        "rare": rare,
        "rare_1_view": [*rare, "--views", "1"],
        "hard": [*hard, "--views", "3"],
        "hard_2_views": [*hard, "--views", "2"],
        "hard_1_view": [*hard, "--views", "1"],
        "hard_ridge": [*hard, "--views", "3", "--estimator", "ridge"],
        "hard_true": [*hard, "--views", "3", "--labels", "true"],
    }


def measure(settings: Settings) -> dict[str, dict[str, Any]]:
    """The numbers of every measurement, by its name; those that are not there yet are measured.

    Raises:
        InputError: when a measurement fails.
    """
    weights = hashlib.sha256(packaged_weights().read_bytes()).hexdigest()[:12]
    sizes = f"{settings.samples}-{settings.rare}-{settings.hard}"
    folder = settings.out / f"{weights}-{sizes}"
    folder.mkdir(parents=True, exist_ok=True)
    data = folder / "hard"
    numbers = {}
    for name, arguments in measurements(settings, data).items():
        path = folder / f"{name}.json"
        if not path.exists():
            if name.startswith("hard") and not (data / "done").exists():
                _depthmocap("synth", "--out", str(data), "--subset", "hard", "--split", "test", "--samples",
                            str(settings.hard), "--seed", "1", "--noise", "sensor", "--postures",
                            str(settings.clips))  # fmt: skip
                (data / "done").touch()
            _depthmocap(*arguments, "--json", str(path))
        numbers[name] = json.loads(path.read_text(encoding="utf-8"))
    return numbers


def _depthmocap(*arguments: str) -> None:
    print("depthmocap", *arguments, flush=True)
    if subprocess.run([sys.executable, "-m", "depthmocap.cli", *arguments], check=False).returncode:
        raise InputError(f"depthmocap {' '.join(arguments[:2])} failed: see above")


def _share(share: float) -> str:
    return f"{100 * share:.1f} %"


def _error(numbers: dict[str, Any]) -> str:
    return f"{numbers['mean_joint_error_cm']:.2f} cm ({_share(numbers['within_10cm'])})"


def _labels(numbers: dict[str, Any]) -> str:
    return f"{_share(numbers['pixel_accuracy'])} ({_share(numbers['class_accuracy'])})"


def headline(numbers: dict[str, dict[str, Any]]) -> list[str]:
    """What counts most, on both sets."""
    bench, hard = numbers["bench"], numbers["hard"]
    seen = {name: numbers[name]["seen"] for name in numbers if name.startswith("bench")}
    fewer = [f"{_error(seen['bench_2_views'])}; {_error(seen['bench_1_view'])}",
             f"{_error(numbers['hard_2_views'])}; {_error(numbers['hard_1_view'])}"]  # fmt: skip
    rows = [
        ("pixels labelled right, of 43 regions (mean per region)", _labels(seen["bench"]), _labels(hard)),
        ("mean joint error, 3 views (within 10 cm)", _error(seen["bench"]), _error(hard)),
        ("the same by ridge regression from the paper's features, on the same labels", _error(seen["bench_ridge"]),
         _error(numbers["hard_ridge"])),
        ("mean joint error, 2 views; 1 view", *fewer),
        ("with true labels, 3 views: the pose stage at its best", _error(seen["bench_true"]),
         _error(numbers["hard_true"])),
        ("cameras off by 10 mm and 0.5°", _error(seen["bench_misplaced"]), ""),
        ("clothes never trained on (coats), 3 views", _error(bench["new clothes"]), ""),
        ("a sensor never trained on (Kinect 1), 3 views", _error(bench["new sensor"]), ""),
        ("people who sit; who lay hands on themselves, 3 views",
         f"{_error(bench['seated'])}; {_error(bench['hands on body'])}", ""),
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
        labels = [_share(row["pixel_accuracy"]), _share(row["class_accuracy"]), f"{100 * row['side_swap']:.2f} %"]
        cells = labels if row["labels"] == "network" else ["", "", ""]
        joints = [f"{row['mean_joint_error_cm']:.2f} cm", _share(row["within_10cm"])]
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
        told = f"{100 * told['joints'][-1] / sum(told['joints']):.0f} % ({_share(told['within_10cm'][-1])})"
        turned = f"{_share(one['turned_round'])} ({_share(one['turned_round_surely'])})"
        cells = (f"`{name}`", _share(row["pixel_accuracy"]), _error(row), told, _error(one), turned)
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def readme(numbers: dict[str, dict[str, Any]]) -> list[str]:
    """The few numbers of the first page."""
    bench = numbers["bench"]
    seen = {name: numbers[name]["seen"] for name in numbers if name.startswith("bench")}
    cells = [_error(seen[name]) for name in ("bench", "bench_2_views", "bench_1_view")]
    unseen = [f"{bench[name]['mean_joint_error_cm']:.2f} cm" for name in ("new clothes", "new sensor")]
    return [
        "| Measured on our own generated test set `bench` (not UBC3V) | 3 views | 2 views | 1 view |",
        "|---|---|---|---|",
        f"| mean joint error (within 10 cm) | {' | '.join(cells)} |",
        f"| ridge regression from the paper's features, on the same labels | {_error(seen['bench_ridge'])} | | |",
        f"| cameras off by 10 mm and 0.5° | {_error(seen['bench_misplaced'])} | | |",
        f"| clothes; a sensor never trained on | {'; '.join(unseen)} | | |",
        f"| pixels labelled right, of 43 regions | {_share(seen['bench']['pixel_accuracy'])} | | |",
    ]


TABLES: dict[str, Callable[[dict[str, dict[str, Any]]], list[str]]] = {
    "readme": readme,
    "headline": headline,
    "sets": sets,
    "rare": rare,
}


def fill(page: str, tables: dict[str, list[str]]) -> str:
    """A page with its marked tables replaced.

    Raises:
        InputError: when a mark names no table, or has no end.
    """

    def table(mark: re.Match[str]) -> str:
        if mark[1] not in tables:
            raise InputError(f"there is no table {mark[1]!r}: there are {', '.join(tables)}")
        return "\n".join([f"<!-- results: {mark[1]} -->", "", *tables[mark[1]], "", "<!-- end -->"])

    filled, count = re.subn(r"<!-- results: (\w+) -->\n.*?<!-- end -->", table, page, flags=re.DOTALL)
    if count != page.count("<!-- results:"):
        raise InputError("a table's mark has no end: <!-- end -->")
    return filled


def main(settings: Settings) -> None:
    """Measure, and write the tables into the pages."""
    numbers = measure(settings)
    tables = {name: make(numbers) for name, make in TABLES.items()}
    for name in PAGES:
        path = ROOT / name
        path.write_text(fill(path.read_text(encoding="utf-8"), tables), encoding="utf-8")
        print(f"wrote {name}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
