"""Samples made on the fly, in order, by any number of processes."""

from __future__ import annotations

import contextlib
import functools
import itertools
from collections.abc import Iterator

from depthmocap.errors import InputError
from depthmocap.synth.sample import Recipe, Sample, Sampler
from depthmocap.synth.writing.workers import ordered


def stream(
    recipe: Recipe, seed: int = 0, start: int = 0, stop: int | None = None, workers: int = 0, chunk: int = 8
) -> Iterator[tuple[int, Sample]]:
    """Samples ``start`` to ``stop`` (None: without end) of a recipe with their indices, in order.

    They do not depend on ``workers``: 0 draws them in this process; more are processes that draw ``chunk`` samples at a
    time, each at most two chunks ahead of the consumer. A program that uses workers must keep its own
    start under ``if __name__ == "__main__":``, as with any of Python's process pools. Closing the iterator, Ctrl-C and
    the end of this process end the workers at once.

    Training on samples that are never stored::

        for index, sample in stream(Recipe(subset="open"), seed=1, workers=4):
            for view in sample.views:
                window = make_window(view.depth_m, view.mask, view.camera)
                ...  # window.inputs, window.labels_from_image(view.labels, UNLABELLED)

    Every rank of a distributed training takes its own seed, or its own range of indices.

    Raises:
        InputError: a setting of the recipe cannot be, no camera sees a person, or workers keep dying.
    """
    if workers < 0 or chunk < 1:
        raise InputError(f"workers must be at least 0 and chunk at least 1, got {workers} and {chunk}")
    size = chunk if workers else 1
    firsts = itertools.count(start, size) if stop is None else range(start, stop, size)
    tasks = ((recipe, seed, first, first + size if stop is None else min(first + size, stop)) for first in firsts)
    with contextlib.closing(ordered(_draw_range, tasks, workers)) as chunks:
        for samples in chunks:
            yield from samples


def draw(recipe: Recipe, seed: int, index: int) -> Sample:
    """One sample; the models are loaded once per process.

    Raises:
        InputError: when no camera sees the person.
    """
    return _sampler(recipe, seed)(index)


@functools.lru_cache(maxsize=2)
def _sampler(recipe: Recipe, seed: int) -> Sampler:
    return Sampler(recipe, seed)


def _draw_range(task: tuple[Recipe, int, int, int]) -> list[tuple[int, Sample]]:
    recipe, seed, start, stop = task
    return [(index, draw(recipe, seed, index)) for index in range(start, stop)]
