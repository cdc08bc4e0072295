"""Train the network that finds people (extra: train). Can be stopped at any time and resumed by the same command."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils.data import Dataset

from depthmocap.core.settings import check_above_0, check_at_least
from depthmocap.train.checkpoints import save_weights
from depthmocap.train.distributed import process_count, process_rank, trains
from depthmocap.train.people_export import export_people_onnx
from depthmocap.train.people_network import PeopleNet
from depthmocap.train.people_samples import IGNORED, PeopleExample, PeopleScenes
from depthmocap.train.training_run import (
    ENDLESS,
    Row,
    TrainingRun,
    TrainingRunSettings,
    check_device,
    data_loader,
    prepare_folder,
    run_training,
)

#: Weight of the error of the centres (metres) against the cross-entropy.
_OFFSET_WEIGHT = 1.0
#: A person of fewer samples than this weighs more, by the square root of how many fewer: otherwise nobody learns what a
#: small child or a far person is.
_FEW_SAMPLES = 400
#: The most that a person weighs.
_MOST_WEIGHT = 3.0
#: So many batches tell the ranges of the network's values, for its 8 bits.
_RANGE_BATCHES = 8
#: Scenes between which pictures are mixed.
_MIXED = 120
#: Settings that may change when a run is resumed, besides those of every run.
_FREE = ("valid_scenes",)
#: Files that a run writes besides those of every run.
_WRITTEN = ("people.safetensors", "people.onnx")


@dataclasses.dataclass(frozen=True, kw_only=True)
class PeopleTraining(TrainingRunSettings):
    """Settings of one training run.

    Attributes:
        out: folder of the run: settings.json, history.jsonl, curves.png, checkpoint.pt, people.safetensors and
            people.onnx.
        postures: folder of motion capture clips, or a pool made of them; without it the packaged prior.
        learning_rate: its peak.
        valid_scenes: scenes of validation, ten pictures each.
    """

    postures: Path | None = None
    images: int = 500_000
    learning_rate: float = 2e-3
    valid_every: int = 16000
    valid_scenes: int = 60

    def __post_init__(self) -> None:
        super().__post_init__()
        check_at_least(1, {"--valid-scenes": self.valid_scenes})
        check_above_0({"--learning-rate": self.learning_rate})


class _Scenes(Dataset[list[PeopleExample]]):
    """Open-ended scenes from one on."""

    def __init__(self, scenes: PeopleScenes, first: int) -> None:
        self.scenes, self.first = scenes, first

    def __len__(self) -> int:
        return ENDLESS

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


class _Run(TrainingRun[PeopleNet, list[PeopleExample]]):
    """The training of the network that finds people.

    Attributes:
        scenes: number of scenes drawn so far.
    """

    settings: PeopleTraining

    def __init__(self, settings: PeopleTraining) -> None:
        self.scenes = 0
        super().__init__(
            settings, PeopleNet,
            lambda network: torch.optim.AdamW(
                network.parameters(), settings.learning_rate, betas=(0.9, 0.98), weight_decay=0.01
            ),
        )  # fmt: skip
        self._losses: list[tuple[float, float]] = []

    def state(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return {**super().state(), "scenes": self.scenes}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from what a checkpoint holds."""
        super().restore(state)
        self.scenes = int(state["scenes"])

    def _recent_losses(self) -> tuple[float, float]:
        """Mean losses of the last 100 steps."""
        labels, centres = np.mean(self._losses[-100:], 0)
        return float(labels), float(centres)

    def recent(self) -> str:
        """Mean losses of the last steps."""
        labels, centres = self._recent_losses()
        return f"loss {labels:.3f}  centres {100 * centres:.0f} cm"

    def objective(self, batch: list[PeopleExample]) -> Tensor:
        """Loss of the samples and of the centres; half of the batch is mirrored."""
        examples = [mirrored(e) if k % 2 else e for k, e in enumerate(batch)]
        x, people, offsets = _tensors(examples, self.settings.device)
        labels, centres = people_loss(self.network(x), people, offsets)
        self._losses.append((labels.item(), centres.item()))
        return labels + _OFFSET_WEIGHT * centres

    def validate(self, examples: Sequence[PeopleExample]) -> Row:
        """Measure the averaged network."""
        network = self.averaged
        network.eval()
        hits = missed = false = 0
        errors, empties = [], []
        with torch.no_grad():
            for first in range(0, len(examples), 32):
                x, people, offsets = _tensors(examples[first : first + 32], self.settings.device)
                outputs = network(x)
                predicted = nn.functional.pixel_shuffle(outputs[:, :4], 2)[:, 0] > 0
                shown = (people > 0) & (people != IGNORED)
                hits += int((predicted & shown).sum())
                missed += int((~predicted & shown).sum())
                false += int((predicted & (people == 0)).sum())
                has_centre = offsets[:, 0].isfinite()
                errors.append((outputs[:, 4:] - offsets).permute(0, 2, 3, 1)[has_centre].norm(dim=-1))
                nobody = ~shown.flatten(1).any(1)
                empties.append((predicted & (people == 0)).flatten(1).float().mean(1)[nobody])
        return {
            "loss": self._recent_losses()[0],
            "iou": hits / max(hits + missed + false, 1), "recall": hits / max(hits + missed, 1),
            "precision": hits / max(hits + false, 1), "centre_cm": 100 * float(torch.cat(errors).mean()),
            "centre_median_cm": 100 * float(torch.cat(errors).median()),
            "false_in_empty": float(torch.cat(empties).mean()),
        }  # fmt: skip

    def export(self, examples: Iterable[PeopleExample]) -> Path:
        """Write the averaged weights as .safetensors and, in 8 bits by the ranges on examples, as ONNX, which it
        returns."""
        network = self.averaged.cpu().eval()
        save_weights(network, self.settings.out / "people.safetensors")
        pictures = [example.inputs for example in examples]
        return export_people_onnx(network, self.settings.out / "people.onnx", {"images": str(self.images)}, pictures)


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


def _batches(run: _Run, scenes: PeopleScenes) -> Iterator[list[PeopleExample]]:
    """Batches without end, mixed from many scenes."""
    settings = run.settings
    loader = data_loader(
        _Scenes(scenes, run.scenes), settings.workers, batch_size=None, shuffle=False,
        sampler=range(process_rank(), ENDLESS, process_count()),
    )  # fmt: skip
    rng = np.random.default_rng([settings.seed, run.images + process_rank()])
    mixed: list[PeopleExample] = []
    for drawn, examples in enumerate(loader, 1):
        mixed += examples
        run.scenes += process_count()
        # Begin early with few, so that the first steps do not wait for the whole mixture.
        while len(mixed) > max(settings.batch, 20 * min(_MIXED, drawn) * 0.8):
            chosen = set(rng.choice(len(mixed), settings.batch, replace=False).tolist())
            yield [mixed[i] for i in chosen]
            mixed = [example for i, example in enumerate(mixed) if i not in chosen]


@trains
def train_people(settings: PeopleTraining) -> Path:
    """Train or resume training, and export; returns the ONNX file.

    The objective is the mean cross-entropy of all samples with depth, and the mean distance of the centres.

    Raises:
        InputError: postures or weights that cannot be read, or a folder that holds another run.
    """
    check_device(settings.device)
    prepare_folder(settings, _WRITTEN, _FREE)
    run = _Run(settings)
    valid_scenes = PeopleScenes(settings.postures, "valid", 1)
    valid = [example for i in range(settings.valid_scenes) for example in valid_scenes(i)]
    training = _batches(run, PeopleScenes(settings.postures, "train", settings.seed))
    run_training(run, training, lambda: run.validate(valid))
    run.add_row(run.validate(valid))
    run.write_history()
    if process_rank() > 0:
        return settings.out / "people.onnx"
    return run.export(example for batch in itertools.islice(training, _RANGE_BATCHES) for example in batch)
