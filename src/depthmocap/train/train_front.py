"""Train the network that tells which way a trunk faces (extra: train). Can be stopped and resumed as any run."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils.data import Dataset

from depthmocap.body.trunk import front_of_trunk
from depthmocap.classify.front import CONCENTRATION, DIRECTIONS
from depthmocap.core.settings import check_above_0, check_at_least
from depthmocap.errors import InputError
from depthmocap.train.batches import Batches, WindowSource, sorted_batches, training_batches
from depthmocap.train.checkpoints import save_weights
from depthmocap.train.distributed import process_rank, trains
from depthmocap.train.front_network import FrontNet, load_encoder
from depthmocap.train.onnx_export import export_windows_onnx
from depthmocap.train.quantise import quantise_front
from depthmocap.train.training_run import (
    Row,
    TrainingRun,
    TrainingRunSettings,
    check_device,
    check_share,
    data_loader,
    prepare_folder,
    run_training,
)
from depthmocap.train.windows import LabelledWindow

#: Factor of the learning rate of what was learnt as part of a classifier.
_ENCODER_RATE = 0.5
#: Number of pictures from which the new head learns alone.
_HEAD_ALONE = 8000
#: Share of a batch that is turned in the picture,
_TURNED = 1 / 3
#: standard deviation of the turn (radians)
_TURN_RAD = 0.15
#: and of the logarithm of its size.
_SIZE = 0.05
#: Log odds above which a front is told surely: nine to one.
_SURE = 2.2
#: Number of training windows from which the ranges of the 8-bit form are taken.
_CALIBRATION = 64
#: Settings that may change when a run is resumed, besides those of every run.
_FREE = ("valid_images",)
#: Files that a run writes besides those of every run.
_WRITTEN = ("front.safetensors", "front.onnx")


@dataclasses.dataclass(frozen=True, kw_only=True)
class FrontTraining(TrainingRunSettings):
    """Settings of one training run.

    Attributes:
        out: folder of the run: settings.json, history.jsonl, curves.png, checkpoint.pt, front.safetensors and
            front.onnx.
        postures: folder of motion capture clips, or a pool made of them; without it the packaged prior.
        classifier: a classifier's .safetensors, whose way down it starts with; the head then learns alone at first.
        cut: share of people who are cut off.
        learning_rate: its peak.
    """

    postures: Path | None = None
    classifier: Path | None = None
    cut: float = 0.7
    images: int = 150_000
    batch: int = 32
    learning_rate: float = 2e-3
    valid_images: int = 640

    def __post_init__(self) -> None:
        super().__post_init__()
        check_at_least(1, {"--valid-images": self.valid_images})
        check_above_0({"--learning-rate": self.learning_rate})
        check_share({"--cut": self.cut})
        if self.classifier is not None and self.start is not None:
            raise InputError("--classifier and --start are two beginnings: give one")


class FrontBatch(NamedTuple):
    """Windows (n, 3, h, w) and the fronts in them (n, 3), NaN where unknown."""

    inputs: Tensor
    fronts: Tensor


def turned_in_picture(batch: FrontBatch, angles: Tensor, scales: Tensor) -> FrontBatch:
    """The first windows turned clockwise by angles (radians) and enlarged, with their fronts."""
    count = len(angles)
    height, width = batch.inputs.shape[2:]
    cosine, sine, zero = torch.cos(angles), torch.sin(angles), torch.zeros(count)
    # Where each pixel of the turned picture comes from, in half sides of the window.
    rows = (
        torch.stack([cosine, sine * height / width, zero], 1) / scales[:, None],
        torch.stack([-sine * width / height, cosine, zero], 1) / scales[:, None],
    )
    grid = nn.functional.affine_grid(torch.stack(rows, 1), [count, 1, height, width], align_corners=False)
    inputs, fronts = batch.inputs.clone(), batch.fronts.clone()
    inputs[:count, :2] = nn.functional.grid_sample(inputs[:count, :2], grid, mode="nearest", align_corners=False)
    right, down = batch.fronts[:count, 0], batch.fronts[:count, 1]
    fronts[:count, 0], fronts[:count, 1] = cosine * right - sine * down, sine * right + cosine * down
    return FrontBatch(inputs, fronts)


def _nearness(fronts: Tensor) -> Tensor:
    """Logarithms (n, 64), but for a sum, of the von Mises–Fisher distributions of fronts (n, 3) at the directions."""
    return CONCENTRATION * fronts @ torch.from_numpy(DIRECTIONS.astype(np.float32)).T.to(fronts.device)


def log_odds(logits: Tensor, fronts: Tensor) -> Tensor:
    """Log odds (n,) of fronts (n, 3) against their opposites, as ``classify.front.log_odds``."""
    near = _nearness(fronts)
    return torch.logsumexp(logits + near, -1) - torch.logsumexp(logits - near, -1)


def front_loss(logits: Tensor, fronts: Tensor) -> Tensor:
    """Cross-entropy with each known front spread over the directions by a von Mises–Fisher distribution."""
    known = fronts.isfinite().all(1)
    if not known.any():
        return logits.sum() * 0
    return nn.functional.cross_entropy(logits[known], _nearness(fronts[known]).softmax(-1))


class _Run(TrainingRun[FrontNet, FrontBatch]):
    """The training of the network."""

    settings: FrontTraining

    def __init__(self, settings: FrontTraining) -> None:
        super().__init__(settings, self._make_network, self._make_optimiser)
        self._losses: list[float] = []

    def _make_network(self) -> FrontNet:
        network = FrontNet()
        if self.settings.classifier is not None:
            load_encoder(network, self.settings.classifier)
        return network

    def _make_optimiser(self, network: FrontNet) -> torch.optim.Optimizer:
        rate = self.settings.learning_rate
        groups = [
            {"params": network.head_weights(), "peak": rate},
            {"params": network.encoder_weights(), "peak": rate * _ENCODER_RATE},
        ]
        return torch.optim.AdamW(groups, rate, weight_decay=0.02)

    def recent(self) -> str:
        """Mean loss of the last steps."""
        return f"loss {np.mean(self._losses[-50:]):.3f}"

    def objective(self, batch: FrontBatch) -> Tensor:
        """The loss; the head learns alone at first if the rest comes from a classifier."""
        x = batch.inputs.to(self.settings.device).to(memory_format=torch.channels_last)
        frozen = self.settings.classifier is not None and self.images < _HEAD_ALONE
        if frozen:
            self.network.stem.eval()
            self.network.down.eval()
        for weight in self.network.encoder_weights():
            weight.requires_grad_(not frozen)
        loss = front_loss(self.network(x), batch.fronts.to(self.settings.device))
        self._losses.append(loss.item())
        return loss

    def validate(self, windows: Sequence[LabelledWindow]) -> Row:
        """Measure the averaged network: shares of fronts taken for backs, of those surely, and the cross-entropy."""
        network = self.averaged.eval()
        odds = []
        with torch.no_grad():
            for x, _, joints in sorted_batches(windows, 32):
                fronts = torch.from_numpy(front_of_trunk(joints.numpy()))
                known = fronts.isfinite().all(1)
                odds.append(log_odds(network(x.to(self.settings.device)).cpu()[known], fronts[known]))
        all_odds = torch.cat(odds)
        return {
            "loss": float(np.mean(self._losses)), "turned": float((all_odds < 0).float().mean()),
            "surely_turned": float((all_odds < -_SURE).float().mean()),
            "nats": float(nn.functional.softplus(-all_odds).mean()),
        }  # fmt: skip

    def export(self, windows: Sequence[LabelledWindow]) -> Path:
        """Write the averaged weights as .safetensors and, in 8 bits by the ranges on windows, as ONNX, which it
        returns."""
        network = self.averaged.cpu().eval()
        save_weights(network, self.settings.out / "front.safetensors")
        return export_front_onnx(
            network, self.settings.out / "front.onnx", {"images": str(self.images)}, [w.inputs for w in windows]
        )


def export_front_onnx(network: FrontNet, path: Path, metadata: dict[str, str], windows: Sequence[np.ndarray]) -> Path:
    """Write the network as ONNX in 8 bits: input ``windows`` (n, 3, h, w), output ``directions`` (n, 64).

    Args:
        windows: inputs from training data.
    """
    with tempfile.TemporaryDirectory() as folder:
        metadata = {"network": "front", **metadata}
        plain = export_windows_onnx(network, Path(folder) / "float.onnx", ["directions"], metadata)
        return quantise_front(plain, windows, path)


def _batches(run: _Run, data: Dataset[LabelledWindow]) -> Iterator[FrontBatch]:
    """Training batches without end."""
    settings = run.settings
    loader = data_loader(data, settings.workers, batch_sampler=Batches(settings.batch))
    rng = np.random.default_rng([settings.seed, run.images + process_rank()])
    count = round(_TURNED * settings.batch)
    for x, _, joints in training_batches(loader, settings.batch, settings.seed + run.images + process_rank()):
        fronts = torch.from_numpy(front_of_trunk(joints.numpy()))
        angles, sizes = rng.normal(0, _TURN_RAD, count), np.exp(rng.normal(0, _SIZE, count))
        yield turned_in_picture(
            FrontBatch(x, fronts),
            torch.from_numpy(angles.astype(np.float32)), torch.from_numpy(sizes.astype(np.float32)),
        )  # fmt: skip


@trains
def train_front(settings: FrontTraining) -> Path:
    """Train or resume training, and export; returns the ONNX file.

    Raises:
        InputError: postures or weights that cannot be read, or a folder that holds another run.
    """
    check_device(settings.device)
    prepare_folder(settings, _WRITTEN, _FREE)
    run = _Run(settings)
    source = WindowSource("fast", "synth", "open", settings.postures, settings.seed, cut=settings.cut)
    data = source.train(run.images)
    valid = source.valid(settings.valid_images)
    run_training(run, _batches(run, data), lambda: run.validate(valid))
    run.add_row(run.validate(valid))
    run.write_history()
    if process_rank() > 0:
        return settings.out / "front.onnx"
    return run.export([data[i] for i in range(_CALIBRATION)])
