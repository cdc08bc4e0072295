"""The one error type that user input can cause."""

from depthmocap.text import harmless, shortened

#: Letters of a message: less than 300 with what stands before it on the terminal.
LONGEST = 290


class InputError(ValueError):
    """Bad input. The message names the file or value, what was expected, and the fix; it is one line of bounded length,
    whatever it quotes."""

    def __init__(self, message: str) -> None:
        super().__init__(shortened(harmless(message), LONGEST))


def missing_extra(package: str, extra: str) -> InputError:
    """Error for an optional dependency that is not installed."""
    return InputError(f"this needs the package '{package}': pip install 'depthmocap[{extra}]'")
