"""Joints by votes of the regions: a small network run by ONNX Runtime; needs no torch."""

from __future__ import annotations

import importlib.resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float32, Float64
from numpy import ndarray

from depthmocap.body.skeleton import JOINTS
from depthmocap.core.onnx_session import open_network
from depthmocap.errors import InputError
from depthmocap.geometry import z_up_from
from depthmocap.pose.cloud import MIN_CLOUD_POINTS, LabelledCloud
from depthmocap.pose.parts import PART_COUNT, body_frame, network_inputs, part_statistics

if TYPE_CHECKING:
    import onnxruntime


class VotesEstimator:
    """Every region that a camera sees, and every joint that it guesses, votes for every joint, in a frame that turns
    with the body; a network tells the votes and their weights from what all cameras see. Any number of cameras,
    anywhere.

    The confidence of a joint is the probability that it is within 10 cm of the truth, as samples kept out of the
    training had it.
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
        """Joints in the world (metres) and their confidence; NaN and 0 where hardly anything was seen.

        Raises:
            InputError: see ``part_statistics``.
        """
        if len(cloud) < MIN_CLOUD_POINTS:
            return np.full((len(JOINTS), 3), np.nan), np.zeros(len(JOINTS))
        parts = part_statistics(cloud, up)
        inputs, seen = network_inputs(parts, frame := body_frame(parts))
        if not seen.any():
            return np.full((len(JOINTS), 3), np.nan), np.zeros(len(JOINTS))
        joints, confidence = run_votes(self._session, inputs[None])
        return frame.to_world(joints[0]) @ z_up_from(up), confidence[0]


def voting_session(source: Path) -> onnxruntime.InferenceSession:
    """A votes.onnx, ready to run.

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
    """Joints in the body's frame and their confidence, from what ``parts.network_inputs`` gives."""
    joints, sure = (np.asarray(each, np.float64) for each in session.run(None, {"parts": inputs}))
    return joints, 1 / (1 + np.exp(-sure))
