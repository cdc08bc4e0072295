"""The pipeline: views of one instant in, the pose out, with the milliseconds of every stage.

Person mask → body-part labels → labelled world cloud → joints → smoothing. Each stage is a plain function of the one
before; replace one and keep the rest.
"""

from __future__ import annotations

import copy
import dataclasses
import time
from collections.abc import Collection, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, UInt8
from numpy import ndarray

from depthmocap.classify.classifier import ViewPrediction
from depthmocap.core.network_devices import NetworkDevices
from depthmocap.frames import FrameSet, Pose, View
from depthmocap.pose.cloud import LabelledCloud, merge_agreeing_views, merge_views
from depthmocap.pose.estimators import JointEstimator, estimate_pose
from depthmocap.pose.front_memory import FrontMemory
from depthmocap.pose.labelled_view import LabelledView
from depthmocap.segment.people_segmenter import PersonMasks
from depthmocap.smooth.pose_filter import MAX_GAP_S, PoseFilter

STAGES = ("segment", "label", "merge", "joints", "smooth")


@runtime_checkable
class ViewClassifier(Protocol):
    """Labels what is in the masks of views; see ``Classifier``."""

    def label_views(
        self, views: Sequence[View], masks: Sequence[Bool[ndarray, "_ _"]], up: str | None = None
    ) -> list[ViewPrediction]:
        """The labels of the views, in order; ``up`` is the world's up axis if known."""
        ...


@runtime_checkable
class Segmenter(Protocol):
    """Gives the people in a set of views, the one whose pose is wanted first; see ``PeopleSegmenter``.

    Attributes:
        people: so many are given at most.
        problems: what makes good masks unlikely, one line each.
    """

    people: int
    problems: list[str]

    def __call__(self, frames: FrameSet) -> tuple[PersonMasks, ...]: ...

    def reset(self) -> None:
        """Forget who was there."""
        ...


@runtime_checkable
class SparingSegmenter(Segmenter, Protocol):
    """One that can leave out cameras; see ``NetworkSegmenter``."""

    def find(self, frames: FrameSet, left_out: Collection[str] = ()) -> tuple[PersonMasks, ...]: ...


@dataclasses.dataclass(frozen=True, eq=False)
class PersonResult:
    """One person of a frame set: their number, which stays theirs, their pose, and what it was found in.

    Attributes:
        mistakable: numbers of those from whom the person cannot be told apart now; the confidences are lower by the
            probability that the pose is theirs.
    """

    number: int
    pose: Pose
    masks: tuple[Bool[ndarray, "_ _"], ...]
    labels: tuple[UInt8[ndarray, "_ _"], ...]
    cloud: LabelledCloud
    mistakable: tuple[int, ...] = ()


@dataclasses.dataclass(frozen=True, eq=False)
class Result:
    """The pose of a frame set and everything found on the way to it.

    A filter that waits for later frames makes the pose that of an earlier one: its timestamp tells which.

    Attributes:
        pose: of the person who is followed; its masks, labels and cloud come next.
        milliseconds: by stage, of everybody together.
        people: everybody, the one who is followed first, each with a pose that was smoothed by itself.
        final: where several people are followed, by number the poses that became final with this set: this one's, or
            an earlier one's where the filter waits, and what it held back of somebody who has gone.
    """

    pose: Pose
    masks: tuple[Bool[ndarray, "_ _"], ...]
    labels: tuple[UInt8[ndarray, "_ _"], ...]
    cloud: LabelledCloud
    milliseconds: dict[str, float]
    people: tuple[PersonResult, ...] = ()
    final: dict[int, list[Pose]] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True, eq=False)
class LabelledSet:
    """A frame set whose people are found and labelled.

    Attributes:
        persons: everybody, the one who is followed first.
        masks: of each of them in every view; of nobody, once, where nobody is there.
        predictions: in the same order.
        milliseconds: of the stages so far.
    """

    frames: FrameSet
    persons: tuple[PersonMasks, ...]
    masks: tuple[tuple[Bool[ndarray, "_ _"], ...], ...]
    predictions: tuple[list[ViewPrediction], ...]
    milliseconds: dict[str, float]


@dataclasses.dataclass(eq=False)
class _Smoothed:
    """A person's filter, how many poses it was given, and the time of the last."""

    filter: PoseFilter
    given: int = 0
    last_ns: int = 0

    def __call__(self, pose: Pose, smoothed: Pose | None = None) -> Pose:
        """``smoothed``: what the filter, which is another's too, has made of the pose already."""
        self.given, self.last_ns = self.given + 1, pose.timestamp_ns
        return self.filter(pose) if smoothed is None else smoothed

    @property
    def is_final(self) -> bool:
        """Whether what the filter gave last will not be given again."""
        return self.given > self.filter.delay_frames


class Pipeline:
    """Depth views to joints. Keeps state only for following people and for smoothing; :meth:`reset` forgets it.

    Attributes:
        devices: where its networks run.
    """

    def __init__(
        self,
        classifier: ViewClassifier,
        estimator: JointEstimator,
        segment: Segmenter,
        up: str = "z",
        smoothing: PoseFilter | None = None,
    ) -> None:
        """
        Args:
            segment: finds the people in a set of views, e.g. a ``PeopleSegmenter``.
            up: the world's up axis.
            smoothing: a filter over time, of this pipeline alone (``load_filter``); None for none. Further
                people get copies of it.
        """
        self._classifier, self._estimator, self.segment, self._up = classifier, estimator, segment, up
        self.smoothing, self.devices = smoothing, NetworkDevices()
        self._filters: dict[int, _Smoothed] = {}
        #: The filter, once it was given joints.
        self._begun: PoseFilter | None = None
        self._fronts: dict[int, FrontMemory] = {}
        #: Of sets that are labelled sparingly: their number, and in the last one the cameras that see each person.
        self._turn, self._seen = 0, list[list[str]]()

    def reset(self) -> None:
        """Forget past poses and who was there; what is known of the empty scene is kept."""
        self.segment.reset()
        self._filters.clear()
        self._fronts.clear()
        self._begun = None
        if self.smoothing is not None:
            self.smoothing.reset()

    def change_smoothing(self, smoothing: PoseFilter | None) -> None:
        """Smooth by another filter from the next set on; what the present one holds back is given by :meth:`finish`
        and :meth:`finish_people` before."""
        self.smoothing = smoothing
        self._filters.clear()

    def finish(self) -> list[Pose]:
        """The poses that a filter which waits has held back, at the end of a stream; forgets past poses."""
        self._part(None, 0)
        self._begun = None
        return [] if self.smoothing is None else self.smoothing.finish()

    def finish_people(self) -> dict[int, list[Pose]]:
        """The same of everybody, by their numbers, where several people are followed."""
        held = {number: smoother.filter.finish() for number, smoother in self._filters.items()}
        self._filters.clear()
        return held

    def __call__(self, frames: FrameSet) -> Result:
        """Process one frame set. Without a person (or a view) the joints are NaN and their confidence 0."""
        return self.estimate(self.label(frames))

    def label(self, frames: FrameSet, sparing: bool = False) -> LabelledSet:
        """The first half of :meth:`__call__`: people and body-part labels. One thread may be in it while another is in
        :meth:`estimate` with the set before; sets go through both in the same order.

        Args:
            sparing: look for everybody, and label them, only in some of the views, in the other ones in the next set:
                where sets follow each other the joints are as good, and a set takes two thirds of the time.
        """
        clock = [time.perf_counter()]
        names = [view.camera.name for view in frames.views]
        left_out = set[str]()
        if sparing:
            self._turn += 1
            left_out = out_of_turn(names, self._seen, self._turn)
        if left_out and isinstance(self.segment, SparingSegmenter):
            persons = self.segment.find(frames, left_out)
        else:
            persons = self.segment(frames)
        nobody = tuple(np.zeros(view.depth_m.shape, np.bool_) for view in frames.views)
        # Somebody is looked for even where nobody is, so that every set has a pose.
        all_masks = tuple(person.masks for person in persons) or (nobody,)
        clock.append(time.perf_counter())
        labelled = [
            mask if name not in left_out else nothing
            for masks in all_masks
            for name, mask, nothing in zip(names, masks, nobody, strict=True)
        ]
        if sparing:
            self._seen = [[names[i] for i, mask in enumerate(masks) if mask.any()] for masks in all_masks]
        views = frames.views * len(all_masks)
        predictions = self._classifier.label_views(views, labelled, self._up)
        clock.append(time.perf_counter())
        count = len(frames.views)
        by_person = tuple(predictions[i * count : (i + 1) * count] for i in range(len(all_masks)))
        return LabelledSet(frames, persons, all_masks, by_person, _milliseconds(STAGES[:2], clock))

    def estimate(self, labelled: LabelledSet) -> Result:
        """The second half of :meth:`__call__`: joints, smoothed over time."""
        frames, persons, by_person = labelled.frames, labelled.persons, labelled.predictions
        clock = [time.perf_counter()]
        numbers: list[int | None] = [person.number for person in persons] or [None]
        clouds = [self._merge(frames, *pair) for pair in zip(by_person, numbers, strict=True)]
        clock.append(time.perf_counter())
        raw = [estimate_pose(self._estimator, cloud, self._up, frames.timestamp_ns) for cloud in clouds]
        for i, person in enumerate(persons):
            if person.doubt:
                raw[i] = raw[i].doubted(person.doubt)
        clock.append(time.perf_counter())
        followed = raw[0] if self.smoothing is None else self._follow(self.smoothing, raw[0], numbers[0])
        final = self._gone(frames.timestamp_ns)
        poses = [self._smooth(person.number, pose, followed, final) for person, pose in zip(persons, raw, strict=False)]
        clock.append(time.perf_counter())
        all_labels = [tuple(prediction.labels for prediction in of_person) for of_person in by_person]
        people = [
            PersonResult(person.number, poses[i], person.masks, all_labels[i], clouds[i], person.mistakable)
            for i, person in enumerate(persons)
        ]
        return Result(
            followed, labelled.masks[0], all_labels[0], clouds[0],
            labelled.milliseconds | _milliseconds(STAGES[2:], clock),
            tuple(people), final,
        )  # fmt: skip

    def _merge(self, frames: FrameSet, predictions: list[ViewPrediction], number: int | None) -> LabelledCloud:
        """The labelled cloud of a person; where frames follow each other, with the front that was seen before."""
        parts = [LabelledView(view, *prediction) for view, prediction in zip(frames.views, predictions, strict=True)]
        if self.smoothing is None or number is None:
            return merge_views(parts)
        now_ns = frames.timestamp_ns
        self._fronts = {n: memory for n, memory in self._fronts.items() if memory.knows(now_ns)}
        return merge_agreeing_views(self._fronts.setdefault(number, FrontMemory())(parts, now_ns))

    def _follow(self, smoothing: PoseFilter, pose: Pose, number: int | None) -> Pose:
        """The smoothed pose of the person who is followed. Where several are, somebody who has been that from the
        filter's first joints on has no other filter: it would make the same of the same poses."""
        several = self.segment.people > 1
        self._part(number if several else None, pose.timestamp_ns)
        if self._begun is not smoothing and np.isfinite(pose.joints).any():
            if several and number is not None and number not in self._filters and not smoothing.delay_frames:
                smoothing.reset()  # as a filter of their own would begin
                self._filters[number] = _Smoothed(smoothing)
            self._begun = smoothing
        return smoothing(pose)

    def _part(self, number: int | None, now_ns: int) -> None:
        """Give whoever shares the followed person's filter one of their own, unless they are followed still."""
        for other, smoother in self._filters.items():
            still = other == number and 0 <= now_ns - smoother.last_ns <= MAX_GAP_S * 1e9
            if smoother.filter is self.smoothing and not still:
                smoother.filter = copy.deepcopy(smoother.filter)

    def _gone(self, now_ns: int) -> dict[int, list[Pose]]:
        """What filters held back of people whom they forget, by number; a filter begins anew when somebody returns."""
        longest_ns = MAX_GAP_S * 1e9
        gone = [n for n, smoother in self._filters.items() if not 0 <= now_ns - smoother.last_ns <= longest_ns]
        return {number: self._filters.pop(number).filter.finish() for number in gone}

    def _smooth(self, number: int, pose: Pose, followed: Pose, final: dict[int, list[Pose]]) -> Pose:
        """A person's pose by a filter of their own, and into ``final`` what is; where one person is followed at most,
        that is the pipeline's."""
        if self.segment.people == 1:
            return followed
        if self.smoothing is None:
            final[number] = [pose]
            return pose
        if number not in self._filters:
            own_filter = copy.deepcopy(self.smoothing)
            own_filter.reset()
            self._filters[number] = _Smoothed(own_filter)
        smoother = self._filters[number]
        smoothed = smoother(pose, followed if smoother.filter is self.smoothing else None)
        if smoother.is_final:
            final.setdefault(number, []).append(smoothed)
        return smoothed


def out_of_turn(names: Sequence[str], seen: Sequence[Sequence[str]], turn: int) -> set[str]:
    """Every second camera, the other ones in the next turn; of three one, of two none. Of the cameras that see somebody
    two stay at least: joints need two.

    Args:
        names: of the cameras.
        seen: of those that see each person.
    """
    left_out = set(names[turn % 2 :: 2]) if len(names) > 3 else {names[turn % 3]} if len(names) == 3 else set[str]()
    for of_person in seen:
        there = [name for name in of_person if name in names]
        missing = [name for name in there if name in left_out]
        fewest = min(2, len(there)) - (len(there) - len(missing))
        for i in range(fewest):
            left_out.remove(missing.pop((turn // 2 + i) % len(missing)))
    return left_out


def _milliseconds(stages: Sequence[str], clock: Sequence[float]) -> dict[str, float]:
    """Of each stage, by the seconds at which the first begins and each ends."""
    return dict(zip(stages, (np.diff(clock) * 1e3).tolist(), strict=True))


def mix_up_lines(result: Result) -> list[str]:
    """Who cannot be told apart in a set, a line each."""
    pairs = {(min(one.number, two), max(one.number, two)) for one in result.people for two in one.mistakable}
    return [
        f"people {one} and {two} could not be told apart: they touched, or are as tall, and may be each other"
        for one, two in sorted(pairs)
    ]


def warm_up(pipeline: Pipeline, frames: FrameSet) -> Pipeline:
    """Run the pipeline on a set and reset it, so that everything is loaded and compiled; returns the pipeline."""
    pipeline(frames)
    pipeline.reset()
    return pipeline
