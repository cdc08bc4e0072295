"""Samples made on the fly, in order, by any number of processes."""

from __future__ import annotations

import collections
import contextlib
import functools
import itertools
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import TypeVar

import cv2

from depthmocap.errors import InputError
from depthmocap.synth.sample import Recipe, Sample, Sampler

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")

#: A task whose process died is given to another one, so many times in a row.
_DEATHS = 3


def usable_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def stream(
    recipe: Recipe, seed: int = 0, start: int = 0, stop: int | None = None, workers: int = 0, chunk: int = 8
) -> Iterator[tuple[int, Sample]]:
    """Samples ``start`` to ``stop`` (None: without end) of a recipe with their indices, in order.

    They are the same whatever ``workers`` is: 0 draws them here, more are processes that draw ``chunk`` samples at a
    time and are at most two chunks each ahead of what has been taken. A program that uses workers must keep its own
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
    """One sample; what is needed to draw is loaded once a process.

    Raises:
        InputError: when no camera sees the person.
    """
    sample = _sampler(recipe, seed)(index)
    if not any(view.labels is not None and view.labels.any() for view in sample.views):
        raise InputError(
            f"sample {index}: no camera sees the person; bring the cameras nearer, let them aim closer, or leave more "
            "of the person free of the scene"
        )
    return sample


@functools.lru_cache(maxsize=2)
def _sampler(recipe: Recipe, seed: int) -> Sampler:
    return Sampler(recipe, seed)


def _draw_range(task: tuple[Recipe, int, int, int]) -> list[tuple[int, Sample]]:
    recipe, seed, start, stop = task
    return [(index, draw(recipe, seed, index)) for index in range(start, stop)]


def ordered(
    function: Callable[[_Task], _Result], tasks: Iterable[_Task], workers: int
) -> Generator[_Result, None, None]:
    """``function`` of every task, in their order, with at most two tasks a worker under way.

    A task must have the same result whenever and wherever it is done: that of a process that died (killed, out of
    memory) is done again. 0 workers do them here. Errors of the function are raised here.

    Raises:
        InputError: when processes die three times in a row.
    """
    if not workers:
        yield from map(function, tasks)
        return
    left = iter(tasks)
    under_way: collections.deque[tuple[_Task, Future[_Result]]] = collections.deque()
    pool = _Pool(workers)
    deaths = 0
    try:
        under_way.extend((task, pool.submit(function, task)) for task in itertools.islice(left, 2 * workers))
        while under_way:
            try:
                result = under_way[0][1].result()
                for task in itertools.islice(left, 1):
                    under_way.append((task, pool.submit(function, task)))
            except BrokenProcessPool:
                deaths += 1
                if deaths >= _DEATHS:
                    raise InputError(
                        f"worker processes died {deaths} times in a row: give fewer --workers if memory ran out, and "
                        'in a program of your own start under if __name__ == "__main__":'
                    ) from None
                pool.close(at_once=True)
                pool = _Pool(workers)
                under_way = collections.deque((task, pool.submit(function, task)) for task, _ in under_way)
                continue
            deaths = 0
            under_way.popleft()
            yield result
    finally:
        pool.close(at_once=bool(under_way))


class _Pool:
    """Processes that end with this one, however it ends: each watches a pipe whose other end only this one holds."""

    def __init__(self, workers: int) -> None:
        context = multiprocessing.get_context("spawn")  # threads and a lock of ours do not survive a fork
        self._theirs, self._ours = context.Pipe(duplex=False)
        self._pool = ProcessPoolExecutor(workers, context, initializer=_start_worker, initargs=(self._theirs,))

    def submit(self, function: Callable[[_Task], _Result], task: _Task) -> Future[_Result]:
        return self._pool.submit(function, task)

    def close(self, at_once: bool) -> None:
        """End the processes, after their tasks unless ``at_once``."""
        if at_once:
            self._ours.close()
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._ours.close()
        self._theirs.close()


def _start_worker(parent: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; the parent decides
    limit_threads()
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: Connection) -> None:
    with contextlib.suppress(EOFError, OSError):
        parent.recv_bytes()
    os._exit(1)


def limit_threads() -> None:
    """One thread a process: there are as many processes as cores."""
    os.environ["OMP_NUM_THREADS"] = "1"  # torch reads it when it is loaded
    cv2.setNumThreads(1)
    if "torch" in sys.modules:
        import torch

        torch.set_num_threads(1)
