"""Arrows between packages point one way: a package imports from the groups below it or from its own; no circles."""

from __future__ import annotations

import ast
import collections
import graphlib
from collections.abc import Iterator
from pathlib import Path

import pytest

import depthmocap

SOURCE = Path(depthmocap.__file__).parent
#: From the ground up.
GROUPS = (
    "errors text",
    "core",
    "geometry body kernels frames",
    "cameras recordings",
    "segment classify pose smooth",
    "datasets exporting report",
    "offline calibration streaming viewing realtime rigging analysis",
    "synth",
    "train",
    "evaluate",
    "commands completion cli",
)
FLOOR = {package: floor for floor, group in enumerate(GROUPS) for package in group.split()}


def _modules() -> dict[str, Path]:
    names = {}
    for path in SOURCE.rglob("*.py"):
        parts = path.relative_to(SOURCE).with_suffix("").parts
        names[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return names


MODULES = _modules()


def _statements(node: ast.AST) -> Iterator[ast.stmt]:
    """All statements, without the expressions in them: those are most of a tree, and import nothing."""
    for field in ("body", "handlers", "orelse", "finalbody", "cases"):
        for inner in getattr(node, field, ()):
            if isinstance(inner, ast.stmt):
                yield inner
            yield from _statements(inner)


def _imports(path: Path) -> set[str]:
    """Modules of this package that a file imports, at its top and within functions."""
    found = set()
    for node in _statements(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "depthmocap":
            inside = (node.module or "").partition(".")[2]
            for name in node.names:
                module = f"{inside}.{name.name}".lstrip(".")
                found.add(module if module in MODULES else inside)
        elif isinstance(node, ast.Import):
            found |= {name.name.partition(".")[2] for name in node.names if name.name.startswith("depthmocap.")}
    return found


IMPORTS = {name: _imports(path) for name, path in MODULES.items()}


def test_every_package_has_its_floor() -> None:
    assert {name.split(".")[0] for name in MODULES if name} == set(FLOOR)


def test_arrows_point_down() -> None:
    up = [
        f"{module} imports {other or 'the public face'}"
        for module, others in IMPORTS.items()
        for other in others
        if module and (not other or FLOOR[other.split(".")[0]] > FLOOR[module.split(".")[0]])
    ]
    assert not up


@pytest.mark.parametrize("what", ["packages", "modules"])
def test_there_are_no_circles(what: str) -> None:
    graph: dict[str, set[str]] = {}
    for module, others in IMPORTS.items():
        if module:  # the face names what is in the house
            name = module.split(".")[0] if what == "packages" else module
            ends = {other.split(".")[0] if what == "packages" else other for other in others}
            graph.setdefault(name, set()).update(ends - {name})
    tuple(graphlib.TopologicalSorter(graph).static_order())  # raises CycleError, which names the circle


def test_files_have_names_of_their_own() -> None:
    names = collections.Counter(path.stem for path in MODULES.values() if path.stem != "__init__")
    assert [name for name, count in names.items() if count > 1] == []


def test_files_can_be_read_in_a_sitting() -> None:
    long = {name: len(path.read_text(encoding="utf-8").splitlines()) for name, path in MODULES.items()}
    assert {name: lines for name, lines in long.items() if lines > 450} == {}
