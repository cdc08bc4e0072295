"""JSON within limits, and its numbers as they are due."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from depthmocap.core.reading import json_text
from depthmocap.core.reading.json_text import (
    DEEPEST,
    array,
    number,
    number_from_text,
    parse_json,
    read_json,
    whole_number,
)
from depthmocap.errors import InputError


def test_documents_are_read_with_and_without_a_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    for mark in (b"", b"\xef\xbb\xbf"):
        path.write_bytes(mark + '{"place": "Küche", "x": [1, 2.5, null]}'.encode())
        assert read_json(path) == {"place": "Küche", "x": [1, 2.5, None]}
    within = DEEPEST * "[" + DEEPEST * "]"
    assert parse_json(within + " ", "it") is not None
    assert parse_json(r'"\ud83d\ude00 \\ud800"', "it") == r"😀 \ud800"
    assert parse_json('["' + 999 * "[" + r"\"[" + '"]', "it") == [999 * "[" + '"[']


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (b"{", "not valid JSON"),
        (b"", "not valid JSON"),
        (b"\xff{}", "byte 0 is not UTF-8"),
        (100_000 * b"[", "brackets within one another"),
        ((DEEPEST + 1) * b"[" + (DEEPEST + 1) * b"]", "brackets within one another"),
        (b'{"a":' * 999 + b"1" + b"}" * 999, "brackets within one another"),
        (b'{"fx": ' + 5000 * b"9" + b"}", "a number of 5000 digits"),
        (b'{"fx": -' + 50 * b"9" + b"}", "a number of 51 digits"),
        (rb'{"name": "\ud800"}', "surrogate"),
        (rb'[[{"\udfff": 1}]]', "surrogate"),
    ],
)
def test_hostile_documents_are_refused_in_one_line(text: bytes, told: str) -> None:
    with pytest.raises(InputError, match=told) as caught:
        parse_json(text, "rig.json")
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("rig.json ")


def test_large_documents_are_refused_before_they_are_parsed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(json_text, "LARGEST_JSON", 100)
    path = tmp_path / "a.json"
    path.write_text("[" + 100 * " " + "]")
    with pytest.raises(InputError, match="larger than"):
        read_json(path)
    with pytest.raises(InputError, match="larger than"):
        parse_json(path.read_text(), "it")


def test_numbers_are_numbers() -> None:
    assert number(3, "x") == 3.0
    assert whole_number(512.0, "x") == 512
    assert number_from_text(" 1e-3 ", "x") == 0.001
    for value in (True, "3", None, math.nan, math.inf, 10**400, [3]):
        with pytest.raises(InputError, match="fx must be a finite number, got"):
            number(value, "fx")
    for value in (True, "3", 2.5, math.nan, math.inf, 10**20, None):
        with pytest.raises(InputError, match="width must be a whole number, got"):
            whole_number(value, "width")
    for text in ("x", "nan", "inf", "1e999", ""):
        with pytest.raises(InputError, match="unit must be a finite number, got"):
            number_from_text(text, "unit")


def test_arrays_have_the_shape_that_is_due() -> None:
    assert np.array_equal(array([[1, 2], [3, 4.5]], (2, 2), "pose"), [[1, 2], [3, 4.5]])
    assert array(7, (), "x") == 7
    assert np.isnan(array([None, math.nan, 1], (3,), "joint", unknown=True)).tolist() == [True, True, False]
    wrong: list[Any] = [
        [[1, 2]],
        [[1, 2], [3]],
        [[1, 2], [3, "4"]],
        [[1, 2], [3, None]],
        "ab",
        None,
        [[1, 2], [3, True]],
    ]
    for value in wrong:
        with pytest.raises(InputError, match="pose must be"):
            array(value, (2, 2), "pose")
