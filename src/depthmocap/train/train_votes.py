"""Train the voting network of the pose stage: body regions vote for joints (extra: train)."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import json
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
from scipy.spatial.transform import Rotation
from torch import nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from depthmocap.body.landmarks import POINT_JOINTS, POINT_MIRROR, POINT_ROWS, POINTS
from depthmocap.body.regions import REGION_COUNT
from depthmocap.body.skeleton import JOINTS
from depthmocap.body.skeleton import MIRROR as MIRRORED_JOINTS
from depthmocap.core.output import atomic_write, write_file
from depthmocap.core.settings import check_above_0
from depthmocap.errors import InputError
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
from depthmocap.train.checkpoints import load_weights, save_weights
from depthmocap.train.distributed import average_gradients, process_count, process_rank, same_everywhere
from depthmocap.train.pose_samples import CollectedSamples
from depthmocap.train.precision import in_bfloat16
from depthmocap.train.training_run import LEAST_RATE, cosine_rate
from depthmocap.train.votes_network import VotesNet

#: A joint within this distance (metres) of the true one is correct, as in the paper; the confidence predicts it.
RIGHT_M = 0.1
#: Samples per step.
_BATCH = 64
#: The exported weights are an exponential average with this decay per step.
_AVERAGE_DECAY = 0.998
#: Averaging starts after this many steps.
_AVERAGE_AFTER = 1000
#: The learning rate rises over this many steps.
_WARM_UP_STEPS = 200
#: Weight of the distance of a joint or point that the network gives no chance to be right; of one that it is sure of 1.
_LEAST_WEIGHT = 0.2
#: Weight of the confidence's cross-entropy against the distance in metres.
_CONFIDENCE_WEIGHT = 0.02
#: Share of samples with true labels, so that one network serves both kinds of labels.
_TRUE_LABELS = 0.15
#: Share of samples without the classifier's joints.
_NO_JOINTS = 0.08
#: Share of samples that are tilted as a whole, cameras included, in addition to the tilt of their postures.
_TILTED = 0.1
#: Standard deviation of the frame's error about each level axis, radians.
_TILT_RAD = 0.08
#: Share of samples with errors of the extrinsics.
_MISPLACED = 0.5
#: Parts and share of a sample's cameras in which left and right of these parts are swapped, in addition to the
#: classifier's own swaps; only where there are several cameras.
_SWAPPED = ((ARMS, 0.04), (LEGS, 0.02), (ARMS | True, 0.01))
#: Weight of the points' mean distance against the joints'.
_POINT_WEIGHT = 0.5
#: What is learnt: joints, then points. ``targets[:, _MIRRORED_TARGETS]`` swaps left and right.
_MIRRORED_TARGETS = np.concatenate([MIRRORED_JOINTS, len(JOINTS) + POINT_MIRROR])
#: One in this many groups of postures is used for validation.
_VALID_FOLDS = 20


@dataclasses.dataclass(frozen=True)
class VotesTraining:
    """How the voting network is trained.

    Attributes:
        minutes: length of the training.
        learning_rate: its peak; it falls to zero along a cosine.
        weight_decay: of AdamW.
        start: a votes.safetensors to start from.
        points_only: joints stay exactly those of ``start``; what tells points from their tokens learns alone.
        bfloat16: multiply matrices in half precision; by default where the device has instructions for it.
    """

    minutes: float = 15.0
    learning_rate: float = 1.5e-3
    weight_decay: float = 0.03
    start: Path | None = None
    points_only: bool = False
    bfloat16: bool | None = None


def augment(
    rng: np.random.Generator, parts: Float32[ndarray, "n v 61 16"], targets: Float[ndarray, "n t 3"]
) -> tuple[Float32[ndarray, "n v 61 16"], Float[ndarray, "n t 3"]]:
    """Augment samples: mirror images, fewer cameras, errors of the extrinsics, swapped sides, missing regions. At least
    one camera that sees something is left in each sample. The targets are the 18 joints, or these and the points."""
    n, views = parts.shape[:2]
    mirror = rng.random(n) < 0.5
    parts, targets = parts.copy(), targets.copy()
    flipped = parts[mirror][:, :, MIRRORED]
    flipped[..., [CENTRE.start + 1, TO_CAMERA.start + 1, COVARIANCE.start + 1, COVARIANCE.start + 4]] *= -1
    parts[mirror] = flipped
    targets[mirror] = targets[mirror][:, _MIRRORED_TARGETS[: targets.shape[1]]] * [1, -1, 1]

    has_view = (parts[..., 0] > 0).any(-1)
    order = np.where(has_view, rng.random((n, views)), 2).argsort(1)
    keep = 1 + (rng.random(n) * has_view.sum(1).clip(1)).astype(np.int64)
    dropped = order.argsort(1) >= keep[:, None]
    # Some classifiers, and true labels, give no joints.
    parts[rng.random(n) < _NO_JOINTS, :, REGION_COUNT:] = 0
    missing = rng.random(parts.shape[:3]) < rng.choice([0.0, 0.0, 0.05, 0.15], (n, 1, 1))
    parts[dropped[:, :, None] | missing] = 0

    several = (parts[..., 0] > 0).any(-1).sum(1) > 1
    for limb, share in _SWAPPED:
        swapped = several[:, None] & (rng.random((n, views)) < share)
        parts = np.where((swapped[..., None] & limb)[..., None], parts[:, :, MIRRORED], parts)

    misplaced = (rng.random(n) < _MISPLACED)[:, None]
    angle = rng.normal(0, 0.008, (n, views)) * misplaced
    middle = targets[:, : len(JOINTS)].mean(1)
    turn = yaw_matrix(np.cos(angle), np.sin(angle))
    shift = rng.normal(0, 0.012, (n, views, 3)) * misplaced[..., None]
    shift += middle[:, None] - np.einsum("nvij,nj->nvi", turn, middle)
    return transform_parts(parts, turn, shift), targets


def tilt(
    rng: np.random.Generator, parts: Float32[ndarray, "n v 61 16"], targets: Float[ndarray, "n t 3"]
) -> tuple[Float32[ndarray, "n v 61 16"], Float[ndarray, "n t 3"]]:
    """Tilt a share of the samples by any angle to any side, since people who lie or stand on their hands are rare in
    recordings. The appearance of a region does not depend on its direction. Heights change little."""
    chosen = rng.random(len(parts)) < _TILTED
    n, views = int(chosen.sum()), parts.shape[1]
    side, cosine = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1, 1, n)
    sine = np.sqrt(1 - cosine**2)
    up = np.stack([sine * np.cos(side), sine * np.sin(side), cosine], -1)
    turn = rotation_between(np.broadcast_to([0.0, 0.0, 1.0], (n, 3)), up)
    middle = targets[chosen, : len(JOINTS)].mean(1)
    shift = middle - np.einsum("nij,nj->ni", turn, middle)
    parts, targets = parts.copy(), targets.copy()
    parts[chosen] = transform_parts(parts[chosen], turn[:, None].repeat(views, 1), shift[:, None].repeat(views, 1))
    targets[chosen] = targets[chosen] @ np.swapaxes(turn, -1, -2) + shift[:, None]
    return parts, targets


def _perturb_frame(rng: np.random.Generator, frame: BodyFrame) -> BodyFrame:
    """The body's frame with random errors of its position, its heading and its lean."""
    n = len(frame.origin)
    angle = np.where(rng.random(n) < 0.03, rng.uniform(-np.pi, np.pi, n), rng.normal(0, 0.12, n))
    tilts = rng.normal(0, _TILT_RAD, (n, 3)) * [1, 1, 0]
    turn = Rotation.from_rotvec(tilts).as_matrix() @ yaw_matrix(np.cos(angle), np.sin(angle)) @ frame.rotation
    return BodyFrame(frame.origin + rng.normal(0, 0.03, (n, 3)), turn)


def _errors(network: nn.Module, parts: ndarray, targets: ndarray) -> ndarray:
    """(n, t) errors in metres, without augmentation."""
    out = []
    with torch.no_grad():
        for i in range(0, len(parts), 512):
            part = parts[i : i + 512]
            frame = body_frame(part)
            estimates, _ = _joined(network(torch.from_numpy(network_inputs(part, frame)[0])))
            out.append(np.linalg.norm(estimates.numpy() - frame.from_world(targets[i : i + 512]), axis=-1))
    return np.concatenate(out)


def _joined(outputs: tuple[torch.Tensor, ...]) -> tuple[torch.Tensor, torch.Tensor]:
    """Positions of joints and points, if the network has these, and the logits of both."""
    return torch.cat(outputs[::2], 1), torch.cat(outputs[1::2], 1)


def _mean_votes(parts: ndarray, joints: ndarray) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The arguments of ``VotesNet.start_from``, from at most 2,000 samples with all their cameras."""
    parts, joints = parts[:2000], joints[:2000]
    frame = body_frame(parts)
    x, visible = network_inputs(parts, frame)
    y = frame.from_world(joints).astype(np.float32)
    views = visible.sum(1)
    centre = np.einsum("nvr,nvrc->nrc", visible.astype(np.float32), x[..., CENTRE]) / np.maximum(views, 1)[..., None]
    offsets = np.where((views > 0)[..., None, None], y[:, None] - centre[:, :, None], np.nan)
    rows = offsets.reshape(len(offsets), -1)
    known = np.isfinite(rows)
    count = np.maximum(known.sum(0), 1)
    mean = np.where(known, rows, 0).sum(0) / count
    variance = np.where(known, (rows - mean) ** 2, 0).sum(0) / count
    # A region that no sample shows gets little weight.
    variance = np.where(known.any(0), variance, 1).reshape(*offsets.shape[1:]).sum(-1)
    mean = mean.reshape(offsets.shape[1:])
    offset, variance, place = (torch.from_numpy(np.asarray(array, np.float32)) for array in (mean, variance, y.mean(0)))
    return offset, variance, place


class _Data:
    """CollectedSamples samples, split by groups of postures into training and validation."""

    def __init__(self, samples: CollectedSamples, seed: int) -> None:
        self._samples = samples
        points = samples.landmarks[:, POINT_ROWS]
        self.points = bool(np.isfinite(points).any())
        self._targets = np.concatenate([samples.joints, points], 1) if self.points else samples.joints
        self._rng = np.random.default_rng([seed, 11, process_rank()] if process_rank() else [seed, 11])
        self._labels: list[Labels] = [k for k in LABELS if samples.parts[k][..., 0].any()]
        complete = np.all([samples.parts[k][..., 0].any((-1, -2)) for k in self._labels], axis=0)
        held_out = grouped_folds(samples.groups, _VALID_FOLDS) == 0
        self.train, self.valid = np.flatnonzero(complete & ~held_out), np.flatnonzero(complete & held_out)

    def rows(self, rows: ndarray) -> tuple[ndarray, ndarray]:
        """Parts of the first kind of labels, and joints with points (NaN where unknown) if any sample has these,
        without augmentation."""
        return self._samples.parts[self._labels[0]][rows], self._targets[rows]

    def usual_points(self) -> torch.Tensor:
        """Mean places of points beside their joints in the body's frame."""
        parts, targets = self.rows(self.train[:2000])
        inside = body_frame(parts).from_world(targets)
        beside = inside[:, len(JOINTS) :] - inside[:, POINT_JOINTS]
        return torch.from_numpy(np.nanmean(beside, 0).astype(np.float32))

    def draw_batch(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Inputs of the network and what it is to tell in the body's frame, of a random augmented batch."""
        rng = self._rng
        rows = rng.choice(self.train, _BATCH)
        use_true = rng.random(_BATCH) < (_TRUE_LABELS if len(self._labels) > 1 else 0)
        parts, targets = self.rows(rows)
        if use_true.any():
            parts[use_true] = self._samples.parts[self._labels[1]][rows[use_true]]
        parts, targets = augment(rng, *tilt(rng, parts, targets))
        frame = _perturb_frame(rng, body_frame(parts))
        inputs, _ = network_inputs(parts, frame)
        return torch.from_numpy(inputs), torch.from_numpy(frame.from_world(targets).astype(np.float32))


def _known_mean(values: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """Mean of the values in the mask; 0 of none."""
    return torch.where(known, values, 0.0).sum() / known.sum().clamp(min=1)


class _Run:
    """The network, its optimiser and the average of its weights."""

    def __init__(self, data: _Data, settings: VotesTraining) -> None:
        self._settings = settings
        self._network = VotesNet(points=data.points)
        complete = False
        if settings.start is None:
            parts, targets = data.rows(data.train)
            self._network.start_from(*_mean_votes(parts, targets[:, : len(JOINTS)]))
        else:
            complete = load_weights(self._network, settings.start, "points.")
        if self._network.points is not None and not complete:
            self._network.points.usual_place.data.copy_(data.usual_points())
        if settings.points_only:
            if self._network.points is None:
                raise InputError("no sample tells points: collect them anew")
            self._network.requires_grad_(False)
            self._network.points.requires_grad_(True)
        self._average = AveragedModel(self._network, multi_avg_fn=get_ema_multi_avg_fn(_AVERAGE_DECAY))
        self._optimiser = torch.optim.AdamW(
            [parameter for parameter in self._network.parameters() if parameter.requires_grad],
            settings.learning_rate,
            weight_decay=settings.weight_decay,
            betas=(0.9, 0.98),
        )
        self._bfloat16 = in_bfloat16(settings.bfloat16)
        self.steps = 0

    def step(self, inputs: torch.Tensor, targets: torch.Tensor, share: float) -> tuple[float, float]:
        """Train on one batch at a share (0–1) of the run; returns the mean distances (cm) of joints and points."""
        factor = cosine_rate(share, (self.steps + 1) / _WARM_UP_STEPS)
        for group in self._optimiser.param_groups:
            group["lr"] = self._settings.learning_rate * factor + LEAST_RATE
        with torch.autocast("cpu", torch.bfloat16, enabled=self._bfloat16):
            estimates, logits = _joined(self._network(inputs))
        known = targets[..., 0].isfinite()
        distance = (estimates - targets.nan_to_num()).norm(dim=-1)
        right = (distance.detach() < RIGHT_M).float()
        doubt = nn.functional.binary_cross_entropy_with_logits(logits.float(), right, reduction="none")
        # Joints that nobody can tell, hidden or cut off, would drown what is to be learnt of the others.
        weights = _LEAST_WEIGHT + (1 - _LEAST_WEIGHT) * logits.detach().float().sigmoid() ** 2
        of_joints, of_points = (
            [_known_mean(values[:, part], known[:, part]) for values in (weights * distance, doubt, distance)]
            for part in (slice(len(JOINTS)), slice(len(JOINTS), None))
        )
        loss, confidence_loss, _ = (a + _POINT_WEIGHT * b for a, b in zip(of_joints, of_points, strict=True))
        loss = loss + _CONFIDENCE_WEIGHT * confidence_loss
        self._optimiser.zero_grad()
        loss.backward()
        average_gradients(self._network)
        nn.utils.clip_grad_norm_(self._network.parameters(), 1.0)
        self._optimiser.step()
        self.steps += 1
        if self.steps > _AVERAGE_AFTER:
            self._average.update_parameters(self._network)
        return of_joints[2].item() * 100, of_points[2].item() * 100

    def best(self) -> VotesNet:
        """The averaged network; the network itself before averaging starts."""
        averaged = self._average.module
        assert isinstance(averaged, VotesNet)
        return averaged if self._average.n_averaged > 0 else self._network


def train_votes(samples: CollectedSamples, settings: VotesTraining, seed: int, out: Path, console: Console) -> Path:
    """Train on collected samples; writes votes.onnx and votes.safetensors and returns the former's path.

    The objective is the mean distance of the joints, and the cross-entropy of the probability of an error within
    ``RIGHT_M``. Ctrl-C ends the training early, and the network so far is written, by the first of several processes.

    Raises:
        InputError: for samples of fewer than two groups (motion clips), or weights that cannot be read.
    """
    check_above_0({"--minutes": settings.minutes, "--learning-rate": settings.learning_rate})
    torch.manual_seed(seed)
    data = _Data(samples, seed)
    run = _Run(data, settings)
    history, distances = [], []
    start = reported = time.monotonic()
    with Progress(console=console) as progress, _early_end(lambda: run.steps > 0, console):
        task = progress.add_task("votes", total=1.0)
        while (share := same_everywhere((time.monotonic() - start) / 60 / settings.minutes)) < 1:
            distances.append(run.step(*data.draw_batch(), share))
            count = run.steps * _BATCH * process_count()
            progress.update(task, completed=share, description=f"{count} samples  {distances[-1][0]:.1f} cm")
            if time.monotonic() - reported > max(20, settings.minutes * 3):
                reported = time.monotonic()
                row = {
                    "minutes": (reported - start) / 60,
                    "samples": count,
                    "train_cm": float(np.mean(distances, 0)[0]),
                }
                if data.points:
                    row["train_points_cm"] = float(np.mean(distances, 0)[1])
                if len(data.valid):
                    errors = _errors(run.best(), *data.rows(data.valid))
                    of_joints, of_points = errors[:, : len(JOINTS)], errors[:, len(JOINTS) :]
                    row |= {"valid_cm": 100 * float(of_joints.mean())}
                    row |= {"valid_within_10cm": float((of_joints < RIGHT_M).mean())}
                    if np.isfinite(of_points).any():
                        row["valid_points_cm"] = 100 * float(np.nanmean(of_points))
                distances = []
                history.append(row)
                progress.console.print({k: round(v, 3) for k, v in row.items()})
    network = run.best().eval()
    if process_rank() > 0:
        return out / "votes.onnx"
    save_weights(network, out / "votes.safetensors")
    write_file(out / "votes.jsonl", "".join(json.dumps(row) + "\n" for row in history))
    return export_votes(network, out / "votes.onnx")


@contextlib.contextmanager
def _early_end(begun: Callable[[], bool], console: Console) -> Iterator[None]:
    """Let Ctrl-C end the block only, once training has begun."""
    try:
        yield
    except KeyboardInterrupt:
        if not begun():
            raise
        console.print("stopped: what was learnt until now is written, and --start goes on from it")


def export_votes(network: VotesNet, path: Path) -> Path:
    """Write the network as ONNX: input ``parts`` (n, views, 61, 16), outputs ``joints`` and ``sure``, and of a network
    with points ``points`` and ``points_sure``, whose names are in the metadata, separated by spaces."""
    import onnx
    from onnx import helper

    from depthmocap.train.onnx_export import store_half

    network = copy.deepcopy(network).eval()
    outputs = ["joints", "sure"]
    if network.points is not None:
        outputs += ["points", "points_sure"]
    example = torch.zeros(2, 3, PART_COUNT, PART_COLUMNS)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            network, (example,), input_names=["parts"], output_names=outputs,
            dynamo=True, verbose=False,
            dynamic_shapes={"parts": {0: torch.export.Dim("n", min=1), 1: torch.export.Dim("views", min=1)}},
        )  # fmt: skip
    assert program is not None
    program.optimize()
    model = program.model_proto
    store_half(model)
    if network.points is not None:
        helper.set_model_props(model, {"points": " ".join(POINTS)})
    with atomic_write(path) as unfinished:
        onnx.save(model, unfinished)
    return path
