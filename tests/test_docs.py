"""Pages name commands, names and files that there are. Their options are looked at when the site is built."""

import importlib.util
import pkgutil
import re
from pathlib import Path

import pytest

import depthmocap
from depthmocap.commands import COMMANDS as _COMMANDS

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]

_found = importlib.util.spec_from_file_location("checks", ROOT / "docs" / "scripts" / "checks.py")
assert _found is not None and _found.loader is not None
checks = importlib.util.module_from_spec(_found)
_found.loader.exec_module(checks)

COMMANDS = {command.words for command in _COMMANDS}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_names_is_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert not [
        *checks.wrong_commands(text, COMMANDS),
        *checks.wrong_names(text),
        *checks.wrong_files(text, page.parent),
    ]


def test_every_page_is_in_the_navigation_of_the_site() -> None:
    told = set(re.findall(r"[\w/-]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8")))
    there = {page.relative_to(ROOT / "docs").as_posix() for page in PAGES[2:]}
    assert told == there | {"reference/python.md", "reference/commands.md"}


def test_every_package_is_in_the_layout() -> None:
    text = (ROOT / "docs" / "reference" / "code.md").read_text(encoding="utf-8")
    packages = {module.name for module in pkgutil.iter_modules(depthmocap.__path__)}
    assert packages <= set(re.findall(r"`(\w+)`", text))


def test_what_is_not_there_is_told() -> None:
    text = "`depthmocap dance`, `depthmocap run X --faster`, `depthmocap.Pipe`, examples/99_none.py, [a](none.md)"
    assert [*checks.wrong_commands(text, COMMANDS, lambda words: "--out --rig")] == [
        "there is no command 'depthmocap dance'",
        "'depthmocap run' has no option --faster",
    ]
    assert [*checks.wrong_names(text)] == ["there is no depthmocap.Pipe"]
    assert len([*checks.wrong_files(text, ROOT)]) == 2


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_is_merged(page: Path) -> None:
    assert not re.search(r"^(<<<<<<<|>>>>>>>) ", page.read_text(encoding="utf-8"), re.MULTILINE)
