"""``depthmocap evaluate people``: are several people found, told apart and followed, and is one as good as alone?"""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from rich.console import Console
from rich.table import Table

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.capture.segment import PersonSegmenter
from depthmocap.classify.runtime import Classifier
from depthmocap.errors import InputError
from depthmocap.evaluate.encounter import Encounter, Moment
from depthmocap.frames import FrameSet
from depthmocap.people.segmenter import PeopleSegmenter, SeenPerson
from depthmocap.pipeline import Pipeline, Segmenter
from depthmocap.pose.estimate import load_estimator
from depthmocap.settings import check_seed, plain_settings

#: Somebody is in view when they show so much surface to all cameras together (m²), and found when the masks overlap.
IN_VIEW_M2, FOUND = 0.25, 0.5
#: The second person spoils the first most when they are nearer to each other than this (metres).
NEAR_M = 1.2
_HIP = JOINT_INDEX["Hip"]

Masks = tuple[Bool[ndarray, "_ _"], ...]


@dataclasses.dataclass(frozen=True)
class PeopleEvaluation:
    """Two people come, cross, stand side by side, push a chair, go and return, in generated scenes.

    Attributes:
        scenes: so many, of other people, cameras and ways.
        cameras: in each.
        rate_hz: sets a second.
        apart_m: between the two when they stand side by side, from middle to middle.
        joints: measure the first person's joints as well, with the second one there and without; most of the time goes
            there.
        json: file for all numbers.
    """

    scenes: int = 4
    cameras: int = 3
    rate_hz: float = 15.0
    apart_m: float = 0.5
    seed: int = 0
    joints: bool = True
    json: Path | None = None

    def __post_init__(self) -> None:
        check_seed(self.seed)
        if min(self.scenes, self.cameras) < 1 or not 1 <= self.rate_hz <= 60 or not 0.2 <= self.apart_m <= 1:
            raise InputError("--scenes and --cameras take at least 1, --rate-hz 1 to 60, --apart-m 0.2 to 1")


class _EachView:
    """One person by each view alone: the largest body there."""

    def __init__(self, segmenter: PersonSegmenter) -> None:
        self._segmenter = segmenter

    def __call__(self, frames: FrameSet) -> tuple[SeenPerson, ...]:
        return (SeenPerson(1, tuple(self._segmenter(view) for view in frames.views)),)

    def reset(self) -> None:
        """Nothing is remembered."""


class _True:
    """The masks that the frames bring."""

    def __call__(self, frames: FrameSet) -> tuple[SeenPerson, ...]:
        masks = [view.mask for view in frames.views]
        assert all(mask is not None for mask in masks)
        return (SeenPerson(1, tuple(mask for mask in masks if mask is not None)),)

    def reset(self) -> None:
        """Nothing is remembered."""


def evaluate_people(settings: PeopleEvaluation, console: Console | None = None) -> dict[str, Any]:
    """Make the scenes, follow the people in them and print what became of it; returns the numbers."""
    console = console or Console(stderr=True)
    rng = np.random.default_rng(settings.seed)
    known: list[dict[str, Any]] = []
    learnt: list[dict[str, Any]] = []
    errors: dict[str, list[ndarray]] = {}
    for index in range(settings.scenes):
        with console.status(f"scene {index + 1} of {settings.scenes}"):
            encounter = Encounter(rng, settings.cameras, settings.rate_hz, settings.apart_m)
            moments = list(encounter.moments())
            known.append(follow_people(encounter.backgrounds_m, moments))
            learnt.append(follow_people({}, moments))
            if settings.joints:
                for name, found in _first_joints(encounter, moments).items():
                    errors.setdefault(name, []).append(found)
    numbers: dict[str, Any] = {
        "settings": plain_settings(settings),
        "background known": _pooled(known),
        "background learnt": _pooled(learnt),
    }
    if errors:
        numbers["first person's joints, cm"] = {name: _error_row(found) for name, found in errors.items()}
    _tell(numbers, console)
    if settings.json is not None:
        settings.json.parent.mkdir(parents=True, exist_ok=True)
        settings.json.write_text(json.dumps(numbers, indent=1) + "\n")
    return numbers


def follow_people(backgrounds_m: Mapping[str, Float[ndarray, "_ _"]], moments: Sequence[Moment]) -> dict[str, Any]:
    """What became of the people in one scene: overlaps of the masks, numbers given, delays and time."""
    for moment in moments[:2]:  # compiles, which is not to count
        PeopleSegmenter(backgrounds_m, people=2)(moment.frames)
    segmenter = PeopleSegmenter(backgrounds_m, people=2)
    overlaps: list[list[float]] = [[], []]
    numbers: list[list[int]] = [[], []]
    first_s: list[list[float]] = [[], []]
    #: When each came into view, and whether they are still waited for.
    came_s, awaited = [np.nan, np.nan], [False, False]
    ghosts = 0
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    spent_s = 0.0
    for moment in moments:
        start = time.process_time()
        people = segmenter(moment.frames)
        spent_s += time.process_time() - start
        now_s = moment.frames.timestamp_ns * 1e-9
        taken = set()
        for k, true in enumerate(moment.masks):
            if surface_m2(moment.frames, true) < IN_VIEW_M2:
                came_s[k] = np.nan
                continue
            if np.isnan(came_s[k]):
                came_s[k], awaited[k] = now_s, True
            best, number = max(((overlap(own.masks, true), own.number) for own in people), default=(0.0, 0))
            overlaps[k].append(best)
            if best >= FOUND:
                numbers[k].append(number)
                taken.add(number)
                if awaited[k]:
                    first_s[k].append(now_s - came_s[k])
                awaited[k] = False
        for own in people:
            if own.number not in taken:
                seen = surface_m2(moment.frames, own.masks) >= IN_VIEW_M2
                true = max((overlap(own.masks, true) for true in moment.masks), default=0.0)
                ghosts += seen and true < 0.2
    cv2.setNumThreads(threads)
    return {
        "overlaps": [value for own in overlaps for value in own],
        "switches": sum(int(np.count_nonzero(np.diff(own))) for own in numbers),
        "first_s": [value for own in first_s for value in own],
        "ghost_sets": ghosts,
        "sets": len(moments),
        "ms_per_view": spent_s * 1e3 / sum(len(moment.frames.views) for moment in moments),
    }


def overlap(found: Masks, true: Masks) -> float:
    """Intersection over union of masks in all views together; 0 where both are empty."""
    both = sum(int(np.count_nonzero(a & b)) for a, b in zip(found, true, strict=True))
    either = sum(int(np.count_nonzero(a | b)) for a, b in zip(found, true, strict=True))
    return both / max(either, 1)


def surface_m2(frames: FrameSet, masks: Masks) -> float:
    """Surface across the line of sight that masks show to all cameras together."""
    return sum(
        float((view.depth_m[mask] ** 2).sum() / (view.camera.fx * view.camera.fy))
        for view, mask in zip(frames.views, masks, strict=True)
    )


def _first_joints(encounter: Encounter, moments: Sequence[Moment]) -> dict[str, Float[ndarray, "n 2"]]:
    """Mean error of the first person's joints (cm, NaN where missing) and distance to the second (metres), by way of
    finding the person."""
    alone = list(encounter.moments((True, False)))
    true = [_with_masks(moment) for moment in moments]
    rows = {
        "with true masks": (_True(), true),
        "by all cameras": (PeopleSegmenter(encounter.backgrounds_m), [moment.frames for moment in moments]),
        "by each view": (_EachView(PersonSegmenter(encounter.backgrounds_m)), [m.frames for m in moments]),
        "alone": (PeopleSegmenter(encounter.backgrounds_m), [moment.frames for moment in alone]),
    }
    gaps = np.array([np.linalg.norm(m.joints[0][_HIP, :2] - m.joints[1][_HIP, :2]) for m in moments])
    return {
        name: np.stack([joint_errors_cm(segmenter, frames, [m.joints[0] for m in moments]), gaps], 1)
        for name, (segmenter, frames) in rows.items()
    }


def joint_errors_cm(
    segmenter: Segmenter, frames: Iterable[FrameSet], truths: Sequence[Float[ndarray, "18 3"]]
) -> Float[ndarray, " n"]:
    """Mean distance of a set's joints from the truth; NaN where there is no truth or no estimate."""
    pipeline = Pipeline(Classifier(), load_estimator(), segmenter)
    found = [pipeline(each).pose.joints for each in frames]
    return 100 * np.linalg.norm(np.stack(found) - np.stack(truths), axis=2).mean(1)


def _with_masks(moment: Moment) -> FrameSet:
    views = [
        dataclasses.replace(view, mask=mask) for view, mask in zip(moment.frames.views, moment.masks[0], strict=True)
    ]
    return dataclasses.replace(moment.frames, views=tuple(views))


def _pooled(scenes: Sequence[dict[str, Any]]) -> dict[str, float]:
    overlaps = np.concatenate([scene["overlaps"] for scene in scenes])
    first_s = np.concatenate([scene["first_s"] for scene in scenes])
    return {
        "persons_in_sets": len(overlaps),
        "overlap_mean": float(overlaps.mean()),
        "overlap_p5": float(np.quantile(overlaps, 0.05)),
        "found_share": float((overlaps >= FOUND).mean()),
        "switches": sum(scene["switches"] for scene in scenes),
        "arrivals": len(first_s),
        "first_mask_s_p50": float(np.median(first_s)),
        "first_mask_s_most": float(first_s.max()),
        "ghost_sets": sum(scene["ghost_sets"] for scene in scenes),
        "sets": sum(scene["sets"] for scene in scenes),
        "cpu_ms_per_view": float(np.mean([scene["ms_per_view"] for scene in scenes])),
    }


def _error_row(scenes: Sequence[Float[ndarray, "_ 2"]]) -> dict[str, float]:
    errors, gaps = np.concatenate(scenes).T
    near = gaps < NEAR_M
    return {
        "mean": float(np.nanmean(errors)),
        "near": float(np.nanmean(errors[near])),
        "over_10cm": float((errors[np.isfinite(errors)] > 10).mean()),
        "missing": float(np.isnan(errors).mean()),
    }


def _tell(numbers: dict[str, Any], console: Console) -> None:
    table = Table(title="people in their masks", title_justify="left")
    for heading in ("", "overlap", "p5", "found", "switches", "first mask s", "at most s", "ghosts", "CPU ms a view"):
        table.add_column(heading, justify="right" if heading else "left")
    for name in ("background known", "background learnt"):
        row = numbers[name]
        table.add_row(
            name, f"{row['overlap_mean']:.3f}", f"{row['overlap_p5']:.3f}", f"{row['found_share']:.1%}",
            f"{row['switches']} in {row['arrivals']} arrivals", f"{row['first_mask_s_p50']:.2f}",
            f"{row['first_mask_s_most']:.2f}", f"{row['ghost_sets']} of {row['sets']} sets",
            f"{row['cpu_ms_per_view']:.2f}",
        )  # fmt: skip
    console.print(table)
    if (errors := numbers.get("first person's joints, cm")) is None:
        return
    table = Table(title="first person's joints, nothing smoothed", title_justify="left")
    for heading in ("found", "error cm", f"second within {NEAR_M} m", "over 10 cm", "missing"):
        table.add_column(heading, justify="left" if heading == "found" else "right")
    for name, row in errors.items():
        table.add_row(
            name, f"{row['mean']:.2f}", f"{row['near']:.2f}", f"{row['over_10cm']:.1%}", f"{row['missing']:.1%}"
        )
    console.print(table)
