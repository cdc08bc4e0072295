"""What labelling people in some of the views costs the joints, beside leaving out sets: a machine that is too slow.

    python benchmarks/sparing_cost.py [--people 2] [--seconds 6] [--json FILE]

plays the moving people of ``studio.py`` before four Kinects (extra ``train``) three times: labelled whole; as ``live``
does where it is late, in every second view, in turn; and labelled whole with every third set left out, whose joints are
those of the set before. Prints the joints' error, how far the error goes from set to set, and CPU time a set.
"""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table
from studio import Studio

from depthmocap.core.output import write_json
from depthmocap.frames import FrameSet
from depthmocap.offline.pipeline import Result
from depthmocap.offline.pipeline_settings import load_pipeline
from depthmocap.realtime.live_capture import WHOLE_EVERY, BackgroundSource

Way = Literal["whole", "sparing", "every third set left out"]
#: Sets until everybody is found and the room is known: they do not count.
FIRST = 30


@dataclasses.dataclass(frozen=True)
class SparingCost:
    """Settings.

    Attributes:
        people: one or two.
        seconds: of the scene.
        json: also write all numbers to this file.
    """

    people: int = 1
    seconds: float = 6.0
    json: Path | None = None


def play(way: Way, studio: Studio, sets: list[FrameSet], people: int) -> dict[str, float]:
    """Joint errors (cm) and CPU time (ms) of one way; of the person whose joints are known."""
    pipeline = load_pipeline(BackgroundSource(studio.rig, {}), people=people)
    away, result, begun_s = [], None, time.process_time()
    for i, frames in enumerate(sets):
        if i == FIRST:
            begun_s = time.process_time()
        if way != "every third set left out" or i % 3 or i < FIRST:
            result = pipeline.estimate(pipeline.label(frames, way == "sparing" and i % WHOLE_EVERY > 0))
        assert result is not None and frames.true_joints is not None
        if i >= FIRST:
            away.append(_nearest(result, frames.true_joints))
    cpu_s, away = time.process_time() - begun_s, np.stack(away)
    errors_cm, steps_cm = (100 * np.linalg.norm(each, axis=-1) for each in (away, np.diff(away, axis=0)))
    return {
        "mean_cm": float(errors_cm.mean()), "p95_cm": float(np.quantile(errors_cm, 0.95)),
        "step_cm": float(np.sqrt((steps_cm**2).mean())), "cpu_ms": 1e3 * cpu_s / len(away),
    }  # fmt: skip


def _nearest(result: Result, true_joints: np.ndarray) -> np.ndarray:
    """How far off the joints are of the person who is nearest to the true ones (metres)."""
    away = [person.pose.joints - true_joints for person in result.people]
    return min(away, key=lambda each: float(np.linalg.norm(each)))


def main(settings: SparingCost) -> None:
    """Play, print and write."""
    studio = Studio(settings.seconds, 30.0, people=settings.people)
    sets = list(studio)
    numbers: dict[str, Any] = {way: play(way, studio, sets, settings.people) for way in get_args(Way)}
    shown = Table()
    for column in ("sets are labelled", "error, cm", "p95", "from set to set, cm", "CPU, ms a set"):
        shown.add_column(column, justify="left" if column == "sets are labelled" else "right")
    for way, row in numbers.items():
        shown.add_row(way, *(f"{row[key]:.2f}" for key in ("mean_cm", "p95_cm", "step_cm")), f"{row['cpu_ms']:.1f}")
    Console().print(shown)
    if settings.json is not None:
        write_json(settings.json, numbers)


if __name__ == "__main__":
    main(tyro.cli(SparingCost))
