"""The same function of many tasks, in order, by processes that may be killed."""

from __future__ import annotations

import collections
import contextlib
import itertools
import multiprocessing
import os
import pickle
import queue
import sys
import threading
import traceback
from collections.abc import Callable, Generator, Iterable
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from multiprocessing.util import Finalize
from typing import Any, Generic, NamedTuple, TypeVar

import cv2

from depthmocap.core.interrupts import ignore_signals
from depthmocap.errors import InputError

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")

#: Largest number of attempts of a task whose processes die.
_DEATHS = 3
#: Threads and a lock of ours do not survive a fork.
_CONTEXT = multiprocessing.get_context("spawn")


def ordered(
    function: Callable[[_Task], _Result], tasks: Iterable[_Task], workers: int
) -> Generator[_Result, None, None]:
    """``function`` of every task, in their order, with at most two tasks a worker under way.

    A task must have the same result whenever and wherever it is done: that of a process that died (killed, out of
    memory) is done again. 0 workers do them here. Errors of the function are raised here, when the task's turn comes.

    Raises:
        InputError: when processes die three times in a row.
    """
    if not workers:
        yield from map(function, tasks)
        return
    left = enumerate(tasks)
    crew: list[_Worker[_Task]] = []
    done: dict[int, _Outcome] = {}
    deaths = 0
    try:
        for number, task in itertools.islice(left, 2 * workers):
            if len(crew) < workers:
                crew.append(_Worker(function))
            crew[number % workers].give(number, task)
        for turn in itertools.count():
            while turn not in done:
                busy = [worker for worker in crew if worker.under_way]
                if not busy:
                    return
                ready = wait([worker.pipe for worker in busy])
                for worker in busy:
                    if worker.pipe not in ready:
                        continue
                    try:
                        number, outcome = worker.take()
                    except _DiedError:
                        deaths += 1
                        if deaths >= _DEATHS:
                            raise InputError(
                                f"worker processes died {deaths} times in a row: give fewer --workers if memory ran "
                                'out, and in a program of your own start under if __name__ == "__main__":'
                            ) from None
                        crew[crew.index(worker)] = worker.successor()
                    else:
                        done[number] = outcome
            outcome = done.pop(turn)
            if outcome.error is not None:
                raise outcome.error from _InWorkerError(outcome.trace)
            for number, task in itertools.islice(left, 1):
                min(crew, key=lambda worker: len(worker.under_way)).give(number, task)
            deaths = 0
            yield outcome.result
    finally:
        for worker in crew:
            worker.end()


class _Outcome(NamedTuple):
    """What became of a task."""

    result: Any
    error: Exception | None = None
    trace: str = ""


class _InWorkerError(Exception):
    """Where in its process an error came about."""


class _DiedError(Exception):
    """A worker ended before it had answered."""


class _Worker(Generic[_Task]):
    """A process that answers tasks in the order they are given. It ends with this process, however this one ends.

    Only the worker holds its end of the pipe: when it dies in the middle of an answer, reading that ends.
    """

    def __init__(self, function: Callable[[_Task], object]) -> None:
        self._function = function
        self.pipe, theirs = _CONTEXT.Pipe()
        self._process = _CONTEXT.Process(target=_work, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()
        # Python waits for its processes at the end, of whose signals it sends these hear none.
        Finalize(self, self._process.kill, exitpriority=1)
        #: Number and task that it has not answered.
        self.under_way: collections.deque[tuple[int, _Task]] = collections.deque()

    def give(self, number: int, task: _Task) -> None:
        """Have a task done after those it has."""
        self.under_way.append((number, task))
        message = ForkingPickler.dumps((self._function, task))
        with contextlib.suppress(OSError):  # it is dead, which shows when it is asked
            self.pipe.send_bytes(message)

    def take(self) -> tuple[int, _Outcome]:
        """Wait for the next answer: a task's number, and what became of it.

        Raises:
            _DiedError: when there will not be one.
        """
        try:
            answer = self.pipe.recv_bytes()
        except (EOFError, OSError):
            raise _DiedError from None
        return self.under_way.popleft()[0], _Outcome(*pickle.loads(answer))

    def successor(self) -> _Worker[_Task]:
        """Another one, with this one's tasks."""
        self.end()
        other = _Worker(self._function)
        for number, task in self.under_way:
            other.give(number, task)
        return other

    def end(self) -> None:
        """End the process at once, whatever it does."""
        self._process.kill()
        self._process.join()
        self.pipe.close()


def _work(pipe: Connection) -> None:
    """What a worker does."""
    ignore_signals()
    limit_threads()
    messages: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(pipe, messages), daemon=True).start()
    while True:
        message = messages.get()
        try:
            function, task = pickle.loads(message)
            answer = ForkingPickler.dumps((function(task),))
        except Exception as error:
            trace = "\n" + traceback.format_exc()
            try:
                answer = ForkingPickler.dumps((None, error, trace))
            except Exception:  # an error may hold anything
                answer = ForkingPickler.dumps((None, RuntimeError(f"{type(error).__name__}: {error}"), trace))
        with contextlib.suppress(OSError):  # the parent is gone, and in a moment so is this process
            pipe.send_bytes(answer)


def _listen(pipe: Connection, messages: queue.SimpleQueue[bytes]) -> None:
    """Take tasks at once, so that the parent never waits for this process to read; end this process with the parent."""
    with contextlib.suppress(EOFError, OSError):
        while True:
            messages.put(pipe.recv_bytes())
    os._exit(1)


def limit_threads() -> None:
    """One thread a process: there are as many processes as cores."""
    os.environ["OMP_NUM_THREADS"] = "1"  # torch reads it when it is loaded
    cv2.setNumThreads(1)
    if "torch" in sys.modules:
        import torch

        torch.set_num_threads(1)
