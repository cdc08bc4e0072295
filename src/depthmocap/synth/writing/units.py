"""Units of a data set: each is made by one process, and an interrupted folder can be continued."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

from depthmocap.datasets.shards import SAMPLES_PER_SHARD, ShardWriter, count_samples, shard_path
from depthmocap.datasets.ubc3v import FRAMES_PER_SECTION
from depthmocap.datasets.ubc3v_write import FrameTruth, SectionWriter, frame_truth, write_images
from depthmocap.errors import InputError
from depthmocap.synth.sample import Recipe, Sample
from depthmocap.synth.writing.card import CardRow, describe
from depthmocap.synth.writing.stream import draw

Layout = Literal["ubc3v", "shards"]

#: Of UBC3V's layout: a thirteenth of a section.
_FRAMES_PER_UNIT = 77
_DESCRIBED_PER_UNIT = 16


@dataclasses.dataclass(frozen=True)
class Unit:
    """Samples ``start`` to ``stop`` of a set of so many. Whoever makes it, and however often, writes the same pictures
    and truth.

    ``layout`` None stores nothing: the samples are only described, every ``step``-th.
    """

    folder: Path
    layout: Layout | None
    recipe: Recipe
    seed: int
    samples: int
    identity: str
    start: int
    stop: int
    step: int = 1

    @property
    def indices(self) -> range:
        """The samples' indices."""
        return range(self.start, self.stop, self.step)


@dataclasses.dataclass(frozen=True, eq=False)
class Made:
    """Result of a unit: rows of the data card, and the ground truth where it is not stored yet."""

    unit: Unit
    rows: tuple[CardRow, ...]
    truths: tuple[FrameTruth, ...] = ()


def make_unit(unit: Unit) -> Made:
    """Draw and store a unit's samples.

    Raises:
        InputError: when a sample cannot be drawn, or not be stored in this layout.
        OSError: when a file cannot be written.
    """
    rows: list[CardRow] = []

    def drawn() -> Iterator[tuple[int, Sample]]:
        for index in unit.indices:
            sample = draw(unit.recipe, unit.seed, index)
            row = describe(index, sample, unit.samples)
            if row is not None:
                rows.append(row)
            yield index, sample

    truths: list[FrameTruth] = []
    if unit.layout == "shards":
        with ShardWriter(shard_path(unit.folder, unit.start // SAMPLES_PER_SHARD)) as writer:
            for index, sample in drawn():
                about = {"seed": unit.seed, "settings": unit.identity}
                writer.write(index, sample.views, sample.joints, sample.group, about)
    else:
        for index, sample in drawn():
            if unit.layout is None:
                continue
            try:
                truths.append(frame_truth(sample.views, sample.joints))
            except ValueError as error:
                raise InputError(f"UBC3V's layout cannot hold this ({error}); use --format shards") from None
            section, frame = divmod(index, FRAMES_PER_SECTION)
            write_images(unit.folder / str(section + 1), frame, sample.views)
    return Made(unit, tuple(rows), tuple(truths))


class ShardFolder:
    """Shards count as soon as they have their final name.

    Raises:
        InputError: when the last shard is damaged.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.close()
        numbers = [int(path.stem.removeprefix("shard-")) for path in folder.glob("shard-*.tar")]
        self._made = set(numbers)
        self._last = max(numbers, default=-1)
        # Only the last can be short.
        self._in_last = count_samples(shard_path(folder, self._last)) if numbers else 0
        self.begun = self._last * SAMPLES_PER_SHARD + self._in_last if numbers else 0

    def missing(self, samples: int) -> Iterator[tuple[int, int]]:
        """Start and stop of the shards, in order, that are not there, or, if the last, too short."""
        for number, start in enumerate(range(0, samples, SAMPLES_PER_SHARD)):
            stop = min(start + SAMPLES_PER_SHARD, samples)
            if number not in self._made or (number == self._last and self._in_last < stop - start):
                yield start, stop

    def commit(self, made: Made) -> None:
        """A shard is complete by itself."""

    def close(self) -> None:
        """Remove what killed processes left."""
        for left in self._folder.glob("shard-*.tar.part-*"):
            left.unlink()


class Ubc3vFolder:
    """Images are written first, by any process in any order; the truth only here, in order, so that it never tells of
    an image that is not there. What follows the last stored truth is made again.

    Raises:
        InputError: when the last section's truth is damaged.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        numbers = [int(path.parent.name) for path in folder.glob("*/groundtruth.mat") if path.parent.name.isdecimal()]
        last = max(numbers, default=1)
        self._writer = self._open(last)
        self.begun = (last - 1) * FRAMES_PER_SECTION + len(self._writer)

    def _open(self, section: int) -> SectionWriter:
        return SectionWriter(self._folder.parent.parent, self._folder.parent.name, self._folder.name, section)

    def missing(self, samples: int) -> Iterator[tuple[int, int]]:
        """Start and stop of runs of frames, in order, none over the border of a section."""
        start = self.begun
        while start < samples:
            section_end = (start // FRAMES_PER_SECTION + 1) * FRAMES_PER_SECTION
            stop = min(start + _FRAMES_PER_UNIT, section_end, samples)
            yield start, stop
            start = stop

    def commit(self, made: Made) -> None:
        """Take the truth of frames whose images are stored; in the order of ``missing``."""
        section, frame = divmod(made.unit.start, FRAMES_PER_SECTION)
        if self._writer.full:
            self._writer = self._open(section + 1)
        assert len(self._writer) == frame, "units are committed in order"
        for truth in made.truths:
            self._writer.append(truth)

    def close(self) -> None:
        """Store the truth of the last frames."""
        self._writer.close()


#: A split's folder. A set only grows: ``begun`` samples are there, or were once begun.
Folder = ShardFolder | Ubc3vFolder


def open_folder(folder: Path, layout: Layout) -> Folder:
    """The split's folder, which must exist and be locked."""
    return ShardFolder(folder) if layout == "shards" else Ubc3vFolder(folder)


def describing_units(unit: Unit, described: Sequence[int], stride: int) -> Iterator[Unit]:
    """Units that store nothing and describe what the card lacks: every ``stride``-th sample but those described."""
    known = set(described)
    for start in range(0, unit.samples, stride * _DESCRIBED_PER_UNIT):
        stop = min(start + stride * _DESCRIBED_PER_UNIT, unit.samples)
        if not known.issuperset(range(start, stop, stride)):
            yield dataclasses.replace(unit, layout=None, start=start, stop=stop, step=stride)
