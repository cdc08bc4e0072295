"""Label depth images with a trained network, through ONNX Runtime; needs no torch."""

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

#: The outputs of each network.
_OUTPUTS = {
    "fast": ["probabilities", "joints"],
    "paper": ["logits"],
}
#: How labels are read from the first of them.
_READERS = {"fast": label_groups, "paper": label_dense_pixels}


def packaged_weights() -> Path:
    """The 8-bit ONNX file of the packaged network; its weights for training are in the repository, ``weights/``."""
    return Path(str(importlib.resources.files("depthmocap.classify") / "weights" / "fast.onnx"))


class Found(NamedTuple):
    """What the network finds in a view: regions 0–43 and their probabilities at the masked pixels, 0 elsewhere; and
    where it takes the joints to be in the world, with the error to expect (metres), NaN where it does not tell."""

    labels: UInt8[ndarray, "h w"]
    confidence: Float[ndarray, "h w"]
    joints: Float[ndarray, "18 4"]


class FoundInWindow(NamedTuple):
    """The same in a window: places of the joints as in ``Window.places_from_world``, and the logarithm of the error."""

    labels: UInt8[ndarray, "h w"]
    confidence: Float[ndarray, "h w"]
    joints: Float[ndarray, "18 4"]


@dataclasses.dataclass(frozen=True, eq=False)
class LabelledMask:
    """What was found in a view, in its window, and the window: None where nobody was."""

    found: Found
    window: Window | None
    in_window: FoundInWindow | None


def _no_joints() -> Float[ndarray, "18 4"]:
    return np.full((len(JOINTS), 4), np.nan)


class Classifier:
    """A trained body-part classifier: depth in, region and probability of every pixel out (paper, Sec. IV-A).

    Views are labelled side by side, each by one thread from the picture to the labels: nothing waits for another view,
    as the threads of a network would after every layer.

    Attributes:
        path: of its file.
        network: its name, "fast" or "paper", which the file tells; windows are made as that network wants
            them.
        tells_joints: whether it tells where the joints are, besides the labels.
        make_window: makes them.
    """

    def __init__(self, path: Path | None = None, threads: int | None = None) -> None:
        """Load an ONNX file written by ``depthmocap train classifier``; the packaged one by default.

        Args:
            threads: views labelled at a time; by default as many as this process may use cores.

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
            known = ", ".join(f"{each!r} with {' and '.join(outputs)}" for each, outputs in _OUTPUTS.items())
            raise InputError(
                f"{source} holds a network {name!r} with {' and '.join(names[1])}, and this version knows {known}: "
                "update depthmocap, or export the classifier anew"
            )
        self.path, self.network, self.tells_joints = source, name, "joints" in names[1]
        self.make_window: WindowMaker = WINDOW_MAKERS[name]
        self._read = _READERS[name]
        self._pool = ThreadPoolExecutor(threads or usable_cores())

    def label_window(self, window: Window) -> FoundInWindow:
        """What is found in a window; labels are 0 where it shows no person."""
        outputs = self._session.run(None, {"windows": window.inputs[None]})
        mask = window.inputs[1] > 0
        labels, confidence = np.zeros(mask.shape, np.uint8), np.zeros(mask.shape, np.float32)
        scores = np.asarray(outputs[0])
        self._read(scores if self._read is label_groups else scores[0], mask, labels, confidence)
        joints = np.asarray(outputs[1], np.float64)[0] if self.tells_joints else _no_joints()
        return FoundInWindow(labels, confidence, joints)

    def label_mask(self, view: View, mask: Bool[ndarray, "_ _"]) -> LabelledMask:
        """What is found in a view as it stands, and the window it comes from."""
        window = self.make_window(view.depth_m, mask, view.camera)
        if window is None:
            nothing = np.zeros(mask.shape, np.uint8), np.zeros(mask.shape, np.float32)
            return LabelledMask(Found(*nothing, _no_joints()), None, None)
        inside = self.label_window(window)
        labels, confidence = window.labels_to_image(inside.labels, inside.confidence, mask)
        joints = inside.joints
        if self.tells_joints:
            places = window.places_to_world(joints[:, :3], view.camera)
            joints = np.concatenate([places, np.exp(joints[:, 3:])], 1)
        return LabelledMask(Found(labels, confidence, joints), window, inside)

    def label_masks(self, views: Sequence[View], masks: Sequence[Bool[ndarray, "_ _"]]) -> Iterator[LabelledMask]:
        """What is found in every view as it stands, in order, and the windows it comes from."""
        pairs = list(zip(views, masks, strict=True))
        return self._pool.map(lambda pair: self.label_mask(*pair), pairs)

    def label_views(
        self, views: Sequence[View], masks: Sequence[Bool[ndarray, "_ _"]], up: str | None = None
    ) -> list[Found]:
        """What is found in every view: labels are 0 and joints NaN where nobody is.

        Args:
            up: the world's up axis. Where it is told, pictures of cameras that hang on their side or upside down are
                turned upright for the network, which learns from people as cameras mostly see them.
        """
        pairs = list(zip(views, masks, strict=True))
        upright = None if up is None else z_up_from(up)[2]
        return list(self._pool.map(lambda pair: self._label_upright(pair[0], pair[1], upright), pairs))

    def _label_upright(self, view: View, mask: Bool[ndarray, "_ _"], up_world: Float[ndarray, "3"] | None) -> Found:
        quarters = 0 if up_world is None else view.camera.quarters_upright(up_world)
        if not quarters:
            return self.label_mask(view, mask).found
        turned = View(view.camera, view.depth_m, mask).turned(quarters)
        assert turned.mask is not None
        found = self.label_mask(turned, turned.mask).found
        labels, confidence = (np.ascontiguousarray(np.rot90(each, -quarters)) for each in found[:2])
        return Found(labels, confidence, found.joints)
