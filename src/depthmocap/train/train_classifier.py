"""Train a body-part classifier (extra: train). Can be stopped at any time and resumed by the same command."""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from safetensors.torch import save as serialise
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.data import DataLoader, Dataset

from depthmocap.body.regions import UNLABELLED
from depthmocap.core.console import Terminal
from depthmocap.core.interrupts import deferred_interrupts, ignore_signals
from depthmocap.core.locks import locks_outputs
from depthmocap.core.output import write_file
from depthmocap.core.settings import claim_folder
from depthmocap.errors import InputError
from depthmocap.report.metrics import PixelAccuracy
from depthmocap.train.batches import Batches, LabelledBatch, sorted_batches, training_batches
from depthmocap.train.checkpoints import blend_weights, load_weights, read_checkpoint
from depthmocap.train.classifier_settings import ClassifierTraining, Optimiser
from depthmocap.train.networks import FastNet, Network, masked_outputs
from depthmocap.train.onnx_export import export_onnx
from depthmocap.train.paper_network import PaperNet
from depthmocap.train.precision import in_bfloat16
from depthmocap.train.quantise import quantise
from depthmocap.train.windows import LabelledWindow

#: Weight of the joint loss (metres) against the cross-entropy of the labels.
_JOINT_WEIGHT = 4.0
#: Weight of the likelihood of the expected errors in the joint loss.
_LIKELIHOOD_WEIGHT = 0.01
#: The learning rate rises over this many images.
_WARM_UP_IMAGES = 3200
#: Gradients are clipped to this norm.
_LARGEST_GRADIENT = 5.0
#: Number of training windows from which the ranges of the 8-bit form are taken.
_CALIBRATION = 64
#: Default learning rate and weight decay of each optimiser.
_RATES: dict[Optimiser, tuple[float, float]] = {"adamw": (2e-3, 0.02), "sgd": (0.03, 5e-4)}
#: Longest time between two checkpoints, seconds.
_SAVE_EVERY_S = 300.0
#: Settings that may change when a run is resumed.
_FREE = (
    "out", "images", "minutes", "blend", "postures", "workers", "device", "bfloat16", "valid_every", "valid_images",
)  # fmt: skip


#: Files that a run writes besides the checkpoint and the settings.
_WRITTEN = ("history.jsonl", "curves.png", "classifier.safetensors", "classifier.onnx", "classifier_int8.onnx")


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


class _Run:
    """One training run: the state that a checkpoint holds, and the steps that change it.

    Attributes:
        images: number of images trained on so far.
        spent_s: training time so far, seconds.
        history: a row of numbers per validation.
    """

    def __init__(self, settings: ClassifierTraining) -> None:
        """Make the network and its optimiser, or restore them from the folder's checkpoint."""
        self.settings = settings
        self._checkpoint = settings.out / "checkpoint.pt"
        torch.manual_seed(settings.seed)
        self.network = make_network(settings)
        self.network.to(settings.device)
        self.network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue] - the stub lacks it alone
        if settings.start is not None:
            load_weights(self.network, settings.start)
        self._average = AveragedModel(
            self.network, multi_avg_fn=get_ema_multi_avg_fn(settings.average), use_buffers=True
        )
        self._optimiser = _make_optimiser(self.network, settings)
        self._peaks = [group["peak"] for group in self._optimiser.param_groups]
        self.images, self.spent_s = 0, 0.0
        self.history: list[dict[str, int | float]] = []
        if self._checkpoint.exists():
            self._restore()
        self._bfloat16 = in_bfloat16(settings.bfloat16, settings.device)
        self._losses: list[float] = []
        self._accuracies: list[float] = []
        self._saved_s = time.monotonic()

    def _restore(self) -> None:
        state = read_checkpoint(self._checkpoint, self.settings.device)
        try:
            self.network.load_state_dict(state["network"])
            self._average.load_state_dict(state["average"])
            self._optimiser.load_state_dict(state["optimiser"])
        except (RuntimeError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(
                f"{self._checkpoint} is of another network or optimiser ({str(error).splitlines()[0]}): "
                "use the same settings, or another --out"
            ) from None
        self.images, self.spent_s, self.history = state["done"], state["spent"], state["history"]

    def save(self) -> None:
        """Write the checkpoint."""
        self._saved_s = time.monotonic()
        parts = {"network": self.network, "average": self._average, "optimiser": self._optimiser}
        state = {name: part.state_dict() for name, part in parts.items()}
        buffer = io.BytesIO()  # torch does not report a full disk in a way of its own
        history = json.dumps(self.history)
        torch.save({**state, "done": self.images, "spent": self.spent_s, "history": history}, buffer)
        write_file(self._checkpoint, buffer.getbuffer())

    def save_at_times(self) -> None:
        """Write the checkpoint if the last one is older than ``_SAVE_EVERY_S``."""
        if time.monotonic() - self._saved_s > _SAVE_EVERY_S:
            self.save()

    @property
    def progress(self) -> float:
        """Share of the run that is done, 0–1: by time where the settings limit it, otherwise by images."""
        if self.settings.minutes > 0:
            return min(1.0, self.spent_s / 60 / self.settings.minutes)
        return min(1.0, self.images / self.settings.images)

    @property
    def recent_loss(self) -> float:
        """Mean cross-entropy of the last 50 steps."""
        return float(np.mean(self._losses[-50:]))

    def step(self, batch: LabelledBatch) -> None:
        """Train on one batch."""
        settings, network = self.settings, self.network
        factor = 1.0
        if settings.schedule == "cosine":
            warm_up = min(1.0, (self.images + settings.batch) / _WARM_UP_IMAGES)
            factor = warm_up * 0.5 * (1 + math.cos(math.pi * self.progress))
        for group, peak in zip(self._optimiser.param_groups, self._peaks, strict=True):
            group["lr"] = peak * factor + 1e-6
        network.train()
        x = batch.inputs.to(settings.device).to(memory_format=torch.channels_last)
        y = batch.labels.to(settings.device)
        with torch.autocast(settings.device.split(":")[0], torch.bfloat16, enabled=self._bfloat16):
            known = y != UNLABELLED
            logits, truth, joints = masked_outputs(
                network, x, y, known if network.learns_background else known & (x[:, 1] > 0)
            )
        objective = loss = nn.functional.cross_entropy(logits.float(), truth.long())
        if joints is not None:
            objective = loss + _JOINT_WEIGHT * joint_loss(joints, batch.joints.to(settings.device))
        self._optimiser.zero_grad()
        objective.backward()
        nn.utils.clip_grad_norm_(network.parameters(), _LARGEST_GRADIENT)
        self._optimiser.step()
        self._average.update_parameters(network)
        self.images += settings.batch
        self._losses.append(loss.item())
        self._accuracies.append((logits.argmax(1) == truth)[truth > 0].float().mean().item())

    def validate(self, windows: Sequence[LabelledWindow]) -> dict[str, int | float]:
        """Measure the averaged network; the row of numbers is also added to the history."""
        accuracy, joint_m = evaluate_windows(cast(Network, self._average.module), windows, self.settings.device)
        row = {
            "step": self.images, "minutes": self.spent_s / 60, "loss": float(np.mean(self._losses)),
            "train_pixel_accuracy": float(np.mean(self._accuracies)),
            "valid_pixel_accuracy": accuracy.pixel_accuracy, "valid_class_accuracy": accuracy.class_accuracy,
        }  # fmt: skip
        if not math.isnan(joint_m):
            row["valid_joint_cm"] = joint_m * 100
        self._losses, self._accuracies = [], []
        self.history.append(row)
        return row

    def export(self, data: Dataset[LabelledWindow]) -> Path:
        """Write the averaged weights as .safetensors and ONNX, and our networks in 8 bits; returns the ONNX file."""
        settings, network = self.settings, self.network
        network.load_state_dict(self._average.module.state_dict())
        if settings.blend:
            assert settings.start is not None
            blend_weights(network, settings.start, settings.blend)
        network.eval()
        # Norms and biases are few and keep their range; kernels take half the space.
        state = network.cpu().state_dict()
        half = {k: v.half() if v.is_floating_point() and v.ndim > 1 else v for k, v in state.items()}
        write_file(settings.out / "classifier.safetensors", serialise({k: v.contiguous() for k, v in half.items()}))
        metadata = {"network": settings.network, "images": str(self.images)}
        path = export_onnx(network, settings.out / "classifier.onnx", metadata)
        if settings.network != "paper":
            windows = [data[i].inputs for i in range(_CALIBRATION)]
            quantise(path, windows, settings.out / "classifier_int8.onnx")
        return path


def _prepare_folder(settings: ClassifierTraining) -> None:
    """Claim the folder of the run for its settings; files of a run without a checkpoint are removed."""
    out = settings.out
    if settings.start is not None and settings.start.resolve() in [(out / name).resolve() for name in _WRITTEN]:
        raise InputError(f"--start must not be a file that training writes, got {settings.start}: choose another --out")
    if not (out / "checkpoint.pt").exists() and (out / "settings.json").exists():
        for name in (*_WRITTEN, "settings.json"):
            (out / name).unlink(missing_ok=True)
    claim_folder(out, settings, "a run", _FREE)


def _batches(run: _Run, data: Dataset[LabelledWindow]) -> Iterator[LabelledBatch]:
    """Training batches without end."""
    settings = run.settings
    loader = DataLoader(
        data, batch_sampler=Batches(settings.batch), collate_fn=list, num_workers=settings.workers,
        prefetch_factor=6 if settings.workers else None,
        # Forking after OpenMP has run can hang the child.
        multiprocessing_context="spawn" if settings.workers else None,
        persistent_workers=settings.workers > 0, worker_init_fn=begin_worker,
    )  # fmt: skip
    if run.network.learns_background:  # the windows of the paper's network are of one size
        return (batch for windows in loader for batch in sorted_batches(windows, settings.batch))
    return training_batches(loader, settings.batch, settings.seed + run.images, "mirror" not in settings.without)


@locks_outputs(folder="out")
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
    _prepare_folder(settings)
    run = _Run(settings)
    data = settings.source.train(run.images)
    valid = settings.source.valid(settings.valid_images)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Terminal()) as progress, save_at_interruption(run.save):
        task = progress.add_task("training", total=1.0)
        progress.update(task, completed=run.progress)
        clock = time.monotonic()
        for batch in _batches(run, data):
            if run.progress >= 1:
                break
            before = run.images
            run.step(batch)
            run.spent_s += time.monotonic() - clock
            clock = time.monotonic()
            text = f"{run.images} images  loss {run.recent_loss:.3f}"
            progress.update(task, completed=run.progress, description=text)
            if before // settings.valid_every != run.images // settings.valid_every:
                row = run.validate(valid)
                progress.console.print({k: round(v, 4) for k, v in row.items()})
                run.save()
                write_history(settings.out, run.history)
            else:
                run.save_at_times()
    run.save()
    return run.export(data)


def begin_worker(_: int) -> None:
    """Let SIGTERM end a worker at once: torch ends its workers so, and counts an exit as no failure."""
    ignore_signals()
    signal.signal(signal.SIGTERM, lambda *_: os._exit(0))


def check_device(name: str) -> None:
    """Check that torch can use a device, such as "cpu" or "cuda:0".

    Raises:
        InputError: when it cannot.
    """
    try:
        device = torch.zeros(1, device=name).device
    except (RuntimeError, AssertionError, NotImplementedError, ValueError, ModuleNotFoundError) as error:
        reason = str(error).splitlines()[0] if str(error) else "there is none"
        raise InputError(f"--device {name} cannot be used ({reason[:100]}): cpu always can") from None
    if device.type == "meta":
        raise InputError(f"--device {name} holds no numbers: cpu does")


@contextlib.contextmanager
def save_at_interruption(save: Callable[[], None]) -> Iterator[None]:
    """Save when Ctrl-C ends the block."""
    try:
        yield
    except KeyboardInterrupt:
        with deferred_interrupts():
            save()
        raise


def write_history(out: Path, history: list[dict[str, int | float]]) -> None:
    from depthmocap.report.charts import loss_curves

    write_file(out / "history.jsonl", "".join(json.dumps(row) + "\n" for row in history))
    with contextlib.suppress(InputError):  # a picture is not worth a training run
        write_file(out / "curves.png", loss_curves(history))
