"""The reference's pages, made from the code while the site is built: public names, and every command's own help."""

from __future__ import annotations

import contextlib
import functools
import io
import os
from types import ModuleType

from mkdocs.exceptions import PluginError  # pyright: ignore[reportMissingImports] - of the docs extra

#: Columns of the help.
_WIDTH = 100


def python_page(package: ModuleType) -> str:
    """Everything that ``import depthmocap`` offers, by kind; mkdocstrings makes the text from the docstrings."""
    kinds: dict[str, list[str]] = {"Functions": [], "Classes": [], "Constants": []}
    for name in package.__all__:
        value = getattr(package, name)
        kinds["Classes" if isinstance(value, type) else "Functions" if callable(value) else "Constants"].append(name)
    lines = [
        "# Python",
        "",
        "The public names: `import depthmocap` brings them, and loads neither torch nor a camera's SDK. Whatever is "
        "not here may change from version to version.",
    ]
    for kind, names in kinds.items():
        lines += ["", f"## {kind}", ""] if names else []
        for name in names:
            lines += [f"::: {package.__name__}.{name}", "    options:", "      heading_level: 3", ""]
    return "\n".join(lines)


def commands_page() -> str:
    """Every command with what it says of itself, by groups.

    Raises:
        PluginError: when a command cannot be loaded, for want of an extra.
    """
    from depthmocap.commands import GROUPS

    lines = [
        "# Commands",
        "",
        "Each as its own `--help` tells it. An option that is not given has the value in brackets. A shell "
        "completes commands and options after `source <(depthmocap --print-completion bash)`, or `zsh`.",
    ]
    for group, commands in GROUPS.items():
        lines += ["", f"**{group}**", "", "| Command | | Extra |", "|---|---|---|"]
        for command in commands:
            anchor = f"depthmocap-{command.words.replace(' ', '-')}"
            lines.append(f"| [`depthmocap {command.words}`](#{anchor}) | {command.help} | {command.extra or '–'} |")
    for command in (command for commands in GROUPS.values() for command in commands):
        needs = f" Needs `pip install 'depthmocap[{command.extra}]'`." if command.extra else ""
        summary = command.help[0].upper() + command.help[1:]
        lines += ["", f"## depthmocap {command.words}", "", f"{summary}.{needs}", "", "```text", help_of(command.words)]
        lines += ["```"]
    return "\n".join(lines)


def command_words() -> set[str]:
    """The words of every command."""
    from depthmocap.commands import COMMANDS

    return {command.words for command in COMMANDS}


@functools.cache
def help_of(words: str) -> str:
    """What ``depthmocap WORDS --help`` prints.

    Raises:
        PluginError: when the command cannot be loaded, for want of an extra.
    """
    from depthmocap.cli import main

    out, errors = io.StringIO(), io.StringIO()
    before = {name: os.environ.get(name) for name in ("COLUMNS", "NO_COLOR")}
    os.environ.update(COLUMNS=str(_WIDTH), NO_COLOR="1")
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors), contextlib.suppress(SystemExit):
            main([*words.split(), "--help"])
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
    text = out.getvalue().rstrip()
    if not text:
        said = errors.getvalue().strip() or "it printed nothing"
        raise PluginError(
            f"depthmocap {words} --help: {said}\nThe site needs all of the package: make docs installs it."
        )
    return text
