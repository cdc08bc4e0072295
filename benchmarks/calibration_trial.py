"""How well cameras are placed in generated scenes, where the truth is known. Needs the extra ``train``.

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

#: Where cameras stand (degrees around the middle).
_AROUND: dict[str, tuple[float, ...]] = {
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
        repeats: scenes of each kind, of other people, ways and cameras.
        seconds: of each.
        rate_hz: sets a second.
        only: kinds of scenes whose names begin with this.
    """

    out: tyro.conf.Positional[Path]
    repeats: int = 1
    seconds: float = 20.0
    rate_hz: float = 5.0
    seed: int = 0
    only: str = ""


def _kinds(trial: Trial) -> dict[str, TrialScene]:
    scenes = {name: TrialScene(azimuths) for name, azimuths in _AROUND.items()}
    three = scenes["3 cameras"]
    scenes["3 cameras, out of step by 20 ms"] = dataclasses.replace(three, out_of_step_s=(0.0, 0.02, -0.02))
    scenes["3 cameras, no room"] = dataclasses.replace(three, room=False)
    return {
        name: dataclasses.replace(scene, seconds=trial.seconds, rate_hz=trial.rate_hz)
        for name, scene in scenes.items()
        if name.startswith(trial.only)
    }


def run_trial(trial: Trial, console: Console) -> list[dict[str, Any]]:
    """Make, calibrate and compare; prints a line and keeps the numbers of every scene as it is done."""
    rows = []
    for repeat in range(trial.repeats):
        for name, scene in _kinds(trial).items():
            scene = dataclasses.replace(scene, seed=1000 * trial.seed + repeat)
            path = trial.out / f"{name} {repeat}".replace("°", "").replace(",", "").replace(" ", "_")
            true_rig = scene.write(path)
            quiet = Terminal(file=io.StringIO())
            found = find_rig(open_recording(path), CalibrateSettings(path), quiet)
            rows.append({"scene": name, "repeat": repeat, **compare(path, true_rig, found)})
            write_json(trial.out / "trial.json", rows)
            shown = ", ".join(f"{key} {value:.2f}" for key, value in rows[-1].items() if isinstance(value, float))
            console.print(f"{name}, {repeat}: {shown}, {found.grade}, floor by {found.floor}")
    return rows


def compare(path: Path, true_rig: Rig, found: Calibration) -> dict[str, Any]:
    """Errors of the found rig against the true one, and of joints by both.

    Raises:
        InputError: when a camera could not be placed.
    """
    if found.unplaced:
        raise InputError(f"{path}: {found.unplaced}")
    truth = np.stack([joints for _, joints in open_recording(path).truth_rows()])
    middle = np.median(truth[:, JOINT_INDEX["Hip"]], axis=0)
    errors = [
        _pair_error(true_rig, found.rig, *pair, middle)
        for pair in itertools.combinations(range(len(true_rig.cameras)), 2)
    ]
    millimetres, degrees = np.array(errors).T
    first_true, first = true_rig.cameras[0].world_from_camera, found.rig.cameras[0].world_from_camera
    tilt = np.rad2deg(np.arccos(np.clip(first_true[2, :3] @ first[2, :3], -1, 1)))
    return {
        "mm": float(millimetres.mean()),
        "most mm": float(millimetres.max()),
        "degrees": float(degrees.mean()),
        "most degrees": float(degrees.max()),
        "± mm": max(pair.uncertainty_mm for pair in found.pairs),
        "± degrees": max(pair.uncertainty_deg for pair in found.pairs),
        "tilt degrees": float(tilt),
        "height mm": 1e3 * float(np.abs([
            camera.world_from_camera[2, 3] - true.world_from_camera[2, 3]
            for camera, true in zip(found.rig.cameras, true_rig.cameras, strict=True)
        ]).max()),
        "joints cm, true rig": _joint_error_cm(path, true_rig),
        "joints cm, found rig": _joint_error_cm(path, found.rig),
        "late_ms": {name: 1e3 * offset_s for name, offset_s in found.offset_s.items()},
        "floor": found.floor,
        "grade": found.grade,
    }  # fmt: skip


def _pair_error(true: Rig, found: Rig, a: int, b: int, middle: Float[ndarray, "3"]) -> tuple[float, float]:
    """How far a pair puts the person wrong (mm), and the turn between them (degrees)."""
    b_from_a = rigid_inverse(found.cameras[b].world_from_camera) @ found.cameras[a].world_from_camera
    true_b_from_a = true.cameras[b].camera_from_world @ true.cameras[a].world_from_camera
    error = b_from_a @ rigid_inverse(true_b_from_a)
    person = transform_points(true.cameras[b].camera_from_world, middle)
    displacement = transform_points(error, person) - person
    return 1e3 * float(np.linalg.norm(displacement)), float(np.rad2deg(Rotation.from_matrix(error[:3, :3]).magnitude()))


def _joint_error_cm(path: Path, rig: Rig) -> float:
    """Mean joint error of the pipeline with a rig, after one rigid motion of all joints onto the true ones: a found
    world stands where it likes."""
    save_rig(rig, path / "rig.json")
    recording = open_recording(path)
    pipeline = load_pipeline(recording)
    pairs = [(pipeline(frames).pose.joints, frames.true_joints) for frames in recording]
    joints, truth = (np.stack(each).reshape(-1, 3) for each in zip(*pairs, strict=True))
    known = np.isfinite(joints).all(1)
    true_from_found = align(truth[known], joints[known], np.ones(known.sum()))
    error = transform_points(true_from_found, joints[known]) - truth[known]
    return 100 * float(np.linalg.norm(error, axis=1).mean())


if __name__ == "__main__":
    run_trial(tyro.cli(Trial), Terminal())
