"""``depthmocap evaluate people``: are people found, told apart, followed and known again, and is one of several as good
as alone?"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.classify.classifier import Classifier
from depthmocap.core.console import Terminal
from depthmocap.core.locks import owns
from depthmocap.core.output import check_outputs, write_json
from depthmocap.core.settings import check_seed, plain_settings
from depthmocap.errors import InputError
from depthmocap.evaluate.encounter import Encounter, Moment
from depthmocap.evaluate.scenarios import Beside, Empty, Meeting, Story, Visits
from depthmocap.frames import FrameSet
from depthmocap.offline.pipeline import Pipeline, Segmenter
from depthmocap.pose.estimators import load_estimator
from depthmocap.segment.people_segmenter import PeopleSegmenter, PersonMasks
from depthmocap.segment.static_scene import PersonSegmenter
from depthmocap.segment.tracking import GONE_S

#: Somebody is in view when they show so much surface to all cameras together (m²), and found when the masks overlap.
IN_VIEW_M2, FOUND = 0.25, 0.5
#: The second person spoils the first most when they are nearer to each other than this (metres).
NEAR_M = 1.2
_HIP = JOINT_INDEX["Hip"]

Masks = tuple[Bool[ndarray, "_ _"], ...]


@dataclasses.dataclass(frozen=True)
class PeopleEvaluation:
    """People in generated scenes.

    Attributes:
        story: meeting: two come, cross, stand side by side, push a chair, go and return. returns: two or three come and
            go, and all are away before they return. beside: one stands close to furniture when it begins, and an empty
            room.
        scenes: so many of each kind that the story has, of other people, cameras and ways.
        cameras: in each.
        rate_hz: sets a second.
        apart_m: between the two when they stand side by side, from middle to middle.
        joints: of a meeting, measure the first person's joints as well, with the second one there and without; most of
            the time goes there.
        json: file for all numbers.
    """

    story: Literal["meeting", "returns", "beside"] = "meeting"
    scenes: int = 4
    cameras: int = 3
    rate_hz: float = 15.0
    apart_m: float = 0.5
    seed: int = 0
    joints: bool = True
    json: Path | None = None

    def __post_init__(self) -> None:
        check_seed(self.seed)
        check_outputs({"--json": self.json})
        if min(self.scenes, self.cameras) < 1 or not 1 <= self.rate_hz <= 60 or not 0.2 <= self.apart_m <= 1:
            raise InputError("--scenes and --cameras take at least 1, --rate-hz 1 to 60, --apart-m 0.2 to 1")


class _EachView:
    """One person by each view alone: the largest body there."""

    people = 1

    def __init__(self, segmenter: PersonSegmenter) -> None:
        self._segmenter, self.problems = segmenter, segmenter.problems

    def __call__(self, frames: FrameSet) -> tuple[PersonMasks, ...]:
        return (PersonMasks(1, tuple(self._segmenter(view) for view in frames.views)),)

    def reset(self) -> None:
        """Nothing is remembered."""


class _True:
    """The masks that the frames bring."""

    people = 1

    def __init__(self) -> None:
        self.problems: list[str] = []

    def __call__(self, frames: FrameSet) -> tuple[PersonMasks, ...]:
        masks = [view.mask for view in frames.views]
        assert all(mask is not None for mask in masks)
        return (PersonMasks(1, tuple(mask for mask in masks if mask is not None)),)

    def reset(self) -> None:
        """Nothing is remembered."""


@owns(files=("json",))
def evaluate_people(settings: PeopleEvaluation, console: Console | None = None) -> dict[str, Any]:
    """Make the scenes, follow the people in them and print what became of it; returns the numbers."""
    console = console or Terminal(stderr=True)
    rng = np.random.default_rng(settings.seed)
    numbers: dict[str, Any] = {"settings": plain_settings(settings)}
    errors: dict[str, list[ndarray]] = {}
    for kind, story, backgrounds in _kinds(settings):
        followings = {background: Following() for background in backgrounds}
        for index in range(settings.scenes):
            encounter = Encounter(rng, story, settings.cameras, settings.rate_hz)
            for background, following in followings.items():
                known = encounter.backgrounds_m if background == "known" else {}
                following.begin(PeopleSegmenter(known, people=max(encounter.count, 1)), encounter.count)
            joints = FirstJoints(encounter) if settings.joints and settings.story == "meeting" else None
            description = f"{kind}, scene {index + 1} of {settings.scenes}"
            moments = encounter.moments()
            for moment in track(moments, description, len(encounter.times_s), console=console, transient=True):
                for following in followings.values():
                    following.add(moment)
                if joints is not None:
                    joints.add(moment)
            if joints is not None:
                for name, found in joints.finish(encounter.moments(alone=True)).items():
                    errors.setdefault(name, []).append(found)
        numbers |= {
            f"{kind}, background {background}": following.numbers() for background, following in followings.items()
        }
    if errors:
        numbers["first person's joints, cm"] = {name: _error_row(found) for name, found in errors.items()}
    _tell(numbers, console)
    if settings.json is not None:
        write_json(settings.json, numbers)
    return numbers


def _kinds(settings: PeopleEvaluation) -> list[tuple[str, Story, tuple[str, ...]]]:
    """Names, stories, and what is known of the background."""
    if settings.story == "meeting":
        return [("meeting", Meeting(settings.apart_m), ("known", "learnt"))]
    if settings.story == "beside":
        return [("beside furniture", Beside(), ("learnt",)), ("empty room", Empty(), ("learnt",))]
    return [
        ("two, unlike", Visits(2), ("known",)),
        ("two, alike", Visits(2, alike=True), ("known",)),
        ("three, unlike", Visits(3), ("known",)),
        ("three, alike", Visits(3, alike=True), ("known",)),
        ("two and a newcomer", Visits(3, newcomer=True), ("known",)),
    ]


class Following:
    """What becomes of the people in scenes: overlaps of their masks, numbers given, delays, and time spent."""

    def __init__(self) -> None:
        self._overlaps: list[float] = []
        self._first_s: list[float] = []
        self._returns = {"old": 0, "new": 0, "wrong": 0}
        self._ghosts = self._sets = self._views = self._switches = 0
        self._spent_s = 0.0

    def begin(self, segmenter: PeopleSegmenter, count: int) -> None:
        """Begin a scene with so many people."""
        self._segmenter = segmenter
        self._people = [_Followed() for _ in range(count)]

    def add(self, moment: Moment) -> None:
        """Follow into the next set."""
        if not self._sets:  # compiles, which is not to count
            self._segmenter(moment.frames)
            self._segmenter.reset()
        threads = cv2.getNumThreads()
        cv2.setNumThreads(1)  # threads that wait count as work
        start = time.process_time()
        people = self._segmenter(moment.frames)
        self._spent_s += time.process_time() - start
        cv2.setNumThreads(threads)
        self._sets += 1
        self._views += len(moment.frames.views)
        now_s, taken = moment.frames.timestamp_ns * 1e-9, set()
        for person, true in zip(self._people, moment.masks, strict=True):
            if surface_m2(moment.frames, true) < IN_VIEW_M2:
                person.came_s = np.nan
                continue
            if np.isnan(person.came_s):
                person.came_s, person.awaited = now_s, True
            best, number = max(((overlap(own.masks, true), own.number) for own in people), default=(0.0, 0))
            self._overlaps.append(best)
            if best >= FOUND:
                taken.add(number)
                self._find(person, number, now_s)
        for own in people:
            if own.number not in taken and surface_m2(moment.frames, own.masks) >= IN_VIEW_M2:
                self._ghosts += max((overlap(own.masks, true) for true in moment.masks), default=0.0) < 0.2

    def _find(self, person: _Followed, number: int, now_s: float) -> None:
        others = {number for each in self._people if each is not person for number in each.numbers}
        if person.awaited:
            self._first_s.append(now_s - person.came_s)
            if person.numbers and person.came_s - person.found_s > GONE_S:
                self._returns["old" if number in person.numbers else "wrong" if number in others else "new"] += 1
            elif not person.numbers:
                self._returns["wrong"] += number in others
        person.awaited = False
        self._switches += bool(person.numbers) and number != person.numbers[-1]
        if number not in person.numbers[-1:]:
            person.numbers.append(number)
        person.found_s = now_s

    def numbers(self) -> dict[str, float | int]:
        """What became of all."""
        overlaps, first_s = np.array(self._overlaps), np.array(self._first_s)
        numbers: dict[str, float | int] = {
            "sets": self._sets,
            "ghost_sets": self._ghosts,
            "cpu_ms_per_view": self._spent_s * 1e3 / self._views,
        }
        if not len(overlaps):
            return numbers
        return numbers | {
            "persons_in_sets": len(overlaps),
            "overlap_mean": float(overlaps.mean()),
            "overlap_p5": float(np.quantile(overlaps, 0.05)),
            "found_share": float((overlaps >= FOUND).mean()),
            "switches": self._switches,
            **{f"returns_{outcome}": count for outcome, count in self._returns.items()},
            "arrivals": len(first_s),
            "first_mask_s_p50": float(np.median(first_s)),
            "first_mask_s_most": float(first_s.max()),
        }


@dataclasses.dataclass(eq=False)
class _Followed:
    """Somebody in a scene: their numbers so far, when they came into view, whether they are still waited for, and when
    they were last found."""

    numbers: list[int] = dataclasses.field(default_factory=list)
    came_s: float = np.nan
    awaited: bool = False
    found_s: float = np.nan


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


class FirstJoints:
    """Errors of the first person's joints, by ways of finding the person; nothing is smoothed."""

    def __init__(self, encounter: Encounter) -> None:
        classifier, estimator = Classifier(), load_estimator()
        ways: dict[str, Segmenter] = {
            "with true masks": _True(),
            "by all cameras": PeopleSegmenter(encounter.backgrounds_m),
            "by each view": _EachView(PersonSegmenter(encounter.backgrounds_m)),
            "alone": PeopleSegmenter(encounter.backgrounds_m),
        }
        self._pipelines = {name: Pipeline(classifier, estimator, way) for name, way in ways.items()}
        self._errors: dict[str, list[float]] = {name: [] for name in ways}
        self._gaps: list[float] = []

    def add(self, moment: Moment) -> None:
        """Estimate with the second person there."""
        if np.isfinite(moment.joints[0]).all():
            self._gaps.append(float(np.linalg.norm(moment.joints[0][_HIP, :2] - moment.joints[1][_HIP, :2])))
        for name in self._pipelines:
            if name != "alone":
                self._estimate(name, _with_masks(moment) if name == "with true masks" else moment.frames)

    def finish(self, alone: Iterable[Moment]) -> dict[str, Float[ndarray, "n 2"]]:
        """Estimate without the second person; errors (cm, NaN where missing) and distances of the two (metres)."""
        for moment in alone:
            self._estimate("alone", moment.frames)
        return {name: np.stack([errors, self._gaps], 1) for name, errors in self._errors.items()}

    def _estimate(self, name: str, frames: FrameSet) -> None:
        assert frames.true_joints is not None
        joints = self._pipelines[name](frames).pose.joints
        if np.isfinite(frames.true_joints).all():  # in the room
            self._errors[name].append(100 * float(np.linalg.norm(joints - frames.true_joints, axis=1).mean()))


def _with_masks(moment: Moment) -> FrameSet:
    views = [
        dataclasses.replace(view, mask=mask) for view, mask in zip(moment.frames.views, moment.masks[0], strict=True)
    ]
    return dataclasses.replace(moment.frames, views=tuple(views))


def _error_row(scenes: Sequence[Float[ndarray, "_ 2"]]) -> dict[str, float]:
    errors, gaps = np.concatenate(scenes).T
    near = gaps < NEAR_M  # NaN while one of them is not there
    return {
        "mean": float(np.nanmean(errors)),
        "near": float(np.nanmean(errors[near])),
        "over_10cm": float((errors[np.isfinite(errors)] > 10).mean()),
        "missing": float(np.isnan(errors).mean()),
    }


def _tell(numbers: dict[str, Any], console: Console) -> None:
    rows = {name: row for name, row in numbers.items() if "sets" in row}
    table = Table(title="people in their masks", title_justify="left")
    for heading in ("", "sets", "overlap", "p5", "found", "switches", "old, new, wrong", "mask after s", "at most",
                    "ghosts", "CPU ms"):  # fmt: skip
        table.add_column(heading, justify="right" if heading else "left")
    for name, row in rows.items():
        found = ["–"] * 7
        if "arrivals" in row:
            found = [
                f"{row['overlap_mean']:.3f}", f"{row['overlap_p5']:.3f}", f"{row['found_share']:.1%}",
                f"{row['switches']}", f"{row['returns_old']}, {row['returns_new']}, {row['returns_wrong']}",
                f"{row['first_mask_s_p50']:.2f}", f"{row['first_mask_s_most']:.2f}",
            ]  # fmt: skip
        table.add_row(name, f"{row['sets']}", *found, f"{row['ghost_sets']}", f"{row['cpu_ms_per_view']:.2f}")
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
