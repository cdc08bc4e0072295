"""The truth of walks, and the errors against it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from even_walk import FPS as RATE
from even_walk import landings, walk
from rich.console import Console

from depthmocap.analysis.measures import Movement, movement
from depthmocap.analysis.steady_joints import SteadyJoints
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.evaluate import analysis_protocol
from depthmocap.evaluate.analysis_protocol import (
    AnalysisEvaluation,
    _errors,
    _summary,
    cells_of,
    evaluate_analysis,
    quantities_in_order,
)
from depthmocap.evaluate.estimated_sequences import SequenceEstimates
from depthmocap.evaluate.moving_people import FPS
from depthmocap.evaluate.walking_scenes import clip_scenes, true_swings
from depthmocap.exporting.timeline import Y_UP_FROM_Z_UP


def moved(joints: np.ndarray) -> Movement:
    return movement(SteadyJoints(np.arange(len(joints)) / RATE, joints @ Y_UP_FROM_Z_UP.T, 1 / RATE))


def test_a_foot_is_gone_when_heel_and_toe_have_gone() -> None:
    assert FPS == RATE
    joints = walk(6)
    foot = joints[:, JOINT_INDEX["LFoot"]]
    points = np.stack([foot, foot + np.array([0, -0.2, 0])], axis=1)
    found = true_swings(points, "left")
    times = [at for side, at in landings(6) if side == "L"]
    assert len(found) == len(times)
    for swing, landing_s in zip(found, times, strict=True):
        assert landing_s - 0.1 < swing.heel_strike_s < landing_s
        assert landing_s - 0.45 < swing.toe_off_s < landing_s - 0.3
    points[:, 1] = points[0, 1]  # a toe that stays holds the foot on the floor
    assert true_swings(points, "left") == []


def test_errors_of_the_truth_are_none_and_of_others_are_theirs() -> None:
    truth = moved(walk(7))
    for name, values in _errors(truth, truth).items():
        assert np.abs(values).max() < 1e-6, name
    longer = _errors(truth, moved(1.1 * walk(7)))
    strides = np.array(longer["stride_length"])
    assert len(strides) == len(truth.strides)
    np.testing.assert_allclose(strides, [0.1 * each.values["stride_length"] for each in truth.strides], rtol=0.05)
    missed = dataclasses.replace(truth, swings=[], strides=[])
    assert np.isnan(_errors(truth, missed)["heel_strike"]).all()
    summary = _summary([0.01, -0.03, float("nan"), 0.02])
    assert summary["found"] == 0.75 and summary["error"] == pytest.approx(0.02)
    unit, cells = cells_of("heel_strike", {"all": {"heel_strike": summary}})
    assert (unit, cells[0], cells[-1]) == ("ms", "20.0", "75% of 4")


def test_clips_need_a_manifest(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"manifest\.csv"):
        next(clip_scenes(tmp_path, "test", 1, np.random.default_rng(0)))
    (tmp_path / "manifest.csv").write_text("file,description\na.bvh,dance\n")
    with pytest.raises(InputError, match="described as a walk"):
        next(clip_scenes(tmp_path, "test", 1, np.random.default_rng(0)))
    with pytest.raises(InputError, match="at least 1"):
        AnalysisEvaluation(tmp_path, sequences=0)


@pytest.mark.slow
def test_true_joints_have_small_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def true_ones(settings, scenes, console):  # the truth in place of what cameras see
        made = []
        for scene in scenes:
            stamps = np.rint(scene.motion.times_s * 1e9).astype(np.int64)
            joints = np.repeat(scene.joints[None], 3, 0)
            made.append(SequenceEstimates(scene.name, stamps, scene.joints, joints, np.ones(joints.shape[:3])))
        return made

    monkeypatch.setattr(analysis_protocol, "_estimates", true_ones)
    settings = AnalysisEvaluation(tmp_path / "out", sequences=1, json=tmp_path / "numbers.json")
    numbers = evaluate_analysis(settings, Console(quiet=True))
    rows = numbers["views 3"]["all"]
    assert {"heel_strike", "stride_length", "sit_to_stand", "knee_flexion"} <= set(quantities_in_order(rows))
    assert rows["stride_length"]["error"] < 0.015 and rows["heel_strike"]["error"] < 0.04
    assert rows["sit_to_stand"]["error"] < 0.05 and rows["knee_flexion"]["error"] < 2
    assert (tmp_path / "numbers.json").is_file()
