"""Numbers of skeletons: known errors are told, and the protocol measures what files and avatars get."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.evaluate.estimated_sequences import EstimateStore, SequenceEstimates
from depthmocap.evaluate.motion_protocol import estimate_settings, posture_sequences, sequence_rng
from depthmocap.evaluate.moving_people import FPS, moving_person
from depthmocap.evaluate.skeleton_metrics import SkeletonTrack, skeleton_metrics
from depthmocap.evaluate.skeleton_protocol import SkeletonEvaluation, evaluate_skeleton
from depthmocap.synth.body.mesh import Body
from depthmocap.synth.motion.true_rotations import true_motion

QUIET = Console(quiet=True)


def test_known_errors_are_told() -> None:
    rng = np.random.default_rng(0)
    joints = rng.normal(size=(1, 18, 3)).repeat(40, 0)
    rotations = Rotation.random(40 * 18, rng).as_matrix().reshape(40, 18, 3, 3)
    truth = SkeletonTrack(joints, rotations)
    numbers = skeleton_metrics([truth], [truth], 1 / 30)
    assert numbers["limb_twist_deg"] < 1e-3 and numbers["trunk_head_deg"] < 1e-3 and numbers["joint_error_cm"] == 0
    assert numbers["foot_skate_mm"] == 0 and np.isnan(numbers["held_in_swing"])
    turned, moved = rotations.copy(), joints.copy()
    turned[:, JOINT_INDEX["RHip"]] @= Rotation.from_euler("y", 30, degrees=True).as_matrix()  # about the bone
    turned[:, JOINT_INDEX["LKnee"]] @= Rotation.from_euler("x", 20, degrees=True).as_matrix()  # across it
    turned[:, JOINT_INDEX["Head"]] @= Rotation.from_euler("z", 12, degrees=True).as_matrix()
    moved[1::2, JOINT_INDEX["LFoot"], 0] += 0.004
    numbers = skeleton_metrics([SkeletonTrack(moved, turned)], [truth], 1 / 30)
    assert numbers["thigh_twist_deg"] == pytest.approx(15, abs=1e-3)
    assert numbers["thigh_swing_deg"] < 1e-3
    assert numbers["shin_swing_deg"] == pytest.approx(10, abs=1e-3) and numbers["shin_twist_deg"] < 1e-3
    assert numbers["head_deg"] == pytest.approx(12, abs=1e-3)
    assert numbers["trunk_head_deg"] == pytest.approx(2, abs=1e-3)
    assert numbers["foot_skate_mm"] == pytest.approx(2) and numbers["length_variation_mm"] > 0


def test_a_foot_held_in_swing_is_told() -> None:
    joints = np.zeros((20, 18, 3))
    joints[:, JOINT_INDEX["RFoot"], 0] = 0.03 * np.arange(20)
    rotations = np.tile(np.eye(3), (20, 18, 1, 1))
    truth, held = SkeletonTrack(joints, rotations), joints.copy()
    held[:6, JOINT_INDEX["RFoot"]] = 0
    numbers = skeleton_metrics([SkeletonTrack(held, rotations)], [truth], 1 / 30)
    assert numbers["held_in_swing"] == pytest.approx(5 / 19)


def store_of(settings: SkeletonEvaluation) -> EstimateStore:
    return EstimateStore(settings.out, estimate_settings(settings.motion()))


def test_the_protocol_measures_files_and_live(tmp_path: Path, default_body: Body) -> None:
    settings = SkeletonEvaluation(tmp_path / "out", sequences=1, seconds=1.0, views=1, json=tmp_path / "numbers.json")
    motion = settings.motion()
    (sequence,) = posture_sequences(motion)
    truth = true_motion(moving_person(sequence_rng(motion, 0)).body, sequence.postures).joints
    truth = np.stack([truth[..., 0], -truth[..., 2], truth[..., 1]], -1)
    stamps = np.round(np.arange(len(truth)) / FPS * 1e9).astype(int)
    noise = np.random.default_rng(0).normal(0, 0.01, truth.shape)
    estimates = SequenceEstimates("prior 0", stamps, truth, (truth + noise)[None], np.ones((1, len(truth), 18)))
    store_of(settings).save(0, estimates)
    evaluate_skeleton(settings, QUIET)
    numbers = json.loads((tmp_path / "numbers.json").read_text())
    exact, live, noisy = (numbers[name] for name in ("true joints, files", "true joints, live", "1 view, files"))
    assert exact["limb_swing_deg"] < 1.5 and exact["joint_error_cm"] < 0.5 and live["joint_error_cm"] < 0.8
    with_points = numbers["true joints and points, files"]
    assert with_points["head_deg"] < min(8, exact["head_deg"]) and with_points["feet_deg"] < exact["feet_deg"]
    assert with_points["joint_error_cm"] == pytest.approx(exact["joint_error_cm"], abs=1e-6)
    assert exact["length_variation_mm"] < 1e-6 and len(noisy["sequences"]) == 1
    assert noisy["joint_error_cm"] < noisy["free_joint_error_cm"] + 0.2


def test_estimates_of_other_motions_are_refused(tmp_path: Path, default_body: Body) -> None:
    settings = SkeletonEvaluation(tmp_path / "out", sequences=1, seconds=1.0, views=1)
    truth = np.zeros((5, 18, 3))
    store_of(settings).save(0, SequenceEstimates("x", np.arange(5), truth, truth[None], np.ones((1, 5, 18))))
    with pytest.raises(InputError, match="estimates of other motions"):
        evaluate_skeleton(settings, QUIET)
