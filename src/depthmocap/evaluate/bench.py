"""``depthmocap evaluate bench``: the project's own test sets, generated from their recipes.

Anyone with the same clips can make the same sets; without clips the postures come from the packaged prior.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from rich.console import Console
from rich.progress import Progress
from scipy.spatial.transform import Rotation

from depthmocap.core.console import Terminal
from depthmocap.core.cores import usable_cores
from depthmocap.core.locks import locks_outputs
from depthmocap.core.settings import check_seed, plain_settings
from depthmocap.errors import InputError
from depthmocap.evaluate.accuracy import AccuracyEvaluation, check_views, measure_accuracy, print_numbers
from depthmocap.evaluate.evaluation_report import FILES, about, write_outputs
from depthmocap.evaluate.found_masks import with_found_masks
from depthmocap.frames import FrameSet
from depthmocap.geometry import DepthCamera
from depthmocap.segment.people_detector import PeopleDetector
from depthmocap.synth.motion.postures import ClipPostures, posture_source
from depthmocap.synth.sample import BENCH, Recipe
from depthmocap.synth.writing.stream import stream

SceneName: TypeAlias = Literal["off", "training", "full"]


@dataclasses.dataclass(frozen=True)
class BenchEvaluation(AccuracyEvaluation):
    """Accuracy of labels and joints on the project's own test sets.

    People of all builds in clothes, any sensor with its errors, cameras anywhere around; clothes and a sensor that
    training never shows; and people who sit or lay their hands on themselves.

    Attributes:
        postures: folder of motion capture clips, or a pool made of them, of which the test split is taken; without it
            postures come from the packaged prior (an easier set, not disjoint from training: bench-prior).
        samples: postures per set.
        sets: names of the sets.
        views: cameras around each posture.
        scene: what is around the people: "off" nothing, "training" things that hide them or touch them, "full"
            furnished rooms, with somebody else in some.
        masks: "true" ones, or those that the network finds without an empty scene (of several people found, the one who
            overlaps most with the true masks).
        misplaced_mm: error of each camera's position, in a random direction.
        misplaced_deg: error of each camera's rotation, about a random axis.
        workers: processes that make the images.
    """

    postures: Path | None = None
    samples: int = 300
    sets: tuple[str, ...] = tuple(BENCH)
    views: int = 3
    scene: SceneName = "off"
    masks: Literal["true", "network"] = "true"
    seed: int = 1
    misplaced_mm: float = 0.0
    misplaced_deg: float = 0.0
    workers: int = usable_cores()


def _frames(recipe: Recipe, settings: BenchEvaluation) -> Iterator[FrameSet]:
    detector = PeopleDetector() if settings.masks == "network" else None
    for index, sample in stream(recipe, settings.seed, 0, settings.samples, settings.workers):
        rng = np.random.default_rng([settings.seed, index, 17])
        views = tuple(dataclasses.replace(view, camera=_misplaced(view.camera, settings, rng)) for view in sample.views)
        yield FrameSet(index, views if detector is None else with_found_masks(views, detector), sample.joints)


def _misplaced(camera: DepthCamera, settings: BenchEvaluation, rng: np.random.Generator) -> DepthCamera:
    """The camera with a random error of its pose."""
    shift, axis = (direction / np.linalg.norm(direction) for direction in rng.normal(size=(2, 3)))
    pose = camera.world_from_camera.copy()
    pose[:3, :3] = Rotation.from_rotvec(axis * np.radians(settings.misplaced_deg)).as_matrix() @ pose[:3, :3]
    pose[:3, 3] += shift * settings.misplaced_mm / 1000
    return dataclasses.replace(camera, world_from_camera=pose)


@locks_outputs(files=FILES)
def evaluate_bench(settings: BenchEvaluation, console: Console | None = None) -> dict[str, Any]:
    """Make and measure the sets; returns their numbers by name. Samples are independent, nothing is smoothed.

    Raises:
        InputError: a set that does not exist, a number out of range, or clips, weights or regressors that cannot be
            read.
    """
    check_seed(settings.seed)
    check_views(settings.views)
    console = console or Terminal(stderr=True)
    if not (0 <= settings.misplaced_mm < np.inf and 0 <= settings.misplaced_deg <= 180):
        raise InputError("--misplaced-mm must be at least 0 and --misplaced-deg from 0 to 180")
    if settings.masks == "network" and settings.labels == "true":
        raise InputError("--masks network goes with --labels network: true labels are of the true masks")
    unknown = [name for name in settings.sets if name not in BENCH]
    if unknown or not settings.sets or settings.samples < 1:
        raise InputError(f"--sets takes {', '.join(map(repr, BENCH))} and --samples at least 1; got {settings.sets}")
    stages = settings.load()
    source = posture_source(settings.postures, "test")
    clips = source.names if isinstance(source, ClipPostures) else []  # none: postures are of the prior
    numbers: dict[str, Any] = {}
    for name in settings.sets:
        recipe = dataclasses.replace(
            BENCH[name], postures=settings.postures, views=settings.views, scene=settings.scene
        )
        with Progress(console=console) as progress:
            frames = progress.track(_frames(recipe, settings), settings.samples, description=name)
            result = measure_accuracy(frames, settings.views, *stages)
        assert result is not None  # every sample has labels and joints
        numbers[name] = {"recipe": plain_settings(recipe), "seed": settings.seed, "clips": clips, **result}
        print_numbers(f"bench, {name}", result, console)
    settings_kept = about(settings)
    write_outputs(
        settings,
        "Our own test sets",
        {name: {"about": settings_kept, **result} for name, result in numbers.items()},
        numbers,
    )
    return numbers
