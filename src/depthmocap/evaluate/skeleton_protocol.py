"""``depthmocap evaluate skeleton``: rotations, lengths and feet of the skeleton that files and avatars get."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from rich.console import Console
from rich.table import Table

from depthmocap.body.landmarks import POINT_BONES, POINT_ROWS, POINTS
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.settings import plain_settings
from depthmocap.errors import InputError
from depthmocap.evaluate.motion_protocol import (
    MotionEvaluation,
    apply_filter,
    make_estimates,
    posture_sequences,
    sequence_rng,
)
from depthmocap.evaluate.moving_people import FPS, moving_person
from depthmocap.evaluate.sequence_settings import SequenceSettings
from depthmocap.evaluate.skeleton_metrics import LANDMARK_GROUPS, SkeletonTrack, point_errors_mm, skeleton_metrics
from depthmocap.exporting.body_motion import solve_body
from depthmocap.exporting.seen_points import MEAN_ERROR_M
from depthmocap.exporting.timeline import LEAST_CONFIDENCE, Timeline, points_beside, y_up_from
from depthmocap.exporting.virtual_markers import landmark_positions
from depthmocap.frames import Pose
from depthmocap.smooth.filters import AUTO, FilterName, load_filter
from depthmocap.streaming.running_skeleton import RunningSkeleton
from depthmocap.synth.body.mesh_landmarks import posed_landmarks
from depthmocap.synth.motion.true_rotations import true_motion

#: Rows of the table: key, words, digits, factor.
_ROWS = (
    ("limb_swing_deg", "limbs, swing °", 1, 1),
    ("limb_twist_deg", "limbs, twist °", 1, 1),
    ("upper_arm_twist_deg", "– upper arms", 1, 1),
    ("forearm_twist_deg", "– forearms", 1, 1),
    ("thigh_twist_deg", "– thighs", 1, 1),
    ("shin_twist_deg", "– shins", 1, 1),
    ("trunk_head_deg", "trunk and head °", 1, 1),
    ("pelvis_deg", "– pelvis", 1, 1),
    ("spine_deg", "– spine", 1, 1),
    ("neck_deg", "– neck", 1, 1),
    ("head_deg", "– head", 1, 1),
    ("hands_deg", "hands °", 1, 1),
    ("feet_deg", "feet °", 1, 1),
    ("joint_error_cm", "joints cm", 2, 1),
    ("told_joint_error_cm", "joints that were told, cm", 2, 1),
    ("free_joint_error_cm", "these before, cm", 2, 1),
    ("foot_skate_mm", "skate of standing feet, mm a frame", 2, 1),
    ("free_foot_skate_mm", "skate before", 2, 1),
    ("held_in_swing", "feet held in swing %", 1, 100),
    ("length_variation_mm", "bones' lengths, range mm", 1, 1),
    ("knee_rms_deg", "knee flexion, RMS °", 1, 1),
    ("elbow_rms_deg", "elbow flexion, RMS °", 1, 1),
    ("landmarks_cm", "surface landmarks, cm", 2, 1),
    *((f"landmarks_{group}_cm", f"– {group}", 2, 1) for group in LANDMARK_GROUPS),
    ("us_per_frame", "CPU µs a frame", 0, 1),
)


@dataclasses.dataclass(frozen=True)
class SkeletonEvaluation(SequenceSettings):
    """The skeleton of constant bones on generated sequences, as files have it and as it is made live: of the true
    joints, of these and points of the skin where they are seen on average, and of what ``evaluate motion`` estimates,
    behind the filter. The
    folder of its estimates with the same settings serves.

    Attributes:
        seconds: of motion a sequence, before it comes to rest.
        smooth: the filter of the estimated joints.
    """

    seconds: float = 3.0
    smooth: FilterName = AUTO

    def __post_init__(self) -> None:
        super().__post_init__()
        self.motion()

    def motion(self) -> MotionEvaluation:
        """The evaluation whose estimates are taken.

        Raises:
            InputError: for settings that it does not take.
        """
        shared = {field.name: getattr(self, field.name) for field in dataclasses.fields(SequenceSettings)}
        return MotionEvaluation(**shared, seconds=self.seconds)


@locks_outputs(folder="out", files=("json",))
def evaluate_skeleton(settings: SkeletonEvaluation, console: Console | None = None) -> dict[str, Any]:
    """Make or read the estimates and measure the skeletons; returns the numbers by where joints are from, of
    all sequences together and, as ``sequences``, of each.

    Raises:
        InputError: clips, weights or sensors that cannot be read, or estimates in ``out`` of other settings.
    """
    console = console or Terminal(stderr=True)
    motion = settings.motion()
    sequences = make_estimates(motion, console)
    y_up = y_up_from("z")
    truths = []
    for index, (sequence, postures) in enumerate(zip(sequences, posture_sequences(motion), strict=True)):
        if len(postures.postures) != len(sequence.truth):
            raise InputError(f"{settings.out} holds estimates of other motions than {postures.name}: delete it")
        dressed = moving_person(sequence_rng(motion, index))
        rotations = true_motion(dressed.body, postures.postures).rotations
        joints = sequence.truth @ y_up.T
        landmarks = posed_landmarks(dressed.body, postures.postures) - dressed.body.rest_heads[0]
        truths.append(SkeletonTrack(joints, rotations, landmarks @ y_up.T + joints[:, [JOINT_INDEX["Hip"]]]))
    stamps = [sequence.timestamps_ns for sequence in sequences]
    exact = [
        [Pose(int(ns), joints, np.ones(len(joints))) for ns, joints in zip(times, sequence.truth, strict=True)]
        for times, sequence in zip(stamps, sequences, strict=True)
    ]
    with_points = [
        [
            dataclasses.replace(pose, points=points @ y_up, points_confidence=np.ones(len(POINTS)))
            for pose, points in zip(poses, truth.landmarks[:, POINT_ROWS] + _mean_errors(truth), strict=True)
        ]
        for poses, truth in zip(exact, truths, strict=True)
        if truth.landmarks is not None
    ]
    filter_ = load_filter(settings.smooth)
    estimated = []
    for sequence in sequences:
        estimated.append(apply_filter(filter_, sequence.poses(settings.views)))
        filter_.reset()
    numbers: dict[str, Any] = {
        "settings": plain_settings(settings),
        "sequences": [sequence.name for sequence in sequences],
        "frames": sum(len(sequence.truth) for sequence in sequences),
    }
    views = f"{settings.views} view{'s' * (settings.views > 1)}"
    for name, poses in (("true joints", exact), ("true joints and points", with_points), (views, estimated)):
        for way, solve in (("files", _offline), ("live", _live)):
            start = time.process_time()
            tracks = [solve(stream) for stream in poses]
            spent_s = time.process_time() - start
            before = [
                SkeletonTrack(_joints(stream), track.rotations) for stream, track in zip(poses, tracks, strict=True)
            ]
            free = skeleton_metrics(before, truths, 1 / FPS)
            row = skeleton_metrics(tracks, truths, 1 / FPS)
            told = [
                dataclasses.replace(track, joints=np.where(np.isnan(free_track.joints), np.nan, track.joints))
                for track, free_track in zip(tracks, before, strict=True)
            ]
            row["told_joint_error_cm"] = skeleton_metrics(told, truths, 1 / FPS)["joint_error_cm"]
            row |= {f"free_{key}": free[key] for key in ("joint_error_cm", "foot_skate_mm", "knee_rms_deg")}
            row["us_per_frame"] = 1e6 * spent_s / numbers["frames"]
            of_each = [skeleton_metrics([track], [truth], 1 / FPS) for track, truth in zip(tracks, truths, strict=True)]
            numbers[f"{name}, {way}"] = row | {"sequences": of_each}
    numbers["points"] = point_errors_mm([points_beside(stream, "z") for stream in estimated], truths)
    console.print(_table(numbers))
    settings.write_numbers(numbers)
    return numbers


def _mean_errors(truth: SkeletonTrack) -> Float[ndarray, "t p 3"]:
    """What points are off by on average (m, Y up)."""
    return (truth.rotations[:, POINT_BONES] @ MEAN_ERROR_M[:, :, None])[..., 0]


def _joints(poses: Sequence[Pose]) -> Float[ndarray, "t 18 3"]:
    """Y up; those that are too unsure are NaN."""
    joints = np.stack([pose.joints for pose in poses]).astype(np.float64)
    joints[np.stack([pose.confidence for pose in poses]) < LEAST_CONFIDENCE] = np.nan
    return joints @ y_up_from("z").T


def _offline(poses: Sequence[Pose]) -> SkeletonTrack:
    times_s = np.arange(len(poses)) / FPS
    motion = solve_body(Timeline(times_s, _joints(poses), 1 / FPS, points_beside(poses, "z")))
    return SkeletonTrack(motion.positions(), motion.world_rotations(), landmark_positions(motion))


def _live(poses: Sequence[Pose]) -> SkeletonTrack:
    skeleton = RunningSkeleton("z")
    joints, rotations = [], []
    for pose in poses:
        posed = skeleton(pose)
        if posed is None:
            joints.append(np.full((18, 3), np.nan))
            rotations.append(np.tile(np.eye(3), (18, 1, 1)))
        else:
            joints.append(posed.positions())
            rotations.append(posed.world_rotations())
    return SkeletonTrack(np.stack(joints), np.stack(rotations))


def _table(numbers: dict[str, Any]) -> Table:
    names = [name for name, row in numbers.items() if isinstance(row, dict) and "limb_swing_deg" in row]
    table = Table(title=f"{numbers['frames']} frames", box=None, padding=(0, 1, 0, 0))
    table.add_column("")
    for name in names:
        table.add_column(name, justify="right")
    for key, words, digits, factor in _ROWS:
        values = [numbers[name].get(key) for name in names]
        table.add_row(words, *("–" if value is None else f"{factor * value:.{digits}f}" for value in values))
    return table
