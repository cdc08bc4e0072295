"""Train a body-part classifier (extra: train). Can be stopped at any time and resumed by the same command."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils.data import Dataset

from depthmocap.body.regions import UNLABELLED
from depthmocap.errors import InputError
from depthmocap.report.metrics import PixelAccuracy
from depthmocap.train.batches import Batches, LabelledBatch, sorted_batches, training_batches
from depthmocap.train.checkpoints import blend_weights, save_weights
from depthmocap.train.classifier_settings import ClassifierTraining, Optimiser
from depthmocap.train.distributed import process_rank, trains
from depthmocap.train.networks import FastNet, Network, masked_outputs
from depthmocap.train.onnx_export import export_onnx
from depthmocap.train.paper_network import PaperNet
from depthmocap.train.precision import in_bfloat16
from depthmocap.train.quantise import quantise
from depthmocap.train.training_run import (
    Row,
    TrainingRun,
    check_device,
    data_loader,
    prepare_folder,
    run_training,
)
from depthmocap.train.windows import LabelledWindow

#: Weight of the joint loss (metres) against the cross-entropy of the labels.
_JOINT_WEIGHT = 4.0
#: Weight of the likelihood of the expected errors in the joint loss.
_LIKELIHOOD_WEIGHT = 0.01
#: Number of training windows from which the ranges of the 8-bit form are taken.
_CALIBRATION = 64
#: Default learning rate and weight decay of each optimiser.
_RATES: dict[Optimiser, tuple[float, float]] = {"adamw": (2e-3, 0.02), "sgd": (0.03, 5e-4)}
#: Settings that may change when a run is resumed, besides those of every run.
_FREE = ("blend", "bfloat16", "valid_images")
#: Files that a run writes besides those of every run.
_WRITTEN = ("classifier.safetensors", "classifier.onnx", "classifier_int8.onnx")


def evaluate_windows(
    network: Network, windows: Sequence[LabelledWindow], device: str = "cpu"
) -> tuple[PixelAccuracy, float]:
    """Accuracy over windows, on the person's labelled pixels; and the mean error (metres) of the known joints, NaN of a
    network without joints."""
    network.eval()
    accuracy, errors = PixelAccuracy(), []
    with torch.no_grad():
        for x, y, places in sorted_batches(windows, 16):
            x, y = x.to(device).to(memory_format=torch.channels_last), y.to(device)
            logits, truth, joints = masked_outputs(network, x, y, (x[:, 1] > 0) & (y != UNLABELLED))
            accuracy.add(truth.cpu().numpy(), logits.argmax(1).cpu().numpy().astype(np.uint8))
            if joints is not None:
                errors.append((joints[..., :3].cpu() - places).norm(dim=-1))
    return accuracy, float(torch.cat(errors).nanmean()) if errors else math.nan


def joint_loss(predicted: Tensor, places: Tensor) -> Tensor:
    """Mean distance (metres) of the known joints, plus the negative log-likelihood of that distance under an
    exponential distribution with the expected errors; the latter has no gradient to the positions.

    Args:
        predicted: (n, 18, 4) positions and logarithms of the expected errors, metres.
        places: (n, 18, 3) true positions, metres, NaN where unknown.
    """
    known = places.isfinite().all(-1)
    if not known.any():
        return predicted.sum() * 0
    distance = (predicted[known][:, :3] - places[known]).norm(dim=-1)
    expected = predicted[known][:, 3]
    likelihood_loss = distance.detach() * torch.exp(-expected) + expected
    return distance.mean() + _LIKELIHOOD_WEIGHT * likelihood_loss.mean()


def _make_optimiser(network: Network, settings: ClassifierTraining) -> torch.optim.Optimizer:
    kind: Optimiser = settings.optimiser or ("sgd" if settings.network == "paper" else "adamw")
    rate, decay = _RATES[kind]
    rate = rate if settings.learning_rate is None else settings.learning_rate
    decay = decay if settings.weight_decay is None else settings.weight_decay
    if kind == "adamw":
        groups: list[dict[str, Any]] = [{"params": list(network.parameters()), "peak": rate, "weight_decay": decay}]
        return torch.optim.AdamW(groups, rate, betas=(0.9, 0.98))
    named = list(network.named_parameters())
    weights, biases = ([p for n, p in named if n.endswith("bias") == bias] for bias in (False, True))
    groups = [
        {"params": weights, "peak": rate, "weight_decay": decay},
        {"params": biases, "peak": 2 * rate, "weight_decay": 0.0},
    ]
    return torch.optim.SGD(groups, rate, settings.momentum)


def make_network(settings: ClassifierTraining) -> Network:
    """The network of a run, untrained.

    Raises:
        InputError: when ``without`` is set for the paper's network.
    """
    if settings.network == "paper":
        if settings.without:
            raise InputError("--without is for our networks: the paper's has none of these")
        return PaperNet()
    full = FastNet()
    widths = tuple(width // 2 for width in full.widths) if "width" in settings.without else full.widths
    return FastNet(widths, full.depths, "norm" not in settings.without)


class _Run(TrainingRun[Network, LabelledBatch]):
    """The training of a classifier."""

    settings: ClassifierTraining

    def __init__(self, settings: ClassifierTraining) -> None:
        super().__init__(
            settings, functools.partial(make_network, settings), functools.partial(_make_optimiser, settings=settings)
        )
        self._bfloat16 = in_bfloat16(settings.bfloat16, settings.device)
        self._losses: list[float] = []
        self._accuracies: list[float] = []

    def recent(self) -> str:
        """Mean cross-entropy of the last steps."""
        return f"loss {np.mean(self._losses[-50:]):.3f}"

    def rate_factor(self) -> float:
        """As of every run; one that stays does so from the beginning, as the paper's."""
        return super().rate_factor() if self.settings.schedule == "cosine" else 1.0

    def objective(self, batch: LabelledBatch) -> Tensor:
        """Cross-entropy of the labels, and the joint loss of a network with joints."""
        network, device = self.network, self.settings.device
        x = batch.inputs.to(device).to(memory_format=torch.channels_last)
        y = batch.labels.to(device)
        with torch.autocast(device.split(":")[0], torch.bfloat16, enabled=self._bfloat16):
            known = y != UNLABELLED
            logits, truth, joints = masked_outputs(
                network, x, y, known if network.learns_background else known & (x[:, 1] > 0)
            )
        loss = nn.functional.cross_entropy(logits.float(), truth.long())
        self._losses.append(loss.item())
        self._accuracies.append((logits.argmax(1) == truth)[truth > 0].float().mean().item())
        return loss if joints is None else loss + _JOINT_WEIGHT * joint_loss(joints, batch.joints.to(device))

    def validate(self, windows: Sequence[LabelledWindow]) -> Row:
        """Measure the averaged network."""
        accuracy, joint_m = evaluate_windows(self.averaged, windows, self.settings.device)
        row = {
            "loss": float(np.mean(self._losses)), "train_pixel_accuracy": float(np.mean(self._accuracies)),
            "valid_pixel_accuracy": accuracy.pixel_accuracy, "valid_class_accuracy": accuracy.class_accuracy,
        }  # fmt: skip
        if not math.isnan(joint_m):
            row["valid_joint_cm"] = joint_m * 100
        self._losses, self._accuracies = [], []
        return row

    def export(self, data: Dataset[LabelledWindow]) -> Path:
        """Write the averaged weights as .safetensors and ONNX, and our networks in 8 bits; returns the ONNX file."""
        settings, network = self.settings, self.network
        network.load_state_dict(self.averaged.state_dict())
        if settings.blend:
            assert settings.start is not None
            blend_weights(network, settings.start, settings.blend)
        network.eval()
        network.cpu()
        save_weights(network, settings.out / "classifier.safetensors")
        metadata = {"network": settings.network, "images": str(self.images)}
        path = export_onnx(network, settings.out / "classifier.onnx", metadata)
        if settings.network != "paper":
            windows = [data[i].inputs for i in range(_CALIBRATION)]
            quantise(path, windows, settings.out / "classifier_int8.onnx")
        return path


def _batches(run: _Run, data: Dataset[LabelledWindow]) -> Iterator[LabelledBatch]:
    """Training batches without end."""
    settings = run.settings
    loader = data_loader(data, settings.workers, batch_sampler=Batches(settings.batch))
    if run.network.learns_background:  # the windows of the paper's network are of one size
        return (batch for windows in loader for batch in sorted_batches(windows, settings.batch))
    return training_batches(
        loader, settings.batch, settings.seed + run.images + process_rank(), "mirror" not in settings.without
    )


@trains
def train_classifier(settings: ClassifierTraining) -> Path:
    """Train or resume training, and export; returns the ONNX file.

    The objective is the mean cross-entropy over the pixels with a known label: in the mask for our network, in the
    whole window for the paper's. Ours also learns the joints (:func:`joint_loss`), and learns from the mirror image of
    each picture, which counts as a picture.

    Raises:
        InputError: data, postures or weights that cannot be read, a folder that holds another network's run, or
            ``without`` for the paper's network.
    """
    check_device(settings.device)
    prepare_folder(settings, _WRITTEN, _FREE)
    run = _Run(settings)
    data = settings.source.train(run.images)
    valid = settings.source.valid(settings.valid_images)
    run_training(run, _batches(run, data), lambda: run.validate(valid))
    return run.export(data) if process_rank() == 0 else settings.out / "classifier.onnx"
