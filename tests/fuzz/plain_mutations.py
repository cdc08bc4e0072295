"""Bytes, words and JSON values exchanged, cut out, repeated or put in, and the odd values that are put there."""

from __future__ import annotations

import copy
import json
import re
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

Rng = np.random.Generator

ODD_WORDS = (
    *("", "0", "-0", "-1", "1", "nan", "NaN", "-Infinity", "inf", "1e400", "1e-320", "1e308", "0.5", "9" * 20),
    *("true", "null", '""', '"x"', "x", "[]", "{}", "[", "}", ":", ",", "..", "/", "\\", "CON", "\0", "\x1b[31m"),
    *("[/x]", "$\\frac{$", "<b>", "\u202e", "é", "٣", "1_000", "0x10", "1,5", "-", "+", ".", "e", "\r", "\n\n"),
    *("\ufeff", "9" * 5000, "[" * 3000, "{" * 3000, "a" * 3000),
)  # fmt: skip
_ODD_VALUES = (
    *(None, True, False, 0, -1, 1, 2**31, 2**63, 2**64, 10**30, 10**400, -0.0, 0.5, 1e308, 1e-320, float("nan")),
    *(float("inf"), "", "x", "0.001", "..", "a/b", "\ud800", "\0", "[/x]", "\x1b[31m", "$\\frac{$", "x" * 3000),
    *([], [[]], {}, [0], [None], [1e308]),
)  # fmt: skip
ODD_WHOLE = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 2**31, 2**32 - 1, 2**62, 2**63, 2**64 - 1)
ODD_REAL = (0.0, -0.0, -1.0, 0.5, 1e-320, 1e-9, 1e9, 1e308, float("nan"), float("inf"), float("-inf"))
_WORD = re.compile(r'"[^"\n]*"|[-+.\w]+|[^\s\w]')


def pick(choices: Sequence[Any], rng: Rng) -> Any:
    """One of them."""
    return choices[int(rng.integers(len(choices)))]


def _place(length: int, rng: Rng) -> int:
    """Somewhere in a file; at its beginning as often as anywhere."""
    return int(rng.integers(max(min(length, 400) if rng.random() < 0.5 else length, 1)))


def spoilt_bytes(data: bytes, rng: Rng) -> bytes:
    """A few bytes changed, and pieces cut out, repeated, or put in."""
    held = bytearray(data)
    at, length = _place(len(held), rng), int(rng.choice((1, 2, 4, 8, 30, 300)))
    match int(rng.integers(8)):
        case 0 if held:
            held[at] ^= 1 << int(rng.integers(8))
        case 1 if held:
            held[at] = int(rng.choice((0, 1, 0x20, 0x7F, 0x80, 0xFF)))
        case 2 | 3:
            held[at : at + 8] = odd_number(rng)[: len(held) - at]
        case 4:
            del held[at : at + length]
        case 5:
            held[at:at] = held[at : at + length] * int(rng.choice((1, 2, 50)))
        case 6:
            held[at:at] = rng.bytes(length)
        case _:
            del held[at:]
    return bytes(held)


def odd_number(rng: Rng) -> bytes:
    """A number of any size in either order, often one that a reader stumbles over."""
    order = pick("<>", rng)
    form = pick("BHIQfd", rng)
    if form in "fd":
        value = min(pick(ODD_REAL, rng), 3e38) if form == "f" else pick(ODD_REAL, rng)
        return struct.pack(order + form, value)
    size = struct.calcsize(form)
    return int(pick(ODD_WHOLE, rng) & (2 ** (8 * size) - 1)).to_bytes(size, "little" if order == "<" else "big")


def spoilt_text(data: bytes, rng: Rng) -> bytes:
    """A word or a line exchanged, repeated or left out."""
    text = data.decode("utf-8", "surrogateescape")
    if rng.random() < 0.3:
        lines = text.split("\n")
        row = int(rng.integers(len(lines)))
        match int(rng.integers(4)):
            case 0:
                del lines[row]
            case 1:
                lines.insert(row, lines[row])
            case 2:
                lines[row] = lines[int(rng.integers(len(lines)))]
            case _:
                lines = lines[:row]
        return "\n".join(lines).encode("utf-8", "surrogateescape")
    words = list(_WORD.finditer(text))
    if not words:
        return data
    word = pick(words, rng)
    new = pick(words, rng)[0] if rng.random() < 0.2 else pick(ODD_WORDS, rng)
    start = word.end() if rng.random() < 0.2 else word.start()
    return (text[:start] + new + text[word.end() :]).encode("utf-8", "surrogateescape")


def spoilt_json(data: bytes, rng: Rng) -> bytes:
    """A value of a document exchanged, repeated, put deeper or left out."""
    document = [json.loads(data)]  # so that the whole can be exchanged too
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key in list(node) if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], dict | list):
                walk(node[key])

    walk(document)
    node, key = pick(places, rng)
    match int(rng.integers(8)):
        case 0 if node is not document:
            del node[key]
        case 1:
            other, its = pick(places, rng)
            node[key] = copy.deepcopy(other[its])
        case 2:
            for _ in range(int(rng.choice((1, 70, 300)))):
                node[key] = [node[key]]
        case 3 if isinstance(node, dict):
            node[str(pick(ODD_WORDS, rng))] = node.pop(key)
        case 4 if isinstance(node[key], list):
            node[key] = node[key] * 2 if rng.random() < 0.5 else node[key][:-1]
        case 5 if isinstance(node[key], int | float):
            node[key] = node[key] * float(pick((-1, 0, 1e-9, 1e9, 1e200), rng))
        case _:
            node[key] = pick(_ODD_VALUES, rng)
    return json.dumps(document[0]).encode()
