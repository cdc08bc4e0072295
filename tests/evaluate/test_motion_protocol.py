"""Filters measured on generated sequences."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.cli import main
from depthmocap.core.settings import plain_settings
from depthmocap.errors import InputError
from depthmocap.evaluate.estimated_sequences import EstimateStore, SequenceEstimates
from depthmocap.evaluate.motion_protocol import MotionEvaluation, evaluate_motion
from depthmocap.evaluate.moving_people import (
    FPS,
    REACH_M,
    REST_S,
    clip_motions,
    moving_frames,
    pelvis_trajectory,
    prior_motions,
)
from depthmocap.evaluate.temporal_metrics import temporal_metrics
from depthmocap.smooth.filters import BONES_CHOICES, FILTERS
from depthmocap.synth.body.bones import heading
from depthmocap.synth.body.mesh import REST_POSTURE, Body, BodyModel, Phenotype
from depthmocap.synth.motion.sequence import demo_motion
from depthmocap.synth.people.garments import clothe
from depthmocap.synth.people.wardrobe import ORDINARY_CLOTHES
from depthmocap.synth.sensing.sensor import SensorModel
from depthmocap.synth.sensing.sensors import find_sensor

QUIET = Console(quiet=True)


def test_motion_of_the_prior_comes_to_rest_without_jerks() -> None:
    motion = next(prior_motions(1, 2.0, np.random.default_rng(0)))
    again = next(prior_motions(1, 2.0, np.random.default_rng(0)))
    np.testing.assert_array_equal(motion.postures, again.postures)
    rest = round(REST_S * FPS)
    assert np.ptp(motion.postures[-rest:], axis=0).max() < 1e-9
    turns = np.abs(np.diff(np.unwrap(heading(motion.postures))))
    assert 0.01 < turns.max() < 0.2


def test_the_standing_foot_stays_where_it_is(default_body: Body) -> None:
    dressed = clothe(default_body, ORDINARY_CLOTHES, np.random.default_rng(0))
    known = demo_motion(dressed, np.arange(3.3, 5.0, 1 / FPS))  # steps forward, feet nailed to the floor
    way = pelvis_trajectory(default_body, known.postures)
    moved = way - way[0] - (known.offsets - known.offsets[0])[:, :2]
    # Both feet are low while the weight goes over, so that a little is lost.
    assert np.abs(moved).max() < 0.3 * np.abs(known.offsets - known.offsets[0])[:, 1].max()


def test_frames_show_the_moving_person(default_body: Body) -> None:
    motion = next(prior_motions(1, 1.0, np.random.default_rng(1)))
    short = dataclasses.replace(motion, postures=motion.postures[:3])
    frames = list(moving_frames(short, 2, (find_sensor("kinect2"),), np.random.default_rng(2)))
    assert [frame.timestamp_ns for frame in frames] == [0, 33333333, 66666667]
    for frame in frames:
        assert frame.true_joints is not None and len(frame.views) == 2
        assert np.linalg.norm(frame.true_joints[JOINT_INDEX["Hip"], :2]) < 2 * REACH_M
        assert all(view.mask is not None and view.mask.sum() > 1000 for view in frame.views)
    assert frames[0].views[0].camera is frames[2].views[0].camera


def test_cameras_out_of_step_see_other_instants(default_body: Body) -> None:
    motion = next(prior_motions(1, 1.0, np.random.default_rng(1)))
    moving = dataclasses.replace(motion, postures=motion.postures[12:15])
    sensors = (dataclasses.replace(find_sensor("kinect2"), model=SensorModel()),)
    exact, off = (
        list(moving_frames(moving, 3, sensors, np.random.default_rng(2), out_of_step_s))
        for out_of_step_s in (0.0, 0.03)
    )
    for frame, other in zip(exact, off, strict=True):
        np.testing.assert_array_equal(frame.true_joints, other.true_joints)  # the set's time is the same
        assert frame.timestamp_ns == other.timestamp_ns
    same = [
        np.array_equal(view.depth_m, other.depth_m) for view, other in zip(exact[1].views, off[1].views, strict=True)
    ]
    assert sorted(same) == [False, False, True]  # the one in the middle tells the set's time
    # What the others see lies between the frames before and after.
    for camera in np.flatnonzero(~np.array(same)):
        here, before, after, seen = (
            frames[i].views[camera].depth_m for frames, i in ((exact, 1), (exact, 0), (exact, 2), (off, 1))
        )
        off_by = [np.abs(each - seen)[(each > 0) & (seen > 0)].mean() for each in (before, here, after)]
        assert np.argmax(off_by) != 1


def test_the_fault_is_measured_beside_the_same_sequences(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("depthmocap.evaluate.motion_protocol.FILTERS", ("kalman",))
    settings = MotionEvaluation(tmp_path / "estimates", sequences=1, views=2, out_of_step_ms=16.0)
    settings = dataclasses.replace(settings, report=tmp_path / "new" / "page.html")
    tracks = _with_estimates(settings)
    store = EstimateStore(settings.out / "out_of_step_16_ms", _binding(settings))
    for index, track in enumerate(tracks):
        store.save(index, dataclasses.replace(track, joints=track.truth + 1.5 * (track.joints - track.truth)))
    numbers = evaluate_motion(settings, QUIET)
    assert numbers["out of step, growth"]["none"] == pytest.approx(0.5)
    growth = numbers["out of step"]["none"]["mean_joint_error_cm"] / numbers["views 2"]["none"]["mean_joint_error_cm"]
    assert growth == pytest.approx(1.5)
    page = (tmp_path / "new" / "page.html").read_text()
    assert page.count("<td>kalman, steady bones</td>") == 3 and "sway 0" in page


def test_clips_of_the_split_are_taken_and_too_few_are_told(tmp_path: Path, default_body: Body) -> None:
    with pytest.raises(InputError, match=r"no \.bvh"):
        next(clip_motions(tmp_path, "test", 1, 1.0, np.random.default_rng(0)))


def _tracks(settings: MotionEvaluation) -> list[SequenceEstimates]:
    """Estimates of a body that sways, with noise that the confidence knows nothing of."""
    pytest.importorskip("anny")
    rng = np.random.default_rng(0)
    base = BodyModel.load().shape(Phenotype()).pose(REST_POSTURE).joints.astype(np.float64)
    tracks = []
    for index in range(settings.sequences):
        sway = 0.2 * np.sin(np.arange(90) / FPS * 3)[:, None, None] * np.where(np.arange(90) < 70, 1, 0)[:, None, None]
        truth = base + sway + np.zeros((90, 18, 3))
        joints = truth + rng.normal(0, 0.01, (settings.views, *truth.shape))
        confidence = np.ones(joints.shape[:3])
        tracks.append(
            SequenceEstimates(
                f"sway {index}", np.round(np.arange(90) / FPS * 1e9).astype(int), truth, joints, confidence
            )
        )
    return tracks


def _binding(settings: MotionEvaluation) -> dict[str, Any]:
    left_out = ("out", "device", "sequences", "sides_wrong", "out_of_step_ms", "lag_frames", "json", "report")
    return {k: v for k, v in plain_settings(settings).items() if k not in left_out}


def _with_estimates(settings: MotionEvaluation) -> list[SequenceEstimates]:
    store = EstimateStore(settings.out, _binding(settings))
    for index, track in enumerate(tracks := _tracks(settings)):
        store.save(index, track)
    return tracks


def test_every_filter_is_measured_on_kept_estimates(tmp_path: Path) -> None:
    settings = MotionEvaluation(tmp_path / "estimates", sequences=1, views=2, json=tmp_path / "numbers.json")
    tracks = _with_estimates(settings)
    numbers = evaluate_motion(settings, QUIET)
    assert json.loads((tmp_path / "numbers.json").read_text())["frames"] == 90
    for views in (1, 2):
        rows = numbers[f"views {views}"]
        filtered = [f"{name}, {bones} bones" for name in FILTERS for bones in BONES_CHOICES]
        assert set(rows) == {"none", *filtered}
        raw = temporal_metrics(
            [track.joints[views - 1] for track in tracks], [track.truth for track in tracks], 1 / FPS
        )
        assert rows["none"]["mean_joint_error_cm"] == pytest.approx(raw.mean_joint_error_cm)
        for name in filtered:
            assert rows[name]["acceleration_error_mm"] < 0.8 * raw.acceleration_error_mm
            assert rows[name]["rest_jitter_mm"] < 0.8 * raw.rest_jitter_mm
        for name in FILTERS:
            assert rows[f"{name}, steady bones"]["bone_deviation_mm"] < (
                0.7 * rows[f"{name}, free bones"]["bone_deviation_mm"]
            )
    assert numbers["views 1"]["fixed-lag, free bones"]["waits_ms"] == pytest.approx(4e3 / FPS)


def test_wrong_sides_are_undone(tmp_path: Path) -> None:
    settings = MotionEvaluation(tmp_path / "estimates", sequences=1, views=1, sides_wrong=0.2)
    _with_estimates(settings)
    rows = evaluate_motion(settings, QUIET)["views 1"]
    assert rows["none"]["flips_per_1000"] > 100
    for name, row in rows.items():
        assert name == "none" or row["flips_per_1000"] < 0.1 * rows["none"]["flips_per_1000"]


def test_estimates_of_other_settings_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _with_estimates(MotionEvaluation(tmp_path / "estimates", sequences=1, views=1))
    assert main(["evaluate", "motion", "--out", str(tmp_path / "estimates"), "--views", "2"]) == 2
    assert "other settings" in capsys.readouterr().err
    broken = MotionEvaluation(tmp_path / "estimates", sequences=1, views=1)
    (tmp_path / "estimates" / "0000.npz").write_bytes(b"no archive")
    with pytest.raises(InputError, match="delete it"):
        evaluate_motion(broken, QUIET)


def test_bad_settings() -> None:
    changes: list[dict[str, Any]] = [
        {"sequences": 0}, {"seconds": 0.1}, {"sides_wrong": 1.0}, {"seed": -1}, {"sensors": ()},
        {"out_of_step_ms": -1.0}, {"out_of_step_ms": 40.0}, {"out_of_step_ms": 16.0, "views": 1},
    ]  # fmt: skip
    for bad in changes:
        with pytest.raises(InputError):
            MotionEvaluation(Path("out"), **bad)
