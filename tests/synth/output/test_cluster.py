"""The same set from a Ray cluster, with a worker killed half-way. Heavy: starts a cluster of two workers."""

from __future__ import annotations

import io
import os
from pathlib import Path

import pytest
from rich.console import Console

from depthmocap import InputError
from depthmocap.synth.output import units
from depthmocap.synth.output.cluster import ordered_on_ray
from depthmocap.synth.output.generate import SynthSettings, generate
from depthmocap.synth.sample import Recipe
from file_contents import tree

QUIET = Console(file=io.StringIO())


def test_a_missing_ray_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    with pytest.raises(InputError, match=r"pip install 'depthmocap\[cluster\]'"):
        list(ordered_on_ray(str, [1], "local"))


def test_nobody_at_the_address() -> None:
    pytest.importorskip("ray")
    with pytest.raises(InputError, match=r"no Ray cluster at --ray ray://127\.0\.0\.1:1 .*refused"):
        list(ordered_on_ray(str, [1], "ray://127.0.0.1:1"))


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory):
    ray = pytest.importorskip("ray")
    ray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="error")
    yield ray
    ray.shutdown()


@pytest.mark.filterwarnings("ignore")
def test_the_same_with_a_worker_killed(body_model, cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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

    monkeypatch.setattr("depthmocap.synth.output.generate.make_unit", dies_once)
    there = generate(SynthSettings(tmp_path / "there", settings.recipe, 8, ray="auto"), QUIET)
    assert marker.exists()
    assert tree(there) == tree(here)


@pytest.mark.filterwarnings("ignore")
def test_order_and_errors(cluster) -> None:
    assert list(ordered_on_ray(lambda task: task * 2, range(7), "auto")) == [0, 2, 4, 6, 8, 10, 12]

    def fail(task: int) -> int:
        raise InputError(f"task {task} cannot be")

    with pytest.raises(InputError, match="task 0 cannot be"):
        list(ordered_on_ray(fail, range(3), "auto"))
