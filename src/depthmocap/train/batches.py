"""Labelled windows for training and validation, as endless torch data sets, and batches of them (extra: train)."""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor
from torch.utils.data import Dataset, Sampler

from depthmocap.body import regions, skeleton
from depthmocap.body.regions import UNLABELLED
from depthmocap.body.skeleton import JOINTS
from depthmocap.classify.window import WINDOW_MAKERS, NetworkName
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.synth.motion.postures import (
    TRAINING_VARIATION,
    LeaningPostures,
    PostureSource,
    Variation,
    posture_source,
)
from depthmocap.synth.sample import Recipe, Split, Subset
from depthmocap.synth.sample import Sampler as SampleSampler
from depthmocap.train.distributed import process_count, process_rank
from depthmocap.train.training_run import ENDLESS
from depthmocap.train.windows import Degradations, LabelledWindow, labelled_window, training_window

#: Seed of all validation sets, so that numbers of different runs can be compared.
_VALID_SEED = 1_000_003
#: Number of batches that are sorted together by the size of their windows.
_SORTED_BATCHES = 8
#: Number of windows between one and its mirror image.
_MIRROR_DELAY = 1024
#: Of leaning people, share who are seen upright in the training of a network for them alone.
_UPRIGHT_OF_LEANING = 0.95
#: What the training of our network can leave out, to measure its worth: batch normalisation; half the channels;
#: clothes; the sensors' errors; occlusion and errors of the mask; mirror images; postures beyond the recorded; every
#: second row and column of pixels.
Ingredient = Literal["norm", "width", "clothes", "errors", "spoiling", "mirror", "variation", "resolution"]


@dataclasses.dataclass(frozen=True)
class WindowSource:
    """Where the windows of a network come from.

    Attributes:
        network: name of the network. Ours learns from pictures of any sensor, with its errors and with errors of
            segmentation; the paper's from exact depth of UBC3V's sensor and perfect masks.
        data: "synth", or the root of a UBC3V set.
        subset: who is in the pictures.
        postures: folder of clips or a pool made of them; without it the packaged prior.
        without: ingredients that our network's training pictures lack; validation pictures are always the same, except
            for their resolution.
        cut: share of people who are cut off, also in validation pictures, which have the other errors of training then;
            by default as in the training of the classifier, whose validation pictures show whole people.
        leaning: share of people whose trunk leans, nearly all of whom are seen upright then, also in validation
            pictures, which have the other errors of training then; by default as they come.
    """

    network: NetworkName
    data: str
    subset: Subset
    postures: Path | None
    seed: int
    without: tuple[Ingredient, ...] = ()
    cut: float | None = None
    leaning: float = 0.0

    def train(self, first: int = 0) -> Dataset[LabelledWindow]:
        """Windows from number ``first`` on, without end.

        Raises:
            InputError: postures or data that cannot be read.
        """
        if self.data != "synth":
            return _FolderWindows(self, "train", first)
        return _PaperWindows(self, "train", first) if self.network == "paper" else _SynthWindows(self, first)

    def valid(self, count: int) -> list[LabelledWindow]:
        """The fixed validation windows of the valid split, the same of every seed.

        Raises:
            InputError: postures or data that cannot be read.
        """
        fixed = dataclasses.replace(self, seed=_VALID_SEED)
        if self.data != "synth":
            folder = _FolderWindows(fixed, "valid", 0)
            return [folder[i] for i in range(min(count, len(folder.index)))]
        if self.network == "paper":
            source = _PaperWindows(fixed, "valid", 0)
            return [source[i] for i in range(count)]
        variation = TRAINING_VARIATION if self.leaning else Variation()
        postures = self.leaning_postures(posture_source(self.postures, "valid", self.subset == "easy", variation))
        errors = None if self.cut is None and not self.leaning else self.degradations
        return [self.at_resolution(training_window(fixed.seed, i, self.subset, postures, errors)) for i in range(count)]

    @property
    def degradations(self) -> Degradations:
        """Shares of degraded pictures in the training of our network."""
        plain = Degradations()
        return dataclasses.replace(
            plain,
            cut=plain.cut if self.cut is None else self.cut,
            upright=_UPRIGHT_OF_LEANING if self.leaning else plain.upright,
        )

    def leaning_postures(self, postures: PostureSource) -> PostureSource:
        """The postures, so many of them with a leaning trunk as this source has."""
        return LeaningPostures(postures, self.leaning) if self.leaning else postures

    def at_resolution(self, window: LabelledWindow) -> LabelledWindow:
        """The window at the resolution of this source; half of it keeps every second row and column, repeated twice."""
        if "resolution" not in self.without:
            return window
        return window._replace(inputs=window.inputs[:, ::2, ::2].repeat(2, 1).repeat(2, 2))

    def window(self, view: View, joints: Float[ndarray, "18 3"] | None) -> LabelledWindow | None:
        """The window of a view with mask and labels; None without a person. Only our network learns the joints."""
        assert view.mask is not None and view.labels is not None
        window = WINDOW_MAKERS[self.network](view.depth_m, view.mask, view.camera)
        if window is None:
            return None
        unknown = np.full((len(JOINTS), 3), np.nan, np.float32)
        if self.network == "paper" or joints is None:
            joints = unknown
        example = labelled_window(window, view.labels, joints, view.camera)
        if self.network == "paper":  # learns the background, too
            example.labels[window.inputs[1] == 0] = 0
        return example


class _SynthWindows(Dataset[LabelledWindow]):
    """Open-ended pictures for our network."""

    def __init__(self, source: WindowSource, first: int) -> None:
        self.source, self.first = source, first
        variation = Variation(mirror=0.5) if "variation" in source.without else TRAINING_VARIATION
        postures = posture_source(source.postures, "train", source.subset == "easy", variation)
        self.postures = source.leaning_postures(postures)
        self.degradations = None if "spoiling" in source.without else source.degradations

    def __len__(self) -> int:
        return ENDLESS

    def __getitem__(self, index: int) -> LabelledWindow:
        source = self.source
        window = training_window(
            source.seed, self.first + index, source.subset, self.postures, self.degradations,
            clothes="clothes" not in source.without, errors="errors" not in source.without,
        )  # fmt: skip
        return source.at_resolution(window)


class _PaperWindows(Dataset[LabelledWindow]):
    """Pictures of the paper's kind: exact depth, nothing around the person (Sec. III)."""

    def __init__(self, source: WindowSource, split: Split, first: int) -> None:
        recipe = Recipe(source.subset, split, views=1, postures=source.postures, vary=split == "train")
        self.source, self.first = source, first
        self.sampler = SampleSampler(recipe, source.seed)

    def __len__(self) -> int:
        return ENDLESS

    def __getitem__(self, index: int) -> LabelledWindow:
        (view,) = self.sampler(self.first + index).views
        window = self.source.window(view, None)
        assert window is not None  # the sampler draws again until somebody is seen
        return window


class _FolderWindows(Dataset[LabelledWindow]):
    """Views of a UBC3V split in an order shuffled by the seed, over and over."""

    def __init__(self, source: WindowSource, split: Split, first: int) -> None:
        from depthmocap.datasets.ubc3v import CAMERAS, Section, sections

        self.source, self.first = source, first
        self.sections = [Section(path) for path in sections(Path(source.data), f"{source.subset}-pose", split)]
        self.index = [
            (s, i, v)
            for s, section in enumerate(self.sections)
            for i in range(len(section))
            for v in range(len(CAMERAS))
        ]
        self.order = np.random.default_rng(source.seed).permutation(len(self.index))

    def __len__(self) -> int:
        return ENDLESS

    def __getitem__(self, index: int) -> LabelledWindow:
        for attempt in range(100):  # a view may be missing or show no person
            s, i, v = self.index[int(self.order[(self.first + index + 7919 * attempt) % len(self.order)])]
            frames = self.sections[s][i]
            views = frames.views
            if v >= len(views) or views[v].mask is None or views[v].labels is None:
                continue
            window = self.source.window(views[v], frames.true_joints)
            if window is not None:
                return window
        raise InputError("100 views in a row hold no labelled person: is this a UBC3V root with labels?")


class LabelledBatch(NamedTuple):
    """Labelled windows of one size: inputs (n, c, h, w), labels (n, h, w) and joints (n, 18, 3), see LabelledWindow."""

    inputs: Tensor
    labels: Tensor
    joints: Tensor


def sorted_batches(windows: Sequence[LabelledWindow], size: int) -> Iterator[LabelledBatch]:
    """The windows in batches of ``size``, sorted by their size. Smaller windows of a batch are padded around their
    middles, which does not change the positions of the joints."""
    order = sorted(range(len(windows)), key=lambda i: windows[i].labels.shape)
    for first in range(0, len(order), size):
        chosen = [windows[i] for i in order[first : first + size]]
        heights, widths = zip(*(window.labels.shape for window in chosen), strict=True)
        wide = [pad_window(window, max(heights), max(widths)) for window in chosen]
        yield LabelledBatch(*(torch.from_numpy(np.stack(window)) for window in zip(*wide, strict=True)))


def pad_window(window: LabelledWindow, height: int, width: int) -> LabelledWindow:
    """The window padded with empty pixels."""
    inputs, labels, joints = window
    rows, columns = (height - labels.shape[0]) // 2, (width - labels.shape[1]) // 2
    if not (rows or columns):
        return window
    around = (rows, rows), (columns, columns)
    # The last channel is the same all over; depth and mask are 0 around the person.
    wide = np.stack([np.pad(channel, around) for channel in inputs[:2]] + [np.full((height, width), inputs[2, 0, 0])])
    return LabelledWindow(wide, np.pad(labels, around, constant_values=UNLABELLED), joints)


def mirror_window(window: LabelledWindow) -> LabelledWindow:
    """The mirror image of a window."""
    table = np.full(256, UNLABELLED, np.uint8)
    table[: len(regions.MIRROR)] = regions.MIRROR
    inputs, labels = (np.ascontiguousarray(array[..., ::-1]) for array in (window.inputs, window.labels))
    return LabelledWindow(inputs, table[labels], window.joints[skeleton.MIRROR] * np.array([-1, 1, 1], np.float32))


def training_batches(
    windows: Iterable[list[LabelledWindow]], size: int, seed: int, mirror: bool = True
) -> Iterator[LabelledBatch]:
    """Batches for our network. With ``mirror`` each window comes twice, the second time as a mirror image and much
    later. Windows of similar size are in one batch, which saves empty pixels."""
    rng = np.random.default_rng(seed)
    later: collections.deque[LabelledWindow] = collections.deque()
    queue: list[LabelledWindow] = []
    for chunk in windows:
        queue += chunk
        later += chunk if mirror else []
        while len(later) > _MIRROR_DELAY:
            queue.append(mirror_window(later.popleft()))
        if len(queue) >= _SORTED_BATCHES * size:
            batches = list(sorted_batches(queue[: len(queue) // size * size], size))
            del queue[: len(batches) * size]
            for i in rng.permutation(len(batches)):
                yield batches[i]


class Batches(Sampler[list[int]]):
    """Indices 0 to size - 1, then the next ones, without end; of several processes that train each takes its turn."""

    def __init__(self, size: int) -> None:
        self.size = size

    def __iter__(self) -> Iterator[list[int]]:
        start = self.size * process_rank()
        while True:
            yield list(range(start, start + self.size))
            start += self.size * process_count()
