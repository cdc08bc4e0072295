"""All text is UTF-8 by name: what a locale makes of it does not matter."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import depthmocap

SOURCE = Path(depthmocap.__file__).parent
#: Calls for text, and the place of their mode.
_MODE_AT = {"open": 0, "fdopen": 1, "TextIOWrapper": None, "read_text": None, "write_text": None}


def _unnamed(tree: ast.AST) -> list[int]:
    """Lines where text is read or written without an encoding."""
    found = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        function = node.func
        builtin = isinstance(function, ast.Name)
        name = function.id if builtin else function.attr if isinstance(function, ast.Attribute) else ""
        keywords = {each.arg: each.value for each in node.keywords}
        if name in ("run", "Popen", "check_output") and ("text" in keywords or "universal_newlines" in keywords):
            found += [] if "encoding" in keywords else [node.lineno]
        if name not in _MODE_AT or "encoding" in keywords or (builtin and name != "open"):
            continue
        at = _MODE_AT[name]
        if at is not None:
            at += builtin
            mode = keywords.get("mode", node.args[at] if len(node.args) > at else None)
            texts = mode.value if isinstance(mode, ast.Constant) else None if mode is not None else "r"
            if (
                isinstance(function, ast.Attribute)
                and isinstance(function.value, ast.Name)
                and function.value.id == "tarfile"
            ):
                continue
            if not isinstance(texts, str) or not re.fullmatch(r"[rwxat+]+", texts):  # bytes, or no file's mode
                continue
        found.append(node.lineno)
    return found


def test_the_check_sees() -> None:
    bad = "p.read_text()\np.write_text(x)\nopen(p)\np.open('w')\np.open()\nos.fdopen(n, 'w')\nrun(c, text=True)"
    good = "read_text(p)\nopen(p, 'rb')\np.open('wb')\nos.open(p, 1)\nFolder.open(p)\np.open(encoding='utf-8')"
    assert _unnamed(ast.parse(bad)) == [1, 2, 3, 4, 5, 6, 7]
    assert _unnamed(ast.parse(good)) == []


def test_every_text_file_names_its_encoding() -> None:
    root = SOURCE.parents[1]
    paths = [each for folder in (SOURCE, root / "benchmarks", root / "examples") for each in folder.rglob("*.py")]
    assert len(paths) > 200
    assert [f"{path}:{line}" for path in paths for line in _unnamed(ast.parse(path.read_text(encoding="utf-8")))] == []
