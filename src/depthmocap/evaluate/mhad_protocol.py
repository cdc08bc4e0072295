"""``depthmocap evaluate mhad``: the paper's evaluation on real depth (Sec. V-B), and its comparison with Michel et al.

Each person is tested with a fit to all others (leave one subject out), over all 35 joints and over the 29 that others
report. The numbers are over all frames, and over those whose true hands lie in the cloud: the paper notes that the
marker system errs in the others. For Michel's joints the fit leaves out one subject, or one action, at a time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from jaxtyping import Bool, Float
from numpy import ndarray
from rich.console import Console

from depthmocap.classify.classifier import Classifier
from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.reading.json_text import read_json
from depthmocap.datasets.annotated import AnnotatedFrame, AnnotatedSet, PassedOn
from depthmocap.datasets.mhad import MHAD_JOINTS, MhadSet
from depthmocap.errors import InputError
from depthmocap.evaluate.estimated_frames import EstimatedFrames, estimate_frames
from depthmocap.evaluate.evaluation_report import FILES, finish_evaluation
from depthmocap.evaluate.protocol import RealSetEvaluation, Refit, comparable, leave_one_out, measure_estimates
from depthmocap.geometry.transforms import transform_points
from depthmocap.pose.estimators import JointEstimator
from depthmocap.report.metrics import joint_errors_cm

#: A true hand is in the cloud if a point is within this distance, metres: the breadth of a hand plus the error of both
#: systems.
HAND_REACH_M = 0.12
_HANDS = [MHAD_JOINTS.index(f"{side}{joint}") for side in "RL" for joint in ("Hand", "HandEnd")]

#: Joints by table. "reliable": all but the ends of the arms from the middle of the forearm on; published results over
#: 29 joints do not name them. "michel": the joints nearest to those of Michel et al.'s body model, who do not name
#: them either. A file replaces any of the tables.
JOINT_TABLES: dict[str, tuple[str, ...]] = {
    "reliable": tuple(name for name in MHAD_JOINTS if name[1:] not in ("Forearm", "Hand", "HandEnd")),
    "michel": (
        "Neck", "HeadEnd", "RShoulder", "RElbow", "RHand", "LShoulder", "LElbow", "LHand",
        "RHip", "RKnee", "RFoot", "LHip", "LKnee", "LFoot",
    ),
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class MhadEvaluation(RealSetEvaluation):
    """Accuracy of joints on Berkeley MHAD's two Kinects.

    Attributes:
        root: folder with Kinect, Mocap and Calibration.
        subjects: numbers of the people to take, by default all; likewise actions.
        refit: "ridge" fits the set's joints, on other people than are tested; "none" takes our joints as they are.
        joint_table: a JSON file {"reliable": [names], "michel": [names]} that replaces these lists of joints.
    """

    root: tyro.conf.Positional[Path]
    subjects: tuple[int, ...] = ()
    actions: tuple[int, ...] = ()
    refit: Refit = "ridge"
    joint_table: Path | None = None


class HandVisibility(PassedOn):
    """A set that passes the frames of another set on, and records for each whether the true hands are in the cloud."""

    def __init__(self, source: AnnotatedSet) -> None:
        super().__init__(source)
        self.in_cloud: list[bool] = []

    def __iter__(self) -> Iterator[AnnotatedFrame]:
        self.in_cloud.clear()
        for frame in self._source:
            self.in_cloud.append(hands_in_cloud(frame))
            yield frame


def hands_in_cloud(frame: AnnotatedFrame) -> bool:
    """Whether every true wrist and hand end of a frame has a point of the person within ``HAND_REACH_M``."""
    clouds = [
        transform_points(view.camera.world_from_camera, view.camera.unproject(view.depth_m, view.mask))
        for view in frame.views
    ]
    points = np.concatenate(clouds).astype(np.float32)
    hands = frame.joints_world[_HANDS].astype(np.float32)
    return all(bool((((points - hand) ** 2).sum(1) <= HAND_REACH_M**2).any()) for hand in hands)


@dataclasses.dataclass(frozen=True, eq=False)
class MhadResults:
    """Results of all protocols.

    Attributes:
        numbers: by the name of the protocol.
        frames: the frames, with the estimates of our joints.
        estimates: the set's joints by a fit to all other people.
    """

    numbers: dict[str, dict[str, Any]]
    frames: EstimatedFrames
    estimates: Float[ndarray, "n j 3"]


def measure_mhad(
    source: AnnotatedSet,
    estimator: JointEstimator,
    classifier: Classifier,
    refit: Refit = "ridge",
    tables: dict[str, tuple[str, ...]] = JOINT_TABLES,
    console: Console | None = None,
) -> MhadResults:
    """All protocols (see the top of this file). Frames are independent, nothing is smoothed.

    Raises:
        InputError: when no frame can be evaluated, or there is nobody else to fit to.
    """
    visibility = HandVisibility(source)
    frames = comparable(estimate_frames(visibility, estimator, classifier, 1, console), refit)
    hands = np.array(visibility.in_cloud)
    everybody = np.ones(len(frames), bool)
    estimates = leave_one_out(frames, frames.subjects, refit)
    numbers: dict[str, dict[str, Any]] = {}
    for table in (MHAD_JOINTS, tables["reliable"]):
        joints = tuple(joint for joint in frames.joints if joint in table)
        for kind, rows in (("", everybody), (", hands in the cloud", hands)):
            if joints and rows.any():
                numbers[f"{len(joints)} joints{kind}"] = _measure(frames, estimates, joints, rows)
    problems = []
    if not hands.any():
        problems.append(f"in none of {len(hands)} frames are all true hands in the cloud: not evaluated apart")
    michel = tuple(joint for joint in frames.joints if joint in tables["michel"])
    for kind, groups in (("subjects", frames.subjects), ("actions", frames.actions)):
        if len(np.unique(groups)) < 2:
            problems.append(f"only one of the {kind} is there: nothing is left out by {kind}")
        elif michel:
            part = frames.only(michel)
            numbers[f"Michel's joints, {kind}"] = _measure(part, leave_one_out(part, groups, refit), michel, everybody)
    for result in numbers.values():
        result["problems"] = [*result["problems"], *problems]
    return MhadResults(numbers, frames, estimates)


def _measure(
    observed: EstimatedFrames, estimates: Float[ndarray, "n j 3"], joints: tuple[str, ...], rows: Bool[ndarray, "n"]
) -> dict[str, Any]:
    columns = [observed.joints.index(joint) for joint in joints]
    part, chosen = observed.only(joints).rows(rows), estimates[rows][:, columns]
    errors_cm = joint_errors_cm(chosen, part.truths)
    known = ~np.isnan(errors_cm)
    counted = known.any(1)
    of_frames = np.where(known, errors_cm, 0).sum(1)[counted] / known.sum(1)[counted]
    return {
        **measure_estimates(part, chosen),
        # The paper's deviation in its comparison with Michel et al. is too small to be that of single joints.
        "deviation_of_frames_cm": float(of_frames.std()) if counted.any() else float("nan"),
        "frames_not_counted": int((~rows).sum()),
    }


def read_joint_tables(path: Path | None) -> dict[str, tuple[str, ...]]:
    """The lists of joints, with those of a file in place of ours.

    Raises:
        InputError: when the file cannot be read, or has other lists or joints.
    """
    if path is None:
        return JOINT_TABLES
    tables = read_json(path)
    if not isinstance(tables, dict) or not tables or not set(tables) <= set(JOINT_TABLES):
        raise InputError(f'{path} must be an object of lists of joints: {{"reliable": [...], "michel": [...]}}')
    for name, joints in tables.items():
        if not isinstance(joints, list) or not joints:
            raise InputError(f"{path}: {name} must be a list of joints")
        if unknown := [joint for joint in joints if joint not in MHAD_JOINTS]:
            raise InputError(f"{path}: {name} has {unknown[0]!r}; the joints are {', '.join(MHAD_JOINTS)}")
    return JOINT_TABLES | {name: tuple(joints) for name, joints in tables.items()}


@locks_outputs(files=FILES)
def evaluate_mhad(settings: MhadEvaluation, console: Console | None = None) -> dict[str, Any]:
    """Run the evaluation; returns the numbers by protocol.

    Raises:
        InputError: see ``measure_mhad``, ``MhadSet`` and ``read_joint_tables``.
    """
    console = console or Terminal(stderr=True)
    tables = read_joint_tables(settings.joint_table)
    source = MhadSet(settings.root, settings.subjects, settings.actions, settings.every)
    numbers = measure_mhad(source, *settings.load(), settings.refit, tables, console).numbers
    return finish_evaluation(settings, source.name, numbers, console)
