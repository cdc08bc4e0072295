"""``depthmocap compare A.json B.json``: the numbers of two evaluations of one set, side by side."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from depthmocap.core.console import Terminal
from depthmocap.core.reading.json_text import array, read_json
from depthmocap.errors import InputError
from depthmocap.evaluate.evaluation_report import MEASURE_KEYS, Numbers, measures
from depthmocap.exporting.summary import Summary, check_summary

#: Keys that identify a set: two results may be compared only where these agree.
_SET_KEYS = ("subset", "split", "frames", "joints", "seed", "clips")
#: Keys of the method, which may differ.
_METHOD_KEYS = ("data", "views", "labels", "weights", "estimator")
#: Settings of a recipe that are paths on a disk.
_PATH_KEYS = ("postures",)


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Two evaluations of the same set: their numbers and the differences, B − A.

    Attributes:
        a: what an evaluation wrote with --json, or the summary.json of a recording whose true joints are known.
        b: another, of the same frames and joints; views, labels, weights, estimator and refit may differ.
    """

    a: tyro.conf.Positional[Path]
    b: tyro.conf.Positional[Path]


def load_results(path: Path) -> Mapping[str, Numbers]:
    """The results by name of a file that an evaluation wrote, or of a summary.json.

    Raises:
        InputError: when it is not such a file.
    """
    document = read_json(path, "give a file that an evaluation wrote with --json")
    if isinstance(document, dict) and "schema" in document:
        document = _from_summary(path, check_summary(path, document))
    if isinstance(document, dict) and "mean_joint_error_cm" in document:  # of one set, such as UBC3V's
        document = {f"{document.get('subset', 'all')}/{document.get('split', 'all')}": document}
    if not isinstance(document, dict) or not document or not all(map(_is_result, document.values())):
        raise InputError(f"{path} holds no numbers of joints: give a file that an evaluation wrote with --json")
    for name, numbers in document.items():
        single = {key: numbers[key] for key in MEASURE_KEYS if key in numbers}
        for key, value in {**single, **numbers["per_joint_error_cm"]}.items():
            array(value, (), f"{path}: {key} of {name}", unknown=True)
    return document


def _from_summary(path: Path, summary: Summary) -> dict[str, Numbers]:
    """The errors in a summary, with the keys of an evaluation."""
    if summary["error"] is None:
        raise InputError(f"{path} tells no errors: the true joints of {', '.join(summary['sources'])} are not known")
    numbers = {
        "frames": summary["frames"],
        "frames_without_person": summary["gaps"],
        **summary["error"],
        "ms_per_frame": summary["ms_per_frame"] and summary["ms_per_frame"]["p50"],
    }
    return {Path(summary["sources"][0]).name: numbers}


def _is_result(numbers: Any) -> bool:
    return (
        isinstance(numbers, dict)
        and isinstance(numbers.get("per_joint_error_cm"), dict)
        and "frames" in numbers
        and all(isinstance(numbers.get(key) or {}, dict) for key in ("about", "recipe"))
        and isinstance(numbers.get("true_joints"), str | None)
    )


def compare(settings: Comparison, console: Console | None = None) -> dict[str, dict[str, tuple[float, float]]]:
    """Print the tables; returns by result and measure the values of A and B.

    Raises:
        InputError: when a file cannot be read or the two are of different sets.
    """
    console = console or Terminal()
    a, b = load_results(settings.a), load_results(settings.b)
    _check_same(settings, a, b)
    for letter, path in (("A", settings.a), ("B", settings.b)):
        console.print(f"{letter}: {path}", soft_wrap=True)
    values: dict[str, dict[str, tuple[float, float]]] = {}
    for name in a:
        ours, theirs = measures(a[name]), measures(b[name])
        joints = {f"{joint} (cm)": (error, b[name]["per_joint_error_cm"][joint])
                  for joint, error in a[name]["per_joint_error_cm"].items()}  # fmt: skip
        rows = {words + (f" ({unit})" if unit else ""): (value, theirs[words][0])
                for words, (value, unit) in ours.items() if words in theirs}  # fmt: skip
        values[name] = {words: (_number(x), _number(y)) for words, (x, y) in (rows | joints).items()}
        for key, x, y in ((key, _setting(a[name], key), _setting(b[name], key)) for key in _METHOD_KEYS):
            if x != y:
                console.print(f"{key} of {name}: {x} in A, {y} in B", soft_wrap=True)
        table = Table(title=name)
        table.add_column("")
        for title in ("A", "B", "B − A", "B / A"):
            table.add_column(title, justify="right")
        for words, (x, y) in values[name].items():
            ratio = f"{y / x:.2f}" if x > 0 and np.isfinite(y) else "–"
            table.add_row(words, _text(x), _text(y), _text(y - x, "+"), ratio)
        console.print(table)
    return values


def _check_same(settings: Comparison, a: Mapping[str, Numbers], b: Mapping[str, Numbers]) -> None:
    message = f"{settings.a} and {settings.b} are of different sets"
    if set(a) != set(b):
        raise InputError(f"{message}: {', '.join(a)}; {', '.join(b)}")
    for name in a:
        if list(a[name]["per_joint_error_cm"]) != list(b[name]["per_joint_error_cm"]):
            raise InputError(f"{message}: {name} has {_joints(a[name])} in A, {_joints(b[name])} in B")
        pairs = [(key, a[name].get(key), b[name].get(key)) for key in _SET_KEYS]
        recipes = [numbers.get("recipe") or {} for numbers in (a[name], b[name])]
        keys = sorted(set(recipes[0]) | set(recipes[1]))
        pairs += [(key, *(recipe.get(key) for recipe in recipes)) for key in keys if key not in _PATH_KEYS]
        for key, x, y in pairs:
            if x != y:
                raise InputError(f"{message}: {key} of {name} is {_short(x)} in A, {_short(y)} in B")
        # Results of earlier versions lack it.
        true = {numbers.get("true_joints") for numbers in (a[name], b[name])} - {None}
        if len(true) > 1:
            raise InputError(f"{message}: the true joints of {name} differ")


def _setting(numbers: Numbers, key: str) -> Any:
    value = numbers.get(key, (numbers.get("about") or {}).get(key))
    return "the packaged ones" if key == "weights" and value is None else value


def _joints(numbers: Numbers) -> str:
    return f"{len(numbers['per_joint_error_cm'])} joints"


def _short(value: Any) -> str:
    text = "not told" if value is None else str(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _text(value: float, sign: str = "") -> str:
    return "–" if np.isnan(value) else f"{value:{sign}.2f}"
