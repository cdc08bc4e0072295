"""Which way the trunk faces: a second network that tells front from back where the labels took one for the other.

Depth shows the outline of a person from the front and from behind nearly alike, and labels decide pixel by pixel. This
network sees the same window as the classifier and gives a probability to each of ``DIRECTIONS``. From these follow the
odds that the front that the labels imply is the front, and not the back.
"""

from __future__ import annotations

import importlib.resources
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from depthmocap.body.regions import REGION_NAMES
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.classify.window import DEPTH_SCALE_M, Window
from depthmocap.core.onnx_session import open_network
from depthmocap.errors import InputError

#: Number of directions, spread evenly over the sphere.
DIRECTION_COUNT = 64
#: Concentration of the von Mises–Fisher distribution round a front, by which a front is spread over the directions.
CONCENTRATION = 8.0


def _even_directions() -> Float[ndarray, "64 3"]:
    """Points on a spiral of golden angles (Vogel, "A better way to construct the sunflower head", 1979)."""
    number = np.arange(DIRECTION_COUNT) + 0.5
    polar = np.arccos(1 - 2 * number / DIRECTION_COUNT)
    azimuth = np.pi * (1 + np.sqrt(5)) * number
    return np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], 1)


#: Unit vectors in a window: right, down and away from the camera.
DIRECTIONS = _even_directions()
#: Regions on the sides of the trunk, and the arms' beginnings.
_TRUNK = (
    "chest", "belly", "upper back", "lower back", "collar", "shoulder front", "shoulder back", "upper arm",
)  # fmt: skip


def packaged_front() -> Path:
    """The ONNX file of the packaged network; its weights for training are in the repository, ``weights/``."""
    return Path(str(importlib.resources.files("depthmocap.classify") / "weights" / "front.onnx"))


#: Of each region, 1 on the left side of the trunk and its arms' beginnings, -1 on the right one, otherwise 0.
_SIDES = np.array(
    [
        {"L": 1, "R": -1}[name[-1]] if name[:-2] in _TRUNK else 0
        for name in REGION_NAMES
    ],
    np.int8,
)  # fmt: skip
#: A side of the trunk with fewer pixels than this tells nothing.
_FEWEST_ON_A_SIDE = 20


def front_of_labels(
    window: Window, labels: UInt8[ndarray, "h w"], joints: Float[ndarray, "18 3"]
) -> Float[ndarray, "3"]:
    """The front that the labels of a window imply, as a unit vector in the window: at right angles to the line between
    the pixels on the trunk's left and right, and to the spine. NaN where one of them is unknown.

    Args:
        joints: in the window, of which only the spine counts.
    """
    height, width = labels.shape
    sides = _SIDES[labels]
    middles = []
    for side in (1, -1):
        rows, columns = np.nonzero(sides == side)
        if len(rows) < _FEWEST_ON_A_SIDE:
            return np.full(3, np.nan)
        middles.append(
            np.array([
                (columns.mean() + 0.5 - width / 2) * window.pixel_m,
                (rows.mean() + 0.5 - height / 2) * window.pixel_m,
                float(window.inputs[0][rows, columns].mean()) * DEPTH_SCALE_M,
            ])
        )  # fmt: skip
    front = np.cross(middles[0] - middles[1], joints[JOINT_INDEX["Neck"]] - joints[JOINT_INDEX["Hip"]])
    return front / max(float(np.linalg.norm(front)), 1e-9)


def log_odds(scores: Float[ndarray, "64"], front: Float[ndarray, "3"]) -> float:
    """Logarithm of the odds that a trunk's front is ``front`` and not the opposite; NaN for an unknown front.

    Args:
        scores: of ``FrontNetwork``.
        front: unit vector in the window (``Window.positions_from_world``).
    """
    if not np.isfinite(front).all():
        return float("nan")
    near = CONCENTRATION * (DIRECTIONS @ front)
    return float(np.logaddexp.reduce(scores + near) - np.logaddexp.reduce(scores - near))


class FrontNetwork:
    """Scores of the directions in which a person in a window may face: logarithms of probabilities, but for a sum."""

    def __init__(self, path: Path | None = None) -> None:
        """Load a front.onnx written by ``depthmocap train front``; the packaged one by default.

        Raises:
            InputError: when the file is missing or not such a network.
        """
        source = path or packaged_front()
        self._session = open_network(source, "give the front.onnx of a training run")
        names = [node.name for node in self._session.get_inputs()], [node.name for node in self._session.get_outputs()]
        if names != (["windows"], ["directions"]):
            raise InputError(f"{source} does not tell fronts: its inputs and outputs are {names}")

    def __call__(self, window: Window) -> Float[ndarray, "64"]:
        """The scores of ``DIRECTIONS``."""
        (scores,) = self._session.run(None, {"windows": window.inputs[None]})
        return np.asarray(scores, np.float64)[0]
