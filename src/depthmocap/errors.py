"""The one error type that user input can cause."""


class InputError(ValueError):
    """Bad input. The message names the file or value, what was expected, and the fix."""


def missing_extra(package: str, extra: str) -> InputError:
    """Error for an optional dependency that is not installed."""
    return InputError(f"this needs the package '{package}': pip install 'depthmocap[{extra}]'")
