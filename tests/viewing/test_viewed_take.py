"""Takes on their timeline: recordings, results and truth side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from viewed import APART_M, COMES_AT, GAP, OFF_M, SETS, write_result

from depthmocap.errors import InputError
from depthmocap.exporting.edits import Edit, Edits
from depthmocap.exporting.stored_result import read_result
from depthmocap.recordings.open_recording import open_recording
from depthmocap.viewing.viewed_take import ViewedTake, gap_starts, nearest_rows, open_take, worst_instants


def test_nearest_rows() -> None:
    stamps, table = np.array([0, 10, 20, 31, 90]), np.array([1, 11, 30, 60])
    assert nearest_rows(stamps, table, 2).tolist() == [0, 1, -1, 2, -1]
    assert nearest_rows(stamps, np.zeros(0, np.int64), 2).tolist() == [-1] * 5
    assert nearest_rows(stamps, np.array([20]), 1).tolist() == [-1, -1, 0, -1, -1]


def test_gaps_and_worst_instants() -> None:
    seen = np.array([False, True, True, False, False, True, False])
    assert gap_starts(seen).tolist() == [0, 3, 6]
    confidence = np.array([0.9, 0.5, 0.4, np.nan, 0.8, 0.7])
    assert worst_instants(confidence, np.arange(6) * 0.3) == [2, 5, 0]
    assert worst_instants(np.full(3, np.nan), np.arange(3.0)) == []


def test_a_recording_alone(recording: Path) -> None:
    take = open_take((recording,))
    assert len(take) == SETS and take.people == () and take.has_truth and take.up == "z"
    frames = take.frames(2)
    assert frames is not None and frames.timestamp_ns == take.stamps_ns[2]
    assert np.isfinite(take.truth(0, SETS)).all() and np.isnan(take.confidence(None)).all()


def test_a_result_brings_its_recording(result: Path, recording: Path) -> None:
    take = open_take((result,))
    assert take.recording is not None and take.recording.path == recording
    assert [person.label for person in take.people] == ["person 1", "person 2"]
    assert len(take) == SETS and not take.notes
    first, second = take.people
    assert first.at(GAP[0]) is None and second.at(COMES_AT - 1) is None
    found = second.at(COMES_AT)
    assert found is not None and np.allclose(
        found[0] - take.truth(COMES_AT, COMES_AT + 1)[0], [OFF_M + APART_M, 0, 0], atol=2e-6
    )
    assert np.allclose(take.confidence(None), [0.9, 0.9, 0.5, 0.8, 0.8, 0.8, 0.8, 0.8])
    assert np.flatnonzero(np.isnan(take.confidence(1))).tolist() == list(GAP)
    error_m = take.error_m(None)
    assert np.allclose(error_m[:COMES_AT], OFF_M, atol=2e-6) and np.allclose(
        error_m[GAP[0]], OFF_M + APART_M, atol=2e-6
    )
    assert np.isnan(first.series(4, 7)[0][1:]).all() and np.isfinite(first.series(4, 7)[0][0]).all()


def test_a_result_without_its_recording(recording: Path, tmp_path: Path) -> None:
    write_result(tmp_path / "out", recording)
    summary = tmp_path / "out" / "summary.json"
    summary.write_text(summary.read_text().replace(recording.name, "gone"))
    take = open_take((tmp_path / "out",))
    assert take.recording is None and take.frames(0) is None and not take.has_truth and len(take.people) == 2


def test_two_results_over_each_other(result: Path, recording: Path, tmp_path: Path) -> None:
    write_result(tmp_path / "other", recording, off_m=0.5)
    take = open_take((recording, result), tmp_path / "other")
    (mine, _), (other, _) = take.people, take.beside
    assert np.allclose((other.series(0, 2)[0] - mine.series(0, 2)[0])[..., 0], 0.5 - OFF_M, atol=2e-6)
    assert not take.notes


def test_a_result_of_another_time_is_moved(result: Path, tmp_path: Path) -> None:
    table = (result / "person-1" / "pose.csv").read_text()
    other = tmp_path / "later"
    other.mkdir()
    (other / "pose.csv").write_text(table.replace(",17000", ",18000"))
    take = open_take((result,), other)
    assert take.beside[0].rows.tolist() == list(range(SETS)) and "another time" in take.notes[0]


def test_corrections_change_the_timeline(result: Path) -> None:
    take = open_take((result,))
    stored = read_result(result)
    first_ns = int(take.stamps_ns[2])
    take.change_result(stored.edited(Edits(stored.edits.digest, (Edit("trim", first_ns=first_ns),))))
    assert len(take) == SETS - 2 and take.index_at(first_ns) == 0 and take.index_at(first_ns - 10**12) == 0
    nobody = Edits(stored.edits.digest, (Edit("delete", 1), Edit("delete", 2)))
    take.change_result(stored.edited(nobody))  # the room is left
    assert len(take) == SETS and take.people == ()
    alone = ViewedTake(None, stored)
    with pytest.raises(InputError, match="no pose to show"):
        alone.change_result(stored.edited(nobody))
    assert len(alone) == SETS and len(alone.people) == 2


def test_what_is_no_take_is_told(result: Path, recording: Path, tmp_path: Path) -> None:
    for paths, message in (
        ((), "name a recording"),
        ((tmp_path / "nowhere",), "is not a folder"),
        ((result, result), "second folder of results"),
        ((recording, recording), "second recording"),
    ):
        with pytest.raises(InputError, match=message):
            open_take(paths)


def test_sets_have_their_times(recording: Path) -> None:
    opened = open_recording(recording)
    assert opened.set_stamps_ns.tolist() == [opened[i].timestamp_ns for i in range(len(opened))]
