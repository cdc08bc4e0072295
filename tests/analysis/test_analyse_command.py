"""Results in, tables and a page out; again only what has changed."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import numpy as np
import pytest
from even_walk import START_NS, STEP_M, landings, walk, write_result
from two_people_take import write_take

from depthmocap import AnalyseSettings, InputError, analyse
from depthmocap.analysis.measures import trials
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.cli import main
from depthmocap.exporting.edits import TakeMarker, write_edits
from depthmocap.exporting.stored_result import read_result
from depthmocap.recordings.open_recording import packaged_recording


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def mark(folder: Path, *markers: tuple[float, str]) -> None:
    result = read_result(folder)
    named = tuple(TakeMarker(START_NS + round(time_s * 1e9), text) for time_s, text in markers)
    write_edits(folder, dataclasses.replace(result.edits, markers=named))


def test_many_results_are_one_table(tmp_path: Path) -> None:
    write_result(tmp_path / "takes" / "anna" / "walk", walk(7))
    write_result(tmp_path / "takes" / "ben" / "walk", 0.9 * walk(5))
    write_take(tmp_path / "two")
    out = tmp_path / "out"
    settings = AnalyseSettings((tmp_path / "takes", tmp_path / "two"), out=out, report=False)
    rows = analyse(settings)
    table = rows_of(out / "parameters.csv")
    assert len(table) == len(rows)
    assert {row["result"] for row in table} == {"anna-walk", "ben-walk", "two"}
    assert {row["person"] for row in table if row["result"] == "two"} == {"person 1", "person 2"}
    lengths = {row["result"]: float(row["value"]) for row in table
               if row["quantity"] == "stride_length" and not row["side"]}  # fmt: skip
    assert lengths["anna-walk"] == pytest.approx(2 * STEP_M, abs=0.12)  # the last stride closes the feet
    assert lengths["ben-walk"] < lengths["anna-walk"]
    assert all(row["unit"] for row in table)
    events = rows_of(out / "anna-walk" / "events.csv")
    strikes = [float(row["time_s"]) for row in events if row["event"] == "heel strike"]
    np.testing.assert_allclose(strikes, [at - 0.06 for _, at in landings(7)], atol=0.04)
    assert (out / "two" / "person-2-series.csv").is_file()
    # Again: nothing is analysed, what belongs together stays, and a correction counts.
    stamp = (out / "anna-walk" / "series.csv").stat().st_mtime_ns
    assert len(analyse(settings)) == len(rows)
    assert (out / "anna-walk" / "series.csv").stat().st_mtime_ns == stamp
    mark(tmp_path / "takes" / "anna" / "walk", (0.5, "slow"), (3.6, "end"))
    again = analyse(settings)
    assert {row["trial"] for row in again if row["result"] == "anna-walk"} == {"slow"}
    assert (out / "anna-walk" / "series.csv").stat().st_mtime_ns > stamp
    assert [row["n"] for row in again if row["quantity"] == "stride_time" and not row["side"]][0] < 5  # noqa: RUF015


def test_the_truth_of_the_packaged_recording(tmp_path: Path) -> None:
    (tmp_path / "demo").mkdir()
    truth = packaged_recording() / "truth.csv"
    (tmp_path / "demo" / "pose.csv").write_bytes(truth.read_bytes())
    assert main(["analyse", str(tmp_path / "demo"), "--out", str(tmp_path / "out")]) == 0
    rows = {(row["quantity"], row["side"]): row for row in rows_of(tmp_path / "out" / "parameters.csv")}
    # The score of the demo: both arms are lifted to 163 degrees, and the trunk is bent by about 86.
    assert 155 < float(rows["shoulder_elevation", "left"]["largest"]) < 175
    assert 70 < float(rows["trunk_lean", ""]["largest"]) < 95
    page = (tmp_path / "out" / "analysis.html").read_text(encoding="utf-8")
    assert "no medical device" in page and "://" not in page.replace("http://www.w3.org", "")
    assert page.count("<img") == 5 and "only 8.0 poses a second" in page


def test_unsure_joints_are_not_seen(tmp_path: Path) -> None:
    joints = walk(7)
    confidence = np.ones(joints.shape[:2])
    confidence[:, JOINT_INDEX["LFoot"]] = 0.4
    write_result(tmp_path / "take", joints, confidence)
    rows = analyse(AnalyseSettings((tmp_path / "take",), out=tmp_path / "out", report=False))
    names = {(row["quantity"], row["side"]) for row in rows}
    assert ("knee_flexion", "left") not in names and ("knee_flexion", "right") in names
    assert not [name for name, _ in names if name.startswith("st")]  # a stride has a step of each foot
    rows = analyse(AnalyseSettings((tmp_path / "take",), out=tmp_path / "out", least_confidence=0.3, report=False))
    assert "stride_length" in {row["quantity"] for row in rows}


def test_trials() -> None:
    assert [trial.name for trial in trials([])] == ["all"]
    found = trials([(1.0, "walk"), (2.0, "End"), (4.0, ""), (6.0, "sit")])
    assert [(trial.name, trial.start_s, trial.end_s) for trial in found] == [
        ("walk", 1.0, 2.0), ("trial 3", 4.0, 6.0), ("sit", 6.0, np.inf)]  # fmt: skip
    assert found[0].holds(1.0, 1.9) and not found[0].holds(1.5, 2.0)


def test_what_is_wrong_is_told(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="nor has any"):
        analyse(AnalyseSettings((tmp_path / "empty",), out=tmp_path / "out"))
    with pytest.raises(InputError, match="name one or more"):
        analyse(AnalyseSettings((), out=tmp_path / "out"))
    write_result(tmp_path / "a", walk(3))
    with pytest.raises(InputError, match="must not be a folder of results"):
        analyse(AnalyseSettings((tmp_path / "a",), out=tmp_path / "a"))
    with pytest.raises(InputError, match="least-confidence"):
        analyse(AnalyseSettings((tmp_path / "a",), out=tmp_path / "out", least_confidence=2.0))
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "pose.csv").write_text("nothing\n")
    with pytest.raises(InputError, match="1 of 2 results"):
        analyse(AnalyseSettings((tmp_path / "a", tmp_path / "b"), out=tmp_path / "out", report=False))
    assert {row["result"] for row in rows_of(tmp_path / "out" / "parameters.csv")} == {"a"}
