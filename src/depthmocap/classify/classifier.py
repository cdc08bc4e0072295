"""Classification: body-part labels of depth images by a trained network, run by ONNX Runtime without torch."""

from __future__ import annotations

import dataclasses
import importlib.resources
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from depthmocap.body.regions import MIRROR as MIRRORED_REGIONS
from depthmocap.body.regions import REGION_NAMES, TURNED
from depthmocap.body.skeleton import MIRROR
from depthmocap.body.trunk import front_of_trunk, trunk_lean
from depthmocap.classify.front import FrontNetwork, front_of_labels, log_odds
from depthmocap.classify.label_network import LabelNetwork, WindowPrediction, no_joints
from depthmocap.classify.window import Window, make_window
from depthmocap.core.shared_work import SharedWork
from depthmocap.frames import View
from depthmocap.geometry import z_up_from

#: Labels that a front and a back have in different places: those of the trunk and the head.
_FACING = TURNED != MIRRORED_REGIONS
#: Labels of legs below the thighs.
_LOWER_LEGS = np.array([name[:-2] in ("knee", "shin", "ankle", "forefoot") for name in REGION_NAMES])
#: The network of fronts is asked about people who are cut off: less than these shares of their pixels are lower legs,
_FEWEST_LOWER_LEGS = 0.05
#: or trunk and head.
_LEAST_FACING = 0.15
#: But where the labels of trunk and head have a mean probability above this, front and back are hardly ever mistaken
#: for each other: that network is not asked,
_SURE_OF_FRONT = 0.76
#: and these are the log odds.
_SURE_LOG_ODDS = 5.0
#: Log odds of labels and joints that imply the same front to be right about it, before that network is asked.
_PRIOR_LOG_ODDS = 0.5
#: It is so much less sure on people whom it was not trained on.
_CALIBRATION = 0.85
#: Somebody whose trunk leans by more than this in the picture is seen again, upright (radians),
_LYING_RAD = 0.8
#: and by more than this, where the labels are unsure (radians):
_LEANING_RAD = 0.35
#: of a mean probability below this, which hardly any are of people who stand.
_SURE_OF_LABELS = 0.7
#: The network for leaning people has learnt from harder pictures: where its labels are as good, their mean probability
#: is lower by up to this.
_LESS_SURE = 0.1


def packaged_weights() -> Path:
    """The 8-bit ONNX file of the packaged network; its weights for training are in the repository, ``weights/``."""
    return Path(str(importlib.resources.files("depthmocap.classify") / "weights" / "fast.onnx"))


def packaged_leaning() -> Path:
    """The 8-bit ONNX file of the packaged network that sees leaning people again."""
    return Path(str(importlib.resources.files("depthmocap.classify") / "weights" / "leaning.onnx"))


class ViewPrediction(NamedTuple):
    """The prediction for a view: regions 0–43 and their probabilities at the masked pixels, 0 elsewhere; the joints'
    world positions with their expected errors (metres), NaN where there are none; and the log odds that what is told
    front is not the back (``FrontNetwork``), NaN where unknown."""

    labels: UInt8[ndarray, "h w"]
    confidence: Float[ndarray, "h w"]
    joints: Float[ndarray, "18 4"]
    front_log_odds: float = float("nan")


def _facing_right(prediction: WindowPrediction, window: Window, scores: Float[ndarray, "64"]) -> WindowPrediction:
    """The prediction with its labels and its joints, which may contradict each other, turned round where the odds are
    that they take a back for a front.

    Args:
        scores: of ``FrontNetwork``.
    """
    labels, joints = prediction.labels, prediction.joints
    of_joints = log_odds(scores, front_of_trunk(joints[None, :, :3])[0])
    of_labels = log_odds(scores, front_of_labels(window, labels, joints[:, :3]))
    if np.isnan(of_labels):
        of_labels = of_joints
    if (of_labels < 0) == (of_joints < 0):
        # Where labels and joints agree they count as well.
        of_labels, of_joints = of_labels + _PRIOR_LOG_ODDS, of_joints + _PRIOR_LOG_ODDS
    if of_labels < 0:
        labels = TURNED[labels]
    if of_joints < 0:
        joints = joints[MIRROR]
    return WindowPrediction(labels, prediction.confidence, joints, _CALIBRATION * abs(of_labels))


@dataclasses.dataclass(frozen=True, eq=False)
class LabelledMask:
    """The predictions for a view and for its window, and the window; the latter two are None without a person."""

    prediction: ViewPrediction
    window: Window | None
    window_prediction: WindowPrediction | None


@dataclasses.dataclass(frozen=True, eq=False)
class _Shown:
    """A view turned upright by quarters, and the window in which the network sees the person; None without one."""

    view: View
    mask: Bool[ndarray, "_ _"]
    quarters: int
    window: Window | None


class Classifier:
    """A trained body-part classifier: depth in, region and probability of every pixel out (paper, Sec. IV-A).

    Somebody whose trunk does not point up in the picture is seen again in a window that is turned so that it does, by
    a network that was trained on such people.
    Labels that take a back for a front, or a front for a back, are turned round (``FrontNetwork``).

    Views are labelled in parallel, each by one thread from the depth image to the labels, or two at once where there
    are more views than threads. Threads inside the network would wait for each other after every layer.

    Attributes:
        path: of its file.
        network: name of the network in the file, "fast" or "paper".
        predicts_joints: whether it predicts joints besides the labels.
        make_window: makes this network's windows.
    """

    def __init__(
        self, path: Path | None = None, threads: int | None = None, fronts: bool = True, leaning: Path | None = None
    ) -> None:
        """Load an ONNX file written by ``depthmocap train classifier``; the packaged one by default.

        Args:
            fronts: turn labels round by the packaged ``FrontNetwork``; never those of the paper's network.
            threads: views labelled at a time; by default as many as the cores that this process may use.
            leaning: the network that sees leaning people again, of ``train classifier --leaning``; by default the
                packaged one with the packaged classifier, and with another classifier that itself.

        Raises:
            InputError: when a file is missing or not such a network.
        """
        self._network = LabelNetwork(path or packaged_weights())
        if leaning is None and path is None:
            leaning = packaged_leaning()
        self._of_leaning = self._network if leaning is None else LabelNetwork(leaning)
        self.path, self.network = self._network.path, self._network.name
        self.predicts_joints, self.make_window = self._network.predicts_joints, self._network.make_window
        self._front = FrontNetwork() if fronts and self.predicts_joints else None
        self._work = SharedWork(threads)

    def _with_trunk_up(
        self, view: View, mask: Bool[ndarray, "_ _"], window: Window, prediction: WindowPrediction
    ) -> tuple[Window, WindowPrediction]:
        """The window of a view and the prediction for it; where its joints tell that the trunk does not point up, those
        for a window that is turned so that it does, unless their labels are less sure. Networks know people best who
        are upright in their window, and tell from any how they lie."""
        probability, lean = prediction.mean_probability, trunk_lean(prediction.joints[:, :3])
        if not abs(lean) > (_LEANING_RAD if probability < _SURE_OF_LABELS else _LYING_RAD):
            return window, prediction  # also for a network without joints, whose lean is NaN
        turned = make_window(view.depth_m, mask, view.camera, lean)
        assert turned is not None  # as the window before
        (of_turned,) = self._of_leaning([turned])
        least = probability if self._of_leaning is self._network else probability - _LESS_SURE
        return (turned, of_turned) if of_turned.mean_probability > least else (window, prediction)

    def _with_front(self, prediction: WindowPrediction, window: Window) -> WindowPrediction:
        """The prediction with the log odds of its front, and turned round where these say so."""
        if self._front is None:
            return prediction
        labels, confidence = prediction.labels, prediction.confidence
        labelled, facing = max(int(np.count_nonzero(labels)), 1), confidence[_FACING[labels]]
        lower_legs = int(np.count_nonzero(_LOWER_LEGS[labels]))
        if lower_legs >= _FEWEST_LOWER_LEGS * labelled and len(facing) >= _LEAST_FACING * labelled:
            return prediction  # of whole people the labels tell it as well, and each view by itself
        if len(facing) and facing.mean() > _SURE_OF_FRONT:
            return prediction._replace(front_log_odds=_SURE_LOG_ODDS)
        return _facing_right(prediction, window, self._front(window))

    def label_mask(self, view: View, mask: Bool[ndarray, "_ _"]) -> LabelledMask:
        """The prediction for a view, without turning the image upright."""
        window = self.make_window(view.depth_m, mask, view.camera)
        return self._labelled(view, mask, window, None if window is None else self._network([window])[0])

    def _labelled(
        self, view: View, mask: Bool[ndarray, "_ _"], window: Window | None, found: WindowPrediction | None
    ) -> LabelledMask:
        """The prediction for a view from the network's for its window."""
        if window is None or found is None:
            empty = np.zeros(mask.shape, np.uint8), np.zeros(mask.shape, np.float32)
            return LabelledMask(ViewPrediction(*empty, no_joints()), None, None)
        window, found = self._with_trunk_up(view, mask, window, found)
        found = self._with_front(found, window)
        labels, confidence = window.labels_to_image(found.labels, found.confidence, mask)
        joints = found.joints
        if self.predicts_joints:
            positions = window.positions_to_world(joints[:, :3], view.camera)
            joints = np.concatenate([positions, np.exp(joints[:, 3:])], 1)
        return LabelledMask(ViewPrediction(labels, confidence, joints, found.front_log_odds), window, found)

    def label_masks(self, views: Sequence[View], masks: Sequence[Bool[ndarray, "_ _"]]) -> Iterator[LabelledMask]:
        """The predictions for the views, in order, without turning the images upright."""
        return iter(self._work.map(self.label_mask, views, masks))

    def label_views(
        self, views: Sequence[View], masks: Sequence[Bool[ndarray, "_ _"]], up: str | None = None
    ) -> list[ViewPrediction]:
        """The predictions for the views, in order; labels are 0 and joints NaN without a person.

        Args:
            up: the world's up axis if known. Then images of cameras on their side or upside down are turned upright,
                because the network is trained on upright cameras.
        """
        up_world = None if up is None else z_up_from(up)[2]
        if len(views) <= self._work.threads:
            return self._work.map(lambda view, mask: self._label_upright(view, mask, up_world), views, masks)
        shown = self._work.map(lambda view, mask: self._show_upright(view, mask, up_world), views, masks)

        def label(places: list[int]) -> list[ViewPrediction]:
            windows = [window for place in places if (window := shown[place].window) is not None]
            found = self._network(windows) if windows else [None] * len(places)
            return [self._prediction(shown[place], each) for place, each in zip(places, found, strict=True)]

        of_views = [item.window for item in shown]
        few = sum(window is not None for window in of_views) <= self._work.threads  # each gets a thread
        twos = [[place] for place in range(len(shown))] if few else _by_twos(of_views)
        labelled = self._work.map(label, twos)
        by_place = {
            place: prediction
            for places, predictions in zip(twos, labelled, strict=True)
            for place, prediction in zip(places, predictions, strict=True)
        }
        return [by_place[place] for place in range(len(shown))]

    def _label_upright(
        self, view: View, mask: Bool[ndarray, "_ _"], up_world: Float[ndarray, "3"] | None
    ) -> ViewPrediction:
        shown = self._show_upright(view, mask, up_world)
        return self._prediction(shown, None if shown.window is None else self._network([shown.window])[0])

    def _show_upright(self, view: View, mask: Bool[ndarray, "_ _"], up_world: Float[ndarray, "3"] | None) -> _Shown:
        quarters = 0 if up_world is None else view.camera.quarters_upright(up_world)
        if quarters:
            view = View(view.camera, view.depth_m, mask).turned(quarters)
            assert view.mask is not None
            mask = view.mask
        return _Shown(view, mask, quarters, self.make_window(view.depth_m, mask, view.camera))

    def _prediction(self, shown: _Shown, found: WindowPrediction | None) -> ViewPrediction:
        """The prediction for a view as the camera has it."""
        prediction = self._labelled(shown.view, shown.mask, shown.window, found).prediction
        if not shown.quarters:
            return prediction
        labels, confidence = (np.ascontiguousarray(np.rot90(image, -shown.quarters)) for image in prediction[:2])
        return prediction._replace(labels=labels, confidence=confidence)


def _by_twos(windows: Sequence[Window | None]) -> list[list[int]]:
    """Places of windows that the network sees at once: two of one size, which take a tenth less time together than one
    after the other; the largest first, so that threads end at about the same time. Views without window come last."""
    by_size: dict[tuple[int, ...], list[int]] = {}
    for place, window in enumerate(windows):
        by_size.setdefault((0,) if window is None else window.inputs.shape, []).append(place)
    twos = [(np.prod(size), places[i : i + 2]) for size, places in by_size.items() for i in range(0, len(places), 2)]
    return [places for size, places in sorted(twos, key=lambda two: (-two[0] * len(two[1]), two[1]))]
