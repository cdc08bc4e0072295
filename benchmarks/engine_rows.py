"""Rows of the data engine as a whole: labelled 512×424 frames by two processes, made in memory or written."""

from __future__ import annotations

import dataclasses
import io
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from PIL import Image
from timing import Bench, Reference, Row, Timing

from depthmocap.body.regions import UNLABELLED
from depthmocap.datasets.ubc3v import encode_depth, encode_labels, image_paths
from depthmocap.datasets.ubc3v_write import write_images
from depthmocap.errors import InputError
from depthmocap.synth.body.mesh import BodyModel
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.people.bodies import random_phenotype
from depthmocap.synth.render import PosedPerson
from depthmocap.synth.sample import CameraRange, Noise, Recipe, Sampler, random_camera, see
from depthmocap.synth.sensing.sensors import SENSORS
from depthmocap.synth.writing.stream import draw
from depthmocap.synth.writing.units import Layout, Unit, make_unit, open_folder
from depthmocap.synth.writing.workers import ordered

_VIEWS = 3
#: Samples per task.
_SAMPLES = 20
#: Tasks per timed run.
_TASKS = 12
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
    """Wall-clock time per frame over runs of ``_TASKS`` tasks after a warm-up, without the start of the processes."""
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
        timing = _milliseconds(function, workers)
        rate = f"{1000 / timing.median_ms:.0f} frames a second by {workers} processes"
        bench.rows.append(Row(what, timing, goal_ms=goal_ms, note=rate))


@dataclasses.dataclass(frozen=True)
class Written:
    """Cost of writing a set with ``workers`` processes.

    Attributes:
        seconds: wall-clock time of ``frames``, after each process has written a unit.
        start_s: time until each process has drawn its first sample, not part of ``seconds``.
        driver_s: CPU time of this process for ``all_frames``, to store the ground truth; it does not scale with cores.
        size_bytes: size of the files of ``all_frames``.
    """

    workers: int
    frames: int
    seconds: float
    start_s: float
    all_frames: int
    driver_s: float
    size_bytes: int

    @property
    def frames_a_second(self) -> float:
        """The rate of all processes together."""
        return self.frames / self.seconds


def _first(number: int) -> None:
    draw(Recipe("hard", views=_VIEWS), 0, number)


def write_set(folder: Path, layout: Layout, noise: Noise, samples: int, workers: int) -> Written:
    """Write a set of the paper's hard kind as ``depthmocap synth`` does; ``folder`` must not exist."""
    start = time.perf_counter()
    for _ in ordered(_first, range(workers), workers):
        pass
    start_s = time.perf_counter() - start
    folder.mkdir(parents=True)
    recipe = Recipe("hard", views=_VIEWS, noise=noise)
    whole = Unit(folder, layout, recipe, 0, samples, "benchmark", 0, samples)
    target = open_folder(folder, layout)
    units = [dataclasses.replace(whole, start=start, stop=stop) for start, stop in target.missing(samples)]
    if len(units) <= 2 * workers:
        raise InputError(f"{samples} samples are {len(units)} units of work, too few for {workers} processes")
    frames, begun, ended, driver = 0, 0.0, 0.0, time.process_time()
    for number, made in enumerate(ordered(make_unit, units, workers)):
        target.commit(made)
        ended = time.perf_counter()
        if number + 1 <= workers:
            begun = ended
        else:
            frames += len(made.unit.indices) * _VIEWS
    target.close()
    driver = time.process_time() - driver
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    return Written(workers, frames, ended - begun, start_s, samples * _VIEWS, driver, size)


def written(bench: Bench) -> None:
    """Frames of the paper's hard set on disk, without the start of the processes, which the note gives."""
    samples = max(2002, 600 * bench.threads)
    cases: tuple[tuple[Layout, Noise, float | None], ...] = (
        ("ubc3v", "none", 1000 / 150),
        ("ubc3v", "sensor", None),
        ("shards", "none", None),
    )
    for layout, noise, goal_ms in cases:
        cost = write_set(bench.folder / f"{layout}-{noise}", layout, noise, samples, bench.threads)
        milliseconds = 1000 / cost.frames_a_second
        note = (
            f"{cost.frames_a_second:.0f} frames a second by {cost.workers} processes, of {cost.frames} frames; "
            f"before it {cost.start_s:.1f} s of start; {cost.size_bytes / cost.all_frames / 1000:.1f} kB a frame"
        )
        what = f"Write a frame: hard, {layout}" + ("" if noise == "none" else ", Kinect 2's errors")
        timing = Timing(milliseconds, milliseconds, milliseconds, 1)
        bench.rows.append(Row(what, timing, goal_ms=goal_ms, note=note))


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
