"""What training runs share: settings, the state that a checkpoint holds, and the loop (extra: train).

A run can be stopped at any time and is resumed by the same command.
"""

from __future__ import annotations

import abc
import contextlib
import dataclasses
import io
import json
import math
import os
import signal
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar, cast

import torch
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.data import DataLoader, Dataset

from depthmocap.core.console import Terminal
from depthmocap.core.interrupts import deferred_interrupts, ignore_signals
from depthmocap.core.output import write_file
from depthmocap.core.settings import check_at_least, check_seed, claim_folder
from depthmocap.errors import InputError
from depthmocap.train.checkpoints import load_weights, read_checkpoint
from depthmocap.train.distributed import (
    average_gradients,
    process_count,
    process_rank,
    same_everywhere,
    wait_for_all,
)

_Net = TypeVar("_Net", bound=nn.Module)
_Batch = TypeVar("_Batch")
#: Numbers of a validation, by name.
Row = dict[str, int | float]

#: Length of a data set without end.
ENDLESS = 1 << 40
#: The learning rate rises over this many pictures.
_WARM_UP_IMAGES = 3200
#: The learning rate never falls below this.
LEAST_RATE = 1e-6
#: Gradients are clipped to this norm.
_LARGEST_GRADIENT = 5.0
#: Longest time between two checkpoints, seconds.
_SAVE_EVERY_S = 300.0
#: Batches that each worker makes ahead.
_AHEAD = 6
#: Settings that may change when a run is resumed, of every run.
_FREE = ("out", "images", "minutes", "postures", "workers", "device", "valid_every")
#: Files that every run writes besides the checkpoint and the settings.
_WRITTEN = ("history.jsonl", "curves.png")


@dataclasses.dataclass(frozen=True)
class TrainingRunSettings:
    """Settings of one training run.

    Attributes:
        out: folder of the run.
        images: number of pictures to train on.
        minutes: stop after this much training instead (the learning rate then follows the clock), 0 for no limit.
        batch: pictures per step, of each process where ``torchrun`` starts several.
        schedule: of the learning rate: it falls to zero along a cosine, or stays.
        average: what is validated and kept is an average of the weights over about 1 / (1 - this) steps; 0 for the
            last weights.
        start: a .safetensors file to start from.
        workers: processes that make pictures; 0 makes them between steps.
        valid_every: pictures between two validations.
    """

    out: Path
    _: dataclasses.KW_ONLY
    images: int = 100_000
    minutes: float = 0.0
    batch: int = 16
    schedule: Literal["cosine", "constant"] = "cosine"
    average: float = 0.998
    start: Path | None = None
    seed: int = 0
    workers: int = 1
    valid_every: int = 8000
    device: str = "cpu"

    def __post_init__(self) -> None:
        check_seed(self.seed)
        check_at_least(1, {"--images": self.images, "--batch": self.batch, "--valid-every": self.valid_every})
        check_at_least(0, {"--minutes": self.minutes})
        check_share({"--average": self.average})


def check_share(shares: dict[str, float]) -> None:
    """Raise InputError unless all numbers, by option, are at least 0 and below 1."""
    for option, share in shares.items():
        if not 0 <= share < 1:
            raise InputError(f"{option} must be from 0 to less than 1, got {share}")


def cosine_rate(share: float, warm_up: float) -> float:
    """Factor of the peak learning rate at a share (0–1) of a run, of whose rise a share ``warm_up`` is over."""
    return min(1.0, warm_up) * 0.5 * (1 + math.cos(math.pi * share))


class TrainingRun(abc.ABC, Generic[_Net, _Batch]):
    """One training run: the state that a checkpoint holds, and the steps that change it.

    Attributes:
        settings: of the run.
        network: the network that learns.
        images: number of images trained on so far.
        spent_s: training time so far, seconds.
        history: a row of numbers per validation.
    """

    def __init__(
        self,
        settings: TrainingRunSettings,
        make_network: Callable[[], _Net],
        make_optimiser: Callable[[_Net], torch.optim.Optimizer],
    ) -> None:
        """Make the network and its optimiser, or restore them from the folder's checkpoint.

        Args:
            make_optimiser: its parameter groups may name a ``peak`` of their learning rate.

        Raises:
            InputError: weights to start from or a checkpoint that cannot be read, or are of another network.
        """
        self.settings = settings
        self._checkpoint = settings.out / "checkpoint.pt"
        torch.manual_seed(settings.seed)
        self.network = make_network()
        self.network.to(settings.device)
        self.network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue] - the stub lacks it alone
        if settings.start is not None:
            load_weights(self.network, settings.start)
        self._average = AveragedModel(
            self.network, multi_avg_fn=get_ema_multi_avg_fn(settings.average), use_buffers=True
        )
        self._optimiser = make_optimiser(self.network)
        self._peaks = [group.get("peak", group["lr"]) for group in self._optimiser.param_groups]
        self.images, self.spent_s = 0, 0.0
        self.history: list[Row] = []
        if self._checkpoint.exists():
            state = read_checkpoint(self._checkpoint, settings.device)
            try:
                self.restore(state)
            except (RuntimeError, ValueError, KeyError, TypeError, AttributeError) as error:
                raise InputError(
                    f"{self._checkpoint} is of another network or optimiser ({str(error).splitlines()[0]}): "
                    "use the same settings, or another --out"
                ) from None
        self._saved_s = time.monotonic()

    def state(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        parts = {"network": self.network, "average": self._average, "optimiser": self._optimiser}
        return {
            **{name: part.state_dict() for name, part in parts.items()},
            "done": self.images, "spent": self.spent_s, "history": json.dumps(self.history),
        }  # fmt: skip

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from what a checkpoint holds."""
        self.network.load_state_dict(state["network"])
        self._average.load_state_dict(state["average"])
        self._optimiser.load_state_dict(state["optimiser"])
        self.images, self.spent_s, self.history = state["done"], state["spent"], state["history"]

    def save(self) -> None:
        """Write the checkpoint, in the first process."""
        self._saved_s = time.monotonic()
        if process_rank() > 0:
            return
        buffer = io.BytesIO()  # torch does not report a full disk in a way of its own
        torch.save(self.state(), buffer)
        write_file(self._checkpoint, buffer.getbuffer())

    def save_at_times(self) -> None:
        """Write the checkpoint if the last one is older than ``_SAVE_EVERY_S``."""
        if time.monotonic() - self._saved_s > _SAVE_EVERY_S:
            self.save()

    @property
    def averaged(self) -> _Net:
        """The averaged network, which is validated and kept."""
        return cast(_Net, self._average.module)

    @property
    def progress(self) -> float:
        """Share of the run that is done, 0–1: by time where the settings limit it, otherwise by images."""
        if self.settings.minutes > 0:
            return min(1.0, self.spent_s / 60 / self.settings.minutes)
        return min(1.0, self.images / self.settings.images)

    @property
    def step_images(self) -> int:
        """Pictures per step, of all processes."""
        return self.settings.batch * process_count()

    def rate_factor(self) -> float:
        """Factor of the peak learning rate at the next step."""
        warm_up = (self.images + self.step_images) / _WARM_UP_IMAGES
        return cosine_rate(self.progress if self.settings.schedule == "cosine" else 0.0, warm_up)

    def step(self, batch: _Batch) -> None:
        """Train on one batch of each process."""
        factor = self.rate_factor()
        for group, peak in zip(self._optimiser.param_groups, self._peaks, strict=True):
            group["lr"] = peak * factor + LEAST_RATE
        self.network.train()
        objective = self.objective(batch)
        self._optimiser.zero_grad()
        objective.backward()
        average_gradients(self.network)
        nn.utils.clip_grad_norm_(self.network.parameters(), _LARGEST_GRADIENT)
        self._optimiser.step()
        self._average.update_parameters(self.network)
        self.images += self.step_images

    def add_row(self, numbers: Row) -> Row:
        """Add the numbers of a validation to the history; returns the whole row."""
        row = {"step": self.images, "minutes": self.spent_s / 60, **numbers}
        self.history.append(row)
        return row

    def write_history(self) -> None:
        """Write the history and its curves, in the first process."""
        if process_rank() > 0:
            return
        from depthmocap.report.charts import loss_curves

        out = self.settings.out
        write_file(out / "history.jsonl", "".join(json.dumps(row) + "\n" for row in self.history))
        with contextlib.suppress(InputError):  # a picture is not worth a training run
            write_file(out / "curves.png", loss_curves(self.history))

    @abc.abstractmethod
    def objective(self, batch: _Batch) -> Tensor:
        """What a step makes smaller."""

    @abc.abstractmethod
    def recent(self) -> str:
        """How it goes, in a few words."""


def run_training(run: TrainingRun[Any, _Batch], batches: Iterable[_Batch], validate: Callable[[], Row]) -> None:
    """Train until the run is done, and measure at intervals; a checkpoint is written after each validation, at times
    between them, at Ctrl-C and at the end. Each process measures the same network, and the first one tells."""
    settings = run.settings
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Terminal(quiet=process_rank() > 0)) as progress, _saved_at_interruption(run):
        task = progress.add_task("training", total=1.0)
        progress.update(task, completed=run.progress)
        clock = time.monotonic()
        for batch in batches:
            if run.progress >= 1:
                break
            before = run.images
            run.step(batch)
            run.spent_s = same_everywhere(run.spent_s + time.monotonic() - clock)
            clock = time.monotonic()
            progress.update(task, completed=run.progress, description=f"{run.images} images  {run.recent()}")
            if before // settings.valid_every != run.images // settings.valid_every:
                row = run.add_row(validate())
                progress.console.print({k: round(v, 4) for k, v in row.items()})
                run.save()
                run.write_history()
            else:
                run.save_at_times()
    run.save()


@contextlib.contextmanager
def _saved_at_interruption(run: TrainingRun[Any, Any]) -> Iterator[None]:
    """Write the checkpoint when Ctrl-C ends the block."""
    try:
        yield
    except KeyboardInterrupt:
        with deferred_interrupts():
            run.save()
        raise


def prepare_folder(settings: TrainingRunSettings, written: Collection[str], free: Collection[str]) -> None:
    """Claim the folder of the run for its settings; files of a run without a checkpoint are removed. The first process
    does so, and others wait.

    Args:
        written: files that this kind of run writes in addition to those of every run.
        free: settings of this kind of run that may change when it is resumed, in addition to those of every run.

    Raises:
        InputError: when the folder holds a run with other settings, or the weights to start from would be overwritten.
    """
    if process_rank() > 0:
        wait_for_all()
        return
    out, names = settings.out, (*_WRITTEN, *written)
    if settings.start is not None and settings.start.resolve() in [(out / name).resolve() for name in names]:
        raise InputError(f"--start must not be a file that training writes, got {settings.start}: choose another --out")
    if not (out / "checkpoint.pt").exists() and (out / "settings.json").exists():
        for name in (*names, "settings.json"):
            (out / name).unlink(missing_ok=True)
    claim_folder(out, settings, "a run", (*_FREE, *free))
    wait_for_all()


def data_loader(data: Dataset[Any], workers: int, **options: Any) -> DataLoader[Any]:
    """A loader of what a run trains on, by worker processes where there are any."""
    return DataLoader(
        data, num_workers=workers, prefetch_factor=_AHEAD if workers else None,
        # Forking after OpenMP has run can hang the child.
        multiprocessing_context="spawn" if workers else None,
        persistent_workers=workers > 0, worker_init_fn=_begin_worker, collate_fn=list, **options,
    )  # fmt: skip


def _begin_worker(_: int) -> None:
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
