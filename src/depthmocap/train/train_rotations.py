"""``depthmocap train rotations``: the network that tells the rotations of bones from joints."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from rich.console import Console
from rich.progress import Progress

from depthmocap.body.skeleton import BONES, JOINT_INDEX, MIRROR
from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.output import atomic_write
from depthmocap.core.settings import check_above_0, check_seed
from depthmocap.errors import InputError, missing_extra
from depthmocap.exporting.learnt_rotations import LOOKED_BACK_S, rotation_features, trunk_axes
from depthmocap.synth.body.mesh import Body, BodyModel, Phenotype
from depthmocap.synth.motion.mocap import SPLITS, Clip, ClipFolder
from depthmocap.synth.motion.postures import anny_rest
from depthmocap.synth.motion.true_rotations import true_motion

#: Clips have so many frames a second.
_FPS = 30.0
_BACK = tuple(round(_FPS * back_s) for back_s in LOOKED_BACK_S)
#: A joint does not move further between frames (m): where it does, frames are missing.
_LARGEST_STEP_M = 0.3
#: Passes until clips are performed by other bodies; noise is new in every one.
_PASSES = 4
#: Share of samples that know no past, as at the start of a take.
_STARTS = 0.05
_ENDS = np.array([[JOINT_INDEX[name] for name in bone] for bone in BONES])
_FLIP = np.array([-1.0, 1.0, 1.0])


@dataclasses.dataclass(frozen=True)
class RotationTraining:
    """Learn bones' rotations from the joints of motion capture clips, on bodies of many builds.

    Attributes:
        postures: folders of motion capture clips.
        out: the .npz file to write; the best on the validation clips.
        epochs: passes over the training clips.
        bodies: of random builds; another of them performs each clip every few passes.
        hidden: width of the two hidden layers.
        noise_m: joints are off by up to about so much (standard deviation), a half of it for as long as is looked at.
        learning_rate: its peak.
    """

    postures: tuple[Path, ...]
    out: Path
    epochs: int = 60
    bodies: int = 24
    hidden: int = 256
    noise_m: float = 0.012
    learning_rate: float = 2e-3
    seed: int = 0

    def __post_init__(self) -> None:
        check_seed(self.seed)
        check_above_0({"--noise-m": self.noise_m, "--learning-rate": self.learning_rate})
        if self.out.suffix != ".npz":
            raise InputError(f"--out must be a file that ends in .npz, got {self.out}")
        if not self.postures or min(self.epochs, self.bodies, self.hidden) < 1:
            raise InputError("--postures, --epochs, --bodies and --hidden take at least 1")


@dataclasses.dataclass(frozen=True, eq=False)
class _Motions:
    """All frames of some clips: joints, rotations, and where each frame's clip starts."""

    joints: Float[ndarray, "n 18 3"]
    rotations: Float[ndarray, "n 18 3 3"]
    first: Int[ndarray, " n"]


@locks_outputs(files=("out",))
def train_rotations(settings: RotationTraining, console: Console | None = None) -> Path:
    """Train and write the network; tells the mean error on clips of the validation split.

    Raises:
        InputError: no readable clips, or none of a split.
    """
    try:
        import torch
    except ModuleNotFoundError:
        raise missing_extra("torch", "train") from None
    console = console or Terminal(stderr=True)
    rng = np.random.default_rng(settings.seed)
    torch.manual_seed(settings.seed)
    clips = _read(settings.postures)
    model = BodyModel.load()
    bodies = [model.shape(_random_build(rng)) for _ in range(settings.bodies)]
    valid_x, valid_y = _samples(_performed(clips["valid"], bodies, rng), settings.noise_m, rng)
    x, _ = _samples(_performed(clips["train"], bodies, rng), settings.noise_m, rng)
    mean, scale = x.mean(0), x.std(0) + 1e-3
    network = torch.nn.Sequential(
        torch.nn.Linear(x.shape[1], settings.hidden), torch.nn.ReLU(),
        torch.nn.Linear(settings.hidden, settings.hidden), torch.nn.ReLU(),
        torch.nn.Linear(settings.hidden, valid_y.shape[1]),
    )  # fmt: skip
    optimiser = torch.optim.AdamW(network.parameters(), lr=settings.learning_rate, weight_decay=1e-4)
    batch = 1024
    steps = settings.epochs * max(1, len(x) // batch)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, settings.learning_rate, total_steps=steps + 1)
    best, motions = np.inf, []
    test_x = torch.from_numpy(((valid_x - mean) / scale).astype(np.float32))
    test_y = torch.from_numpy(valid_y.astype(np.float32))
    with Progress(console=console) as progress:
        for epoch in progress.track(range(settings.epochs), description="training"):
            if epoch % _PASSES == 0:
                motions = _performed(clips["train"], bodies, rng)
            x, y = _samples(motions, settings.noise_m, rng)
            inputs = torch.from_numpy(((x - mean) / scale).astype(np.float32))
            targets = torch.from_numpy(y.astype(np.float32))
            order = torch.randperm(len(inputs))[: max(1, len(inputs) // batch) * batch]
            for rows in order.split(batch):
                loss = _loss(network(inputs[rows]), targets[rows])
                optimiser.zero_grad()
                loss.backward()
                optimiser.step()
                schedule.step()
            with torch.no_grad():
                error = float(_loss(network(test_x), test_y))
            if error < best:
                best = error
                _save(settings.out, network, mean, scale)
            if epoch % 10 == 9 or epoch + 1 == settings.epochs:
                progress.console.print(f"pass {epoch + 1}: validation {error:.4f}, best {best:.4f}")
    return settings.out


def _loss(estimate: Any, wanted: Any) -> Any:
    """Of tensors (n, 162): the distance of bones' matrices, about their angle (radians); not squared, for outliers."""
    off = (estimate - wanted).reshape(len(estimate), -1, 9)
    distance = (off.nan_to_num() ** 2).sum(-1) / 2  # an unknown truth is no error
    return (distance + 1e-4).sqrt().mean()


def _read(folders: tuple[Path, ...]) -> dict[str, list[Float[ndarray, "n 20 3"]]]:
    """Postures of the clips of each split, cut where frames are missing."""
    clips: dict[str, list[ndarray]] = {split: [] for split in SPLITS}
    rest = anny_rest()
    for folder in folders:
        for clip in ClipFolder.open(folder).read(rest):
            if isinstance(clip, Clip) and len(clip.postures) > max(_BACK):
                clips[clip.split].append(clip.postures)
    for split in ("train", "valid"):
        if not clips[split]:
            raise InputError(f"{', '.join(map(str, folders))}: no readable clip is of the {split} split")
    return clips


def _random_build(rng: np.random.Generator) -> Phenotype:
    return Phenotype(*rng.uniform([0.0, 0.45, 0.2, 0.2, 0.1, 0.1], [1.0, 1.0, 0.9, 0.9, 0.9, 0.9]).tolist())


def _performed(clips: list[Float[ndarray, "n 20 3"]], bodies: list[Body], rng: np.random.Generator) -> list[_Motions]:
    """Every clip by a random body, or its mirror image."""
    motions = []
    for postures in clips:
        motion = true_motion(bodies[int(rng.integers(len(bodies)))], postures)
        joints, rotations = motion.joints, motion.rotations
        if rng.random() < 0.5:
            joints = joints[:, MIRROR] * _FLIP
            rotations = rotations[:, MIRROR] * _FLIP[:, None] * _FLIP
        gaps = np.linalg.norm(np.diff(joints, axis=0), axis=-1).max(1) > _LARGEST_STEP_M
        index = np.arange(len(joints))
        first = np.maximum.accumulate(np.where(np.r_[True, gaps], index, 0))
        motions.append(_Motions(joints, rotations, first))
    return motions


def _samples(
    motions: list[_Motions], noise_m: float, rng: np.random.Generator
) -> tuple[Float[ndarray, "n f"], Float[ndarray, "n o"]]:
    """Features of joints with noise, and rotation matrices in the axes that the noisy trunk has."""
    features, targets = [], []
    for motion in motions:
        count = len(motion.joints)
        index = np.arange(count)
        window = np.stack([motion.joints[np.maximum(index - back, motion.first)] for back in _BACK])
        level = noise_m * rng.uniform(0, 1, (count, 1, 1))
        window = window + level * 0.75**0.5 * rng.normal(size=(count, 18, 3))
        window = window + 0.5 * level * rng.normal(size=window.shape)
        starts = rng.random(count) < _STARTS
        window[:, starts] = window[0, starts]
        axes = trunk_axes(window[0])
        size_m = np.linalg.norm(motion.joints[0, _ENDS[:, 1]] - motion.joints[0, _ENDS[:, 0]], axis=-1).sum()
        features.append(rotation_features(window, axes, float(size_m * rng.normal(1, 0.01))).astype(np.float32))
        inside = np.swapaxes(axes, -1, -2)[:, None] @ motion.rotations
        targets.append(inside.reshape(count, -1).astype(np.float32))
    return np.concatenate(features), np.concatenate(targets)


def _save(path: Path, network: Any, mean: ndarray, scale: ndarray) -> None:
    """Half precision: a ten-thousandth of a turn is nothing here."""
    arrays: dict[str, Any] = {"mean": mean.astype(np.float32), "scale": scale.astype(np.float32)}
    layers = [layer for layer in network if hasattr(layer, "weight")]
    for i, layer in enumerate(layers):
        arrays[f"weight{i}"] = layer.weight.detach().numpy().astype(np.float16)
        arrays[f"bias{i}"] = layer.bias.detach().numpy().astype(np.float16)
    with atomic_write(path) as unfinished:
        np.savez_compressed(unfinished, **arrays)
