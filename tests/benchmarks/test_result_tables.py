"""The tables of results, and the pages that they are written into."""

from __future__ import annotations

import collections
from pathlib import Path
from typing import Any

import analysis_tables
import bench_tables
import people_tables
import pytest
import results
import time_tables
import tyro
from measurements import ROOT, Measurement, Scale

from depthmocap.analysis.quantities import ANGLES, GAIT, TRANSFERS
from depthmocap.commands import COMMANDS
from depthmocap.errors import InputError
from depthmocap.evaluate.posture_scenarios import ACTS
from depthmocap.smooth.filters import BONES_CHOICES, FILTERS


def _bench_row(error_cm: float) -> dict[str, Any]:
    return {
        "frames": 200, "labels": "network", "mean_joint_error_cm": error_cm, "within_10cm": 0.987,
        "pixel_accuracy": 0.8271, "class_accuracy": 0.7979, "side_swap": 0.0245, "turned_round": 0.05,
        "turned_round_surely": 0.01, "reliability": {"joints": [40, 160], "within_10cm": [0.5, 0.991]},
    }  # fmt: skip


def _bench() -> dict[str, Any]:
    """Every measurement, each with an error of its own."""
    sets = {name: _bench_row(i + 1.234) for i, name in enumerate((*bench_tables.ORDINARY, *bench_tables.RARE))}
    return {name: {**sets, **_bench_row(9.876)} for name in bench_tables.measurements("CLIPS", Scale())}


def _people() -> dict[str, Any]:
    row = {
        "sets": 360, "ghost_sets": 4, "cpu_ms_per_view": 1.94, "arrivals": 21, "overlap_mean": 0.9504,
        "overlap_p5": 0.891, "found_share": 0.969, "switches": 6, "returns_old": 2, "returns_new": 1,
        "returns_wrong": 0, "first_mask_s_p50": 0.2, "first_mask_s_most": None,
    }  # fmt: skip
    joints = {"mean": 1.5, "near": 1.2}
    numbers = {"settings": {"scenes": 2}, "first person's joints, cm": collections.defaultdict(lambda: joints)}
    kinds = (*ACTS, *people_tables.RETURNS, "rooms without people", "meeting", "beside furniture")
    for kind in kinds:
        for way in people_tables.WAYS:
            numbers |= {f"{kind}, {way}": row, f"{kind}, {way}, background known": row}
    return dict.fromkeys(people_tables.measurements("CLIPS", Scale()), numbers)


def _motion() -> dict[str, Any]:
    fields = (
        "mean_joint_error_cm", "acceleration_error_mm", "acceleration_error_mps2", "rest_jitter_mm", "foot_skate_cmps",
        "bone_deviation_mm", "flips_per_1000", "lag_ms", "waits_ms", "us_per_frame",
    )  # fmt: skip
    names = ("none", *(f"{name}, {bones} bones" for name in FILTERS for bones in BONES_CHOICES))
    rows = {name: dict.fromkeys(fields, 2.345) for name in names}
    skeleton = dict.fromkeys([key for key, *_ in time_tables.SKELETON_ROWS], 2.345)
    columns = [f"{joints}, {way}" for joints in ("true joints", "3 views") for way in ("files", "live")]
    skeletons = {"frames": 738, **{name: {**skeleton, "sequences": [skeleton]} for name in columns}}
    return {"motion": {"views 3": rows, "views 1": rows}, "skeleton": skeletons}


def _analysis() -> dict[str, Any]:
    names = ("heel_strike", "toe_off", "mass_centre", *GAIT, *TRANSFERS, *ANGLES, *(f"{name} range" for name in ANGLES))
    row = {"n": 1234, "found": 0.99, "error": 0.0234, "within_95": 0.0567}
    rows = {kind: dict.fromkeys(names, row) for kind in analysis_tables.KINDS}
    return {"analysis": {f"views {views}": rows for views in (1, 2, 3)}}


def _calibration() -> dict[str, Any]:
    numbers = dict.fromkeys(
        ("mm", "degrees", "± mm", "± degrees", "tilt degrees", "height mm", "joints cm, true rig",
         "joints cm, found rig"), 1.26,
    )  # fmt: skip
    row = {**numbers, "most mm": 2.06, "most degrees": 0.04, "grade": "good"}
    pair = {"told": True, "error_s": 0.004, "sigma_s": 0.002, "jump": False}
    kinds = ("about", "circle", "line", "clockwork", "arms")
    simulated = [{**pair, "from": "simulated", "kind": kind} for kind in kinds]
    depth = [{**pair, "from": "depth", "kind": kind} for kind in ("circle", "line", "arms")]
    return {
        "calibration": [{**row, "scene": scene} for scene in ("3 cameras", "4 cameras", "2 cameras, 90° apart")],
        "sync": [*simulated, *depth],
        "sync_30_hz": simulated,
    }


def _speed() -> dict[str, Any]:
    rows = {
        "Pipeline, a set of 4 masked Kinects": "108.4 sets a second over 40 s (labels 4.1 ms)",
        "Label a view (fast), 4 views a call": "", "Write a frame: hard, ubc3v": "", "Write a frame: hard, shards": "",
    }  # fmt: skip
    timing = {"median_ms": 5.0, "p95_ms": 9.8}
    soak = {
        "settings": {"minutes": 30.0, "rate_hz": 30.0}, "frames_sent": {"a": 54_000, "b": 54_000}, "cpu_cores": 0.64,
        "sets_per_second": 28.1, "latency_ms": {"p50": 20.6, "p95": 64.1}, "sets_dropped": 3446,
        "recording": {"lost": 0, "offered": {"a": 100_000, "b": 109_024}, "ratio": 2.45},
        "memory": {"mb": [[2.0, 1100.0], [61.0, 1216.0]], "mb_at_the_end": 1238.2, "mb_a_minute": 0.051},
    }  # fmt: skip
    stream = {"p50_ms": 21.4, "p95_ms": 38.6}
    viewed = {
        "settings": {"minutes": 10.0}, "sets_per_second": 29.87, "sets": 17_990, "sets_dropped": 10,
        "frames_unrecorded": 0, "frames": {"offered": {"a": 18_000, "b": 18_000}},
        "streams": {"osc": stream, "ws": stream}, "memory": soak["memory"] | {"mb_most": 431.7}, "start_s": 2.64,
        "cores": {"live": 0.71, "cameras": 0.05},
    }  # fmt: skip
    coding = {"ratio": 2.65, "coded_a_second": 901.2, "decoded_a_second": None}
    return {
        **_people(), **_motion(), "demo": {"frames_by_camera": {"a": 1, "b": 1, "c": 1}, "frames_per_second": 31.2},
        "benchmark": {
            "machine": {"processor": "AMD EPYC", "usable_cores": 2},
            "rows": [{"what": what, "note": note, "ours": timing, "ratio": 6.6} for what, note in rows.items()],
        },
        "soak_faults": soak, "soak_perfect": soak,
        **dict.fromkeys(("view_one", "view_two", "view_core", "view_memory"), viewed),
        "codings": {"codings": collections.defaultdict(lambda: coding)},
    }  # fmt: skip


_NUMBERS = {
    "bench": _bench, "people": _people, "time": _motion, "analysis": _analysis, "calibration": _calibration,
    "speed": _speed,
}  # fmt: skip
#: A row of each group's tables.
_ROWS = {
    "bench": "| mean joint error, 3 views (within 10 cm) | 1.23 cm (98.7 %) | 9.88 cm (98.7 %) |",
    "people": "| `auto`, the empty scene known | 0.950 (0.89) | 96.9 % | 6 times | 0.20 (–) | 4 | 1.9 |",
    "time": "| **kalman, steady bones** (`auto`) | 2.35 | 2.3 (2.3) | 2.35 | 2.3 | 2.3 | 2.3 | 2 | 2 |",
    "analysis": "| heel strike | ms | 23.4 | 23.4 | 23.4 | 23.4 | 23.4 | 56.7 | 99% of 1,234 |",
    "calibration": "| 3 cameras | 1.3 (worst 2.1) | 1.26 (0.04) | 1.3 mm, 1.26° | 1.26°; 1.3 mm | 1.26; 1.26 |",
    "speed": "| sets left out | 3,446 of 54,000 | 3,446 of 54,000 |",
}


@pytest.mark.parametrize("name", _NUMBERS)
def test_tables_fill_the_marks_of_the_pages(name: results.Group) -> None:
    group = results.GROUPS[name]
    tables = group.make(_NUMBERS[name]())
    marked = set()
    for page_name in group.pages:
        page = (ROOT / page_name).read_text(encoding="utf-8")
        filled = results.fill(page, tables)
        assert filled != page and results.fill(filled, tables) == filled
        assert filled.count("\n|") == page.count("\n|")  # the tables of the page have the rows that are made
        marked |= {table for table in tables if f"<!-- results: {table} -->" in page}
    assert marked == set(tables)
    assert _ROWS[name] in [line for lines in tables.values() for line in lines]


def test_numbers_of_other_scales_are_kept_apart() -> None:
    settings = tyro.cli(results.Settings, args=["CLIPS", "--only", "people", "time", "--samples", "3"])
    assert settings.only == ("people", "time") and settings.scale == Scale(samples=3)
    assert results.folder_of(settings, settings.scale) != results.folder_of(settings, Scale())


@pytest.mark.parametrize("name", _NUMBERS)
def test_measurements_are_of_commands_that_there_are(name: results.Group) -> None:
    for measurement in results.GROUPS[name].measurements("CLIPS", Scale()).values():
        words = measurement.words
        if words[0].endswith(".py"):
            assert (ROOT / "benchmarks" / words[0]).exists()
        else:
            assert any(" ".join(words).startswith(f"{command.words} ") for command in COMMANDS)


def test_what_was_measured_is_not_measured_again(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    measurement = Measurement(("info", "{out}/none.mcap"), None)
    with pytest.raises(InputError, match=r"info .*none\.mcap failed"):
        measurement.read("info", tmp_path)
    assert "none.mcap" in capfd.readouterr().err
    (tmp_path / "info.json").write_text('{"frames": 3}')
    assert measurement.read("info", tmp_path) == {"frames": 3}


@pytest.mark.parametrize("page", ["<!-- results: joy -->\n\n<!-- end -->", "<!-- results: rare -->\n"])
def test_marks_that_cannot_be_right(page: str) -> None:
    with pytest.raises(InputError, match=r"no table 'joy'|no end"):
        results.fill(page, {"rare": []})
