"""Joints from votes of the body parts: a small network run by ONNX Runtime, without torch."""

from __future__ import annotations

import importlib.resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float32, Float64
from numpy import ndarray

from depthmocap.body.landmarks import POINT_MIRROR, POINTS
from depthmocap.body.skeleton import JOINTS, SIDED
from depthmocap.core.onnx_session import open_network
from depthmocap.errors import InputError
from depthmocap.geometry import z_up_from
from depthmocap.pose.cloud import MIN_CLOUD_POINTS, LabelledCloud
from depthmocap.pose.parts import PART_COUNT, body_frame, network_inputs, observed_parts, part_statistics

if TYPE_CHECKING:
    import onnxruntime

#: Of joints and points, those of a side; what is in the middle is on none.
_SIDED = np.concatenate([SIDED, np.arange(len(POINTS)) != POINT_MIRROR])


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
        names = self._session.get_modelmeta().custom_metadata_map.get("points", "").split()
        #: Of each point that the network tells, its row in ``POINTS``, and in the network's output.
        self._columns = {POINTS.index(name): i for i, name in enumerate(names) if name in POINTS}

    def __call__(self, cloud: LabelledCloud, up: str = "z") -> tuple[Float64[ndarray, "18 3"], Float64[ndarray, "18"]]:
        """Joints in the world (metres) and their confidence; NaN and 0 where hardly anything was observed.

        Raises:
            InputError: as ``part_statistics``.
        """
        joints, confidence, *_ = self.with_points(cloud, up)
        return joints, confidence

    @property
    def has_points(self) -> bool:
        """Whether the network tells points of the skin beside the joints."""
        return bool(self._columns)

    def with_points(
        self, cloud: LabelledCloud, up: str = "z"
    ) -> tuple[Float64[ndarray, "18 3"], Float64[ndarray, "18"], Float64[ndarray, "18 3"], Float64[ndarray, "18"]]:
        """Joints and their confidence, and the same of the skin's ``body.landmarks.POINTS``; NaN and 0 of those that
        the network does not tell.

        Raises:
            InputError: as ``part_statistics``.
        """
        places, sure = np.full((len(JOINTS) + len(POINTS), 3), np.nan), np.zeros(len(JOINTS) + len(POINTS))
        if len(cloud) >= MIN_CLOUD_POINTS:
            parts = part_statistics(cloud, up)
            # Cameras that see nothing of the person take time, and change nothing.
            parts = parts[observed_parts(parts).any(1)]
            inputs, observed = network_inputs(parts, frame := body_frame(parts))
            if observed.any():
                (joints, told), logits = _run(self._session, inputs[None])
                known = np.r_[np.arange(len(JOINTS)), len(JOINTS) + np.array(list(self._columns), int)]
                columns = list(self._columns.values())
                places[known] = frame.to_world(np.concatenate([joints[0], told[0, columns]])) @ z_up_from(up)
                sure[known] = _probability(np.concatenate([logits[0][0], logits[1][0, columns]]))
                sure[_SIDED] *= _side_known(cloud)
        count = len(JOINTS)
        return places[:count], sure[:count], places[count:], sure[count:]


def _side_known(cloud: LabelledCloud) -> float:
    """Probability of left and right to be as the labels say."""
    return float(1 / (1 + np.exp(-cloud.front_log_odds))) if np.isfinite(cloud.front_log_odds) else 1.0


def _probability(logits: Float64[ndarray, "..."]) -> Float64[ndarray, "..."]:
    return 1 / (1 + np.exp(-logits))


def voting_session(source: Path) -> onnxruntime.InferenceSession:
    """Open a votes.onnx.

    Raises:
        InputError: when the file is missing or not such a network.
    """
    session = open_network(source, "give the votes.onnx of a training run")
    names = [node.name for node in session.get_inputs()], [node.name for node in session.get_outputs()]
    outputs = ["joints", "sure", "points", "points_sure"]
    if names[0] != ["parts"] or names[1] not in (outputs[:2], outputs):
        raise InputError(f"{source} is not a voting network: its inputs and outputs are {names}")
    shape = session.get_inputs()[0].shape
    if (parts := shape[2] if len(shape) > 2 else 0) != PART_COUNT:
        raise InputError(f"{source} reads {parts} parts, and this version has {PART_COUNT}: train it anew")
    return session


def run_votes(
    session: onnxruntime.InferenceSession, inputs: Float32[ndarray, "n views 61 16"]
) -> tuple[Float64[ndarray, "n 18 3"], Float64[ndarray, "n 18"]]:
    """Joints in the body's frame (metres) and their confidence, from the output of ``parts.network_inputs``."""
    (joints, _), (logits, _) = _run(session, inputs)
    return joints, _probability(logits)


_Pair = tuple[Float64[ndarray, "n ..."], Float64[ndarray, "n ..."]]


def _run(session: onnxruntime.InferenceSession, inputs: Float32[ndarray, "n views 61 16"]) -> tuple[_Pair, _Pair]:
    """Positions of joints and points, and the logits of both; a network that tells no points has none of these."""
    outputs = [np.asarray(output, np.float64) for output in session.run(None, {"parts": inputs})]
    if len(outputs) == 2:
        outputs += [outputs[0][:, :0], outputs[1][:, :0]]
    joints, logits, points, point_logits = outputs
    return (joints, points), (logits, point_logits)
