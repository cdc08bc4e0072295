"""Tasks done in order by processes that end as they should."""

from __future__ import annotations

import functools
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from depthmocap import InputError
from depthmocap.synth.writing import workers
from depthmocap.synth.writing.workers import ordered

posix = pytest.mark.skipif(os.name != "posix", reason="needs signals and pipes of POSIX")
#: Ends a process at once, as Windows does for every signal but two.
KILL = getattr(signal, "SIGKILL", signal.SIGTERM)


def slowest_first(task: int) -> tuple[int, int]:
    time.sleep(0.2 if task == 0 else 0)
    return task, os.getpid()


def test_ordered_is_in_order_and_bounded() -> None:
    taken = []

    def tasks():
        for task in range(20):
            taken.append(task)
            yield task

    results = ordered(slowest_first, tasks(), 2)
    assert next(results)[0] == 0
    assert len(taken) <= 5  # two a worker, and one for that taken
    rest = list(results)
    assert [task for task, _ in rest] == list(range(1, 20))
    assert os.getpid() not in {pid for _, pid in rest}


def die_once(folder: Path, task: int) -> int:
    if task == 1:
        try:
            (folder / "died").touch(exist_ok=False)
        except FileExistsError:
            return task
        os.kill(os.getpid(), KILL)
    return task


def test_the_task_of_a_killed_worker_is_done_again(tmp_path: Path) -> None:
    assert list(ordered(functools.partial(die_once, tmp_path), range(6), 1)) == list(range(6))
    assert (tmp_path / "died").exists()


def die_sending_once(folder: Path, task: int) -> bytes:
    """The first time, its process is killed when half of the result has been sent."""
    size = 1 << 25  # far more than a pipe holds
    try:
        (folder / "died").touch(exist_ok=False)
    except FileExistsError:
        return bytes(size)

    def send_half(pipe: Connection, data: memoryview) -> None:
        sent = 0
        while sent < min(len(data), size // 2):
            sent += os.write(pipe.fileno(), data[sent : sent + 65536])
        if len(data) >= size:
            os.kill(os.getpid(), KILL)

    pytest.MonkeyPatch().setattr(Connection, "_send", send_half)
    return bytes(size)


@posix
def test_a_worker_killed_while_it_sends(tmp_path: Path) -> None:
    def too_late(*arguments: object) -> None:
        raise TimeoutError("the rest of the result is waited for")

    signal.signal(signal.SIGALRM, too_late)
    signal.alarm(60)
    try:
        sizes = [len(result) for result in ordered(functools.partial(die_sending_once, tmp_path), range(3), 2)]
    finally:
        signal.alarm(0)
    assert sizes == 3 * [1 << 25]
    assert (tmp_path / "died").exists()


def always_die(task: int) -> None:
    os._exit(9)


def test_workers_that_keep_dying_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "_DEATHS", 2)
    with pytest.raises(InputError, match="died 2 times in a row"):
        list(ordered(always_die, range(3), 1))


def fail(task: int) -> None:
    raise InputError(f"task {task} cannot be")


def test_errors_arrive_and_processes_end() -> None:
    with pytest.raises(InputError, match="task 0 cannot be"):
        list(ordered(fail, range(3), 1))
    assert not multiprocessing.active_children()


class HoldsALockError(Exception):
    def __init__(self) -> None:
        super().__init__("some text")
        self.lock = threading.Lock()


def fail_late(task: int) -> int:
    if task == 2:
        raise HoldsALockError
    return task


def test_an_error_comes_when_its_turn_does() -> None:
    results = ordered(fail_late, range(4), 2)
    assert [next(results), next(results)] == [0, 1]
    with pytest.raises(RuntimeError, match="HoldsALockError: some text") as caught:  # itself it cannot be sent
        next(results)
    assert "in fail_late" in str(caught.value.__cause__)


def sleep(task: int) -> int:
    time.sleep(60 if task else 0)
    return task


def test_closing_does_not_wait() -> None:
    results = ordered(sleep, range(5), 1)
    assert next(results) == 0
    start = time.monotonic()
    results.close()
    assert time.monotonic() - start < 10
    assert not multiprocessing.active_children()


ORPHAN = """
import os, sys, time
sys.path.insert(0, {tests!r})
from depthmocap.synth.writing.workers import ordered
from test_workers import tell_and_sleep
if __name__ == "__main__":
    list(ordered(tell_and_sleep, [sys.argv[1]], 1))
"""


def tell_and_sleep(path: str) -> None:
    Path(path + ".part").write_text(str(os.getpid()))
    Path(path + ".part").replace(path)
    time.sleep(60)


@posix
def test_workers_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    script, told = tmp_path / "main.py", tmp_path / "pid"
    script.write_text(ORPHAN.format(tests=str(Path(__file__).parent)))
    parent = subprocess.Popen([sys.executable, str(script), str(told)])
    wait_for(told.exists)
    worker = int(told.read_text())
    parent.kill()
    parent.wait()
    wait_for(lambda: not running(worker))


def wait_for(condition) -> None:
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
