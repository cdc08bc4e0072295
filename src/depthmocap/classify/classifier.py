"""Classification: body-part labels of depth images by a trained network, run by ONNX Runtime without torch."""

from __future__ import annotations

import dataclasses
import importlib.resources
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from depthmocap.body.skeleton import JOINTS
from depthmocap.classify.window import WINDOW_MAKERS, Window, WindowMaker
from depthmocap.core.cores import usable_cores
from depthmocap.core.onnx_session import open_network
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry import z_up_from
from depthmocap.kernels.dense_head import label_dense_pixels
from depthmocap.kernels.head import label_groups

#: Names of each network's outputs.
_OUTPUTS = {
    "fast": ["probabilities", "joints"],
    "paper": ["logits"],
}
#: The function that reads the labels from each network's first output.
_READERS = {"fast": label_groups, "paper": label_dense_pixels}


def packaged_weights() -> Path:
    """The 8-bit ONNX file of the packaged network; its weights for training are in the repository, ``weights/``."""
    return Path(str(importlib.resources.files("depthmocap.classify") / "weights" / "fast.onnx"))


class ViewPrediction(NamedTuple):
    """The network's output for a view: regions 0–43 and their probabilities at the masked pixels, 0 elsewhere; and the
    joints' world positions with their expected errors (metres), NaN where it gives none."""

    labels: UInt8[ndarray, "h w"]
    confidence: Float[ndarray, "h w"]
    joints: Float[ndarray, "18 4"]


class WindowPrediction(NamedTuple):
    """The network's output for a window: as of a view, but the joints' positions are in the window
    (``Window.positions_from_world``), with the logarithm of their expected errors."""

    labels: UInt8[ndarray, "h w"]
    confidence: Float[ndarray, "h w"]
    joints: Float[ndarray, "18 4"]


@dataclasses.dataclass(frozen=True, eq=False)
class LabelledMask:
    """The predictions for a view and for its window, and the window; the latter two are None without a person."""

    prediction: ViewPrediction
    window: Window | None
    window_prediction: WindowPrediction | None


def _no_joints() -> Float[ndarray, "18 4"]:
    return np.full((len(JOINTS), 4), np.nan)


class Classifier:
    """A trained body-part classifier: depth in, region and probability of every pixel out (paper, Sec. IV-A).

    Views are labelled in parallel, each by one thread from the depth image to the labels. Threads inside the network
    would wait for each other after every layer.

    Attributes:
        path: of its file.
        network: name of the network in the file, "fast" or "paper".
        predicts_joints: whether it predicts joints besides the labels.
        make_window: makes this network's windows.
    """

    def __init__(self, path: Path | None = None, threads: int | None = None) -> None:
        """Load an ONNX file written by ``depthmocap train classifier``; the packaged one by default.

        Args:
            threads: views labelled at a time; by default as many as the cores that this process may use.

        Raises:
            InputError: when the file is missing or not such a network.
        """
        source = path or packaged_weights()
        self._session = open_network(source, "give the classifier.onnx of a training run")
        names = [node.name for node in self._session.get_inputs()], [node.name for node in self._session.get_outputs()]
        name = self._session.get_modelmeta().custom_metadata_map.get("network")
        if names[0] != ["windows"] or name is None:
            raise InputError(f"{source} is not a depthmocap classifier: its inputs and outputs are {names}")
        if names[1] != _OUTPUTS.get(name):
            known = ", ".join(f"{network!r} with {' and '.join(outputs)}" for network, outputs in _OUTPUTS.items())
            raise InputError(
                f"{source} holds a network {name!r} with {' and '.join(names[1])}, and this version knows {known}: "
                "update depthmocap, or export the classifier anew"
            )
        self.path, self.network, self.predicts_joints = source, name, "joints" in names[1]
        self.make_window: WindowMaker = WINDOW_MAKERS[name]
        self._read = _READERS[name]
        self._pool = ThreadPoolExecutor(threads or usable_cores())

    def label_window(self, window: Window) -> WindowPrediction:
        """The prediction for a window; labels are 0 outside the person."""
        outputs = self._session.run(None, {"windows": window.inputs[None]})
        mask = window.inputs[1] > 0
        labels, confidence = np.zeros(mask.shape, np.uint8), np.zeros(mask.shape, np.float32)
        scores = np.asarray(outputs[0])
        self._read(scores if self._read is label_groups else scores[0], mask, labels, confidence)
        joints = np.asarray(outputs[1], np.float64)[0] if self.predicts_joints else _no_joints()
        return WindowPrediction(labels, confidence, joints)

    def label_mask(self, view: View, mask: Bool[ndarray, "_ _"]) -> LabelledMask:
        """The prediction for a view, without turning the image upright."""
        window = self.make_window(view.depth_m, mask, view.camera)
        if window is None:
            empty = np.zeros(mask.shape, np.uint8), np.zeros(mask.shape, np.float32)
            return LabelledMask(ViewPrediction(*empty, _no_joints()), None, None)
        window_prediction = self.label_window(window)
        labels, confidence = window.labels_to_image(window_prediction.labels, window_prediction.confidence, mask)
        joints = window_prediction.joints
        if self.predicts_joints:
            positions = window.positions_to_world(joints[:, :3], view.camera)
            joints = np.concatenate([positions, np.exp(joints[:, 3:])], 1)
        return LabelledMask(ViewPrediction(labels, confidence, joints), window, window_prediction)

    def label_masks(self, views: Sequence[View], masks: Sequence[Bool[ndarray, "_ _"]]) -> Iterator[LabelledMask]:
        """The predictions for the views, in order, without turning the images upright."""
        pairs = list(zip(views, masks, strict=True))
        return self._pool.map(lambda pair: self.label_mask(*pair), pairs)

    def label_views(
        self, views: Sequence[View], masks: Sequence[Bool[ndarray, "_ _"]], up: str | None = None
    ) -> list[ViewPrediction]:
        """The predictions for the views, in order; labels are 0 and joints NaN without a person.

        Args:
            up: the world's up axis if known. Then images of cameras on their side or upside down are turned upright,
                because the network is trained on upright cameras.
        """
        pairs = list(zip(views, masks, strict=True))
        upright = None if up is None else z_up_from(up)[2]
        return list(self._pool.map(lambda pair: self._label_upright(pair[0], pair[1], upright), pairs))

    def _label_upright(
        self, view: View, mask: Bool[ndarray, "_ _"], up_world: Float[ndarray, "3"] | None
    ) -> ViewPrediction:
        quarters = 0 if up_world is None else view.camera.quarters_upright(up_world)
        if not quarters:
            return self.label_mask(view, mask).prediction
        turned = View(view.camera, view.depth_m, mask).turned(quarters)
        assert turned.mask is not None
        prediction = self.label_mask(turned, turned.mask).prediction
        labels, confidence = (np.ascontiguousarray(np.rot90(image, -quarters)) for image in prediction[:2])
        return ViewPrediction(labels, confidence, prediction.joints)
