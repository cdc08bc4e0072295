"""The training of the network that tells which way a trunk faces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from depthmocap.classify.front import DIRECTIONS, FrontNetwork  # noqa: E402
from depthmocap.classify.front import log_odds as runtime_log_odds  # noqa: E402
from depthmocap.classify.window import Window  # noqa: E402
from depthmocap.errors import InputError  # noqa: E402
from depthmocap.train import train_front as module  # noqa: E402
from depthmocap.train.checkpoints import load_weights  # noqa: E402
from depthmocap.train.front_network import FrontNet  # noqa: E402
from depthmocap.train.train_front import (  # noqa: E402
    FrontBatch,
    FrontTraining,
    export_front_onnx,
    front_loss,
    log_odds,
    train_front,
    turned_in_picture,
)

WEIGHTS = Path(__file__).parents[2] / "weights" / "fast.safetensors"


def test_a_quarter_turn_of_a_picture_turns_the_front() -> None:
    inputs = torch.zeros(2, 3, 64, 32)
    inputs[:, :2, 32 - 10, 16] = 1.0  # above the middle
    fronts = torch.tensor([[0.0, -1.0, 0.0], [0.0, -1.0, 0.0]])
    turned = turned_in_picture(FrontBatch(inputs, fronts), torch.tensor([np.pi / 2]), torch.ones(1))
    row, column = np.argwhere(turned.inputs[0, 0].numpy() > 0).mean(0)
    assert row == pytest.approx(32, abs=1)
    assert column == pytest.approx(16 + 10, abs=1)  # clockwise: above becomes right
    np.testing.assert_allclose(turned.fronts.numpy(), [[1, 0, 0], [0, -1, 0]], atol=1e-6)
    np.testing.assert_array_equal(turned.inputs[1], inputs[1])


def test_the_loss_is_least_at_the_true_front() -> None:
    fronts = torch.from_numpy(DIRECTIONS[[3, 40]].astype(np.float32))
    logits = 8 * fronts @ torch.from_numpy(DIRECTIONS.astype(np.float32)).T
    assert front_loss(logits, fronts) < front_loss(logits * 0, fronts) < front_loss(logits, -fronts)
    assert front_loss(logits, torch.full((2, 3), torch.nan)) == 0
    half = torch.stack([fronts[0], torch.full((3,), torch.nan)])
    assert front_loss(logits, half) == pytest.approx(front_loss(logits[:1], fronts[:1]).item())
    expected = [runtime_log_odds(s, f) for s, f in zip(logits.numpy(), fronts.numpy(), strict=True)]
    np.testing.assert_allclose(log_odds(logits, fronts).numpy(), expected, rtol=1e-4)


@pytest.mark.slow
def test_a_run_trains_resumes_and_exports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("onnxscript")
    monkeypatch.setattr(module, "_CALIBRATION", 4)

    def settings(images: int) -> FrontTraining:
        return FrontTraining(
            tmp_path / "run", images=images, batch=4, workers=0, valid_every=8, valid_images=6, average=0.5,
            classifier=WEIGHTS,
        )  # fmt: skip

    with monkeypatch.context() as patch:
        patch.setattr(module, "export_front_onnx", lambda network, path, *others: path)
        train_front(settings(8))
    path = train_front(settings(12))
    assert '"turned"' in (tmp_path / "run" / "history.jsonl").read_text()
    window = Window(np.zeros((3, 192, 64), np.float32), 0.0, 0.0, 1.0)
    assert FrontNetwork(path)(window).shape == (64,)
    # Of the classifier's weights nothing has changed so early: the head learns alone.
    trained, classifier = FrontNet(), FrontNet()
    load_weights(trained, tmp_path / "run" / "front.safetensors")
    module.load_encoder(classifier, WEIGHTS)
    for one, other in zip(trained.encoder_weights(), classifier.encoder_weights(), strict=True):
        torch.testing.assert_close(one, other)
    exported = FrontNetwork(export_front_onnx(trained, tmp_path / "again.onnx", {}, [window.inputs] * 2))
    assert np.isfinite(exported(window)).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [({"cut": 1.0}, "--cut"), ({"learning_rate": 0.0}, "--learning-rate"), ({"valid_images": 0}, "--valid-images")],
)
def test_settings_that_cannot_be(change: dict, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        FrontTraining(tmp_path, **change)


def test_two_beginnings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="give one"):
        FrontTraining(tmp_path, classifier=WEIGHTS, start=WEIGHTS)
