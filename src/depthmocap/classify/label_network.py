"""A trained body-part network: from windows to the labels of their pixels, run by ONNX Runtime without torch."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from depthmocap.body.skeleton import JOINTS
from depthmocap.classify.window import WINDOW_MAKERS, Window, WindowMaker
from depthmocap.core.onnx_session import open_network
from depthmocap.errors import InputError
from depthmocap.kernels.dense_head import label_dense_pixels
from depthmocap.kernels.head import label_groups

#: Names of each network's outputs.
_OUTPUTS = {
    "fast": ["probabilities", "joints"],
    "paper": ["logits"],
}
#: The function that reads the labels from each network's first output.
_READERS = {"fast": label_groups, "paper": label_dense_pixels}


class WindowPrediction(NamedTuple):
    """The prediction for a window: as of a view, but the joints' positions are in the window
    (``Window.positions_from_world``), with the logarithm of their expected errors."""

    labels: UInt8[ndarray, "h w"]
    confidence: Float[ndarray, "h w"]
    joints: Float[ndarray, "18 4"]
    front_log_odds: float = float("nan")

    @property
    def mean_probability(self) -> float:
        """Of the labels; 0 without any."""
        return float(self.confidence.sum()) / max(int(np.count_nonzero(self.labels)), 1)


def no_joints() -> Float[ndarray, "18 4"]:
    """Joints that nothing is known of."""
    return np.full((len(JOINTS), 4), np.nan)


class LabelNetwork:
    """A network that labels windows.

    Attributes:
        path: of its file.
        name: of the network in the file, "fast" or "paper".
        predicts_joints: whether it predicts joints besides the labels.
        make_window: makes its windows.
    """

    def __init__(self, path: Path) -> None:
        """Load an ONNX file written by ``depthmocap train classifier``.

        Raises:
            InputError: when the file is missing or not such a network.
        """
        self._session = open_network(path, "give the classifier.onnx of a training run")
        names = [node.name for node in self._session.get_inputs()], [node.name for node in self._session.get_outputs()]
        name = self._session.get_modelmeta().custom_metadata_map.get("network")
        if names[0] != ["windows"] or name is None:
            raise InputError(f"{path} is not a depthmocap classifier: its inputs and outputs are {names}")
        if names[1] != _OUTPUTS.get(name):
            known = ", ".join(f"{network!r} with {' and '.join(outputs)}" for network, outputs in _OUTPUTS.items())
            raise InputError(
                f"{path} holds a network {name!r} with {' and '.join(names[1])}, and this version knows {known}: "
                "update depthmocap, or export the classifier anew"
            )
        self.path, self.name, self.predicts_joints = path, name, "joints" in names[1]
        self.make_window: WindowMaker = WINDOW_MAKERS[name]
        self._read = _READERS[name]

    def __call__(self, windows: Sequence[Window]) -> list[WindowPrediction]:
        """The predictions for windows of one size by one run of the network, each as if it were alone."""
        inputs = windows[0].inputs[None] if len(windows) == 1 else np.stack([window.inputs for window in windows])
        outputs = [np.asarray(output) for output in self._session.run(None, {"windows": inputs})]
        predictions, first = [], 0
        for i, window in enumerate(windows):
            mask = window.inputs[1] > 0
            labels, confidence = np.zeros(mask.shape, np.uint8), np.zeros(mask.shape, np.float32)
            if self._read is label_groups:  # which has the groups of one window after those of the other
                first += self._read(outputs[0][first:], mask, labels, confidence)
            else:
                self._read(outputs[0][i], mask, labels, confidence)
            joints = outputs[1][i].astype(np.float64) if self.predicts_joints else no_joints()
            predictions.append(WindowPrediction(labels, confidence, joints))
        return predictions
