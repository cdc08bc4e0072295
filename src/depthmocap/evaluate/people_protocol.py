"""``depthmocap evaluate people``: segmentation, tracking and re-identification of several people.

It also compares the joint error of a person among several with that of the same person alone.
"""

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
from depthmocap.core.locks import locks_outputs
from depthmocap.core.network_devices import NetworkSettings, networks_on
from depthmocap.core.output import check_outputs, write_json
from depthmocap.core.settings import check_seed, plain_settings
from depthmocap.errors import InputError
from depthmocap.evaluate.empty_rooms import EmptyRoomScene
from depthmocap.evaluate.posture_scenarios import ACTS, STILL_RATE_HZ, Act, PostureScenario
from depthmocap.evaluate.posture_scene import PostureScene
from depthmocap.evaluate.scenario_scene import ScenarioScene, SceneFrame
from depthmocap.evaluate.scenarios import BesideFurniture, EmptyRoom, Meeting, Scenario, Visits
from depthmocap.frames import FrameSet
from depthmocap.offline.pipeline import Pipeline, Segmenter
from depthmocap.pose.estimators import load_estimator
from depthmocap.segment.network_segmenter import NetworkSegmenter
from depthmocap.segment.people_detector import PeopleDetector
from depthmocap.segment.people_segmenter import PeopleSegmenter, PersonMasks
from depthmocap.segment.static_scene import PersonSegmenter
from depthmocap.segment.tracking import GONE_S

#: A person is in view when all cameras together see at least this much of the surface, m².
IN_VIEW_M2 = 0.25
#: A small child is in view from this much surface on, m².
IN_VIEW_CHILD_M2 = 0.06
#: A person is detected when the intersection over union of the masks is at least this.
MIN_IOU = 0.5
#: A detected person who overlaps with nobody by this much is counted as a ghost.
GHOST_IOU = 0.2
#: Two people are near each other below this distance, metres: the second disturbs the first most there.
NEAR_M = 1.2
#: Frame sets of a room without people.
_ROOM_SETS = 6
_HIP = JOINT_INDEX["Hip"]

Masks = tuple[Bool[ndarray, "_ _"], ...]


@dataclasses.dataclass(frozen=True)
class PeopleEvaluation(NetworkSettings):
    """People in generated scenes.

    Attributes:
        scenario: meeting: two people enter, cross, stand side by side, push a chair, leave and return. returns: two or
            three people enter and leave, and all are away before they return. beside: one person stands close to
            furniture from the start, and an empty room. postures: people who stand, sit or lie, for long, who fall,
            touch or are small, sit in a wheelchair or lie in bed, or are seen by one camera alone, with and without a
            known empty scene. rooms: furnished rooms without anybody, a third of them with something that moves.
        acts: which of the postures.
        segment: ways of finding people to compare.
        weights: a people.onnx of your own.
        scenes: number of scenes of each kind, with other people, cameras and trajectories.
        cameras: number of cameras.
        rate_hz: frame sets per second.
        apart_m: distance of the two people who stand side by side, from middle to middle.
        joints: in a meeting, also measure the first person's joints, with and without the second person; this takes
            most of the time.
        json: file for all numbers.
    """

    scenario: Literal["meeting", "returns", "beside", "postures", "rooms"] = "meeting"
    acts: tuple[Act, ...] = ACTS
    segment: tuple[Literal["auto", "network", "background"], ...] = ("auto", "network", "background")
    weights: Path | None = None
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
        if not self.acts:
            raise InputError(f"--acts takes some of {', '.join(ACTS)}")
        if min(self.scenes, self.cameras) < 1 or not 1 <= self.rate_hz <= 60 or not 0.2 <= self.apart_m <= 1:
            raise InputError("--scenes and --cameras take at least 1, --rate-hz 1 to 60, --apart-m 0.2 to 1")


class _SingleView:
    """Segments one person in each view alone: the largest body there."""

    people = 1

    def __init__(self, segmenter: PersonSegmenter) -> None:
        self._segmenter, self.problems = segmenter, segmenter.problems

    def __call__(self, frames: FrameSet) -> tuple[PersonMasks, ...]:
        return (PersonMasks(1, tuple(self._segmenter(view) for view in frames.views)),)

    def reset(self) -> None:
        """Nothing is remembered."""


class _TrueMasks:
    """Uses the true masks of the frames."""

    people = 1

    def __init__(self) -> None:
        self.problems: list[str] = []

    def __call__(self, frames: FrameSet) -> tuple[PersonMasks, ...]:
        masks = [view.mask for view in frames.views]
        assert all(mask is not None for mask in masks)
        return (PersonMasks(1, tuple(mask for mask in masks if mask is not None)),)

    def reset(self) -> None:
        """Nothing is remembered."""


@locks_outputs(files=("json",))
def evaluate_people(settings: PeopleEvaluation, console: Console | None = None) -> dict[str, Any]:
    """Make the scenes, track the people in them and print a table; returns the numbers."""
    with networks_on(settings.device):
        return _evaluate(settings, console or Terminal(stderr=True))


def _evaluate(settings: PeopleEvaluation, console: Console) -> dict[str, Any]:
    rng = np.random.default_rng(settings.seed)
    detector = PeopleDetector(settings.weights)
    numbers: dict[str, Any] = {"settings": plain_settings(settings)}
    errors: dict[str, list[ndarray]] = {}
    for kind, scenario, backgrounds in _scenarios(settings):
        still = isinstance(scenario, PostureScenario) and scenario.still
        rate_hz = STILL_RATE_HZ if still else settings.rate_hz
        if isinstance(scenario, PostureScenario):  # whichever others are measured
            rng = np.random.default_rng([settings.seed, ACTS.index(scenario.act)])
        in_view_m2 = IN_VIEW_CHILD_M2 if kind == "infant" else IN_VIEW_M2
        scores = {
            f"{kind}, {segment}{', background known' if background == 'known' else ''}": (
                segment,
                background,
                TrackingScore(),
            )
            for background in backgrounds
            for segment in settings.segment
            if background == "learnt" or segment != "network"
        }
        for index in range(settings.scenes):
            if scenario is None:
                scene = EmptyRoomScene(rng, settings.cameras, rate_hz, _ROOM_SETS)
            elif isinstance(scenario, PostureScenario):
                scene = PostureScene(rng, scenario, settings.cameras, rate_hz)
            else:
                scene = ScenarioScene(rng, scenario, settings.cameras, rate_hz)
            for segment, background, score in scores.values():
                known = scene.backgrounds_m if background == "known" else {}
                score.start_scene(_segmenter(segment, known, max(scene.count, 1), detector), scene.count, in_view_m2)
            joints = None
            if settings.joints and settings.scenario == "meeting" and isinstance(scene, ScenarioScene):
                joints = FirstPersonErrors(scene)
            description = f"{kind}, scene {index + 1} of {settings.scenes}"
            frames = scene.frames()
            for frame in track(frames, description, len(scene.times_s), console=console, transient=True):
                for _, _, score in scores.values():
                    score.add(frame)
                if joints is not None:
                    joints.add(frame)
            if joints is not None:
                for name, pairs in joints.finish(scene.frames(alone=True)).items():
                    errors.setdefault(name, []).append(pairs)
        numbers |= {name: score.numbers() for name, (_, _, score) in scores.items()}
    if errors:
        numbers["first person's joints, cm"] = {name: _error_row(pairs) for name, pairs in errors.items()}
    _print(numbers, console)
    if settings.json is not None:
        write_json(settings.json, numbers)
    return numbers


def _segmenter(
    segment: str, known: dict[str, ndarray], people: int, detector: PeopleDetector
) -> PeopleSegmenter | NetworkSegmenter:
    if segment == "background":
        return PeopleSegmenter(known, people=people)
    return NetworkSegmenter(known, people=people, background=segment == "auto", detector=detector)


def _scenarios(settings: PeopleEvaluation) -> list[tuple[str, Scenario | None, tuple[str, ...]]]:
    """Names, scenarios (None for rooms without people), and whether the background is known or learnt."""
    if settings.scenario == "postures":
        return [
            (act, PostureScenario(act), ("learnt",) if act == "carried" else ("known", "learnt"))
            for act in settings.acts
        ]  # a camera that is carried has no empty scene
    if settings.scenario == "rooms":
        return [("rooms without people", None, ("learnt",))]
    if settings.scenario == "meeting":
        return [("meeting", Meeting(settings.apart_m), ("known", "learnt"))]
    if settings.scenario == "beside":
        return [("beside furniture", BesideFurniture(), ("learnt",)), ("empty room", EmptyRoom(), ("learnt",))]
    return [
        ("two, unlike", Visits(2), ("known",)),
        ("two, alike", Visits(2, alike=True), ("known",)),
        ("three, unlike", Visits(3), ("known",)),
        ("three, alike", Visits(3, alike=True), ("known",)),
        ("two and a newcomer", Visits(3, newcomer=True), ("known",)),
    ]


class TrackingScore:
    """Counts over scenes: overlap of the masks, switched numbers, delays until detection, and CPU time."""

    def __init__(self) -> None:
        self._overlaps: list[float] = []
        self._first_s: list[float] = []
        self._returns = {"old": 0, "new": 0, "wrong": 0}
        self._ghosts = self._sets = self._views = self._switches = 0
        self._spent_s = 0.0

    def start_scene(self, segmenter: Segmenter, count: int, in_view_m2: float = IN_VIEW_M2) -> None:
        """Start a scene with ``count`` people, who are in view from so much surface on."""
        self._segmenter, self._in_view_m2 = segmenter, in_view_m2
        self._people = [_PersonState() for _ in range(count)]

    def add(self, frame: SceneFrame) -> None:
        """Track into the next frame set."""
        if not self._sets:  # the first call compiles, which must not count
            self._segmenter(frame.frames)
            self._segmenter.reset()
        threads = cv2.getNumThreads()
        cv2.setNumThreads(1)  # waiting threads would count as CPU time
        start = time.process_time()
        detections = self._segmenter(frame.frames)
        self._spent_s += time.process_time() - start
        cv2.setNumThreads(threads)
        self._sets += 1
        self._views += len(frame.frames.views)
        now_s, matched = frame.frames.timestamp_ns * 1e-9, set()
        for person, true_masks in zip(self._people, frame.masks, strict=True):
            if visible_surface_m2(frame.frames, true_masks) < self._in_view_m2:
                person.in_view_since_s = np.nan
                continue
            if np.isnan(person.in_view_since_s):
                person.in_view_since_s, person.undetected = now_s, True
            ious = ((mask_iou(detected.masks, true_masks), detected.number) for detected in detections)
            best, number = max(ious, default=(0.0, 0))
            self._overlaps.append(best)
            if best >= MIN_IOU:
                matched.add(number)
                self._detected(person, number, now_s)
        for detected in detections:
            if detected.number not in matched and visible_surface_m2(frame.frames, detected.masks) >= IN_VIEW_M2:
                best = max((mask_iou(detected.masks, true_masks) for true_masks in frame.masks), default=0.0)
                self._ghosts += best < GHOST_IOU

    def _detected(self, person: _PersonState, number: int, now_s: float) -> None:
        others_numbers = {number for other in self._people if other is not person for number in other.numbers}
        if person.undetected:
            self._first_s.append(now_s - person.in_view_since_s)
            if person.numbers and person.in_view_since_s - person.last_detected_s > GONE_S:
                outcome = "old" if number in person.numbers else "wrong" if number in others_numbers else "new"
                self._returns[outcome] += 1
            elif not person.numbers:
                self._returns["wrong"] += number in others_numbers
        person.undetected = False
        self._switches += bool(person.numbers) and number != person.numbers[-1]
        if number not in person.numbers[-1:]:
            person.numbers.append(number)
        person.last_detected_s = now_s

    def numbers(self) -> dict[str, float | int | None]:
        """All counts, with names as in the JSON file."""
        overlaps, first_s = np.array(self._overlaps), np.array(self._first_s)
        numbers: dict[str, float | int | None] = {
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
            "found_share": float((overlaps >= MIN_IOU).mean()),
            "switches": self._switches,
            **{f"returns_{outcome}": count for outcome, count in self._returns.items()},
            "arrivals": len(first_s),
            "first_mask_s_p50": float(np.median(first_s)) if len(first_s) else None,
            "first_mask_s_most": float(first_s.max()) if len(first_s) else None,
        }


@dataclasses.dataclass(eq=False)
class _PersonState:
    """State of one person in a scene.

    Attributes:
        numbers: the numbers that the segmenter has given, in order.
        in_view_since_s: NaN while out of view.
        undetected: in view, but not yet detected.
        last_detected_s: NaN before the first detection.
    """

    numbers: list[int] = dataclasses.field(default_factory=list)
    in_view_since_s: float = np.nan
    undetected: bool = False
    last_detected_s: float = np.nan


def mask_iou(detected: Masks, true: Masks) -> float:
    """Intersection over union of masks in all views together; 0 where both are empty."""
    both = sum(int(np.count_nonzero(a & b)) for a, b in zip(detected, true, strict=True))
    either = sum(int(np.count_nonzero(a | b)) for a, b in zip(detected, true, strict=True))
    return both / max(either, 1)


def visible_surface_m2(frames: FrameSet, masks: Masks) -> float:
    """Surface, projected across the line of sight, that all cameras together see within the masks."""
    return sum(
        float((view.depth_m[mask] ** 2).sum() / (view.camera.fx * view.camera.fy))
        for view, mask in zip(frames.views, masks, strict=True)
    )


class FirstPersonErrors:
    """Joint errors of the first person by method of segmentation; nothing is smoothed."""

    def __init__(self, scene: ScenarioScene) -> None:
        classifier, estimator = Classifier(), load_estimator()
        segmenters: dict[str, Segmenter] = {
            "with true masks": _TrueMasks(),
            "by all cameras": NetworkSegmenter(scene.backgrounds_m),
            "by each view": _SingleView(PersonSegmenter(scene.backgrounds_m)),
            "alone": NetworkSegmenter(scene.backgrounds_m),
        }
        self._pipelines = {name: Pipeline(classifier, estimator, segmenter) for name, segmenter in segmenters.items()}
        self._errors: dict[str, list[float]] = {name: [] for name in segmenters}
        self._gaps: list[float] = []

    def add(self, frame: SceneFrame) -> None:
        """Estimate the joints while the second person is present."""
        if np.isfinite(frame.joints[0]).all():
            self._gaps.append(float(np.linalg.norm(frame.joints[0][_HIP, :2] - frame.joints[1][_HIP, :2])))
        for name in self._pipelines:
            if name != "alone":
                self._estimate(name, _with_masks(frame) if name == "with true masks" else frame.frames)

    def finish(self, alone: Iterable[SceneFrame]) -> dict[str, Float[ndarray, "n 2"]]:
        """Estimate without the second person. Returns by method errors (cm, NaN where missing) and distances of the two
        people (metres)."""
        for frame in alone:
            self._estimate("alone", frame.frames)
        return {name: np.stack([errors, self._gaps], 1) for name, errors in self._errors.items()}

    def _estimate(self, name: str, frames: FrameSet) -> None:
        assert frames.true_joints is not None
        joints = self._pipelines[name](frames).pose.joints
        if np.isfinite(frames.true_joints).all():  # in the room
            self._errors[name].append(100 * float(np.linalg.norm(joints - frames.true_joints, axis=1).mean()))


def _with_masks(frame: SceneFrame) -> FrameSet:
    views = [
        dataclasses.replace(view, mask=mask) for view, mask in zip(frame.frames.views, frame.masks[0], strict=True)
    ]
    return dataclasses.replace(frame.frames, views=tuple(views))


def _error_row(scenes: Sequence[Float[ndarray, "_ 2"]]) -> dict[str, float]:
    errors, gaps = np.concatenate(scenes).T
    near = gaps < NEAR_M  # NaN while one of them is not there
    return {
        "mean": float(np.nanmean(errors)),
        "near": float(np.nanmean(errors[near])),
        "over_10cm": float((errors[np.isfinite(errors)] > 10).mean()),
        "missing": float(np.isnan(errors).mean()),
    }


def _print(numbers: dict[str, Any], console: Console) -> None:
    rows = {name: row for name, row in numbers.items() if "sets" in row}
    table = Table(title="people in their masks", title_justify="left")
    for heading in ("", "sets", "overlap", "p5", "found", "switches", "old, new, wrong", "mask after s", "at most",
                    "ghosts", "CPU ms"):  # fmt: skip
        table.add_column(heading, justify="right" if heading else "left")
    for name, row in rows.items():
        cells = ["–"] * 7
        if "arrivals" in row:
            cells = [
                f"{row['overlap_mean']:.3f}", f"{row['overlap_p5']:.3f}", f"{row['found_share']:.1%}",
                f"{row['switches']}", f"{row['returns_old']}, {row['returns_new']}, {row['returns_wrong']}",
                *("–" if row[key] is None else f"{row[key]:.2f}" for key in ("first_mask_s_p50", "first_mask_s_most")),
            ]  # fmt: skip
        table.add_row(name, f"{row['sets']}", *cells, f"{row['ghost_sets']}", f"{row['cpu_ms_per_view']:.2f}")
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
