"""Completion of commands and options in a shell: ``source <(depthmocap --print-completion bash)``."""

from __future__ import annotations

import dataclasses
import shlex
import types
import typing
from collections.abc import Iterable
from typing import Any, Literal, get_args, get_origin

import tyro

from depthmocap.commands import COMMANDS, Command
from depthmocap.errors import InputError

SHELLS = ("bash", "zsh")
#: How the parser's annotations mark arguments without a name, and options of inner dataclasses without its name.
_POSITIONAL = get_args(tyro.conf.Positional[int])[1]
_WITHOUT_PREFIX = get_args(tyro.conf.OmitArgPrefixes[int])[1]

#: zsh runs bash's completion functions by a module of its own.
_ZSH = "autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n"
_FUNCTION = """_depthmocap() {{
    local current="${{COMP_WORDS[COMP_CWORD]}}" previous="${{COMP_WORDS[COMP_CWORD-1]}}" words="" candidates="" i
    for ((i = 1; i < COMP_CWORD; i++)); do
        case "|{known}|" in
            *"|$words${{words:+ }}${{COMP_WORDS[i]}}|"*) words="$words${{words:+ }}${{COMP_WORDS[i]}}" ;;
            *) break ;;
        esac
    done
    case "$words" in
{words}
    esac
    local with_option="$words${{words:+ }}$previous"
    case "$with_option" in
{choices}
    esac
    COMPREPLY=($(compgen -W "$candidates" -- "$current"))
    if [[ ${{#COMPREPLY[@]}} -eq 0 && "$current" != -* ]]; then
        compopt -o filenames 2>/dev/null
        COMPREPLY=($(compgen -f -- "$current"))
    fi
}}
complete -F _depthmocap depthmocap
"""


@dataclasses.dataclass(frozen=True)
class Option:
    """An option as it is typed, and the values that it takes where these are few."""

    name: str
    choices: tuple[str, ...] = ()


def options(settings: type, *, prefixed: bool = True) -> list[Option]:
    """The options that a settings dataclass becomes, with those of dataclasses within it, which are ``prefixed`` by the
    name of their field or not."""
    hints = typing.get_type_hints(settings, include_extras=True)
    listed: list[Option] = []
    for field in dataclasses.fields(settings):
        kind = hints[field.name]
        markers = getattr(kind, "__metadata__", ())
        kind = get_args(kind)[0] if markers else kind
        name = field.name.replace("_", "-")
        if _POSITIONAL in markers:
            continue
        if dataclasses.is_dataclass(kind):
            with_prefix = prefixed and _WITHOUT_PREFIX not in markers
            prefix = f"{name}." if with_prefix else ""
            inner = options(typing.cast(type, kind), prefixed=with_prefix)[:-1]
            listed += [dataclasses.replace(option, name=f"--{prefix}{option.name[2:]}") for option in inner]
        elif kind is bool:
            listed += [Option(f"--{name}"), Option(f"--no-{name}")]
        else:
            listed.append(Option(f"--{name}", _choices(kind)))
    return [*listed, Option("--help")]


def _choices(kind: Any) -> tuple[str, ...]:
    """The values of a ``Literal``, also within unions and tuples."""
    if get_origin(kind) is Literal:
        return tuple(str(value) for value in get_args(kind))
    if get_origin(kind) in (typing.Union, types.UnionType, tuple):
        return tuple(choice for part in get_args(kind) for choice in _choices(part))
    return ()


def _options_of(command: Command) -> list[Option]:
    """A command's options; none where its extra is not installed."""
    try:
        return options(command.load()[0])
    except InputError:
        return []


def completion_script(shell: str) -> str:
    """The script that a shell sources to complete commands, options and their values; files elsewhere.

    Args:
        shell: "bash" or "zsh".
    """
    after: dict[str, list[str]] = {"": ["--help", "--version", "--print-completion"]}
    values: dict[tuple[str, str], tuple[str, ...]] = {("", "--print-completion"): SHELLS}
    for command in COMMANDS:
        words = command.words.split()
        for i, word in enumerate(words):
            candidates = after.setdefault(" ".join(words[:i]), [])
            if word not in candidates:
                candidates.append(word)
        taken = _options_of(command)
        after.setdefault(command.words, []).extend(option.name for option in taken)
        values |= {(command.words, option.name): option.choices for option in taken if option.choices}

    def case(words: str, candidates: Iterable[str]) -> str:
        return f"    {shlex.quote(words)}) candidates={shlex.quote(' '.join(candidates))} ;;"

    commands = [case(words, candidates) for words, candidates in after.items()]
    choices = [case(f"{words} {option}".strip(), candidates) for (words, option), candidates in values.items()]
    script = _FUNCTION.format(known="|".join(after), words="\n".join(commands), choices="\n".join(choices))
    return (_ZSH if shell == "zsh" else "") + script
