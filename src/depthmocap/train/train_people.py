"""Train the network that finds people (extra: train). Can be stopped at any time and resumed by the same command."""

from __future__ import annotations

import dataclasses
import io
import json
import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal, cast

import numpy as np
import torch
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from safetensors.torch import save as serialise
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.data import DataLoader, Dataset

from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.output import write_file
from depthmocap.core.settings import check_above_0, check_at_least, check_seed, claim_folder
from depthmocap.train.checkpoints import load_weights, read_checkpoint
from depthmocap.train.people_export import export_people_onnx
from depthmocap.train.people_network import PeopleNet
from depthmocap.train.people_samples import IGNORED, PeopleExample, PeopleScenes
from depthmocap.train.train_classifier import begin_worker, check_device, save_at_interruption, write_history

#: Weight of the error of the centres (metres) against the cross-entropy.
_OFFSET_WEIGHT = 1.0
#: A person of fewer samples than this weighs more, by the square root of how many fewer, at most so many times:
#: otherwise nobody learns what a small child or a far person is.
_FEW_SAMPLES, _MOST_WEIGHT = 400, 3.0
#: The learning rate rises over this many pictures.
_WARM_UP = 3200
#: Gradients are clipped to this norm.
_LARGEST_GRADIENT = 5.0
#: Scenes between which pictures are mixed.
_MIXED = 120
#: Longest time between two checkpoints (seconds).
_SAVE_EVERY_S = 300.0
#: Settings that may change when a run is resumed.
_FREE = ("out", "images", "minutes", "postures", "workers", "device", "valid_every", "valid_scenes")
_ENDLESS = 1 << 40


@dataclasses.dataclass(frozen=True)
class PeopleTraining:
    """Settings of one training run.

    Attributes:
        out: folder of the run: settings.json, history.jsonl, curves.png, checkpoint.pt, people.safetensors and
            people.onnx.
        postures: folder of motion capture clips, or a pool made of them; without it the packaged prior.
        images: number of pictures to train on.
        minutes: stop after this much training instead (the learning rate then follows the clock), 0 for no limit.
        batch: pictures per step.
        learning_rate: its peak.
        schedule: of the learning rate: it falls to zero along a cosine, or stays.
        average: what is validated and kept is an average of the weights over about 1 / (1 - this) steps.
        start: a .safetensors file to start from.
        workers: processes that make pictures; 0 makes them between steps.
        valid_every: pictures between two validations.
        valid_scenes: scenes of validation, ten pictures each.
    """

    out: Path
    postures: Path | None = None
    images: int = 500_000
    minutes: float = 0.0
    batch: int = 16
    learning_rate: float = 2e-3
    schedule: Literal["cosine", "constant"] = "cosine"
    average: float = 0.998
    start: Path | None = None
    seed: int = 0
    workers: int = 1
    valid_every: int = 16000
    valid_scenes: int = 60
    device: str = "cpu"

    def __post_init__(self) -> None:
        check_seed(self.seed)
        check_at_least(1, {"--images": self.images, "--batch": self.batch, "--valid-every": self.valid_every,
                           "--valid-scenes": self.valid_scenes})  # fmt: skip
        check_at_least(0, {"--minutes": self.minutes, "--average": self.average})
        check_above_0({"--learning-rate": self.learning_rate})


class _Scenes(Dataset[list[PeopleExample]]):
    """Open-ended scenes from one on."""

    def __init__(self, scenes: PeopleScenes, first: int) -> None:
        self.scenes, self.first = scenes, first

    def __len__(self) -> int:
        return _ENDLESS

    def __getitem__(self, index: int) -> list[PeopleExample]:
        return self.scenes(self.first + index)


def people_loss(outputs: Tensor, people: Tensor, offsets: Tensor) -> tuple[Tensor, Tensor]:
    """Mean cross-entropy of the samples with depth, and mean distance (metres) of the known centres; small people
    weigh more.

    Args:
        outputs: (n, 7, rows, columns) of :class:`PeopleNet`.
        people: (n, 2 rows, 2 columns), see :class:`PeopleExample`.
        offsets: (n, 3, rows, columns), NaN where unknown.
    """
    logits = nn.functional.pixel_shuffle(outputs[:, :4], 2)[:, 0]
    known = people != IGNORED
    weights = _weights(people)
    labels = nn.functional.binary_cross_entropy_with_logits(
        logits[known], (people[known] > 0).float(), weights[known]
    )  # fmt: skip
    has_centre = offsets[:, 0].isfinite()
    if not has_centre.any():
        return labels, outputs[:, 4:].sum() * 0
    error = (outputs[:, 4:] - offsets).permute(0, 2, 3, 1)[has_centre]
    of_cells = nn.functional.max_pool2d(weights[:, None], 2)[:, 0][has_centre]
    return labels, ((error.square().sum(-1) + 1e-4).sqrt() * of_cells).sum() / of_cells.sum()


def _weights(people: Tensor) -> Tensor:
    """Weight of each sample, by the number of samples of its person."""
    numbers = people.long() + 256 * torch.arange(len(people), device=people.device)[:, None, None]
    counts = torch.bincount(numbers.flatten(), minlength=256 * len(people))
    weights = (_FEW_SAMPLES / counts.clamp(min=1)).sqrt().clamp(1.0, _MOST_WEIGHT)
    return torch.where((people > 0) & (people != IGNORED), weights[numbers], 1.0)


class _Run:
    """The state of one training run, and the steps that change it."""

    def __init__(self, settings: PeopleTraining) -> None:
        self.settings = settings
        self._checkpoint = settings.out / "checkpoint.pt"
        torch.manual_seed(settings.seed)
        self.network = PeopleNet().to(settings.device)
        self.network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue] - torch's stubs lack it
        if settings.start is not None:
            load_weights(self.network, settings.start)
        self._average = AveragedModel(
            self.network, multi_avg_fn=get_ema_multi_avg_fn(settings.average), use_buffers=True
        )
        self._optimiser = torch.optim.AdamW(
            self.network.parameters(), settings.learning_rate, betas=(0.9, 0.98), weight_decay=0.01
        )
        self.images, self.spent_s, self.scenes = 0, 0.0, 0
        self.history: list[dict[str, float | int]] = []
        if self._checkpoint.exists():
            state = read_checkpoint(self._checkpoint, settings.device)
            self.network.load_state_dict(state["network"])
            self._average.load_state_dict(state["average"])
            self._optimiser.load_state_dict(state["optimiser"])
            self.images, self.spent_s, self.history = state["done"], state["spent"], state["history"]
            self.scenes = int(state["scenes"])
        self._losses: list[tuple[float, float]] = []
        self._saved_s = time.monotonic()

    @property
    def progress(self) -> float:
        """Share of the run that is done, 0–1."""
        if self.settings.minutes > 0:
            return min(1.0, self.spent_s / 60 / self.settings.minutes)
        return min(1.0, self.images / self.settings.images)

    @property
    def recent_loss(self) -> tuple[float, float]:
        """Mean losses of the last 100 steps."""
        labels, centres = np.mean(self._losses[-100:], 0)
        return float(labels), float(centres)

    def step(self, examples: Sequence[PeopleExample]) -> None:
        """Train on a batch; half of it is mirrored."""
        settings = self.settings
        factor = 1.0
        if settings.schedule == "cosine":
            factor = 0.5 * (1 + math.cos(math.pi * self.progress))
        factor *= min(1.0, (self.images + len(examples)) / _WARM_UP)
        for group in self._optimiser.param_groups:
            group["lr"] = settings.learning_rate * factor + 1e-6
        x, people, offsets = _tensors([mirrored(e) if k % 2 else e for k, e in enumerate(examples)], settings.device)
        self.network.train()
        labels, centres = people_loss(self.network(x), people, offsets)
        self._optimiser.zero_grad()
        (labels + _OFFSET_WEIGHT * centres).backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), _LARGEST_GRADIENT)
        self._optimiser.step()
        self._average.update_parameters(self.network)
        self.images += len(examples)
        self._losses.append((labels.item(), centres.item()))

    def validate(self, examples: Sequence[PeopleExample]) -> dict[str, float | int]:
        """Measure the averaged network; the row is added to the history."""
        network = self._average.module
        network.eval()
        hits = missed = false = 0
        errors, empties = [], []
        with torch.no_grad():
            for first in range(0, len(examples), 32):
                x, people, offsets = _tensors(examples[first : first + 32], self.settings.device)
                outputs = network(x)
                found = nn.functional.pixel_shuffle(outputs[:, :4], 2)[:, 0] > 0
                shown = (people > 0) & (people != IGNORED)
                hits += int((found & shown).sum())
                missed += int((~found & shown).sum())
                false += int((found & (people == 0)).sum())
                has_centre = offsets[:, 0].isfinite()
                errors.append((outputs[:, 4:] - offsets).permute(0, 2, 3, 1)[has_centre].norm(dim=-1))
                nobody = ~shown.flatten(1).any(1)
                empties.append((found & (people == 0)).flatten(1).float().mean(1)[nobody])
        row: dict[str, float | int] = {
            "step": self.images, "minutes": self.spent_s / 60, "loss": self.recent_loss[0],
            "iou": hits / max(hits + missed + false, 1), "recall": hits / max(hits + missed, 1),
            "precision": hits / max(hits + false, 1), "centre_cm": 100 * float(torch.cat(errors).mean()),
            "centre_median_cm": 100 * float(torch.cat(errors).median()),
            "false_in_empty": float(torch.cat(empties).mean()),
        }  # fmt: skip
        self.history.append(row)
        return row

    def save(self) -> None:
        """Write the checkpoint."""
        self._saved_s = time.monotonic()
        parts = {"network": self.network, "average": self._average, "optimiser": self._optimiser}
        state = {name: part.state_dict() for name, part in parts.items()}
        buffer = io.BytesIO()
        history = json.dumps(self.history)
        torch.save(
            {**state, "done": self.images, "spent": self.spent_s, "history": history, "scenes": self.scenes}, buffer
        )
        write_file(self._checkpoint, buffer.getbuffer())

    def save_at_times(self) -> None:
        """Write the checkpoint if the last one is old."""
        if time.monotonic() - self._saved_s > _SAVE_EVERY_S:
            self.save()

    def export(self) -> Path:
        """Write the averaged weights as .safetensors and ONNX; returns the ONNX file."""
        network = cast(PeopleNet, self._average.module).cpu().eval()
        state = {k: v.half() if v.is_floating_point() and v.ndim > 1 else v for k, v in network.state_dict().items()}
        write_file(self.settings.out / "people.safetensors", serialise({k: v.contiguous() for k, v in state.items()}))
        return export_people_onnx(network, self.settings.out / "people.onnx", {"images": str(self.images)})


def _tensors(examples: Sequence[PeopleExample], device: str) -> tuple[Tensor, Tensor, Tensor]:
    inputs, people, offsets = (torch.from_numpy(np.stack(part)).to(device) for part in zip(*examples, strict=True))
    return inputs.to(memory_format=torch.channels_last), people, offsets


def mirrored(example: PeopleExample) -> PeopleExample:
    """The mirror image."""
    inputs = example.inputs[:, :, ::-1][[0, 1, 3, 2, 5, 4, 6, 7]]
    signs = np.ones(len(inputs), np.float32)
    signs[6] = -1  # the slope to the right
    offsets = example.offsets[:, :, ::-1] * np.array([-1, 1, 1], np.float32)[:, None, None]
    return PeopleExample(inputs * signs[:, None, None], example.people[:, ::-1].copy(), offsets)


def _batches(run: _Run, postures: PeopleScenes) -> Iterator[list[PeopleExample]]:
    """Batches without end, mixed from many scenes."""
    settings = run.settings
    loader = DataLoader(
        _Scenes(postures, run.scenes), batch_size=None, shuffle=False, num_workers=settings.workers,
        prefetch_factor=6 if settings.workers else None,
        multiprocessing_context="spawn" if settings.workers else None,
        persistent_workers=settings.workers > 0, worker_init_fn=begin_worker, collate_fn=list,
        sampler=range(_ENDLESS),
    )  # fmt: skip
    rng = np.random.default_rng([settings.seed, run.images])
    mixed: list[PeopleExample] = []
    for scenes, examples in enumerate(loader, 1):
        mixed += examples
        run.scenes += 1
        # Begin early with few, so that the first steps do not wait for the whole mixture.
        while len(mixed) > max(settings.batch, 20 * min(_MIXED, scenes) * 0.8):
            chosen = set(rng.choice(len(mixed), settings.batch, replace=False).tolist())
            yield [mixed[i] for i in chosen]
            mixed = [example for i, example in enumerate(mixed) if i not in chosen]


@locks_outputs(folder="out")
def train_people(settings: PeopleTraining) -> Path:
    """Train or resume training, and export; returns the ONNX file.

    The objective is the mean cross-entropy of all samples with depth, and the mean distance of the centres.

    Raises:
        InputError: postures or weights that cannot be read, or a folder that holds another run.
    """
    check_device(settings.device)
    claim_folder(settings.out, settings, "a run", _FREE)
    run = _Run(settings)
    valid_scenes = PeopleScenes(settings.postures, "valid", 1)
    valid = [example for i in range(settings.valid_scenes) for example in valid_scenes(i)]
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Terminal()) as progress, save_at_interruption(run.save):
        task = progress.add_task("training", total=1.0)
        clock = time.monotonic()
        for batch in _batches(run, PeopleScenes(settings.postures, "train", settings.seed)):
            if run.progress >= 1:
                break
            before = run.images
            run.step(batch)
            run.spent_s += time.monotonic() - clock
            clock = time.monotonic()
            labels, centres = run.recent_loss
            text = f"{run.images} images  loss {labels:.3f}  centres {100 * centres:.0f} cm"
            progress.update(task, completed=run.progress, description=text)
            if before // settings.valid_every != run.images // settings.valid_every:
                row = run.validate(valid)
                progress.console.print({k: round(v, 4) for k, v in row.items()})
                run.save()
                write_history(settings.out, run.history)
            else:
                run.save_at_times()
    run.save()
    run.validate(valid)
    write_history(settings.out, run.history)
    return run.export()
