"""Joints from votes of the body parts: a small network run by ONNX Runtime, without torch."""

from __future__ import annotations

import importlib.resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float32, Float64
from numpy import ndarray

from depthmocap.body.skeleton import JOINTS, SIDED
from depthmocap.core.onnx_session import open_network
from depthmocap.errors import InputError
from depthmocap.geometry import z_up_from
from depthmocap.pose.cloud import MIN_CLOUD_POINTS, LabelledCloud
from depthmocap.pose.parts import PART_COUNT, body_frame, network_inputs, part_statistics

if TYPE_CHECKING:
    import onnxruntime


class VotesEstimator:
    """Every part that a camera observes votes for the position of every joint, in the body's frame.

    A network computes the votes and their weights from the statistics of all cameras, of which there may be any number,
    anywhere. The confidence of a joint is the probability that its error is below 10 cm, calibrated on samples held out
    of the training.
    """

    def __init__(self, path: Path | None = None) -> None:
        """Load a votes.onnx written by ``depthmocap train pose``; the packaged one by default.

        Raises:
            InputError: when the file is missing or not such a network.
        """
        self._session = voting_session(
            path or Path(str(importlib.resources.files("depthmocap.pose") / "weights" / "votes.onnx"))
        )

    def __call__(self, cloud: LabelledCloud, up: str = "z") -> tuple[Float64[ndarray, "18 3"], Float64[ndarray, "18"]]:
        """Joints in the world (metres) and their confidence; NaN and 0 where hardly anything was observed.

        Raises:
            InputError: as ``part_statistics``.
        """
        if len(cloud) < MIN_CLOUD_POINTS:
            return np.full((len(JOINTS), 3), np.nan), np.zeros(len(JOINTS))
        parts = part_statistics(cloud, up)
        inputs, observed = network_inputs(parts, frame := body_frame(parts))
        if not observed.any():
            return np.full((len(JOINTS), 3), np.nan), np.zeros(len(JOINTS))
        joints, confidence = run_votes(self._session, inputs[None])
        return frame.to_world(joints[0]) @ z_up_from(up), confidence[0] * _sides_known(cloud)


def _sides_known(cloud: LabelledCloud) -> Float64[ndarray, "18"]:
    """Probability of each joint to be on the side that the labels say: joints in the middle are on none."""
    sides = np.ones(len(JOINTS))
    if np.isfinite(cloud.front_log_odds):
        sides[SIDED] = 1 / (1 + np.exp(-cloud.front_log_odds))
    return sides


def voting_session(source: Path) -> onnxruntime.InferenceSession:
    """Open a votes.onnx.

    Raises:
        InputError: when the file is missing or not such a network.
    """
    session = open_network(source, "give the votes.onnx of a training run")
    names = [node.name for node in session.get_inputs()], [node.name for node in session.get_outputs()]
    if names != (["parts"], ["joints", "sure"]):
        raise InputError(f"{source} is not a voting network: its inputs and outputs are {names}")
    shape = session.get_inputs()[0].shape
    if (parts := shape[2] if len(shape) > 2 else 0) != PART_COUNT:
        raise InputError(f"{source} reads {parts} parts, and this version has {PART_COUNT}: train it anew")
    return session


def run_votes(
    session: onnxruntime.InferenceSession, inputs: Float32[ndarray, "n views 61 16"]
) -> tuple[Float64[ndarray, "n 18 3"], Float64[ndarray, "n 18"]]:
    """Joints in the body's frame (metres) and their confidence, from the output of ``parts.network_inputs``."""
    joints, logits = (np.asarray(output, np.float64) for output in session.run(None, {"parts": inputs}))
    return joints, 1 / (1 + np.exp(-logits))
