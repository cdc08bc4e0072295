"""What the pipeline finds in the frames of an annotated set, kept beside the truth: all that a protocol works on."""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from numpy import ndarray
from rich.console import Console
from rich.progress import Progress

from depthmocap.body.regions import REGION_COUNT
from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.classify.classifier import Classifier
from depthmocap.core.console import description
from depthmocap.datasets.annotated import AnnotatedFrame, AnnotatedSet
from depthmocap.errors import InputError
from depthmocap.geometry import z_up_from
from depthmocap.pose.cloud import MIN_CLOUD_POINTS, merge_views
from depthmocap.pose.estimators import JointEstimator
from depthmocap.pose.labelled_view import label_people
from depthmocap.pose.parts import AREA, CENTRE, PROBABILITY, BodyFrame, body_frame, part_statistics
from depthmocap.text import joined


@dataclasses.dataclass(frozen=True, eq=False)
class Observations:
    """Frames of a set with known joints, and what was found in each. Points are metres in the world turned Z-up.

    Attributes:
        name: of the set; ``joints`` and ``ours`` as in ``AnnotatedSet``.
        estimates: our joints, NaN in frames where nobody was found.
        confidence: of our joints.
        centres: of the body's regions, NaN where unseen.
        frame: of the body; of no meaning in frames where nobody was found.
        truths: the set's joints, NaN where unknown.
        subjects: and ``actions``, of each frame.
        milliseconds: from masked depth to joints.
        left_out: frames without any known joint or view, which are not in the arrays.
        problems: what could not be read.
    """

    name: str
    joints: tuple[str, ...]
    ours: Mapping[str, str]
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
    def found(self) -> Bool[ndarray, "n"]:
        """Frames in which somebody was found."""
        return np.asarray(~np.isnan(self.estimates).any((1, 2)))

    @property
    def base(self) -> Int[ndarray, "j"]:
        """Our joint (its index) that corresponds to each of the set's; -1 where none does."""
        return np.array([JOINT_INDEX[self.ours[joint]] if joint in self.ours else -1 for joint in self.joints])

    def mapped(self) -> Float[ndarray, "n j 3"]:
        """Our joints where the set's correspond to one, NaN elsewhere: the estimate without any fitting."""
        return np.where((self.base >= 0)[:, None], self.estimates[:, self.base], np.nan)

    def joint_confidence(self) -> Float[ndarray, "n j"]:
        """The confidence of the corresponding joint; NaN where none does."""
        return np.where(self.base >= 0, self.confidence[:, self.base], np.nan)

    def rows(self, chosen: Bool[ndarray, "n"]) -> Observations:
        """Some of the frames."""
        arrays = ("estimates", "confidence", "centres", "truths", "subjects", "actions", "milliseconds")
        frame = BodyFrame(self.frame.origin[chosen], self.frame.turn[chosen])
        return dataclasses.replace(self, frame=frame, **{name: getattr(self, name)[chosen] for name in arrays})

    def only(self, joints: tuple[str, ...]) -> Observations:
        """Some of the set's joints, by name."""
        columns = [self.joints.index(joint) for joint in joints]
        return dataclasses.replace(self, joints=joints, truths=self.truths[:, columns])


def observe(
    source: AnnotatedSet,
    estimator: JointEstimator,
    classifier: Classifier,
    every: int = 1,
    console: Console | None = None,
) -> Observations:
    """Run the pipeline, without smoothing, over every so-many-th frame of a set.

    Raises:
        InputError: when no frame has a view and a known joint; it tells what the reader noticed.
    """
    if every < 1:
        raise InputError(f"--every must be at least 1, got {every}")
    rows: list[dict[str, ndarray]] = []
    subjects, actions, left_out = [], [], 0
    turn = z_up_from(source.up).T
    with Progress(console=console) as progress:
        frames = progress.track(
            itertools.islice(source, 0, None, every), _length(source, every), description=description(source.name)
        )
        for frame in frames:
            if not frame.views or not np.isfinite(frame.joints_world).all(1).any():
                left_out += 1
                continue
            row = _look(frame, source.up, estimator, classifier)
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
    return Observations(
        source.name, source.joints, source.ours, **arrays, frame=frame,
        subjects=np.array(subjects), actions=np.array(actions), left_out=left_out, problems=problems,
    )  # fmt: skip


def _length(source: AnnotatedSet, every: int) -> int | None:
    size = getattr(source, "__len__", None)
    return None if size is None else -(-size() // every)


def _look(frame: AnnotatedFrame, up: str, estimator: JointEstimator, classifier: Classifier) -> dict[str, ndarray]:
    """What is found in one frame; joints in its own world, regions and the body's frame in the world turned Z-up."""
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
    seen = total > 0
    row["centres"][seen] = np.einsum("vr,vrc->rc", weights, regions[..., CENTRE])[seen] / total[seen, None]
    return row | {"origin": body.origin, "turn": body.turn}
