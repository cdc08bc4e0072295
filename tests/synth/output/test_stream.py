"""Samples on the fly: the same from any number of processes, which end as they should."""

from __future__ import annotations

import functools
import itertools
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from depthmocap import InputError
from depthmocap.body.model import BodyModel
from depthmocap.synth.output import stream as stream_module
from depthmocap.synth.output.stream import ordered, stream
from depthmocap.synth.sample import Recipe, Sample

RECIPE = Recipe(subset="easy", split="valid", views=2)


def alike(a: Sample, b: Sample) -> bool:
    return (
        bool((a.joints == b.joints).all())
        and a.group == b.group
        and all(
            (x.depth_m == y.depth_m).all()
            and (x.labels == y.labels).all()  # type: ignore[union-attr]
            and (x.camera.world_from_camera == y.camera.world_from_camera).all()
            for x, y in zip(a.views, b.views, strict=True)
        )
    )


def test_the_same_from_any_number_of_workers(body_model: BodyModel) -> None:
    here = list(stream(RECIPE, 3, 4, 9))
    assert [index for index, _ in here] == [4, 5, 6, 7, 8]
    there = list(stream(RECIPE, 3, 4, 9, workers=2, chunk=2))
    assert [index for index, _ in there] == [4, 5, 6, 7, 8]
    assert all(alike(a, b) for (_, a), (_, b) in zip(here, there, strict=True))
    ((_, other),) = stream(RECIPE, 4, 4, 5)
    assert not alike(here[0][1], other)
    assert [index for index, _ in itertools.islice(stream(RECIPE, 3), 2)] == [0, 1]  # without end


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
        os.kill(os.getpid(), signal.SIGKILL)
    return task


def test_the_task_of_a_killed_worker_is_done_again(tmp_path: Path) -> None:
    assert list(ordered(functools.partial(die_once, tmp_path), range(6), 1)) == list(range(6))
    assert (tmp_path / "died").exists()


def always_die(task: int) -> None:
    os._exit(9)


def test_workers_that_keep_dying_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream_module, "_DEATHS", 2)
    with pytest.raises(InputError, match="died 2 times in a row"):
        list(ordered(always_die, range(3), 1))


def fail(task: int) -> None:
    raise InputError(f"task {task} cannot be")


def test_errors_arrive_and_processes_end() -> None:
    with pytest.raises(InputError, match="task 0 cannot be"):
        list(ordered(fail, range(3), 1))
    assert not multiprocessing.active_children()


def sleep(task: int) -> int:
    time.sleep(60 if task else 0)
    return task


def test_closing_does_not_wait() -> None:
    results = ordered(sleep, range(5), 1)
    assert next(results) == 0
    start = time.monotonic()
    results.close()  # type: ignore[attr-defined]
    assert time.monotonic() - start < 10
    assert not multiprocessing.active_children()


ORPHAN = """
import os, sys, time
sys.path.insert(0, {tests!r})
from depthmocap.synth.output.stream import ordered
from test_stream import tell_and_sleep
if __name__ == "__main__":
    list(ordered(tell_and_sleep, [sys.argv[1]], 1))
"""


def tell_and_sleep(path: str) -> None:
    Path(path + ".part").write_text(str(os.getpid()))
    Path(path + ".part").replace(path)
    time.sleep(60)


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


def test_a_person_nobody_sees_is_an_error(body_model: BodyModel, monkeypatch: pytest.MonkeyPatch) -> None:
    ((_, sample),) = stream(RECIPE, stop=1)
    for view in sample.views:
        assert view.labels is not None
        view.labels[:] = 0
    monkeypatch.setattr(stream_module, "_sampler", lambda recipe, seed: lambda index: sample)
    with pytest.raises(InputError, match="sample 7: no camera sees the person"):
        list(stream(RECIPE, start=7, stop=8))


def test_settings_that_cannot_be() -> None:
    with pytest.raises(InputError, match="workers must be at least 0"):
        next(stream(RECIPE, workers=-1))
    with pytest.raises(InputError, match="chunk at least 1"):
        next(stream(RECIPE, chunk=0))
    assert not list(stream(RECIPE, start=2, stop=2))
