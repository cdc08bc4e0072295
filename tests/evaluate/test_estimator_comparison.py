"""The comparison of estimators, on samples whose truth is a linear function of what was seen."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("sklearn")
pytest.importorskip("torch")

from depthmocap.cli import main
from depthmocap.evaluate.estimator_comparison import EstimatorComparison, _lasso, _perceptron
from depthmocap.pose.features import FEATURE_COUNT
from depthmocap.pose.parts import PART_COUNT


def write_samples(folder, n=400, views=2):
    """Joints follow from twenty features (and the centres of regions); sixteen clips."""
    rng = np.random.default_rng(0)
    folder.mkdir()
    features = rng.normal(size=(n, FEATURE_COUNT)).astype(np.float32)
    weights = np.zeros((FEATURE_COUNT, 54))
    weights[:20] = rng.normal(0, 0.05, (20, 54))
    targets = (features @ weights).reshape(n, 18, 3).astype(np.float32)
    groups = np.arange(n) % 16
    parts = np.zeros((n, views, PART_COUNT, 16), np.float32)
    parts[..., 0] = 100
    parts[..., 1:4] = 0.01, 0.9, 1.0
    parts[..., 4:7] = rng.normal(0, 0.3, (n, 1, PART_COUNT, 3))
    parts[..., [7, 10, 12]] = 0.01
    parts[..., 13] = 1
    joints = parts[:, 0, :18, 4:7].astype(np.float64)
    arrays = {"joints": joints, "groups": groups}
    for labels in ("network", "true"):
        arrays[f"parts {labels}"] = parts
        for count in (1, 2):
            arrays |= {f"features {labels} {count}": features, f"targets {labels} {count}": targets}
            arrays[f"members {labels} {count}"] = groups
    np.savez(folder / "000000.npz", **arrays)
    return folder


@pytest.mark.parametrize("fit", [_lasso, _perceptron])
def test_a_joint_that_follows_from_all_features(fit) -> None:
    rng = np.random.default_rng(0)
    causes = rng.normal(size=(130, 3))
    features = causes @ rng.normal(size=(3, FEATURE_COUNT)) + rng.normal(0, 0.1, (130, FEATURE_COUNT))
    joints = causes.reshape(-1, 1, 3) * 0.1
    groups = np.arange(130) % 12
    train, test = slice(100), slice(100, None)
    predict = fit(features[train].astype(np.float32), joints[train], groups[train], EstimatorComparison(Path("s")))
    estimates = predict(features[test].astype(np.float32)).reshape(-1, 1, 3)
    errors_cm = 100 * np.linalg.norm(estimates - joints[test], axis=-1)
    assert errors_cm.mean() < 6  # the mean alone is 16 cm off


@pytest.mark.slow
def test_linear_truth_is_found_by_all_and_best_by_lasso(tmp_path, capsys):
    folder, path = write_samples(tmp_path / "samples"), tmp_path / "numbers.json"
    arguments = ["evaluate", "estimators", str(folder), "--labels", "true", "--views", "2", "--minutes", "0.05"]
    assert main([*arguments, "--json", str(path)]) == 0
    numbers = json.loads(path.read_text())
    assert numbers["samples"] == 400
    errors = {
        name: {count: row["mean_joint_error_cm"] for count, row in by_views.items()}
        for name, by_views in numbers.items()
        if isinstance(by_views, dict)
    }
    assert set(errors) == {"ridge", "LASSO", "neural network", "votes"}
    assert errors["LASSO"]["2"] < 3  # it finds the twenty among 1,032
    assert errors["LASSO"]["2"] < errors["ridge"]["2"] < 36  # the mean alone is 36 cm off
    assert errors["neural network"]["2"] < 45
    assert errors["votes"]["2"] < 60


def test_what_cannot_be_compared(tmp_path, capsys):
    assert main(["evaluate", "estimators", str(tmp_path)]) == 2
    assert "train pose" in capsys.readouterr().err
    folder = write_samples(tmp_path / "samples")
    assert main(["evaluate", "estimators", str(folder), "--views", "3", "--minutes", "0"]) == 2
    assert "[3] views" in capsys.readouterr().err
    few = write_samples(tmp_path / "few", n=20)
    assert main(["evaluate", "estimators", str(few), "--views", "2", "--minutes", "0"]) == 2
    assert "are too few" in capsys.readouterr().err
    for option, value in (("--minutes", "nan"), ("--folds", "1")):
        assert main(["evaluate", "estimators", str(folder), option, value]) == 2
        assert f"{option} must be finite and at least" in capsys.readouterr().err
