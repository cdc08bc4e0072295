"""Settings of the training of a body-part classifier."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Literal

from depthmocap.classify.window import NetworkName
from depthmocap.core.settings import check_above_0, check_at_least, check_seed
from depthmocap.errors import InputError
from depthmocap.synth.sample import Subset
from depthmocap.train.batches import Ingredient, WindowSource
from depthmocap.train.windows import default_subset

Optimiser = Literal["adamw", "sgd"]


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
        images: number of pictures to train on.
        minutes: stop after this much training instead (the learning rate then follows the clock), 0 for no limit.
        batch: pictures per step.
        optimiser: by default AdamW, and for the paper's network SGD, in which biases learn twice as fast.
        learning_rate: its peak; by default 2e-3 with AdamW, 0.03 with SGD.
        schedule: of the learning rate: it falls to zero along a cosine, or stays.
        weight_decay: by default 0.02 with AdamW, 5e-4 (not of biases) with SGD.
        momentum: of SGD.
        average: what is validated and kept is an average of the weights over about 1 / (1 - this) steps; 0 for the
            last weights.
        start: a .safetensors file to start from.
        blend: share of the weights it started from in the exported ones. It keeps more of what was learnt before, above
            all on pictures unlike those of the training (Wortsman et al., "Robust fine-tuning", CVPR 2022).
        workers: processes that make pictures; 0 makes them between steps.
        valid_every: pictures between two validations.
        bfloat16: multiply in half precision; by default where the device has instructions for it.
        without: ingredients that the training of our network leaves out, to measure their worth (``train ablations``).
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
        return WindowSource(
            self.network, self.data, self.subset or default_subset(self.data), self.postures, self.seed, self.without
        )
