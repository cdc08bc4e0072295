"""Train a body-part classifier (extra: train). Can be stopped at any time and resumed by the same command."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import io
import json
import math
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import torch
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from safetensors.torch import save as serialise
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from depthmocap.body.regions import UNLABELLED
from depthmocap.classify.window import NetworkName
from depthmocap.core.console import Terminal
from depthmocap.core.interrupts import deferred_interrupts, ignore_signals
from depthmocap.core.locks import locks_outputs
from depthmocap.core.output import write_file
from depthmocap.core.reading.input_files import check_file, read_bytes
from depthmocap.core.reading.json_text import number, parse_json, whole_number
from depthmocap.core.settings import check_above_0, check_at_least, check_seed, claim_folder
from depthmocap.errors import InputError
from depthmocap.report.metrics import PixelAccuracy
from depthmocap.synth.sample import Subset
from depthmocap.train.batches import Batches, Ingredient, WindowSource, sorted_batches, training_batches
from depthmocap.train.networks import FastNet, Network, PaperNet, masked_outputs
from depthmocap.train.onnx_export import export_onnx
from depthmocap.train.precision import in_bfloat16
from depthmocap.train.quantise import quantise
from depthmocap.train.windows import LabelledWindow

Optimiser = Literal["adamw", "sgd"]
#: What a metre of a joint's error weighs against the cross-entropy of the labels, and the share of its foretelling.
_JOINT_WEIGHT, _SURPRISE = 4.0, 0.01
#: Training windows on which the ranges of the 8-bit form are found.
_CALIBRATION = 64
#: Learning rate and weight decay of each, where none are given.
_RATES: dict[Optimiser, tuple[float, float]] = {"adamw": (2e-3, 0.02), "sgd": (0.03, 5e-4)}
#: A run that is killed loses no more than this.
_SAVE_EVERY_S = 300.0
#: Bytes of a file of weights, at most.
_LARGEST_WEIGHTS = 1 << 30
#: Settings that may change when a run is gone on with: how long, where and how fast it learns, and what is exported.
_FREE = (
    "out", "images", "minutes", "blend", "postures", "workers", "device", "bfloat16", "valid_every", "valid_images",
)  # fmt: skip


#: What it writes besides the checkpoint and the settings.
_WRITTEN = ("history.jsonl", "curves.png", "classifier.safetensors", "classifier.onnx", "classifier_int8.onnx")


@dataclasses.dataclass(frozen=True)
class ClassifierTraining:
    """Settings of one training run.

    Attributes:
        out: folder of the run: settings.json, history.jsonl, curves.png, checkpoint.pt, classifier.safetensors/.onnx,
            and classifier_int8.onnx of our networks, which is faster and labels alike.
        data: "synth" makes pictures on the fly; a folder is read as a UBC3V root (its --subset's train and valid).
        postures: folder of motion capture clips, or a pool made of them; without it the packaged prior.
        subset: who is in the pictures: easy, inter, hard (as in the paper) or open (all builds); by default open
            bodies are made, and hard is read from a folder.
        network: "fast" is ours; "paper" is the paper's, which by itself sees windows and pictures of
            the paper's kind.
        images: how many pictures to train on.
        minutes: stop after this much training instead (the learning rate then follows the clock), 0 for no limit.
        batch: pictures a step.
        optimiser: by default AdamW, and for the paper's network SGD, in which biases learn twice as fast.
        learning_rate: its peak; by default 2e-3 with AdamW, 0.03 with SGD.
        schedule: of the learning rate: it falls to zero along a cosine, or stays.
        weight_decay: by default 0.02 with AdamW, 5e-4 (not of biases) with SGD.
        momentum: of SGD.
        average: what is validated and kept is an average of the weights over about 1 / (1 - this) steps; 0 for the
            last weights.
        start: a .safetensors file to start from.
        blend: share of the weights it started from in what is exported: what was learnt before holds better, on
            pictures unlike those of training above all (Wortsman et al., "Robust fine-tuning", CVPR 2022).
        workers: processes that make pictures; 0 makes them between steps.
        valid_every: pictures between two validations.
        bfloat16: multiply in half precision; by default where the device has instructions for it.
        without: what our network is trained without, to find out what it is worth (see ``train ablations``).
    """

    out: Path
    data: str = "synth"
    postures: Path | None = None
    subset: Subset | None = None
    network: NetworkName = "fast"
    images: int = 100_000
    minutes: float = 0.0
    batch: int = 16
    optimiser: Optimiser | None = None
    learning_rate: float | None = None
    schedule: Literal["cosine", "constant"] = "cosine"
    weight_decay: float | None = None
    momentum: float = 0.9
    average: float = 0.998
    start: Path | None = None
    blend: float = 0.0
    seed: int = 0
    workers: int = 1
    valid_every: int = 8000
    valid_images: int = 320
    device: str = "cpu"
    bfloat16: bool | None = None
    without: tuple[Ingredient, ...] = ()

    def __post_init__(self) -> None:
        check_seed(self.seed)
        check_at_least(1, {"--images": self.images, "--batch": self.batch, "--valid-every": self.valid_every,
                           "--valid-images": self.valid_images})  # fmt: skip
        check_at_least(0, {"--minutes": self.minutes, "--weight-decay": self.weight_decay})
        check_above_0({"--learning-rate": self.learning_rate})
        for option, share in (("--average", self.average), ("--momentum", self.momentum), ("--blend", self.blend)):
            if not 0 <= share < 1:
                raise InputError(f"{option} must be from 0 to less than 1, got {share}")
        if self.blend and self.start is None:
            raise InputError(f"--blend asks for a --start, got {self.blend} without one")

    @property
    def source(self) -> WindowSource:
        """Where its windows come from."""
        subset = self.subset or ("open" if self.data == "synth" else "hard")
        return WindowSource(self.network, self.data, subset, self.postures, self.seed, self.without)


def evaluate_windows(
    network: Network, windows: Sequence[LabelledWindow], device: str = "cpu"
) -> tuple[PixelAccuracy, float]:
    """Accuracy over windows, on the person's labelled pixels; and the mean error (metres) of the known joints, NaN of a
    network that does not tell them."""
    network.eval()
    accuracy, errors = PixelAccuracy(), []
    with torch.no_grad():
        for x, y, places in sorted_batches(windows, 16):
            x, y = x.to(device).to(memory_format=torch.channels_last), y.to(device)
            chosen, truth, found = masked_outputs(network, x, y, (x[:, 1] > 0) & (y != UNLABELLED))
            accuracy.add(truth.cpu().numpy(), chosen.argmax(1).cpu().numpy().astype(np.uint8))
            if found is not None:
                errors.append((found[..., :3].cpu() - places).norm(dim=-1))
    return accuracy, float(torch.cat(errors).nanmean()) if errors else math.nan


def joint_loss(found: Tensor, places: Tensor) -> Tensor:
    """Mean distance (metres) of the known joints, and how well the expected errors foretell it: the likelihood under an
    exponential distribution, which does not move the places."""
    known = places.isfinite().all(-1)
    if not known.any():
        return found.sum() * 0
    distance = (found[known][:, :3] - places[known]).norm(dim=-1)
    expected = found[known][:, 3]
    surprise = distance.detach() * torch.exp(-expected) + expected
    return distance.mean() + _SURPRISE * surprise.mean()


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
        InputError: when the paper's network shall lack something.
    """
    if settings.network == "paper":
        if settings.without:
            raise InputError("--without is for our networks: the paper's has none of these")
        return PaperNet()
    full = FastNet()
    widths = tuple(width // 2 for width in full.widths) if "width" in settings.without else full.widths
    return FastNet(widths, full.depths, "norm" not in settings.without)


@locks_outputs(folder="out")
def train_classifier(settings: ClassifierTraining) -> Path:
    """Train, or go on training, and export; returns the ONNX file.

    The objective is the mean cross-entropy over the pixels whose label is known: ours learns from the masked ones, the
    paper's network from all of the window. Ours also learns where the joints are (:func:`joint_loss`), and from the
    mirror image of every picture, which counts as a picture.

    Raises:
        InputError: data, postures or weights that cannot be read, a folder that holds another network's run, or a
            network of the paper's that shall lack something.
    """
    check_device(settings.device)
    out = settings.out
    checkpoint = out / "checkpoint.pt"
    if settings.start is not None and settings.start.resolve() in [(out / name).resolve() for name in _WRITTEN]:
        raise InputError(f"--start must not be a file that training writes, got {settings.start}: choose another --out")
    if not checkpoint.exists() and (out / "settings.json").exists():  # of a run that has not begun, or is to begin anew
        for name in (*_WRITTEN, "settings.json"):
            (out / name).unlink(missing_ok=True)
    claim_folder(out, settings, "a run", _FREE)
    torch.manual_seed(settings.seed)
    network = make_network(settings)
    network.to(settings.device).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    if settings.start is not None:
        load_weights(network, settings.start)
    average = AveragedModel(network, multi_avg_fn=get_ema_multi_avg_fn(settings.average), use_buffers=True)
    optimiser = _make_optimiser(network, settings)
    peaks = [group["peak"] for group in optimiser.param_groups]
    done, spent, history = 0, 0.0, []
    if checkpoint.exists():
        state = _read_checkpoint(checkpoint, settings.device)
        try:
            network.load_state_dict(state["network"])
            average.load_state_dict(state["average"])
            optimiser.load_state_dict(state["optimiser"])
        except (RuntimeError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(
                f"{checkpoint} is of another network or optimiser ({str(error).splitlines()[0]}): "
                "use the same settings, or another --out"
            ) from None
        done, spent, history = state["done"], state["spent"], state["history"]

    data = settings.source.train(done)
    valid = settings.source.valid(settings.valid_images)
    loader = torch.utils.data.DataLoader(
        data, batch_sampler=Batches(settings.batch), collate_fn=list, num_workers=settings.workers,
        prefetch_factor=6 if settings.workers else None,
        # Forking after OpenMP has run can hang the child.
        multiprocessing_context="spawn" if settings.workers else None,
        persistent_workers=settings.workers > 0, worker_init_fn=_begin_worker,
    )  # fmt: skip

    if network.learns_background:  # the windows of the paper's network are of one size
        batches = (batch for windows in loader for batch in sorted_batches(windows, settings.batch))
    else:
        batches = training_batches(loader, settings.batch, settings.seed + done, "mirror" not in settings.without)

    def save() -> None:
        nonlocal saved
        saved = time.monotonic()
        parts = {"network": network, "average": average, "optimiser": optimiser}
        state = {name: part.state_dict() for name, part in parts.items()}
        held = io.BytesIO()  # torch tells a full disk as anything
        torch.save({**state, "done": done, "spent": spent, "history": json.dumps(history)}, held)
        write_file(checkpoint, held.getbuffer())

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    running: list[float] = []
    hits: list[float] = []
    saved = time.monotonic()
    with Progress(*columns, console=Terminal()) as progress, _at_interruption(save):
        task = progress.add_task("training", total=1.0)
        progress.update(task, completed=_share(settings, done, spent))
        clock = time.monotonic()
        half = in_bfloat16(settings.bfloat16, settings.device)
        for x, y, places in batches:
            share = _share(settings, done, spent)
            if share >= 1:
                break
            factor = 1.0
            if settings.schedule == "cosine":
                factor = min(1.0, (done + settings.batch) / 3200) * 0.5 * (1 + math.cos(math.pi * share))
            for group, peak in zip(optimiser.param_groups, peaks, strict=True):
                group["lr"] = peak * factor + 1e-6
            network.train()
            x = x.to(settings.device).to(memory_format=torch.channels_last)
            y = y.to(settings.device)
            with torch.autocast(settings.device.split(":")[0], torch.bfloat16, enabled=half):
                known = y != UNLABELLED
                chosen, truth, joints = masked_outputs(
                    network, x, y, known if network.learns_background else known & (x[:, 1] > 0)
                )
            objective = loss = nn.functional.cross_entropy(chosen.float(), truth.long())
            if joints is not None:
                objective = loss + _JOINT_WEIGHT * joint_loss(joints, places.to(settings.device))
            optimiser.zero_grad()
            objective.backward()
            nn.utils.clip_grad_norm_(network.parameters(), 5.0)
            optimiser.step()
            average.update_parameters(network)
            before = done
            done += settings.batch
            spent += time.monotonic() - clock
            clock = time.monotonic()
            running.append(loss.item())
            hits.append((chosen.argmax(1) == truth)[truth > 0].float().mean().item())
            progress.update(task, completed=_share(settings, done, spent),
                            description=f"{done} images  loss {np.mean(running[-50:]):.3f}")  # fmt: skip
            if before // settings.valid_every != done // settings.valid_every:
                accuracy, joint_m = evaluate_windows(cast(Network, average.module), valid, settings.device)
                row = {
                    "step": done, "minutes": spent / 60, "loss": float(np.mean(running)),
                    "train_pixel_accuracy": float(np.mean(hits)),
                    "valid_pixel_accuracy": accuracy.pixel_accuracy, "valid_class_accuracy": accuracy.class_accuracy,
                }  # fmt: skip
                if not math.isnan(joint_m):
                    row["valid_joint_cm"] = joint_m * 100
                running, hits = [], []
                history.append(row)
                progress.console.print({k: round(v, 4) for k, v in row.items()})
                save()
                _write_history(out, history)
            elif time.monotonic() - saved > _SAVE_EVERY_S:
                save()
    save()
    network.load_state_dict(average.module.state_dict())
    if settings.blend:
        assert settings.start is not None
        blend_weights(network, settings.start, settings.blend)
    network.eval()
    # Norms and biases are few and keep their range; kernels take half the space.
    half = {k: v.half() if v.is_floating_point() and v.ndim > 1 else v for k, v in network.cpu().state_dict().items()}
    write_file(out / "classifier.safetensors", serialise({k: v.contiguous() for k, v in half.items()}))
    path = export_onnx(network, out / "classifier.onnx", {"network": settings.network, "images": str(done)})
    if settings.network != "paper":
        quantise(path, [data[i].inputs for i in range(_CALIBRATION)], out / "classifier_int8.onnx")
    return path


def _begin_worker(_: int) -> None:
    """SIGTERM is also how torch ends its processes; one that ends by itself is no failure to it."""
    ignore_signals()
    signal.signal(signal.SIGTERM, lambda *_: os._exit(0))


def check_device(name: str) -> None:
    """See that torch can work on a device, such as "cpu" or "cuda:0".

    Raises:
        InputError: when it has none of that name.
    """
    try:
        found = torch.zeros(1, device=name).device
    except (RuntimeError, AssertionError, NotImplementedError, ValueError, ModuleNotFoundError) as error:
        told = str(error).splitlines()[0] if str(error) else "there is none"
        raise InputError(f"--device {name} cannot be used ({told[:100]}): cpu always can") from None
    if found.type == "meta":
        raise InputError(f"--device {name} holds no numbers: cpu does")


def _read_checkpoint(path: Path, device: str) -> dict[str, Any]:
    """What a run saved: parts, progress and history.

    Raises:
        InputError: when it is damaged, or something else.
    """
    fault = f"{path} is damaged or no checkpoint of a run: remove it to begin anew, or use another --out"
    check_file(path)
    try:
        state = torch.load(path, map_location=device, weights_only=True)
    except Exception:  # torch and pickle raise many types for damaged files
        raise InputError(fault) from None
    if not isinstance(state, dict) or not isinstance(state.get("history"), str):
        raise InputError(fault)
    try:
        done, spent = whole_number(state.get("done"), "done"), number(state.get("spent"), "spent")
        history = parse_json(state["history"], "its history")
    except InputError:
        raise InputError(fault) from None
    if not isinstance(history, list) or min(done, spent) < 0:
        raise InputError(fault)
    return {**state, "done": done, "spent": spent, "history": history}


@contextlib.contextmanager
def _at_interruption(save: Callable[[], None]) -> Iterator[None]:
    """Save when Ctrl-C ends what is within."""
    try:
        yield
    except KeyboardInterrupt:
        with deferred_interrupts():
            save()
        raise


def load_weights(network: nn.Module, path: Path) -> None:
    """Load a .safetensors file into a network; names and shapes must match.

    Raises:
        InputError: when the file is missing, malformed or of another network.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load

    data = read_bytes(path, _LARGEST_WEIGHTS)
    try:
        state = load(data)
        state = {k: v.float() if v.is_floating_point() else v for k, v in state.items()}
        network.load_state_dict(state)
    except (SafetensorError, RuntimeError, ValueError) as error:
        raise InputError(f"{path} does not hold weights of this network: {str(error).splitlines()[0]}") from None


def blend_weights(network: nn.Module, start: Path, share: float) -> None:
    """Move a network's weights by a share of the way to those that it started from.

    Raises:
        InputError: as ``load_weights``.
    """
    before = copy.deepcopy(network)
    load_weights(before, start)
    with torch.no_grad():
        for now, then in zip(network.state_dict().values(), before.state_dict().values(), strict=True):
            if now.is_floating_point():
                now.lerp_(then, share)


def _share(settings: ClassifierTraining, done: int, spent: float) -> float:
    """How much of the run is behind, 0–1: by the clock where a time is set, else by pictures."""
    if settings.minutes > 0:
        return min(1.0, spent / 60 / settings.minutes)
    return min(1.0, done / settings.images)


def _write_history(out: Path, history: list[dict[str, float]]) -> None:
    from depthmocap.report.charts import loss_curves

    write_file(out / "history.jsonl", "".join(json.dumps(row) + "\n" for row in history))
    with contextlib.suppress(InputError):  # a picture is not worth a training run
        write_file(out / "curves.png", loss_curves(history))
