"""Swapped limbs, calibration, and the whole of ``evaluate labels``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from depthmocap.body.regions import MIRROR, REGION, UNLABELLED
from depthmocap.cli import main
from depthmocap.errors import InputError
from depthmocap.evaluate.label_charts import label_grid, region_bars, reliability_diagram
from depthmocap.evaluate.label_measures import LEAST_PIXELS, PARTS, BorderAccuracy, Calibration, PartSwaps
from depthmocap.synth.body.mesh import BodyModel
from depthmocap.synth.sample import Recipe


def body() -> np.ndarray:
    """A view that shows 100 pixels of everything on both sides, from the front."""
    regions = [i for name, i in REGION.items() if "back" not in name and name not in ("background", "nape")]
    return np.repeat(np.array(regions, np.uint8), 100)


def swapped(truth: np.ndarray, predicted: np.ndarray) -> dict[str, int]:
    swaps = PartSwaps()
    found = swaps.add(truth, predicted)
    assert found == bool(swaps.swapped.any()) == bool(swaps.swapped_views)
    return {part: int(n) for part, n in zip(PARTS, swaps.swapped, strict=True) if n}


def test_right_labels_swap_nothing() -> None:
    truth = body()
    swaps = PartSwaps()
    swaps.add(truth, truth)
    assert (swaps.shown == 1).all()
    assert not swaps.swapped.any() and swaps.per_1000_views == 0


def test_a_mirrored_body_swaps_every_limb() -> None:
    truth = body()
    assert set(swapped(truth, MIRROR[truth])) == {"arm R", "arm L", "leg R", "leg L", "torso, left for right"}


def test_one_arm_on_the_other_side() -> None:
    truth = body()
    arm = np.isin(truth, [REGION[f"{name} R"] for name in ("upper arm", "elbow", "forearm", "wrist", "hand")])
    other = np.where(arm, REGION["hand L"], truth)  # any region of the other arm
    assert swapped(truth, other) == {"arm R": 1}
    # Half of it is not enough, and neither is another wrong part.
    half = np.where(arm & (np.cumsum(arm) <= arm.sum() / 2), REGION["hand L"], truth)
    assert swapped(truth, half) == {}
    half[np.flatnonzero(arm)[arm.sum() // 2]] = REGION["hand L"]
    assert swapped(truth, half) == {"arm R": 1}
    assert swapped(truth, np.where(arm, REGION["thigh L"], truth)) == {}


def test_front_for_back() -> None:
    truth = body()
    exchange = {"chest": "upper back", "belly": "lower back", "shoulder front": "shoulder back"}
    predicted = truth.copy()
    for front, back in exchange.items():
        for side, other in ("RL", "LR"):
            predicted[truth == REGION[f"{front} {side}"]] = REGION[f"{back} {other}"]
    assert swapped(truth, predicted) == {"torso, left for right": 1, "torso, front for back": 1}
    # A sliver of the front on a torso seen from behind may be lost: the torso as a whole is not swapped.
    behind = np.concatenate([predicted, truth[truth == REGION["chest R"]]])
    labels = np.concatenate([predicted, np.full(100, REGION["upper back R"], np.uint8)])
    assert swapped(behind, labels) == {}


def test_parts_hardly_seen_and_unknown_pixels_are_not_judged() -> None:
    arm = np.full(LEAST_PIXELS - 1, REGION["forearm R"], np.uint8)
    unknown = np.full(500, UNLABELLED, np.uint8)
    assert swapped(np.concatenate([arm, unknown]), np.full(len(arm) + 500, REGION["forearm L"], np.uint8)) == {}
    arm = np.full(LEAST_PIXELS, REGION["forearm R"], np.uint8)
    assert swapped(arm, np.full(LEAST_PIXELS, REGION["forearm L"], np.uint8)) == {"arm R": 1}


def test_accuracy_by_distance_from_a_border() -> None:
    truth = np.zeros((12, 40), np.uint8)
    truth[2:10, 5:15], truth[2:10, 15:35] = 3, 9  # one border, in the middle; what is around them is none
    predicted = truth.copy()
    predicted[:, 14:16] = 3  # right on one side of the border, wrong on the other
    predicted[:, 34] = 7
    borders = BorderAccuracy()
    borders.add(truth, predicted, truth > 0)
    assert borders.pixels.tolist() == [16, 16, 32, 64, 8 * 14]
    assert borders.right.tolist() == [8, 16, 32, 64, 8 * 13]
    assert borders.rows[0] == ("0 to 1", 16 / 240, 0.5)
    assert borders.rows[-1] == ("8 and more", 112 / 240, 13 / 14)
    borders.add(truth, truth, truth == 9)  # only what counts is counted
    assert borders.pixels.sum() == 240 + 160
    alone = BorderAccuracy()
    alone.add(np.full((3, 3), 5, np.uint8), np.full((3, 3), 5, np.uint8), np.ones((3, 3), bool))
    assert alone.rows == [("8 and more", 1.0, 1.0)]


def test_rate_of_swaps() -> None:
    truth, swaps = body(), PartSwaps()
    assert np.isnan(swaps.per_1000_views)
    for _ in range(3):
        swaps.add(truth, truth)
    swaps.add(truth, MIRROR[truth])
    assert swaps.per_1000_views == 250


@pytest.mark.parametrize("bias", [0.0, 0.2, -0.1])
def test_calibration_error_is_the_bias(bias: float) -> None:
    rng = np.random.default_rng(0)
    chance = rng.uniform(0.3, 0.75, (400, 500))
    calibration = Calibration()
    for part in np.split(np.arange(400), 4):
        calibration.add((chance[part] + bias).astype(np.float32), rng.random((100, 500)) < chance[part])
    assert calibration.error == pytest.approx(abs(bias), abs=0.01)
    assert sum(n for n, _, _ in calibration.rows) == chance.size
    for _, probability, right in calibration.rows:
        assert probability - right == pytest.approx(bias, abs=0.05)


def test_calibration_of_certainty_and_of_nothing() -> None:
    calibration = Calibration()
    assert np.isnan(calibration.error) and calibration.rows == []
    calibration.add(np.array([0.0, 1.0, 1.0], np.float32), np.array([False, True, True]))
    assert calibration.error == 0
    assert calibration.rows == [(1, 0.0, 0.0), (2, 1.0, 1.0)]


def test_pictures() -> None:
    calibration = Calibration()
    calibration.add(np.array([0.5], np.float32), np.array([True]))
    accuracy = np.linspace(0, 1, 43)
    accuracy[3] = np.nan
    for chart in (region_bars(accuracy), reliability_diagram(calibration)):
        assert chart.startswith(b"\x89PNG")
    depth = np.full((60, 80), 2.0, np.float32)
    mask = np.zeros(depth.shape, bool)
    mask[10:50, 0:20] = True
    truth = np.where(mask, np.uint8(5), np.uint8(0))
    grid = label_grid([(depth, mask, truth, truth), (depth, mask, truth, MIRROR[truth])])
    assert grid.shape == (3 * 224 - 4, 2 * 224 - 4, 3)
    first, second = grid[:, :220], grid[:, 224:]
    np.testing.assert_array_equal(first[:440], second[:440])
    np.testing.assert_array_equal(first[224:444], first[448:])  # the prediction is the truth
    assert (first[448:] != second[448:]).any()
    with pytest.raises(InputError, match="at least one view"):
        label_grid([])


def test_on_the_bench(body_model: BodyModel, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "numbers.json"
    command = ["evaluate", "labels", "--samples", "2", "--views", "2", "--workers", "0", "--json", str(path)]
    assert main([*command, "--out", str(tmp_path / "report")]) == 0
    assert "of 1,000" in capsys.readouterr().err
    numbers = json.loads(path.read_text())
    assert numbers["network"] == "fast" and numbers["views"] == 4
    confusion = np.array(numbers["confusion"])
    assert confusion.sum() == numbers["pixels"] == sum(row["pixels"] for row in numbers["calibration"])
    assert np.trace(confusion) / numbers["pixels"] == pytest.approx(numbers["pixel_accuracy"])
    assert 0.3 < numbers["pixel_accuracy"] < 0.98
    assert 0 < numbers["calibration_error"] < 0.5
    written = {each.name for each in (tmp_path / "report").iterdir()}
    assert written == {"report.html", "confusion.png", "regions.png", "calibration.png", "examples.png"}


def test_on_a_folder(body_model: BodyModel, tmp_path: Path) -> None:
    from depthmocap.evaluate.labels import LabelsEvaluation, evaluate_labels
    from depthmocap.synth.writing.generate import SynthSettings, generate

    generate(SynthSettings(tmp_path, Recipe("hard", "test"), samples=2, seed=3))
    numbers = evaluate_labels(LabelsEvaluation(tmp_path / "report", data=tmp_path))
    assert numbers["views"] == 6 and numbers["data"].endswith("hard-pose/test")


@pytest.mark.parametrize(
    ("option", "message"),
    [("--bench old", "--bench is one of 'seen'"), ("--samples 0", "--samples and --pictures must be at least 1")],
)
def test_bad_settings(option: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "labels", "--out", str(tmp_path), *option.split()]) == 2
    assert message in capsys.readouterr().err
