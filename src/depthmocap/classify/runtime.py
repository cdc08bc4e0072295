"""Label depth images with a trained network, through ONNX Runtime; needs no torch."""

from __future__ import annotations

import dataclasses
import importlib.resources
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from depthmocap.classify.preprocess import WINDOW_MAKERS, Window, WindowMaker
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.kernels.dense_head import label_dense_pixels
from depthmocap.kernels.head import label_pixels

#: How labels are read from each network's output.
_READERS = {"fast": label_pixels, "paper": label_dense_pixels}


@dataclasses.dataclass(frozen=True, eq=False)
class LabelledMask:
    """Regions 0–43 and their probabilities at a view's masked pixels, 0 elsewhere; the window (None where nobody was
    found) and its own labels and probabilities."""

    labels: UInt8[ndarray, "h w"]
    confidence: Float[ndarray, "h w"]
    window: Window | None
    window_labels: UInt8[ndarray, "_ _"]
    window_confidence: Float[ndarray, "_ _"]


class Classifier:
    """A trained body-part classifier: depth in, region and probability of every pixel out (paper, Sec. IV-A).

    Attributes:
        path: of its file.
        network: its name, "fast" or "paper", which the file tells; windows are made as that network wants them.
        make_window: makes them.
    """

    def __init__(self, path: Path | None = None, threads: int | None = None) -> None:
        """Load an ONNX file written by ``depthmocap train classifier``; the packaged one by default.

        Args:
            threads: of the network; by default as many as this process may use.

        Raises:
            InputError: when the file is missing or not such a network.
        """
        import onnxruntime

        options = onnxruntime.SessionOptions()
        # Zero lets the runtime choose, one thread a physical core.
        options.intra_op_num_threads = threads or 0
        options.log_severity_level = 3
        source = path or Path(str(importlib.resources.files("depthmocap.classify") / "weights" / "fast.onnx"))
        if not source.is_file():
            raise InputError(f"{source} not found: give the classifier.onnx of a training run")
        try:
            self._session = onnxruntime.InferenceSession(str(source), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # the runtime's errors share no public base class
            raise InputError(f"{source} is not a readable ONNX network: {str(error).splitlines()[0]}") from None
        names = [node.name for node in self._session.get_inputs()], [node.name for node in self._session.get_outputs()]
        if names != (["windows"], ["logits"]):
            raise InputError(f"{source} is not a depthmocap classifier: its inputs and outputs are {names}")
        name = self._session.get_modelmeta().custom_metadata_map.get("network", "fast")
        if name not in WINDOW_MAKERS:
            raise InputError(
                f"{source} holds a network {name!r}, and this version knows {', '.join(WINDOW_MAKERS)}: "
                "update depthmocap, or train the classifier anew"
            )
        self.path, self.network = source, name
        self.make_window: WindowMaker = WINDOW_MAKERS[name]
        self._read = _READERS[name]

    def label_windows(self, windows: Sequence[Window]) -> list[tuple[UInt8[ndarray, "s s"], Float[ndarray, "s s"]]]:
        """Labels and confidences of windows, 0 where a window has no person, all views in one call."""
        if not windows:
            return []
        logits = self._session.run(None, {"windows": np.stack([window.inputs for window in windows])})[0]
        results = []
        for window, output in zip(windows, np.asarray(logits), strict=True):
            mask = window.inputs[1] > 0
            labels, confidence = np.zeros(mask.shape, np.uint8), np.zeros(mask.shape, np.float32)
            self._read(output, mask, labels, confidence)
            results.append((labels, confidence))
        return results

    def label_masks(self, views: Sequence[View], masks: Sequence[Bool[ndarray, "_ _"]]) -> Iterator[LabelledMask]:
        """Labels of every masked pixel of every view, in order, and the windows they come from; one network call."""
        windows = [self.make_window(view.depth_m, mask, view.camera) for view, mask in zip(views, masks, strict=True)]
        found = iter(self.label_windows([window for window in windows if window is not None]))
        for window, mask in zip(windows, masks, strict=True):
            if window is None:
                labels, confidence = np.zeros(mask.shape, np.uint8), np.zeros(mask.shape, np.float32)
                yield LabelledMask(labels, confidence, None, labels[:0], confidence[:0])
            else:
                labels, confidence = next(found)
                yield LabelledMask(*window.labels_to_image(labels, confidence, mask), window, labels, confidence)

    def label_views(
        self, views: Sequence[View], masks: Sequence[Bool[ndarray, "_ _"]]
    ) -> list[tuple[UInt8[ndarray, "_ _"], Float[ndarray, "_ _"]]]:
        """Region 0–43 of every masked pixel of every view, and its probability; all 0 where nobody is."""
        return [(found.labels, found.confidence) for found in self.label_masks(views, masks)]
