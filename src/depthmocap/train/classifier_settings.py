"""Settings of the training of a body-part classifier."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Literal

from depthmocap.classify.window import NetworkName
from depthmocap.core.settings import check_above_0, check_at_least
from depthmocap.errors import InputError
from depthmocap.synth.sample import Subset
from depthmocap.train.batches import Ingredient, WindowSource
from depthmocap.train.training_run import TrainingRunSettings, check_share
from depthmocap.train.windows import default_subset

Optimiser = Literal["adamw", "sgd"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class ClassifierTraining(TrainingRunSettings):
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
        optimiser: by default AdamW, and for the paper's network SGD, in which biases learn twice as fast.
        learning_rate: its peak; by default 2e-3 with AdamW, 0.03 with SGD.
        weight_decay: by default 0.02 with AdamW, 5e-4 (not of biases) with SGD.
        momentum: of SGD.
        blend: share of the weights it started from in the exported ones. It keeps more of what was learnt before, above
            all on pictures unlike those of the training (Wortsman et al., "Robust fine-tuning", CVPR 2022).
        bfloat16: multiply in half precision; by default where the device has instructions for it.
        leaning: share of people whose trunk leans, nearly all of whom are turned upright: for the network that sees
            them again. By default postures come as they are.
        without: ingredients that the training of our network leaves out, to measure their worth (``train ablations``).
    """

    data: str = "synth"
    postures: Path | None = None
    subset: Subset | None = None
    network: NetworkName = "fast"
    optimiser: Optimiser | None = None
    learning_rate: float | None = None
    weight_decay: float | None = None
    momentum: float = 0.9
    blend: float = 0.0
    valid_images: int = 320
    bfloat16: bool | None = None
    leaning: float = 0.0
    without: tuple[Ingredient, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        check_at_least(1, {"--valid-images": self.valid_images})
        check_at_least(0, {"--weight-decay": self.weight_decay})
        check_above_0({"--learning-rate": self.learning_rate})
        check_share({"--momentum": self.momentum, "--blend": self.blend, "--leaning": self.leaning})
        if self.leaning and (self.network == "paper" or self.data != "synth"):
            raise InputError("--leaning is for our network on pictures made on the fly")
        if self.blend and self.start is None:
            raise InputError(f"--blend asks for a --start, got {self.blend} without one")

    @property
    def source(self) -> WindowSource:
        """Where its windows come from."""
        subset = self.subset or default_subset(self.data)
        return WindowSource(
            self.network, self.data, subset, self.postures, self.seed, self.without, leaning=self.leaning
        )
