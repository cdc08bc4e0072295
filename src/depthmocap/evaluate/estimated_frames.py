"""Estimates for the frames of an annotated set, together with the ground truth: the input of a protocol."""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Mapping, Sized

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from numpy import ndarray
from rich.console import Console
from rich.progress import Progress

from depthmocap.body.regions import REGION_COUNT
from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.classify.classifier import Classifier
from depthmocap.core.console import progress_text
from depthmocap.datasets.annotated import AnnotatedFrame, AnnotatedSet
from depthmocap.errors import InputError
from depthmocap.geometry import z_up_from
from depthmocap.pose.cloud import MIN_CLOUD_POINTS, merge_views
from depthmocap.pose.estimators import JointEstimator
from depthmocap.pose.labelled_view import label_people
from depthmocap.pose.parts import AREA, CENTRE, PROBABILITY, BodyFrame, body_frame, part_statistics
from depthmocap.text import joined


@dataclasses.dataclass(frozen=True, eq=False)
class EstimatedFrames:
    """Frames with known joints, and the estimate of each. Points are in metres, in the world turned Z-up.

    Attributes:
        name: name of the set.
        joints: the set's joints, as in ``AnnotatedSet``.
        correspondence: our joint of some of them, as in ``AnnotatedSet``.
        estimates: our joints, NaN in frames without a detected person.
        confidence: confidence of our joints.
        centres: centres of the body's regions, NaN where no camera sees the region.
        frame: the body's coordinate frame; without meaning in frames without a detected person.
        truths: the set's joints, NaN where unknown.
        subjects: the person in each frame.
        actions: the action in each frame.
        milliseconds: time from masked depth to joints.
        left_out: number of frames without a known joint or without a view; they are not in the arrays.
        problems: what could not be read.
    """

    name: str
    joints: tuple[str, ...]
    correspondence: Mapping[str, str]
    estimates: Float[ndarray, "n 18 3"]
    confidence: Float[ndarray, "n 18"]
    centres: Float[ndarray, "n 43 3"]
    frame: BodyFrame
    truths: Float[ndarray, "n j 3"]
    subjects: Shaped[ndarray, "n"]
    actions: Shaped[ndarray, "n"]
    milliseconds: Float[ndarray, "n"]
    left_out: int = 0
    problems: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.truths)

    @property
    def detected(self) -> Bool[ndarray, "n"]:
        """Frames with a detected person."""
        return np.asarray(~np.isnan(self.estimates).any((1, 2)))

    @property
    def corresponding(self) -> Int[ndarray, "j"]:
        """Index of our joint that corresponds to each joint of the set; -1 where none does."""
        return np.array(
            [JOINT_INDEX[self.correspondence[joint]] if joint in self.correspondence else -1 for joint in self.joints]
        )

    def mapped(self) -> Float[ndarray, "n j 3"]:
        """Our corresponding joint of each joint of the set, NaN where none does: the estimate without a fit."""
        return np.where((self.corresponding >= 0)[:, None], self.estimates[:, self.corresponding], np.nan)

    def joint_confidence(self) -> Float[ndarray, "n j"]:
        """The confidence of the corresponding joint; NaN where none does."""
        return np.where(self.corresponding >= 0, self.confidence[:, self.corresponding], np.nan)

    def rows(self, selected: Bool[ndarray, "n"]) -> EstimatedFrames:
        """Some of the frames."""
        arrays = ("estimates", "confidence", "centres", "truths", "subjects", "actions", "milliseconds")
        frame = BodyFrame(self.frame.origin[selected], self.frame.rotation[selected])
        return dataclasses.replace(self, frame=frame, **{name: getattr(self, name)[selected] for name in arrays})

    def only(self, joints: tuple[str, ...]) -> EstimatedFrames:
        """Some of the set's joints, by name."""
        columns = [self.joints.index(joint) for joint in joints]
        return dataclasses.replace(self, joints=joints, truths=self.truths[:, columns])


def estimate_frames(
    source: AnnotatedSet,
    estimator: JointEstimator,
    classifier: Classifier,
    every: int = 1,
    console: Console | None = None,
) -> EstimatedFrames:
    """Run the pipeline, without smoothing, over the frames of a set.

    Args:
        every: read every ``every``-th frame only.

    Raises:
        InputError: when no frame has a view and a known joint; the message holds the reader's problems.
    """
    if every < 1:
        raise InputError(f"--every must be at least 1, got {every}")
    rows: list[dict[str, ndarray]] = []
    subjects, actions, left_out = [], [], 0
    turn = z_up_from(source.up).T
    with Progress(console=console) as progress:
        frames = progress.track(
            itertools.islice(source, 0, None, every), _length(source, every), description=progress_text(source.name)
        )
        for frame in frames:
            if not frame.views or not np.isfinite(frame.joints_world).all(1).any():
                left_out += 1
                continue
            row = _estimate_frame(frame, source.up, estimator, classifier)
            # A joint with one unknown coordinate is unknown.
            known = np.isfinite(frame.joints_world).all(1, keepdims=True)
            row["truths"] = np.where(known, frame.joints_world, np.nan).astype(np.float64) @ turn
            row["estimates"] = row["estimates"] @ turn
            rows.append(row)
            subjects.append(frame.subject)
            actions.append(frame.action)
    problems = tuple(source.problems)
    if not rows:
        reasons = joined(problems) or "check that the folder is that of the set"
        raise InputError(f"{source.name}: no frame has a view and known joints ({left_out} had not): {reasons}")
    arrays = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    frame = BodyFrame(arrays.pop("origin"), arrays.pop("turn"))
    return EstimatedFrames(
        source.name, source.joints, source.correspondence, **arrays, frame=frame,
        subjects=np.array(subjects), actions=np.array(actions), left_out=left_out, problems=problems,
    )  # fmt: skip


def _length(source: AnnotatedSet, every: int) -> int | None:
    """Number of frames that are read; None where the set does not know it before."""
    return -(-len(source) // every) if isinstance(source, Sized) else None


def _estimate_frame(
    frame: AnnotatedFrame, up: str, estimator: JointEstimator, classifier: Classifier
) -> dict[str, ndarray]:
    """The estimate of one frame: joints in its own world; regions and the body's frame in the world turned Z-up."""
    start = time.perf_counter()
    cloud = merge_views(label_people(frame.views, classifier, up))
    joints, confidence = estimator(cloud, up)
    spent_ms = (time.perf_counter() - start) * 1e3
    row = {
        "estimates": joints, "confidence": confidence, "centres": np.full((REGION_COUNT, 3), np.nan),
        "origin": np.zeros(3), "turn": np.eye(3), "milliseconds": np.array(spent_ms),
    }  # fmt: skip
    if len(cloud) < MIN_CLOUD_POINTS or np.isnan(joints).any():
        return row | {"estimates": np.full((len(JOINTS), 3), np.nan), "confidence": np.zeros(len(JOINTS))}
    parts = part_statistics(cloud, up)
    body = body_frame(parts)
    regions = parts[:, :REGION_COUNT]
    weights = (regions[..., AREA] * regions[..., PROBABILITY]).astype(np.float64)
    total = weights.sum(0)
    visible = total > 0
    row["centres"][visible] = np.einsum("vr,vrc->rc", weights, regions[..., CENTRE])[visible] / total[visible, None]
    return row | {"origin": body.origin, "turn": body.rotation}
