"""Reads JSON of users as plain values, and checks the numbers in it."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.core.reading.input_files import read_bytes
from depthmocap.errors import InputError

#: Largest size of a document (bytes); its values may take thirty times as much memory.
LARGEST_JSON = 1 << 25
#: Deepest nesting of brackets, so that recursive functions can go through the values.
DEEPEST = 64
#: Largest number of digits of an integer.
MOST_DIGITS = 40

_BRACKETS = re.compile(r'"(?:[^"\\]|\\.)*"|[\[{]|[\]}]', re.DOTALL)
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")


def read_json(path: Path, missing: str = "") -> Any:
    """Read a JSON document in UTF-8, with or without a byte-order mark. NaN and Infinity are read as numbers, which
    :func:`number` refuses.

    Args:
        missing: what to do if there is no such file, for the message.

    Raises:
        InputError: when it cannot be read, is not JSON, or goes beyond the limits of this file.
    """
    return parse_json(read_bytes(path, LARGEST_JSON, missing), str(path))


def parse_json(text: bytes | str, where: str) -> Any:
    """Parse a JSON text like :func:`read_json`. ``where`` is its origin, for messages.

    Raises:
        InputError: when it is not JSON, or goes beyond the limits of this file.
    """
    fault = f"{where} is not valid JSON"
    if len(text) > LARGEST_JSON:
        raise InputError(f"{where} is larger than the {LARGEST_JSON / 1e6:.0f} MB that a JSON document may have")
    try:
        if isinstance(text, bytes):
            text = text.decode("utf-8-sig")
        document = json.loads(text, parse_int=_whole)
    except UnicodeDecodeError as error:
        raise InputError(f"{fault}: byte {error.start} is not UTF-8") from None
    except RecursionError:
        raise InputError(_too_deep(where)) from None
    except ValueError as error:  # which json.JSONDecodeError is
        raise InputError(f"{fault}: {error}") from None
    if _depth(text) > DEEPEST:
        raise InputError(_too_deep(where))
    if _SURROGATE.search(text) and not _is_unicode(document):
        raise InputError(f"{fault}: half of a surrogate pair is no letter")
    return document


def number(value: Any, what: str) -> float:
    """Check that a value of a document is a finite number, and neither text nor a truth value.

    Args:
        what: the name of the value, for the message.

    Raises:
        InputError: when it is no such number.
    """
    try:
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
    except OverflowError:  # an integer too large for a float
        pass
    raise InputError(f"{what} must be a finite number, got {_shown(value)}")


def whole_number(value: Any, what: str) -> int:
    """Check that a value of a document is an integer of at most 64 bits; 512.0 is one.

    Raises:
        InputError: when it is no such integer.
    """
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 2**63 and value == int(value):
        return int(value)
    raise InputError(f"{what} must be a whole number, got {_shown(value)}")


def number_from_text(text: str, what: str) -> float:
    """Read a finite number from text.

    Raises:
        InputError: when the text is no such number.
    """
    try:
        return number(float(text), what)
    except ValueError:
        raise InputError(f"{what} must be a finite number, got {_shown(text)}") from None


def array(value: Any, shape: Sequence[int], what: str, *, unknown: bool = False) -> Float[ndarray, "..."]:
    """Convert nested lists of finite numbers into an array.

    Args:
        what: the name of the value, for the message.
        unknown: allow null and NaN, which become NaN.

    Raises:
        InputError: when it has another shape, or holds something other than numbers.
    """

    def flat(part: Any, rest: Sequence[int]) -> list[float]:
        if not rest:
            if unknown and (part is None or (isinstance(part, float) and math.isnan(part))):
                return [math.nan]
            return [number(part, what)]
        if not isinstance(part, list) or len(part) != rest[0]:
            size = "×".join(map(str, shape))
            raise InputError(f"{what} must be {size} numbers in lists, row by row, got {_shown(value)}")
        return [value for inner in part for value in flat(inner, rest[1:])]

    return np.array(flat(value, shape), np.float64).reshape(tuple(shape))


def _whole(digits: str) -> int:
    if len(digits) > MOST_DIGITS:
        raise ValueError(f"a number of {len(digits)} digits")
    return int(digits)


def _too_deep(where: str) -> str:
    return f"{where} has more than {DEEPEST} brackets within one another"


def _depth(text: str) -> int:
    """The nesting depth of the brackets of a valid document."""
    if text.count("[") + text.count("{") <= DEEPEST:
        return 0
    deepest = depth = 0
    for match in _BRACKETS.finditer(text):
        if (letter := match[0][0]) in "[{":
            depth += 1
            deepest = max(deepest, depth)
        elif letter != '"':
            depth -= 1
    return deepest


def _is_unicode(value: Any) -> bool:
    """Whether all texts in the value can be written as UTF-8."""
    if isinstance(value, str):
        return not any("\ud800" <= letter <= "\udfff" for letter in value)
    if isinstance(value, dict):
        return all(_is_unicode(key) and _is_unicode(item) for key, item in value.items())
    return not isinstance(value, list) or all(map(_is_unicode, value))


def _shown(value: Any) -> str:
    text = json.dumps(value) if isinstance(value, str | bool | type(None)) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"
