"""The command line."""

from __future__ import annotations

import contextlib
import io
import logging
import sys
import warnings
from typing import Any

import tyro
from rich.console import Console
from rich.table import Table
from rich.text import Text

from depthmocap.commands import COMMANDS, GROUPS, Command
from depthmocap.completion import SHELLS, completion_script
from depthmocap.core.console import OneLineFormatter, Terminal
from depthmocap.core.interrupts import handled_signals
from depthmocap.core.standard_streams import fault_tolerant_streams
from depthmocap.core.version import __version__
from depthmocap.errors import InputError


def _print_help(console: Console) -> None:
    console.print(f"depthmocap {__version__}: human motion capture from several depth cameras")
    console.print()
    table = Table.grid(padding=(0, 3))
    for group, commands in GROUPS.items():
        table.add_row(Text(group, style="bold"))
        for command in commands:
            table.add_row(f"  depthmocap {command.words}", command.help)
    console.print(table)
    console.print()
    console.print(
        "depthmocap COMMAND --help tells a command's options; depthmocap --print-completion bash (or zsh) prints"
    )
    console.print("a script that completes them: source <(depthmocap --print-completion bash)")


def _find(arguments: list[str]) -> tuple[Command, list[str]] | None:
    for command in COMMANDS:
        words = command.words.split()
        if arguments[: len(words)] == words:
            return command, arguments[len(words) :]
    return None


class _Held(io.StringIO):
    """What the parser says of an error, in colours where the terminal has them."""

    def isatty(self) -> bool:
        return sys.__stderr__ is not None and sys.__stderr__.isatty()


def _parse(settings: type, arguments: list[str], prog: str) -> Any:
    """The settings that the arguments tell.

    Raises:
        InputError: of the settings themselves, which the parser would put into a frame.
    """
    held = _Held()
    try:
        with contextlib.redirect_stderr(held):
            return tyro.cli(settings, args=arguments, prog=prog)
    except SystemExit as end:
        cause = end.__context__
        while cause is not None and not isinstance(cause, InputError):
            cause = cause.__context__
        if cause is not None:
            raise cause from None
        sys.stderr.write(held.getvalue())
        raise


def _tell_error(console: Console, error: InputError) -> None:
    console.print(f"error: {error}", style="red", soft_wrap=True)


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns the exit status. Bad input is one line on stderr and status 2; SIGTERM and SIGHUP end
    a command as Ctrl-C does, everything written, with status 143 and 129. Work goes on when nobody can be told of it,
    and text for the standard output that could not be written is status 1."""
    with fault_tolerant_streams() as out:
        try:
            with handled_signals() as ending:
                status = _main(arguments)
        except SystemExit as end:  # of the parser
            raise SystemExit(end.code or out.status()) from None
        return ending.status or status or out.status()


def _main(arguments: list[str] | None) -> int:
    arguments = sys.argv[1:] if arguments is None else arguments
    console, errors = Terminal(), Terminal(stderr=True)
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        _print_help(console)
        return 0
    if arguments[0] == "--version":
        console.print(__version__)
        return 0
    if arguments[0] == "--print-completion":
        if len(arguments) != 2 or arguments[1] not in SHELLS:
            _tell_error(errors, InputError(f"--print-completion takes one of {', '.join(SHELLS)}"))
            return 2
        sys.stdout.write(completion_script(arguments[1]))
        return 0
    match = _find(arguments)
    if match is None and arguments[-1] in ("-h", "--help"):
        _print_help(console)
        return 0
    if match is None:
        _tell_error(errors, InputError(f"no command '{' '.join(arguments[:2])}'"))
        _print_help(errors)
        return 2
    command, rest = match
    # Third-party warnings about their own futures mean nothing to a user.
    warnings.simplefilter("ignore", DeprecationWarning)
    if logging.lastResort is not None:  # which prints our warnings where nobody has asked for others
        logging.lastResort.setFormatter(OneLineFormatter())
    try:
        settings_type, function = command.load()
        function(_parse(settings_type, rest, f"depthmocap {command.words}"))
    except InputError as error:
        _tell_error(errors, error)
        return 2
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        _tell_error(errors, InputError(f"{where}{error.strerror or error}"))
        return 2
    except UnicodeEncodeError as error:  # a path that a library takes as text, or a locale without the letter
        _tell_error(errors, InputError(f"{error.object!r} is no {error.encoding}: rename it, or set PYTHONUTF8=1"))
        return 2
    except KeyboardInterrupt:
        errors.print("stopped", style="red")
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
