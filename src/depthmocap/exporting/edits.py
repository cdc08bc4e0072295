"""Corrections of a result: kept in ``edits.json`` beside it and applied whenever it is read; the result stays."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray

from depthmocap.body.landmarks import POINT_MIRROR, POINTS
from depthmocap.body.skeleton import MIRROR
from depthmocap.core.output import write_json
from depthmocap.core.reading.json_text import read_json, whole_number
from depthmocap.errors import InputError
from depthmocap.recordings.pose_table import PoseTable

EDITS_FILE = "edits.json"
#: Version of the keys; it increases when a key is removed or changes its meaning.
SCHEMA = 1
#: Largest number of characters of a name or a marker.
LONGEST_NAME = 100
EditKind = Literal["name", "join", "split", "exchange", "delete", "trim"]
#: What a table has of every row: of joints and points,
_OF_JOINTS = ("joints", "confidence", "points", "points_confidence")
#: and all of it.
_ARRAYS = ("stamps_ns", "times_s", *_OF_JOINTS)
#: Largest absolute value of a timestamp (ns).
_MOST_NS = 2**63 - 1


@dataclasses.dataclass(frozen=True)
class Edit:
    """One correction. Times are on the frames' clock, as ``timestamp_ns`` of pose.csv, both included; None is the start
    or the end of the take.

    Attributes:
        kind: "name" gives a person, or without one the take, the ``name``; "join" gives ``person`` the poses of
            ``other`` where it has none of its own, and removes ``other``; "split" makes what ``person`` does from
            ``first_ns`` on a new person ``other``; "exchange" exchanges left and right of ``person`` in the span;
            "delete" removes the poses of ``person`` in the span, so that there is a gap, and without a span the person;
            "trim" keeps of everybody what is in the span.
        person: the number of a person of the result, or of one that a split made.
        other: another number, of "join" and "split".
    """

    kind: EditKind
    person: int | None = None
    other: int | None = None
    first_ns: int | None = None
    last_ns: int | None = None
    name: str = ""


@dataclasses.dataclass(frozen=True)
class TakeMarker:
    """A name for an instant, such as "trial 3"."""

    timestamp_ns: int
    text: str


@dataclasses.dataclass(frozen=True)
class Edits:
    """The corrections of one result, in the order in which they are applied.

    Attributes:
        digest: of the result that they belong to (``StoredResult.digest``).
    """

    digest: str
    edits: tuple[Edit, ...] = ()
    markers: tuple[TakeMarker, ...] = ()


def read_edits(folder: Path, digest: str) -> Edits:
    """The corrections beside a result; none where there is no ``edits.json``.

    Args:
        digest: of the result's poses.

    Raises:
        InputError: when the file is malformed, or belongs to another result.
    """
    path = folder / EDITS_FILE
    if not path.exists():
        return Edits(digest)
    document = read_json(path)
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise InputError(f"{path} is no file of corrections of this version (schema {SCHEMA}): move it away")
    if document.get("digest") != digest:
        raise InputError(f"{path} holds corrections of another result than what is beside it now: move it away")
    edits = [_edit(entry, f"{path}: edit {i + 1}") for i, entry in enumerate(_entries(document, "edits", path))]
    markers = []
    for i, entry in enumerate(_entries(document, "markers", path)):
        where = f"{path}: marker {i + 1}"
        stamp = whole_number(entry.get("timestamp_ns"), f"{where}: timestamp_ns")
        markers.append(TakeMarker(stamp, _name(entry, "text", where)))
    return Edits(digest, tuple(edits), tuple(markers))


def write_edits(folder: Path, edits: Edits) -> None:
    """Write ``edits.json``, or remove it where nothing is corrected.

    Raises:
        InputError: when it cannot be written.
    """
    if edits.edits or edits.markers:
        write_json(folder / EDITS_FILE, {"schema": SCHEMA, **dataclasses.asdict(edits)})
    else:
        (folder / EDITS_FILE).unlink(missing_ok=True)


def _entries(document: Mapping[str, Any], key: str, path: Path) -> Sequence[Mapping[str, Any]]:
    entries = document.get(key, [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise InputError(f"{path}: {key} must be a list of objects")
    return entries


def _name(entry: Mapping[str, Any], key: str, where: str) -> str:
    value = entry.get(key, "")
    if not isinstance(value, str) or len(value) > LONGEST_NAME:
        raise InputError(f"{where}: {key} must be text of at most {LONGEST_NAME} characters")
    return value


def _edit(entry: Mapping[str, Any], where: str) -> Edit:
    kind = entry.get("kind")
    if kind not in get_args(EditKind):
        raise InputError(f"{where}: kind must be one of {', '.join(get_args(EditKind))}, got {kind!r}")
    numbers = {
        key: None if entry.get(key) is None else whole_number(entry[key], f"{where}: {key}")
        for key in ("person", "other", "first_ns", "last_ns")
    }
    return Edit(cast(EditKind, kind), **numbers, name=_name(entry, "name", where))


@dataclasses.dataclass(frozen=True, eq=False)
class EditedPeople:
    """People after corrections: their poses and names by number, and the name of the take; names may be empty."""

    tables: dict[int, PoseTable]
    names: dict[int, str]
    take: str = ""


def apply_edits(tables: Mapping[int, PoseTable], edits: Edits) -> EditedPeople:
    """People's poses by number, corrected in the order of the edits. What is given stays as it is.

    Raises:
        InputError: when an edit is of a person whom there is not at that point.
    """
    state = EditedPeople(dict(tables), {})
    for i, edit in enumerate(edits.edits):
        state = _APPLY[edit.kind](state, edit, f"edit {i + 1} ({edit.kind})")
    return state


def _table(state: EditedPeople, number: int | None, where: str) -> PoseTable:
    if number is None or number not in state.tables:
        there = ", ".join(map(str, sorted(state.tables))) or "nobody"
        raise InputError(f"{where}: there is no person {number}, but {there}")
    return state.tables[number]


def _with(state: EditedPeople, tables: Mapping[int, PoseTable]) -> EditedPeople:
    kept = {number: table for number, table in {**state.tables, **tables}.items() if len(table)}
    return dataclasses.replace(state, tables=kept)


def _within(table: PoseTable, edit: Edit) -> Bool[ndarray, " t"]:
    first = -_MOST_NS if edit.first_ns is None else edit.first_ns
    last = _MOST_NS if edit.last_ns is None else edit.last_ns
    return np.asarray((table.stamps_ns >= first) & (table.stamps_ns <= last))


def _rows(table: PoseTable, which: Bool[ndarray, " t"] | Int[ndarray, " n"]) -> PoseTable:
    kept = {key: array[which] for key in _ARRAYS if (array := getattr(table, key)) is not None}
    return dataclasses.replace(table, **kept)


def _with_unknown_points(table: PoseTable) -> PoseTable:
    if table.points is not None:
        return table
    count = len(table), len(POINTS)
    return dataclasses.replace(table, points=np.full((*count, 3), np.nan), points_confidence=np.zeros(count))


def _apply_name(state: EditedPeople, edit: Edit, where: str) -> EditedPeople:
    if edit.person is None:
        return dataclasses.replace(state, take=edit.name)
    _table(state, edit.person, where)
    return dataclasses.replace(state, names={**state.names, edit.person: edit.name})


def _apply_join(state: EditedPeople, edit: Edit, where: str) -> EditedPeople:
    table, other = _table(state, edit.person, where), _table(state, edit.other, where)
    if edit.person == edit.other:
        raise InputError(f"{where}: person {edit.person} cannot be joined with themselves")
    seen = np.asarray(np.isfinite(table.joints).any((1, 2)))
    taken = np.isin(other.stamps_ns, table.stamps_ns[seen])
    # Rows without a joint give way to rows of the other at the same instant.
    kept = seen | ~np.isin(table.stamps_ns, other.stamps_ns[~taken])
    table, other = _rows(table, kept), _rows(other, ~taken)
    if table.points is not None or other.points is not None:
        table, other = _with_unknown_points(table), _with_unknown_points(other)
    arrays = {key: (getattr(table, key), getattr(other, key)) for key in _ARRAYS}
    together = {key: np.concatenate(pair) for key, pair in arrays.items() if pair[0] is not None}
    both = dataclasses.replace(table, **together)
    joined = _rows(both, np.argsort(both.stamps_ns, kind="stable"))
    assert edit.person is not None and edit.other is not None
    tables = {number: table for number, table in state.tables.items() if number != edit.other}
    names = {number: name for number, name in state.names.items() if number != edit.other}
    return EditedPeople({**tables, edit.person: joined}, names, state.take)


def _apply_split(state: EditedPeople, edit: Edit, where: str) -> EditedPeople:
    table = _table(state, edit.person, where)
    if edit.other is None or edit.other in state.tables or edit.first_ns is None:
        raise InputError(f"{where}: it needs a time (first_ns) and a number for the new person (other) that is free")
    later = table.stamps_ns >= edit.first_ns
    assert edit.person is not None
    return _with(state, {edit.person: _rows(table, ~later), edit.other: _rows(table, later)})


def _apply_exchange(state: EditedPeople, edit: Edit, where: str) -> EditedPeople:
    table = _table(state, edit.person, where)
    mirrors: dict[str, ndarray] = dict(zip(_OF_JOINTS, (MIRROR, MIRROR, POINT_MIRROR, POINT_MIRROR), strict=True))
    assert edit.person is not None
    exchanged = _changed(table, edit, lambda key, array: array[:, mirrors[key]])
    return _with(state, {edit.person: exchanged})


def _changed(table: PoseTable, edit: Edit, change: Callable[[str, ndarray], ndarray | float]) -> PoseTable:
    """The table with joints, points and their confidences, where there are any, changed within the edit's time."""
    within = _within(table, edit)
    arrays = {key: getattr(table, key) for key in _OF_JOINTS}
    changed = {
        key: np.where(within.reshape(-1, *[1] * (array.ndim - 1)), change(key, array), array)
        for key, array in arrays.items()
        if array is not None
    }
    return dataclasses.replace(table, **changed)


def _apply_delete(state: EditedPeople, edit: Edit, where: str) -> EditedPeople:
    table = _table(state, edit.person, where)
    assert edit.person is not None
    if edit.first_ns is None and edit.last_ns is None:
        return EditedPeople(
            {number: table for number, table in state.tables.items() if number != edit.person},
            {number: name for number, name in state.names.items() if number != edit.person},
            state.take,
        )
    deleted = _changed(table, edit, lambda key, array: 0.0 if key.endswith("confidence") else np.nan)
    return _with(state, {edit.person: deleted})


def _apply_trim(state: EditedPeople, edit: Edit, where: str) -> EditedPeople:
    trimmed = {number: _rows(table, _within(table, edit)) for number, table in state.tables.items()}
    if not any(map(len, trimmed.values())):
        raise InputError(f"{where}: nothing is left between {edit.first_ns} and {edit.last_ns}")
    return _with(state, trimmed)


_APPLY: dict[str, Callable[[EditedPeople, Edit, str], EditedPeople]] = {
    "name": _apply_name,
    "join": _apply_join,
    "split": _apply_split,
    "exchange": _apply_exchange,
    "delete": _apply_delete,
    "trim": _apply_trim,
}
