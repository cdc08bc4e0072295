"""Train the network by which regions vote for joints (extra: train)."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import json
import math
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float32
from numpy import ndarray
from rich.console import Console
from rich.progress import Progress
from safetensors.torch import save as serialise
from torch import nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from depthmocap.body.regions import REGION_COUNT
from depthmocap.body.skeleton import MIRROR as MIRRORED_JOINTS
from depthmocap.core.output import atomic_write, write_file
from depthmocap.core.settings import check_above_0
from depthmocap.geometry.transforms import rotation_between
from depthmocap.pose.labelled_view import LABELS, Labels
from depthmocap.pose.parts import (
    ARMS,
    CENTRE,
    COVARIANCE,
    LEGS,
    MIRRORED,
    PART_COLUMNS,
    PART_COUNT,
    TO_CAMERA,
    BodyFrame,
    body_frame,
    network_inputs,
    transform_parts,
    yaw_matrix,
)
from depthmocap.pose.ridge import grouped_folds
from depthmocap.train.pose_samples import Collected
from depthmocap.train.precision import in_bfloat16
from depthmocap.train.train_classifier import load_weights
from depthmocap.train.votes_network import VotesNet

#: A joint is right within this (metres), as the paper counts: what the confidence foretells.
RIGHT_M = 0.1
_BATCH = 64
#: What is kept is an average of the weights over about 1 / (1 - this) steps, once so many steps are done.
_AVERAGE, _AVERAGE_AFTER = 0.998, 1000
#: Share of samples that learn from true labels, so that one network serves both.
_TRUE_LABELS = 0.15
#: Share of the others whose cameras tell no joints.
_NO_JOINTS = 0.08
#: Share of samples that are tilted as a whole, cameras and all, on top of what their bodies are.
_TILTED = 0.1
#: Share of samples in which cameras stand a little elsewhere than they say.
_MISPLACED = 0.5
#: Share of a sample's cameras that take the arms, the legs or all of the body for those of the other side, besides
#: those that do; where another camera can tell.
_EXCHANGED = ((ARMS, 0.04), (LEGS, 0.02), (ARMS | True, 0.01))
#: One in so many groups of postures is kept out, to tell how the training goes.
_VALID_FOLDS = 20


@dataclasses.dataclass(frozen=True)
class VotesTraining:
    """How the voting network is trained.

    Attributes:
        minutes: length of the training.
        learning_rate: its peak; it falls to zero along a cosine.
        weight_decay: of AdamW.
        start: a votes.safetensors to start from.
        bfloat16: multiply matrices in half precision; by default where the device has instructions for it.
    """

    minutes: float = 15.0
    learning_rate: float = 1.5e-3
    weight_decay: float = 0.03
    start: Path | None = None
    bfloat16: bool | None = None


def augment(
    rng: np.random.Generator, parts: Float32[ndarray, "n v 61 16"], joints: Float[ndarray, "n 18 3"]
) -> tuple[Float32[ndarray, "n v 61 16"], Float[ndarray, "n 18 3"]]:
    """The same samples mirrored, seen by fewer cameras, by misplaced ones, by such as mistake sides, with regions
    missing. Samples keep at least one camera that sees something."""
    n, views = parts.shape[:2]
    mirror = rng.random(n) < 0.5
    parts, joints = parts.copy(), joints.copy()
    flipped = parts[mirror][:, :, MIRRORED]
    flipped[..., [CENTRE.start + 1, TO_CAMERA.start + 1, COVARIANCE.start + 1, COVARIANCE.start + 4]] *= -1
    parts[mirror] = flipped
    joints[mirror] = joints[mirror][:, MIRRORED_JOINTS] * [1, -1, 1]

    sees = (parts[..., 0] > 0).any(-1)
    order = np.where(sees, rng.random((n, views)), 2).argsort(1)
    keep = 1 + (rng.random(n) * sees.sum(1).clip(1)).astype(np.int64)
    dropped = order.argsort(1) >= keep[:, None]
    # Some classifiers, and true labels, tell no joints.
    parts[rng.random(n) < _NO_JOINTS, :, REGION_COUNT:] = 0
    missing = rng.random(parts.shape[:3]) < rng.choice([0.0, 0.0, 0.05, 0.15], (n, 1, 1))
    parts[dropped[:, :, None] | missing] = 0

    several = (parts[..., 0] > 0).any(-1).sum(1) > 1
    for limb, share in _EXCHANGED:
        exchanged = several[:, None] & (rng.random((n, views)) < share)
        parts = np.where((exchanged[..., None] & limb)[..., None], parts[:, :, MIRRORED], parts)

    off = (rng.random(n) < _MISPLACED)[:, None]
    angle = rng.normal(0, 0.008, (n, views)) * off
    middle = joints.mean(1)
    turn = yaw_matrix(np.cos(angle), np.sin(angle))
    shift = rng.normal(0, 0.012, (n, views, 3)) * off[..., None]
    shift += middle[:, None] - np.einsum("nvij,nj->nvi", turn, middle)
    return transform_parts(parts, turn, shift), joints


def tilted(
    rng: np.random.Generator, parts: Float32[ndarray, "n v 61 16"], joints: Float[ndarray, "n 18 3"]
) -> tuple[Float32[ndarray, "n v 61 16"], Float[ndarray, "n 18 3"]]:
    """The same samples, some of them tilted by any angle to any side: people who lie or stand on their hands are rare,
    and what cameras see of a region is the same however it hangs. Heights stay about what they were."""
    chosen = rng.random(len(parts)) < _TILTED
    n, views = int(chosen.sum()), parts.shape[1]
    side, cosine = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1, 1, n)
    sine = np.sqrt(1 - cosine**2)
    up = np.stack([sine * np.cos(side), sine * np.sin(side), cosine], -1)
    turn = rotation_between(np.broadcast_to([0.0, 0.0, 1.0], (n, 3)), up)
    middle = joints[chosen].mean(1)
    shift = middle - np.einsum("nij,nj->ni", turn, middle)
    parts, joints = parts.copy(), joints.copy()
    parts[chosen] = transform_parts(parts[chosen], turn[:, None].repeat(views, 1), shift[:, None].repeat(views, 1))
    joints[chosen] = joints[chosen] @ np.swapaxes(turn, -1, -2) + shift[:, None]
    return parts, joints


def _shaken(rng: np.random.Generator, frame: BodyFrame) -> BodyFrame:
    """The body's frame, found a little wrong."""
    n = len(frame.origin)
    angle = np.where(rng.random(n) < 0.03, rng.uniform(-np.pi, np.pi, n), rng.normal(0, 0.12, n))
    turn = yaw_matrix(np.cos(angle), np.sin(angle)) @ frame.rotation
    return BodyFrame(frame.origin + rng.normal(0, 0.03, (n, 3)), turn)


def _errors(network: nn.Module, parts: ndarray, joints: ndarray) -> ndarray:
    """(n, 18) errors in metres, nothing augmented."""
    out = []
    with torch.no_grad():
        for i in range(0, len(parts), 512):
            part = parts[i : i + 512]
            frame = body_frame(part)
            found, _ = network(torch.from_numpy(network_inputs(part, frame)[0]))
            out.append(np.linalg.norm(found.numpy() - frame.from_world(joints[i : i + 512]), axis=-1))
    return np.concatenate(out)


def _best(average: AveragedModel, network: VotesNet) -> nn.Module:
    """The averaged network, or the network itself before anything was averaged."""
    return average.module if average.n_averaged > 0 else network


def _usual(parts: ndarray, joints: ndarray) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """What ``VotesNet.start_from`` asks for, of at most 2,000 samples with all their cameras."""
    parts, joints = parts[:2000], joints[:2000]
    frame = body_frame(parts)
    x, seen = network_inputs(parts, frame)
    y = frame.from_world(joints).astype(np.float32)
    views = seen.sum(1)
    centre = np.einsum("nvr,nvrc->nrc", seen.astype(np.float32), x[..., CENTRE]) / np.maximum(views, 1)[..., None]
    offsets = np.where((views > 0)[..., None, None], y[:, None] - centre[:, :, None], np.nan)
    rows = offsets.reshape(len(offsets), -1)
    known = np.isfinite(rows)
    count = np.maximum(known.sum(0), 1)
    mean = np.where(known, rows, 0).sum(0) / count
    variance = np.where(known, (rows - mean) ** 2, 0).sum(0) / count
    # A region that no sample shows gets little weight.
    variance = np.where(known.any(0), variance, 1).reshape(*offsets.shape[1:]).sum(-1)
    mean = mean.reshape(offsets.shape[1:])
    offset, variance, place = (torch.from_numpy(np.asarray(each, np.float32)) for each in (mean, variance, y.mean(0)))
    return offset, variance, place


def train_votes(samples: Collected, settings: VotesTraining, seed: int, out: Path, console: Console) -> Path:
    """Train on collected samples; writes votes.onnx and votes.safetensors and returns the former's path.

    The objective is the mean distance of the joints, and the cross-entropy of the probability of an error within
    ``RIGHT_M``. Ctrl-C ends training early, and what was learnt is written.

    Raises:
        InputError: for samples of fewer than two groups (motion clips), or weights that cannot be read.
    """
    check_above_0({"--minutes": settings.minutes, "--learning-rate": settings.learning_rate})
    torch.manual_seed(seed)
    rng = np.random.default_rng([seed, 11])
    usable: list[Labels] = [k for k in LABELS if samples.parts[k][..., 0].any()]
    sees = np.all([samples.parts[k][..., 0].any((-1, -2)) for k in usable], axis=0)
    held_out = grouped_folds(samples.groups, _VALID_FOLDS) == 0
    train, valid = np.flatnonzero(sees & ~held_out), np.flatnonzero(sees & held_out)
    network = VotesNet()
    if settings.start is None:
        network.start_from(*_usual(samples.parts[usable[0]][train], samples.joints[train]))
    else:
        load_weights(network, settings.start)
    average = AveragedModel(network, multi_avg_fn=get_ema_multi_avg_fn(_AVERAGE))
    optimiser = torch.optim.AdamW(
        network.parameters(), settings.learning_rate, weight_decay=settings.weight_decay, betas=(0.9, 0.98)
    )
    half = in_bfloat16(settings.bfloat16)
    history = []
    start = told = time.monotonic()
    step, running = 0, []
    with Progress(console=console) as progress, _early_end(lambda: step > 0, console):
        task = progress.add_task("votes", total=1.0)
        while (share := (time.monotonic() - start) / 60 / settings.minutes) < 1:
            chosen = rng.choice(train, _BATCH)
            kind = rng.random(_BATCH) < (_TRUE_LABELS if len(usable) > 1 else 0)
            parts = samples.parts[usable[0]][chosen]
            if kind.any():
                parts[kind] = samples.parts[usable[1]][chosen[kind]]
            parts, joints = augment(rng, *tilted(rng, parts, samples.joints[chosen]))
            frame = _shaken(rng, body_frame(parts))
            x, _ = network_inputs(parts, frame)
            y = torch.from_numpy(frame.from_world(joints).astype(np.float32))
            for group in optimiser.param_groups:
                warm = min(1.0, (step + 1) / 200)
                group["lr"] = settings.learning_rate * warm * 0.5 * (1 + math.cos(math.pi * share)) + 1e-6
            with torch.autocast("cpu", torch.bfloat16, enabled=half):
                found, sure = network(torch.from_numpy(x))
            distance = (found - y).norm(dim=-1)
            right = (distance.detach() < RIGHT_M).float()
            loss = distance.mean() + 0.02 * nn.functional.binary_cross_entropy_with_logits(sure.float(), right)
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()
            step += 1
            if step > _AVERAGE_AFTER:
                average.update_parameters(network)
            running.append(distance.mean().item() * 100)
            progress.update(task, completed=share, description=f"{step * _BATCH} samples  {running[-1]:.1f} cm")
            if time.monotonic() - told > max(20, settings.minutes * 3):
                told = time.monotonic()
                row = {"minutes": (told - start) / 60, "samples": step * _BATCH, "train_cm": float(np.mean(running))}
                if len(valid):
                    errors = _errors(_best(average, network), samples.parts[usable[0]][valid], samples.joints[valid])
                    row |= {"valid_cm": float(errors.mean()) * 100, "valid_within_10cm": float((errors < 0.1).mean())}
                running = []
                history.append(row)
                progress.console.print({k: round(v, 3) for k, v in row.items()})
    network = _best(average, network).eval()
    half = {k: v.half() if v.ndim > 1 else v for k, v in network.state_dict().items()}
    write_file(out / "votes.safetensors", serialise({k: v.contiguous() for k, v in half.items()}))
    write_file(out / "votes.jsonl", "".join(json.dumps(row) + "\n" for row in history))
    return export_votes(network, out / "votes.onnx")


@contextlib.contextmanager
def _early_end(begun: Callable[[], bool], console: Console) -> Iterator[None]:
    """Let Ctrl-C end what is within, and nothing else, if it has begun."""
    try:
        yield
    except KeyboardInterrupt:
        if not begun():
            raise
        console.print("stopped: what was learnt until now is written, and --start goes on from it")


def export_votes(network: nn.Module, path: Path) -> Path:
    """Write the network as ONNX: input ``parts`` (n, views, 61, 16), outputs ``joints`` and ``sure``."""
    import onnx

    from depthmocap.train.onnx_export import store_half

    network = copy.deepcopy(network).eval()
    example = torch.zeros(2, 3, PART_COUNT, PART_COLUMNS)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            network, (example,), input_names=["parts"], output_names=["joints", "sure"],
            dynamo=True, verbose=False,
            dynamic_shapes={"parts": {0: torch.export.Dim("n", min=1), 1: torch.export.Dim("views", min=1)}},
        )  # fmt: skip
    assert program is not None
    program.optimize()
    model = program.model_proto
    store_half(model)
    with atomic_write(path) as unfinished:
        onnx.save(model, unfinished)
    return path
