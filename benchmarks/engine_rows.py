"""Rows of the data engine as a whole: labelled 512×424 frames by two processes, made in memory or written."""

from __future__ import annotations

import dataclasses
import io
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from PIL import Image
from rich.console import Console
from timing import Bench, Reference, Row, Timing

from depthmocap.body.model import BodyModel
from depthmocap.body.regions import UNLABELLED
from depthmocap.datasets.ubc3v import encode_depth, encode_labels, image_paths
from depthmocap.datasets.ubc3v_write import write_images
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.output.generate import SynthSettings, generate
from depthmocap.synth.output.stream import draw
from depthmocap.synth.output.units import Layout
from depthmocap.synth.output.workers import ordered
from depthmocap.synth.people.bodies import random_phenotype
from depthmocap.synth.render import PosedPerson
from depthmocap.synth.sample import CameraRange, Recipe, Sampler, random_camera, see
from depthmocap.synth.sensing.sensors import SENSORS

_VIEWS = 3
#: Samples a task, and tasks a timed run.
_SAMPLES, _TASKS = 20, 12
_DRESSED = Recipe("open", views=_VIEWS, sensors=("kinect2",), noise="sensor")


def _bare(first: int) -> int:
    """Draw bare people of any build; the frames stay in this process, as when a network is trained."""
    model, prior = BodyModel.load(), PosturePrior.load()
    for index in range(first, first + _SAMPLES):
        rng = np.random.default_rng([1, index])
        person = PosedPerson(model.shape(random_phenotype(rng)).pose(prior.sample(rng)[0]))
        for _ in range(_VIEWS):
            see(person, None, random_camera(rng, person.body, CameraRange(), SENSORS["ubc3v"], "camera"))
    return _SAMPLES * _VIEWS


def _sampled(recipe: Recipe, first: int) -> int:
    draw = Sampler(recipe, seed=1)
    for index in range(first, first + _SAMPLES):
        draw(index)
    return _SAMPLES * _VIEWS


def _dressed(first: int) -> int:
    return _sampled(_DRESSED, first)


def _furnished(first: int) -> int:
    return _sampled(dataclasses.replace(_DRESSED, scene="full"), first)


def _milliseconds(function: Callable[[int], int], workers: int) -> Timing:
    """Wall-clock time a frame, over runs of as many tasks after a warm-up, process starts not counted."""
    tasks: Iterable[int] = range(0, 4 * _TASKS * _SAMPLES, _SAMPLES)
    times, frames, start = [], 0, 0.0
    for done, made in enumerate(ordered(function, tasks, workers), 1):
        frames += made
        if done % _TASKS == 0:
            now = time.perf_counter()
            if done > _TASKS:
                times.append((now - start) / frames * 1e3)
            frames, start = 0, now
    return Timing.of(np.array(times))


def frames(bench: Bench) -> None:
    """Milliseconds a frame with all cores at work; the goals are rates on two cores: 500, 250 and 150 a second."""
    workers = bench.threads
    for what, function, goal_ms in (
        ("Make a frame: bare, any build", _bare, 2.0),
        ("Make a frame: dressed, Kinect 2's errors", _dressed, 4.0),
        ("Make a frame: the same in a furnished room", _furnished, None),
    ):
        found = _milliseconds(function, workers)
        rate = f"{1000 / found.median_ms:.0f} frames a second by {workers} processes"
        bench.rows.append(Row(what, found, goal_ms=goal_ms, note=rate))


def written(bench: Bench) -> None:
    """The same to disk, starts of the processes included."""
    samples = 600
    goals: dict[Layout, float | None] = {"ubc3v": 1000 / 150, "shards": None}
    for layout, goal_ms in goals.items():
        folder = Path(bench.folder) / layout
        start = time.perf_counter()
        settings = SynthSettings(folder, Recipe("hard"), samples, format=layout, workers=bench.threads)
        generate(settings, Console(quiet=True))
        found = (time.perf_counter() - start) / (samples * _VIEWS) * 1e3
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / (samples * _VIEWS)
        note = f"{1000 / found:.0f} frames a second by {bench.threads} processes, {size / 1000:.1f} kB a frame"
        timing = Timing(found, found, found, 1)
        bench.rows.append(Row(f"Write a frame: hard, {layout}", timing, goal_ms=goal_ms, note=note))


def storing(bench: Bench) -> None:
    """The two pictures of a frame in UBC3V's layout, beside general code for the same pictures."""
    recipe = Recipe("hard", views=_VIEWS)
    views = [view for index in range(6) for view in draw(recipe, 0, index).views]

    def write_pillow() -> None:
        for view in views:
            assert view.mask is not None
            assert view.labels is not None
            labels = np.where(view.mask, np.where(view.labels == 0, np.uint8(UNLABELLED), view.labels), np.uint8(0))
            for path, rgba in (
                ("depth.png", encode_depth(view.depth_m, view.mask)),
                ("labels.png", encode_labels(labels)),
            ):
                data = io.BytesIO()
                Image.fromarray(rgba).save(data, "PNG", compress_level=3)
                (bench.folder / path).write_bytes(data.getvalue())

    def write_ours() -> None:
        for view in views:
            write_images(bench.folder / "written", 0, [view])

    write_ours()
    last = views[-1]
    assert last.mask is not None
    with Image.open(image_paths(bench.folder / "written", last.camera.name, 0)[0]) as image:
        same = bool((np.array(image) == encode_depth(last.depth_m, last.mask)).all())
    bench.measure(
        "Store a frame of UBC3V", write_ours, Reference("Pillow, level 3", write_pillow, len(views)),
        items=len(views), agrees=same, note="depth and labels, RGBA 512×424",
    )  # fmt: skip
