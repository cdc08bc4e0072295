"""What the evaluations of generated sequences have in common."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from depthmocap.core.network_devices import NetworkSettings
from depthmocap.core.output import check_outputs
from depthmocap.core.settings import check_seed
from depthmocap.errors import InputError
from depthmocap.evaluate.evaluation_report import JsonOutput
from depthmocap.synth.sample import Split


@dataclasses.dataclass(frozen=True)
class SequenceSettings(NetworkSettings, JsonOutput):
    """The people, the cameras and the networks of generated sequences.

    Attributes:
        out: folder for the estimates, which are made once: run again, only what comes after them is.
        postures: folder of motion capture clips; without it motion is from posture to posture of the packaged prior.
        split: of the clips.
        sequences: so many, each of another motion and another person.
        views: cameras.
        sensors: each camera is one of these.
        seed: of everything drawn.
        weights: a classifier.onnx of your own.
        estimator: of the joints: votes, ridge (the paper's), or a file that ``train pose`` wrote.
    """

    out: Path
    postures: Path | None = None
    split: Split = "test"
    sequences: int = 8
    views: int = 3
    sensors: tuple[str, ...] = ("kinect2", "azure-nfov-binned")
    seed: int = 0
    weights: Path | None = None
    estimator: str = "votes"

    def __post_init__(self) -> None:
        check_seed(self.seed)
        check_outputs(self.outputs(), {"what --weights names": self.weights})
        if min(self.sequences, self.views) < 1 or not self.sensors:
            raise InputError("--sequences, --views and --sensors take at least 1")

    def outputs(self) -> dict[str, Path | None]:
        """Files to write, by option."""
        return {"--json": self.json}
