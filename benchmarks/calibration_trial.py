"""Errors of calibration in generated scenes with known ground truth. Needs the extra ``train``.

python benchmarks/calibration_trial.py OUT
"""

from __future__ import annotations

import dataclasses
import io
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from calibration_trial_scene import TrialScene
from jaxtyping import Float
from numpy import ndarray
from rich.console import Console
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.calibration.calibrate import CalibrateSettings, Calibration, find_rig
from depthmocap.calibration.pairs import align
from depthmocap.core.console import Terminal
from depthmocap.core.output import write_json
from depthmocap.errors import InputError
from depthmocap.geometry import Rig, rigid_inverse, save_rig, transform_points
from depthmocap.offline.pipeline_settings import load_pipeline
from depthmocap.recordings.open_recording import open_recording

#: Azimuths of the cameras around the middle, degrees.
_AZIMUTHS_DEG: dict[str, tuple[float, ...]] = {
    "3 cameras": (10.0, 125.0, 245.0),
    "2 cameras, opposite": (10.0, 190.0),
    "4 cameras": (10.0, 95.0, 190.0, 280.0),
    "2 cameras, 90° apart": (10.0, 100.0),
}


@dataclasses.dataclass(frozen=True)
class Trial:
    """Scenes of every kind, recorded, calibrated and compared with the truth.

    Attributes:
        out: folder for the recordings, and for ``trial.json`` with the numbers of each.
        repeats: scenes of each kind, with other people, trajectories and cameras.
        seconds: length of each.
        rate_hz: frame sets per second.
        only: kinds of scenes whose names begin with this.
    """

    out: tyro.conf.Positional[Path]
    repeats: int = 1
    seconds: float = 20.0
    rate_hz: float = 5.0
    seed: int = 0
    only: str = ""


def _scenes(trial: Trial) -> dict[str, TrialScene]:
    scenes = {name: TrialScene(azimuths) for name, azimuths in _AZIMUTHS_DEG.items()}
    three = scenes["3 cameras"]
    scenes["3 cameras, out of step by 20 ms"] = dataclasses.replace(three, out_of_step_s=(0.0, 0.02, -0.02))
    scenes["3 cameras, no room"] = dataclasses.replace(three, room=False)
    return {
        name: dataclasses.replace(scene, seconds=trial.seconds, rate_hz=trial.rate_hz)
        for name, scene in scenes.items()
        if name.startswith(trial.only)
    }


def run_trial(trial: Trial, console: Console) -> list[dict[str, Any]]:
    """Make, calibrate and compare; prints a line and stores the numbers after each scene."""
    rows = []
    for repeat in range(trial.repeats):
        for name, scene in _scenes(trial).items():
            scene = dataclasses.replace(scene, seed=1000 * trial.seed + repeat)
            path = trial.out / f"{name} {repeat}".replace("°", "").replace(",", "").replace(" ", "_")
            true_rig = scene.write(path)
            quiet = Terminal(file=io.StringIO())
            calibration = find_rig(open_recording(path), CalibrateSettings(path), quiet)
            rows.append({"scene": name, "repeat": repeat, **compare(path, true_rig, calibration)})
            write_json(trial.out / "trial.json", rows)
            shown = ", ".join(f"{key} {value:.2f}" for key, value in rows[-1].items() if isinstance(value, float))
            console.print(f"{name}, {repeat}: {shown}, {calibration.grade}, floor by {calibration.floor}")
    return rows


def compare(path: Path, true_rig: Rig, calibration: Calibration) -> dict[str, Any]:
    """Errors of the calibrated rig against the true one, and joint errors with both.

    Raises:
        InputError: when a camera could not be placed.
    """
    if calibration.unplaced:
        raise InputError(f"{path}: {calibration.unplaced}")
    truth = np.stack([joints for _, joints in open_recording(path).truth_rows()])
    middle = np.median(truth[:, JOINT_INDEX["Hip"]], axis=0)
    errors = [
        _pair_error(true_rig, calibration.rig, *pair, middle)
        for pair in itertools.combinations(range(len(true_rig.cameras)), 2)
    ]
    millimetres, degrees = np.array(errors).T
    first_true, first = true_rig.cameras[0].world_from_camera, calibration.rig.cameras[0].world_from_camera
    tilt = np.rad2deg(np.arccos(np.clip(first_true[2, :3] @ first[2, :3], -1, 1)))
    return {
        "mm": float(millimetres.mean()),
        "most mm": float(millimetres.max()),
        "degrees": float(degrees.mean()),
        "most degrees": float(degrees.max()),
        "± mm": max(pair.uncertainty_mm for pair in calibration.pairs),
        "± degrees": max(pair.uncertainty_deg for pair in calibration.pairs),
        "tilt degrees": float(tilt),
        "height mm": 1e3 * float(np.abs([
            camera.world_from_camera[2, 3] - true.world_from_camera[2, 3]
            for camera, true in zip(calibration.rig.cameras, true_rig.cameras, strict=True)
        ]).max()),
        "joints cm, true rig": _joint_error_cm(path, true_rig),
        "joints cm, found rig": _joint_error_cm(path, calibration.rig),
        "late_ms": {name: 1e3 * offset_s for name, offset_s in calibration.offset_s.items()},
        "floor": calibration.floor,
        "grade": calibration.grade,
    }  # fmt: skip


def _pair_error(true: Rig, rig: Rig, a: int, b: int, middle: Float[ndarray, "3"]) -> tuple[float, float]:
    """Error of a pair at the person's position (mm), and of its rotation (degrees)."""
    b_from_a = rigid_inverse(rig.cameras[b].world_from_camera) @ rig.cameras[a].world_from_camera
    true_b_from_a = true.cameras[b].camera_from_world @ true.cameras[a].world_from_camera
    error = b_from_a @ rigid_inverse(true_b_from_a)
    person = transform_points(true.cameras[b].camera_from_world, middle)
    moved = transform_points(error, person) - person
    return 1e3 * float(np.linalg.norm(moved)), float(np.rad2deg(Rotation.from_matrix(error[:3, :3]).magnitude()))


def _joint_error_cm(path: Path, rig: Rig) -> float:
    """Mean joint error of the pipeline with a rig, after one rigid alignment of all joints to the true ones, since the
    world of a calibrated rig is arbitrary."""
    save_rig(rig, path / "rig.json")
    recording = open_recording(path)
    pipeline = load_pipeline(recording)
    pairs = [(pipeline(frames).pose.joints, frames.true_joints) for frames in recording]
    joints, truth = (np.stack(arrays).reshape(-1, 3) for arrays in zip(*pairs, strict=True))
    known = np.isfinite(joints).all(1)
    true_from_found = align(truth[known], joints[known], np.ones(known.sum()))
    errors = transform_points(true_from_found, joints[known]) - truth[known]
    return 100 * float(np.linalg.norm(errors, axis=1).mean())


if __name__ == "__main__":
    run_trial(tyro.cli(Trial), Terminal())
