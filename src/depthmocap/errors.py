"""The only type of error that user input causes."""

from depthmocap.text import harmless, shortened

#: Largest number of characters of a message: less than 300 together with its prefix on the terminal.
LONGEST = 290


class InputError(ValueError):
    """Bad input. The message names the file or value, what was expected, and the fix. It is one line of limited length,
    whatever it quotes."""

    def __init__(self, message: str) -> None:
        super().__init__(shortened(harmless(message), LONGEST))


def missing_extra(package: str, extra: str) -> InputError:
    """The error for an optional dependency that is not installed."""
    return InputError(f"this needs the package '{package}': pip install 'depthmocap[{extra}]'")
