"""The same set from a Ray cluster of this machine, with a worker killed half-way. Heavy: starts the cluster."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path
from typing import Any

import pytest
from file_contents import tree
from rich.console import Console
from watched import contacts, descendants, listening, watched_environment

from depthmocap import InputError
from depthmocap.synth.sample import Recipe
from depthmocap.synth.writing import units
from depthmocap.synth.writing.cluster import RayCluster
from depthmocap.synth.writing.generate import SynthSettings, generate

QUIET = Console(file=io.StringIO())


def test_a_missing_ray_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"pip install 'depthmocap\[cluster\]'"), RayCluster("local") as cluster:
        list(cluster.ordered(str, [1]))


def test_nobody_at_the_address() -> None:
    pytest.importorskip("ray")
    with (
        pytest.raises(InputError, match=r"no Ray cluster at --ray ray://127\.0\.0\.1:1 .*refused"),
        RayCluster("ray://127.0.0.1:1") as cluster,
    ):
        list(cluster.ordered(str, [1]))


def _check_order_and_errors() -> None:
    def fail(task: int) -> int:
        raise InputError(f"task {task} cannot be")

    with RayCluster("auto") as cluster:  # this process has one already
        assert list(cluster.ordered(lambda task: task * 2, range(7))) == [0, 2, 4, 6, 8, 10, 12]
        assert list(cluster.ordered(fail, [])) == []
        with pytest.raises(InputError, match="task 0 cannot be"):
            list(cluster.ordered(fail, range(3)))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_the_same_with_a_worker_killed(body_model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ray = pytest.importorskip("ray")
    monkeypatch.setattr(units, "_FRAMES_PER_UNIT", 3)
    settings = SynthSettings(tmp_path / "here", Recipe("easy", "test", views=1), 8, workers=0)
    here = generate(settings, QUIET)
    marker = tmp_path / "killed"

    def dies_once(unit: units.Unit) -> units.Made:
        made = units.make_unit(unit)
        if unit.start == 3:
            try:
                marker.touch(exist_ok=False)
            except FileExistsError:
                return made
            os._exit(1)  # its images are written, but nobody hears of them
        return made

    monkeypatch.setattr("depthmocap.synth.writing.generate.make_unit", dies_once)
    clusters: list[set[str]] = []
    start = ray.init

    def init(**options: Any) -> None:
        start(**options)
        _check_order_and_errors()
        clusters.append(listening(descendants(os.getpid())))

    monkeypatch.setattr(ray, "init", init)
    watch = tmp_path / "watch"
    watch.mkdir()
    for name, value in watched_environment(watch).items():
        monkeypatch.setenv(name, value)
    before = dict(os.environ)
    there = generate(SynthSettings(tmp_path / "there", settings.recipe, 8, ray="local"), QUIET)
    assert marker.exists()
    assert tree(there) == tree(here)
    assert not ray.is_initialized()
    assert dict(os.environ) == before
    if sys.platform == "linux":
        assert clusters == [{"127.0.0.1"}]  # one, which other machines do not reach
    assert len(clusters) == 1
    assert contacts(watch) == set()
