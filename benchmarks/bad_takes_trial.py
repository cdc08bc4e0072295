"""What a calibration says of bad takes: somebody stands, there are two people, cameras share no view, one stops
half-way, a clock jumps. Needs the extra ``train``.

python benchmarks/bad_takes_trial.py OUT
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from calibration_trial_scene import MotionKind
from jaxtyping import Float
from numpy import ndarray
from rich.console import Console
from scipy.spatial.transform import Rotation
from sync_trial_tracks import camera_pose, simulated_track, true_joints

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.calibration.calibrate import Calibration, solve_rig
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.observations import Observation
from depthmocap.core.console import Terminal
from depthmocap.core.output import write_json
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, rigid_inverse, transform_points
from depthmocap.synth.people.bodies import random_dressed_body

#: Kinds of takes, and how the person moves in them.
KINDS: dict[str, MotionKind] = {
    "good": "about", "stands": "arms", "two people": "about", "no shared view": "about", "stops half-way": "about",
    "clock jumps": "about",
}  # fmt: skip
_SECONDS, _HZ, _MOVEMENT_S = 24.0, 10.0, 60.0
_AZIMUTHS_DEG = (10.0, 125.0, 245.0)
#: Length of a time in which a camera sees the person alone (seconds), and by how much a clock jumps.
_TURN_S, _JUMP_S = 3.0, 0.7

Movement = tuple[Float[ndarray, " n"], Float[ndarray, "n 18 3"]]


@dataclasses.dataclass(frozen=True)
class BadTakesTrial:
    """Takes of three simulated tracks each.

    Attributes:
        out: folder for movements, which are used again, and ``bad_takes.json``.
        takes: of each kind.
    """

    out: tyro.conf.Positional[Path]
    takes: int = 4
    seed: int = 0


def run_bad_takes(trial: BadTakesTrial, console: Console) -> list[dict[str, Any]]:
    """Solve every take; prints and stores what is said, and whether each pair is within its ±."""
    rows = []
    for kind, motion in KINDS.items():
        for number in range(trial.takes):
            rng = np.random.default_rng([trial.seed, number])
            movement = _movement(trial.out, motion, number)
            other = _movement(trial.out, motion, (number + 1) % trial.takes)
            poses = [camera_pose(rng, azimuth) for azimuth in _AZIMUTHS_DEG]
            tracks = _tracks(kind, movement, other, poses, rng)
            rows.append({"kind": kind, **_outcome(tracks, poses, movement, rng)})
            console.print(f"{kind}, {number}: {rows[-1]['said']}", soft_wrap=True)
            write_json(trial.out / "bad_takes.json", rows)
    for line in table(rows):
        console.print(line, soft_wrap=True)
    return rows


def _movement(out: Path, kind: MotionKind, seed: int) -> Movement:
    path = out / f"movement_{kind}_{seed}.npz"
    if not path.exists():
        rng = np.random.default_rng([seed, 7])
        times_s, joints = true_joints(random_dressed_body(rng, "easy"), rng, kind, _MOVEMENT_S, 30.0)
        out.mkdir(parents=True, exist_ok=True)
        np.savez(path, times_s=times_s, joints=joints)
    stored = np.load(path)
    return stored["times_s"], stored["joints"]


def _tracks(
    kind: str, movement: Movement, other: Movement, poses: list[Float[ndarray, "4 4"]], rng: np.random.Generator
) -> list[JointTrack]:
    times_s = np.arange(0, _SECONDS, 1 / _HZ)
    tracks = [simulated_track(movement, times_s, pose, rng) for pose in poses]
    first = tracks[0]
    if kind == "two people":  # each camera follows one of them, now this and now that
        others = [simulated_track(other, times_s + 20, pose, rng) for pose in poses]
        for i, track in enumerate(tracks):
            mine = np.repeat(rng.random(len(times_s) // 20 + 1) < 0.3, 20)[: len(times_s), None]
            joints = np.where(mine[..., None], others[i].joints, track.joints)
            tracks[i] = JointTrack(times_s, joints, np.where(mine, others[i].sigma_m, track.sigma_m))
    elif kind == "no shared view":  # one after the other
        turns = (times_s // _TURN_S).astype(int) % len(tracks)
        tracks = [_kept(track, turns == i) for i, track in enumerate(tracks)]
    elif kind == "stops half-way":
        tracks[0] = _kept(first, times_s < _SECONDS / 2)
    elif kind == "clock jumps":
        tracks[0] = JointTrack(times_s + np.where(times_s > _SECONDS / 2, _JUMP_S, 0), first.joints, first.sigma_m)
    return tracks


def _kept(track: JointTrack, kept: ndarray) -> JointTrack:
    return JointTrack(track.times_s[kept], track.joints[kept], track.sigma_m[kept])


def _outcome(
    tracks: list[JointTrack], poses: list[Float[ndarray, "4 4"]], movement: Movement, rng: np.random.Generator
) -> dict[str, Any]:
    cameras = [DepthCamera(f"cam{i}", 32, 24, 30.0, 30.0, 15.5, 11.5) for i in range(len(poses))]
    unknown = np.zeros((24, 32), np.float32)
    observations = [
        Observation(camera, track, {}, unknown, len(track.times_s))
        for camera, track in zip(cameras, tracks, strict=True)
    ]
    try:
        found = solve_rig("the take", observations, [], rng)
    except InputError as error:
        return {"said": f"error: {error}", "good": False, "pairs": [], "held": []}
    pairs = [_pair(found, pair, poses, movement) for pair in found.pairs]
    why = [*found.unplaced.values(), *found.warnings[:2]]
    return {
        "said": f"{found.grade}, {len(found.rig.cameras)} placed; {'; '.join(why)}",
        "good": found.grade == "good",
        "pairs": pairs,
        "held": [cm <= limit_cm and deg <= limit_deg for cm, deg, limit_cm, limit_deg, told in pairs if told],
    }


def _pair(
    found: Calibration, pair: Any, poses: list[Float[ndarray, "4 4"]], movement: Movement
) -> tuple[float, float, float, float, bool]:
    """Error of a pair where the person was (cm) and of its rotation (degrees), ± of both, and whether time is told."""
    a, b = (int(name[-1]) for name in pair.cameras)
    b_from_a = (
        rigid_inverse(found.rig[pair.cameras[1]].world_from_camera) @ found.rig[pair.cameras[0]].world_from_camera
    )
    error = b_from_a @ rigid_inverse(rigid_inverse(poses[b]) @ poses[a])
    person = transform_points(rigid_inverse(poses[b]), np.median(movement[1][:, JOINT_INDEX["Hip"]], axis=0))
    cm = 100 * float(np.linalg.norm(transform_points(error, person) - person))
    degrees = float(np.rad2deg(Rotation.from_matrix(error[:3, :3]).magnitude()))
    return cm, degrees, pair.uncertainty_mm / 10, pair.uncertainty_deg, pair.time_told


def table(rows: list[dict[str, Any]]) -> list[str]:
    """A row for each kind."""
    lines = ["| | takes | pairs with ± | ± held | largest error | called good |", "|---|---|---|---|---|---|"]
    for kind in KINDS:
        some = [row for row in rows if row["kind"] == kind]
        held = [held for row in some for held in row["held"]]
        errors_cm = [pair[0] for row in some for pair in row["pairs"] if pair[4]]
        worst = f"{max(errors_cm):.1f} cm" if errors_cm else "–"
        good = sum(row["good"] for row in some)
        lines.append(f"| {kind} | {len(some)} | {len(held)} | {sum(held)} | {worst} | {good} |")
    return lines


if __name__ == "__main__":
    run_bad_takes(tyro.cli(BadTakesTrial), Terminal())
