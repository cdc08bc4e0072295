"""Corrections of a result: what each does, that the result stays as it was written, and that wrong ones are told."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from test_export import FRAME_NS, START_NS
from test_results import COMES_AT, FRAMES, write

from depthmocap.body.skeleton import MIRROR
from depthmocap.errors import InputError
from depthmocap.exporting.edits import EDITS_FILE, Edit, Edits, TakeMarker, write_edits
from depthmocap.exporting.stored_result import StoredResult, read_result


def at(frame: int) -> int:
    """The timestamp of a frame of the take."""
    return START_NS + frame * FRAME_NS


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A take in which a second person comes later."""
    path = tmp_path_factory.mktemp("edited")
    write(path)
    return path


@pytest.fixture
def result(folder: Path) -> StoredResult:
    return read_result(folder)


def corrected(result: StoredResult, *edits: Edit) -> StoredResult:
    return result.edited(dataclasses.replace(result.edits, edits=edits))


def test_a_result_is_read_back(result: StoredResult, folder: Path) -> None:
    assert [person.number for person in result.people] == [1, 2]
    assert [person.label for person in result.people] == ["person 1", "person 2"]
    assert [len(person.table) for person in result.people] == [FRAMES, FRAMES - COMES_AT]
    assert result.up == "z" and result.name == "" and result.markers == ()
    with pytest.raises(InputError, match=r"has no pose\.csv"):
        read_result(folder / "nowhere")


def test_names(result: StoredResult) -> None:
    after = corrected(result, Edit("name", name="walk"), Edit("name", 2, name="Ann"))
    assert after.name == "walk" and [person.label for person in after.people] == ["person 1", "Ann"]


def test_join_fills_what_is_missing(result: StoredResult) -> None:
    without = Edit("delete", 1, first_ns=at(COMES_AT + 2), last_ns=at(FRAMES))
    (person,) = corrected(result, without, Edit("join", 1, 2)).people
    first, second = result.people[0].table, result.people[1].table
    assert person.table.stamps_ns.tolist() == first.stamps_ns.tolist()
    assert np.array_equal(person.table.joints[: COMES_AT + 2], first.joints[: COMES_AT + 2])
    assert np.array_equal(person.table.joints[COMES_AT + 2 :], second.joints[2:])


def test_split_makes_a_new_person(result: StoredResult) -> None:
    after = corrected(result, Edit("split", 1, 3, first_ns=at(10)))
    assert {person.number: len(person.table) for person in after.people} == {
        1: 10,
        2: FRAMES - COMES_AT,
        3: FRAMES - 10,
    }
    (first, *_) = corrected(result, Edit("split", 1, 3, first_ns=at(10)), Edit("join", 1, 3)).people
    assert np.array_equal(first.table.joints, result.people[0].table.joints)


def test_exchange_left_and_right(result: StoredResult) -> None:
    before = result.people[0].table
    after = corrected(result, Edit("exchange", 1, first_ns=at(2), last_ns=at(4))).people[0].table
    assert np.array_equal(after.joints[2:5], before.joints[2:5][:, MIRROR])
    assert np.array_equal(after.confidence[2:5], before.confidence[2:5][:, MIRROR])
    assert np.array_equal(after.joints[5:], before.joints[5:]) and np.array_equal(after.joints[:2], before.joints[:2])


def test_delete_a_span_or_a_person(result: StoredResult) -> None:
    table = corrected(result, Edit("delete", 1, last_ns=at(3))).people[0].table
    assert np.isnan(table.joints[:4]).all() and not table.confidence[:4].any() and np.isfinite(table.joints[4:]).all()
    assert [person.number for person in corrected(result, Edit("delete", 1)).people] == [2]


def test_trim_keeps_a_part_of_everybody(result: StoredResult) -> None:
    after = corrected(result, Edit("trim", first_ns=at(5), last_ns=at(COMES_AT)))
    assert [len(person.table) for person in after.people] == [COMES_AT - 4, 1]
    assert [person.number for person in corrected(result, Edit("trim", last_ns=at(5))).people] == [1]


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (Edit("name", 7, name="Ann"), "no person 7, but 1, 2"),
        (Edit("join", 1, 1), "cannot be joined"),
        (Edit("split", 1, 2, first_ns=0), "a number for the new person"),
        (Edit("trim", last_ns=0), "nothing is left"),
    ],
)
def test_what_does_not_fit_is_told(result: StoredResult, edit: Edit, message: str) -> None:
    with pytest.raises(InputError, match=message):
        corrected(result, edit)


def test_corrections_are_kept_beside_the_result(tmp_path: Path) -> None:
    write(tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    result = read_result(tmp_path)
    edits = Edits(
        result.edits.digest,
        (Edit("delete", 2), Edit("name", name="a")),
        (TakeMarker(at(9), "b"), TakeMarker(at(3), "a")),
    )
    write_edits(tmp_path, edits)
    after = read_result(tmp_path)
    assert after.edits == edits and after.name == "a" and [person.number for person in after.people] == [1]
    assert [marker.text for marker in after.markers] == ["a", "b"]
    assert [person.number for person in read_result(tmp_path, edited=False).people] == [1, 2]
    assert {path: path.read_bytes() for path in before} == before

    (tmp_path / "person-1" / "pose.csv").write_bytes(before[tmp_path / "person-2" / "pose.csv"])
    with pytest.raises(InputError, match="corrections of another result"):
        read_result(tmp_path)
    write_edits(tmp_path, Edits(""))
    assert not (tmp_path / EDITS_FILE).exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": 2}, "of this version"),
        ({"edits": [{"kind": "dance"}]}, "kind must be one of"),
        ({"edits": [{"kind": "name", "person": "1"}]}, "whole number"),
        ({"edits": [{"kind": "name", "name": 3}]}, "must be text"),
        ({"edits": {}}, "list of objects"),
        ({"markers": [{"text": "a"}]}, "timestamp_ns"),
        ({"edits": [{"kind": "delete", "person": 9}]}, "there is no person 9"),
    ],
)
def test_a_malformed_file_is_told(tmp_path: Path, change: dict[str, object], message: str) -> None:
    write(tmp_path)
    digest = read_result(tmp_path).edits.digest
    (tmp_path / EDITS_FILE).write_text(json.dumps({"schema": 1, "digest": digest, **change}))
    with pytest.raises(InputError, match=message):
        read_result(tmp_path)
