"""Whether what pages name is there: commands and their options, names of the package, scripts and files."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_COMMAND = re.compile(r"^(?: {4}|\t)\s*depthmocap ([a-z].*)$|`depthmocap ([a-z][^`]*)`", re.MULTILINE)
_NAME = re.compile(r"\bdepthmocap((?:\.[A-Za-z_]\w*)+)")
_PATH = re.compile(r"\b(?:benchmarks|examples|docs/scripts|docs/images|weights)/[\w./-]+\.\w+")
_LINK = re.compile(r"\]\(([^)#\s]*)(#[^)\s]*)?\)")


def wrong_commands(text: str, words: set[str], help_of: Callable[[str], str] | None = None) -> Iterator[str]:
    """Commands that there are not, and with ``help_of`` options that a command has not."""
    for found in _COMMAND.finditer(re.sub(r"\\\n\s*", "", text)):
        given = (found[1] or found[2]).split("#")[0]
        said = given.split()
        command = next((each for each in (" ".join(said[:2]), said[0]) if each in words), None)
        if command is None:
            if said[0] not in {each.split()[0] for each in words}:
                yield f"there is no command 'depthmocap {' '.join(said[:2])}'"
            continue
        if help_of is not None:
            known = set(re.findall(r"--[a-z0-9][a-z0-9-]*", help_of(command)))
            for option in re.findall(r"(?<!\S)--[a-z0-9][a-z0-9-]*", given):
                if option not in known:
                    yield f"'depthmocap {command}' has no option {option}"


def wrong_names(text: str) -> Iterator[str]:
    """Names of the package that cannot be imported."""
    for name in sorted({f"depthmocap{found[1]}" for found in _NAME.finditer(text)}):
        if not _there(name):
            yield f"there is no {name}"


def _there(name: str) -> bool:
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            value = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        try:
            for attribute in parts[count:]:
                value = getattr(value, attribute)
        except AttributeError:
            return False
        return True
    return False


def wrong_files(text: str, folder: Path) -> Iterator[str]:
    """Paths in the repository, and links to pages and pictures, that lead nowhere. Pages made while the site is built
    are not looked for."""
    for path in sorted({found[0] for found in _PATH.finditer(text)}):
        if not (ROOT / path).exists():
            yield f"there is no {path}"
    for link in sorted({found[1] for found in _LINK.finditer(text)}):
        made = link.startswith(("http:", "https:")) or re.search(r"(?:^|/)(?:python|commands)\.md$", link)
        if link and not made and not (folder / link).exists():
            yield f"a link leads to {link}, which is not there"
