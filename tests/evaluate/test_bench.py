"""The project's own test sets, end to end on a few samples."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
from rich.console import Console

from depthmocap.errors import InputError
from depthmocap.evaluate.bench import BenchEvaluation, evaluate_bench
from depthmocap.synth.body.mesh import BodyModel
from depthmocap.synth.sample import BENCH

QUIET = Console(quiet=True)


def test_true_labels_beat_the_network(body_model: BodyModel, tmp_path: Path) -> None:
    path = tmp_path / "numbers.json"
    found = {
        labels: evaluate_bench(BenchEvaluation(samples=6, sets=("seen",), labels=labels, workers=0, json=path), QUIET)[
            "seen"
        ]
        for labels in ("network", "true")
    }
    assert json.loads(path.read_text())["seen"]["mean_joint_error_cm"] == found["true"]["mean_joint_error_cm"]
    assert found["true"]["mean_joint_error_cm"] < found["network"]["mean_joint_error_cm"] < 40
    assert found["true"]["pixel_accuracy"] == 1
    assert 0.3 < found["network"]["pixel_accuracy"] < 0.98
    assert found["network"]["frames"] == 6 and found["network"]["clips"] == []
    assert found["network"]["recipe"]["split"] == "test"


def test_masks_in_rooms_may_be_those_that_the_network_finds(body_model: BodyModel) -> None:
    settings = BenchEvaluation(samples=2, sets=("seen",), scene="full", workers=0)
    true = evaluate_bench(settings, QUIET)["seen"]
    found = evaluate_bench(dataclasses.replace(settings, masks="network"), QUIET)["seen"]
    assert true["recipe"]["scene"] == "full" and found["true_joints"] == true["true_joints"]
    with pytest.raises(InputError, match="--masks network"):
        evaluate_bench(dataclasses.replace(settings, masks="network", labels="true"), QUIET)
    assert true["mean_joint_error_cm"] != found["mean_joint_error_cm"] < 20


@pytest.mark.slow
def test_sets_differ_and_are_made_alike_again(body_model: BodyModel) -> None:
    settings = BenchEvaluation(samples=2, workers=0)
    first, again = evaluate_bench(settings, QUIET), evaluate_bench(settings, QUIET)
    assert set(first) == set(BENCH)
    errors = [first[name]["mean_joint_error_cm"] for name in BENCH]
    assert errors == [again[name]["mean_joint_error_cm"] for name in BENCH]
    assert len(set(errors)) == len(BENCH)


def test_misplaced_cameras_cost_accuracy(body_model: BodyModel) -> None:
    settings = BenchEvaluation(samples=4, sets=("seen",), labels="true", workers=0)
    exact = evaluate_bench(settings, QUIET)["seen"]
    for off in ({"misplaced_mm": 150.0}, {"misplaced_deg": 5.0}):
        spoilt = evaluate_bench(dataclasses.replace(settings, **off), QUIET)["seen"]
        assert spoilt["mean_joint_error_cm"] > exact["mean_joint_error_cm"] + 2
    with pytest.raises(InputError, match="misplaced"):
        evaluate_bench(dataclasses.replace(settings, misplaced_mm=-1.0), QUIET)


@pytest.mark.parametrize("views", [0, -1])
def test_no_posture_is_looked_at_by_no_camera(views: int, tmp_path: Path) -> None:
    settings = BenchEvaluation(views=views, samples=1, sets=("seen",), workers=0, weights=tmp_path / "none.onnx")
    with pytest.raises(InputError, match=f"--views must be at least 1, got {views}"):
        evaluate_bench(settings, QUIET)


def test_unknown_sets() -> None:
    with pytest.raises(InputError, match="--sets takes 'seen', 'new clothes', 'new sensor'"):
        evaluate_bench(BenchEvaluation(sets=("old",)), QUIET)
