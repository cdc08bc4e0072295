"""What the package needs is declared, and messages name the extra that brings it."""

from __future__ import annotations

import ast
import functools
import re
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

import depthmocap
from depthmocap.commands import COMMANDS as _COMMANDS
from depthmocap.errors import missing_extra

SOURCE = Path(depthmocap.__file__).parent
ROOT = SOURCE.parents[1]
#: Modules that come with another package, and SDKs that are no Python packages.
_WITH_OTHERS = {"warp": "anny"}


def _normal(requirement: str) -> str:
    """The name of a package, as indexes compare it."""
    found = re.match(r"[\w.-]+", requirement)
    assert found is not None
    return re.sub(r"[-_.]+", "-", found[0]).lower()


def _declared() -> tuple[set[str], dict[str, set[str]]]:
    """Packages of the base install, and of each extra."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    base = re.search(r"\ndependencies = \[(.*?)\n\]", text, re.S)
    extras = re.search(r"\n\[project\.optional-dependencies\](.*?)\n\[", text, re.S)
    assert base is not None and extras is not None

    def names(block: str) -> set[str]:
        return {_normal(each) for each in re.findall(r'^\s+"([^"]+)', block, re.M)}

    return names(base[1]), {name: names(block) for name, block in re.findall(r"\n(\w+) = \[(.*?)\n\]", extras[1], re.S)}


@functools.cache
def _trees() -> dict[Path, ast.Module]:
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(SOURCE.rglob("*.py"))}


def _said(tree: ast.AST) -> list[tuple[str, str]]:
    """Package and extra of every message for a missing package, and of every camera SDK."""
    found = []
    for node in ast.walk(tree):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)):
            continue
        arguments = [each.values[-1] if isinstance(each, ast.BoolOp) else each for each in node.args]
        texts = [each.value if isinstance(each, ast.Constant) else None for each in arguments]
        if node.func.id == "missing_extra" and all(isinstance(each, str) for each in texts):
            found.append((str(texts[0]), str(texts[1])))
        if node.func.id == "CameraMake" and isinstance(texts[2], str):
            found.append((texts[2], str(texts[0])))
    return found


def test_messages_name_the_extra_that_has_the_package() -> None:
    _, extras = _declared()
    said = [
        each for path, tree in _trees().items()
        if re.search("missing_extra|CameraMake", path.read_text(encoding="utf-8"))
        for each in _said(tree)
    ]  # fmt: skip
    assert len(said) > 12
    for package, extra in said:
        assert _normal(package) in extras[extra], f"[{extra}] lacks {package}"
    assert {command.extra for command in _COMMANDS} - {""} <= set(extras)
    assert "pip install 'depthmocap[record]'" in str(missing_extra("lz4", "record"))


def test_docs_name_extras_that_there_are() -> None:
    _, extras = _declared()
    texts = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *SOURCE.rglob("*.py")]
    named = set()
    for path in texts:
        named |= {each for found in re.findall(r"(?:depthmocap|'\.)\[([\w,]+)\]", path.read_text(encoding="utf-8"))
                  for each in found.split(",")}  # fmt: skip
    assert named and named <= set(extras)


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python 3.10 does not know which package brings some modules")
def test_what_is_imported_is_declared() -> None:
    base, extras = _declared()
    declared = base.union(*extras.values())
    brought = packages_distributions()
    for path, tree in _trees().items():
        imported = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                imported |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                imported.add(node.module.partition(".")[0])
        for module in imported - set(sys.stdlib_module_names) - {"depthmocap"}:
            bringer = _WITH_OTHERS.get(module)
            packages = {_normal(each) for each in brought.get(module, [bringer or module])}
            packages |= {bringer} if bringer else set()
            assert packages & declared, f"{path.name} imports {module}, which no extra brings"
