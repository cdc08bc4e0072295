"""Train a body-part classifier (extra: train). Can be stopped at any time and resumed by the same command."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy import ndarray
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from depthmocap.body.regions import UNLABELLED
from depthmocap.classify.data import Spoiling, training_window
from depthmocap.classify.export import export_onnx
from depthmocap.classify.networks import NETWORKS, Network, masked_logits
from depthmocap.classify.preprocess import make_window
from depthmocap.errors import InputError
from depthmocap.evaluate.metrics import PixelAccuracy
from depthmocap.settings import check_seed, plain_settings
from depthmocap.synth.motion.postures import TRAINING_VARIATION, posture_source
from depthmocap.synth.sample import Subset

#: What is validated and kept is an average of the weights over about 1 / (1 - this) steps.
_AVERAGE = 0.998


@dataclasses.dataclass(frozen=True)
class ClassifierTraining:
    """Settings of one training run.

    Attributes:
        out: folder of the run: settings.json, history.jsonl, curves.png, checkpoint.pt, classifier.safetensors/.onnx.
        data: "synth" makes pictures on the fly; a folder is read as a UBC3V root (its --subset's train and valid).
        postures: folder of motion capture clips, or a pool made of them; without it the packaged prior.
        subset: who is in the pictures: easy, inter, hard (as in the paper) or open (all builds); by default open
            bodies are made, and hard is read from a folder.
        network: which network.
        images: how many pictures to train on.
        minutes: stop after this much training instead (the learning rate then follows the clock), 0 for no limit.
        batch: pictures a step.
        learning_rate: its peak; it falls to zero along a cosine.
        start: a .safetensors file to start from.
        workers: processes that make pictures; 0 makes them between steps.
        valid_every: pictures between two validations.
        bfloat16: multiply in half precision; some processors are faster without.
    """

    out: Path
    data: str = "synth"
    postures: Path | None = None
    subset: Subset | None = None
    network: Literal["fast"] = "fast"
    images: int = 100_000
    minutes: float = 0.0
    batch: int = 16
    learning_rate: float = 2e-3
    weight_decay: float = 0.02
    start: Path | None = None
    seed: int = 0
    workers: int = 1
    valid_every: int = 8000
    valid_images: int = 320
    device: str = "cpu"
    bfloat16: bool = True

    @property
    def people(self) -> Subset:
        """The subset, its default resolved."""
        return self.subset or ("open" if self.data == "synth" else "hard")


class _SynthWindows(torch.utils.data.Dataset):  # type: ignore[type-arg]
    def __init__(self, settings: ClassifierTraining, first: int) -> None:
        simple = settings.people == "easy"
        self.settings, self.first = settings, first
        self.postures = posture_source(settings.postures, "train", simple, TRAINING_VARIATION)

    def __len__(self) -> int:
        return 1 << 40

    def __getitem__(self, index: int) -> tuple[ndarray, ndarray]:
        return training_window(self.settings.seed, self.first + index, self.settings.people, self.postures, Spoiling())


class _FolderWindows(torch.utils.data.Dataset):  # type: ignore[type-arg]
    """Views of a UBC3V split in an order shuffled by the seed, over and over."""

    def __init__(self, root: Path, settings: ClassifierTraining, split: str, first: int) -> None:
        from depthmocap.datasets.ubc3v import CAMERAS, Section, sections

        self.sections = [Section(path) for path in sections(root, f"{settings.people}-pose", split)]
        self.index = [
            (s, i, v)
            for s, section in enumerate(self.sections)
            for i in range(len(section))
            for v in range(len(CAMERAS))
        ]
        self.order = np.random.default_rng(settings.seed).permutation(len(self.index))
        self.first = first

    def __len__(self) -> int:
        return 1 << 40

    def __getitem__(self, index: int) -> tuple[ndarray, ndarray]:
        for attempt in range(100):  # a view may be missing or show nobody
            s, i, v = self.index[self.order[(self.first + index + 7919 * attempt) % len(self.order)]]
            views = self.sections[s][i].views
            if v >= len(views) or views[v].mask is None or views[v].labels is None:
                continue
            window = make_window(views[v].depth_m, views[v].mask, views[v].camera)
            if window is not None:
                return window.inputs, window.labels_from_image(views[v].labels, UNLABELLED)
        raise InputError("100 views in a row hold no labelled person: is this a UBC3V root with labels?")


class _Batches(torch.utils.data.Sampler):  # type: ignore[type-arg]
    def __init__(self, size: int) -> None:
        self.size = size

    def __iter__(self) -> Iterator[list[int]]:
        start = 0
        while True:
            yield list(range(start, start + self.size))
            start += self.size


def _validation(settings: ClassifierTraining) -> tuple[Tensor, Tensor]:
    """The fixed validation windows: postures of the valid split, bodies and noise of a seed of their own."""
    if settings.data == "synth":
        postures = posture_source(settings.postures, "valid", settings.people == "easy")
        windows = [
            training_window(settings.seed + 1_000_003, i, settings.people, postures, None)
            for i in range(settings.valid_images)
        ]
    else:
        folder = _FolderWindows(Path(settings.data), settings, "valid", 0)
        windows = [folder[i] for i in range(min(settings.valid_images, len(folder.index)))]
    return (
        torch.from_numpy(np.stack([x for x, _ in windows])),
        torch.from_numpy(np.stack([y for _, y in windows])),
    )


def evaluate_windows(network: Network, inputs: Tensor, labels: Tensor, device: str = "cpu") -> PixelAccuracy:
    """Accuracy over windows (n, 3, s, s) and labels (n, s, s) uint8, on the person's labelled pixels."""
    network.eval()
    accuracy = PixelAccuracy()
    with torch.no_grad():
        for x, y in zip(inputs.split(16), labels.split(16), strict=True):
            x, y = x.to(device).to(memory_format=torch.channels_last), y.to(device)
            chosen, truth = masked_logits(network, x, y, (x[:, 1] > 0) & (y != UNLABELLED))
            accuracy.add(truth.cpu().numpy(), chosen.argmax(1).cpu().numpy().astype(np.uint8))
    return accuracy


def train_classifier(settings: ClassifierTraining) -> Path:
    """Train, or go on training, and export; returns the ONNX file.

    The objective is the mean cross-entropy over the masked pixels whose label is known.
    """
    check_seed(settings.seed)
    out = settings.out
    out.mkdir(parents=True, exist_ok=True)
    (out / "settings.json").write_text(json.dumps(plain_settings(settings), indent=1) + "\n")
    torch.manual_seed(settings.seed)
    network = NETWORKS[settings.network]().to(settings.device).to(memory_format=torch.channels_last)  # pyright: ignore
    if settings.start is not None:
        load_weights(network, settings.start)
    average = AveragedModel(network, multi_avg_fn=get_ema_multi_avg_fn(_AVERAGE), use_buffers=True)
    optimiser = torch.optim.AdamW(
        network.parameters(), settings.learning_rate, weight_decay=settings.weight_decay, betas=(0.9, 0.98)
    )
    done, spent, history = 0, 0.0, []
    checkpoint = out / "checkpoint.pt"
    if checkpoint.exists():
        state = torch.load(checkpoint, map_location=settings.device, weights_only=True)
        network.load_state_dict(state["network"])
        average.load_state_dict(state["average"])
        optimiser.load_state_dict(state["optimiser"])
        done, spent, history = state["done"], state["spent"], json.loads(state["history"])

    data = (
        _SynthWindows(settings, done)
        if settings.data == "synth"
        else _FolderWindows(Path(settings.data), settings, "train", done)
    )
    valid_x, valid_y = _validation(settings)
    loader = torch.utils.data.DataLoader(
        data, batch_sampler=_Batches(settings.batch), num_workers=settings.workers,
        prefetch_factor=6 if settings.workers else None,
        # Forking after OpenMP has run can hang the child.
        multiprocessing_context="spawn" if settings.workers else None,
        persistent_workers=settings.workers > 0,
    )  # fmt: skip

    def save() -> None:
        partial = checkpoint.with_suffix(".tmp")
        parts = {"network": network, "average": average, "optimiser": optimiser}
        state = {name: part.state_dict() for name, part in parts.items()}
        torch.save({**state, "done": done, "spent": spent, "history": json.dumps(history)}, partial)
        partial.replace(checkpoint)

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    running: list[float] = []
    hits: list[float] = []
    with Progress(*columns) as progress:
        task = progress.add_task("training", total=1.0)
        progress.update(task, completed=_share(settings, done, spent))
        clock = time.monotonic()
        for x, y in loader:
            share = _share(settings, done, spent)
            if share >= 1:
                break
            warm = min(1.0, (done + settings.batch) / 3200)
            for group in optimiser.param_groups:
                group["lr"] = settings.learning_rate * warm * 0.5 * (1 + math.cos(math.pi * share)) + 1e-6
            network.train()
            x = x.to(settings.device).to(memory_format=torch.channels_last)
            y = y.to(settings.device)
            with torch.autocast(settings.device.split(":")[0], torch.bfloat16, enabled=settings.bfloat16):
                chosen, truth = masked_logits(network, x, y, (x[:, 1] > 0) & (y != UNLABELLED))
            loss = nn.functional.cross_entropy(chosen.float(), truth.long())
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(network.parameters(), 5.0)
            optimiser.step()
            average.update_parameters(network)
            before = done
            done += settings.batch
            spent += time.monotonic() - clock
            clock = time.monotonic()
            running.append(loss.item())
            hits.append((chosen.argmax(1) == truth).float().mean().item())
            progress.update(task, completed=_share(settings, done, spent),
                            description=f"{done} images  loss {np.mean(running[-50:]):.3f}")  # fmt: skip
            if before // settings.valid_every != done // settings.valid_every:
                accuracy = evaluate_windows(average.module, valid_x, valid_y, settings.device)
                row = {
                    "step": done, "minutes": spent / 60, "loss": float(np.mean(running)),
                    "train_pixel_accuracy": float(np.mean(hits)),
                    "valid_pixel_accuracy": accuracy.pixel_accuracy, "valid_class_accuracy": accuracy.class_accuracy,
                }  # fmt: skip
                running, hits = [], []
                history.append(row)
                progress.console.print({k: round(v, 4) for k, v in row.items()})
                save()
                _write_history(out, history)
    save()
    network = average.module.eval()
    # Norms and biases are few and keep their range; kernels take half the space.
    half = {k: v.half() if v.is_floating_point() and v.ndim > 1 else v for k, v in network.cpu().state_dict().items()}
    save_file({k: v.contiguous() for k, v in half.items()}, out / "classifier.safetensors")
    return export_onnx(network, out / "classifier.onnx", {"network": settings.network, "images": str(done)})


def load_weights(network: nn.Module, path: Path) -> None:
    """Load a .safetensors file into a network; names and shapes must match.

    Raises:
        InputError: when the file is missing, malformed or of another network.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        state = load_file(path)
        network.load_state_dict({k: v.float() if v.is_floating_point() else v for k, v in state.items()})
    except (OSError, SafetensorError, RuntimeError) as error:
        raise InputError(f"{path} does not hold weights of this network: {str(error).splitlines()[0]}") from None


def _share(settings: ClassifierTraining, done: int, spent: float) -> float:
    """How much of the run is behind, 0–1: by the clock where a time is set, else by pictures."""
    if settings.minutes > 0:
        return min(1.0, spent / 60 / settings.minutes)
    return min(1.0, done / settings.images)


def _write_history(out: Path, history: list[dict[str, float]]) -> None:
    from depthmocap.evaluate.charts import loss_curves

    (out / "history.jsonl").write_text("".join(json.dumps(row) + "\n" for row in history))
    with contextlib.suppress(OSError):  # a picture is not worth a training run
        (out / "curves.png").write_bytes(loss_curves(history))
