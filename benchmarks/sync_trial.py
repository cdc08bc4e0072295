"""Clocks of two cameras that share nothing, put in step by movement: how often the offset is right. Needs the extra
``train``.

python benchmarks/sync_trial.py OUT
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, get_args

import numpy as np
import tyro
from calibration_trial_scene import MotionKind, TrialScene
from jaxtyping import Float
from numpy import ndarray
from rich.console import Console
from sync_table import sync_table
from sync_trial_tracks import camera_pose, simulated_track, true_joints

from depthmocap.calibration.clock_steps import find_step
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.observations import observe
from depthmocap.calibration.time_search import LONGEST_SEARCH_S, find_time
from depthmocap.classify.classifier import Classifier
from depthmocap.core.console import Terminal
from depthmocap.core.output import write_json
from depthmocap.recordings.open_recording import open_recording
from depthmocap.segment.static_scene import PersonSegmenter
from depthmocap.synth.people.bodies import random_dressed_body

#: How much later than its timestamps the second camera of takes of depth pictures exposes (seconds).
_LATE_S = 0.04
#: Length and rate of takes of depth pictures, and of simulated movement.
_DEPTH_S, _DEPTH_HZ = 22.0, 10.0
_MOVEMENT_S, _MOVEMENT_HZ = 90.0, 30.0


@dataclasses.dataclass(frozen=True)
class SyncTrial:
    """Pairs of recordings whose clocks are up to ten minutes apart, by kind of movement.

    Attributes:
        out: folder for takes and tracks, which are used again, and ``sync.json`` with the numbers of each pair.
        seeds: people and paths of each kind, simulated.
        pairs: pairs of recordings of each.
        depth_kinds: kinds of which takes of depth pictures are made, with a pair of cameras each.
        depth_pairs: pairs of recordings cut from each of these.
        track_hz: rate of simulated tracks.
        shared_s: how long both recordings see the person (seconds, at most 20), in turns.
    """

    out: tyro.conf.Positional[Path]
    seeds: int = 4
    pairs: int = 6
    depth_kinds: tuple[MotionKind, ...] = ("circle", "line", "arms")
    depth_pairs: int = 12
    track_hz: float = 15.0
    shared_s: tuple[float, ...] = (20.0, 20.0, 12.0, 8.0)


def run_sync_trial(trial: SyncTrial, console: Console) -> list[dict[str, Any]]:
    """Make takes, put them in step and compare; prints the table and stores the numbers."""
    rows = []
    for kind in (k for k in get_args(MotionKind) if k != "still"):
        for seed in range(trial.seeds):
            movement = _movement(trial.out, kind, seed)
            for number in range(trial.pairs):
                rng = np.random.default_rng([seed, number, 1])
                begin_s = rng.uniform(0.5, _MOVEMENT_S - 42)
                shared_s = trial.shared_s[number % len(trial.shared_s)]
                a_s = begin_s + np.arange(0, 20, 1 / trial.track_hz)
                b_s = a_s + 20 - shared_s + rng.uniform(0, 1 / trial.track_hz)
                azimuths = rng.uniform(0, 360) + np.array([0, rng.choice([60, 95, 140, 180])])
                a, b = (
                    simulated_track(movement, exposed_s, camera_pose(rng, azimuth), rng)
                    for exposed_s, azimuth in zip((a_s, b_s), azimuths.tolist(), strict=True)
                )
                rows.append({"kind": kind, "from": "simulated", **_compare(a, b, 0.0, shared_s, rng)})
        _tell(kind, rows, console)
    for kind in trial.depth_kinds:
        tracks = _depth_tracks(trial.out, kind)
        for number in range(trial.depth_pairs):
            rng = np.random.default_rng([number, 2])
            shared_s = trial.shared_s[number % len(trial.shared_s)]
            at_s = rng.uniform(0, _DEPTH_S - shared_s)
            a, b = _between(tracks[0], 0.0, at_s + shared_s), _between(tracks[1], at_s, _DEPTH_S)
            rows.append({"kind": kind, "from": "depth", **_compare(a, b, _LATE_S, shared_s, rng)})
        _tell(kind, rows, console)
    write_json(trial.out / "sync.json", rows)
    for line in sync_table(rows):
        console.print(line, soft_wrap=True)
    return rows


def _tell(kind: str, rows: list[dict[str, Any]], console: Console) -> None:
    some = [row for row in rows if row["kind"] == kind and row["from"] == rows[-1]["from"]]
    console.print(f"{kind}, {rows[-1]['from']}: {sum(row['told'] for row in some)} of {len(some)} told")


def _compare(a: JointTrack, b: JointTrack, late_s: float, shared_s: float, rng: np.random.Generator) -> dict[str, Any]:
    """What is found where the clock of b is off by up to ten minutes, against the truth."""
    start_s = float(a.times_s[0] - b.times_s[0])
    clock_s = rng.uniform(-LONGEST_SEARCH_S + 30, LONGEST_SEARCH_S - 30)
    match = find_time(a, JointTrack(b.times_s - clock_s + start_s, b.joints, b.sigma_m), rng)
    fit = match.fit
    return {
        "shared_s": shared_s,
        "told": match.told,
        "why": match.why,
        "error_s": None if fit is None else fit.shift_s - (clock_s - start_s + late_s),
        "sigma_s": None if fit is None else float(np.hypot(fit.sigma_s, 0.001)),
        "rank": match.rank,
        "rival": match.rival,
        "jump": match.told and fit is not None and find_step(
            a, JointTrack(b.times_s - clock_s + start_s, b.joints, b.sigma_m), fit
        ) is not None,
    }  # fmt: skip


def _movement(out: Path, kind: MotionKind, seed: int) -> tuple[Float[ndarray, " n"], Float[ndarray, "n 18 3"]]:
    """True joints, made once."""
    path = out / f"movement_{kind}_{seed}.npz"
    if not path.exists():
        rng = np.random.default_rng([seed, 7])
        dressed = random_dressed_body(rng, "easy")
        times_s, joints = true_joints(dressed, rng, kind, _MOVEMENT_S, _MOVEMENT_HZ)
        out.mkdir(parents=True, exist_ok=True)
        np.savez(path, times_s=times_s, joints=joints)
    stored = np.load(path)
    return stored["times_s"], stored["joints"]


def _depth_tracks(out: Path, kind: MotionKind) -> list[JointTrack]:
    """Tracks of two cameras from depth pictures, made once."""
    path = out / f"depth_{kind}.npz"
    if not path.exists():
        take = out / f"take_{kind}"
        late_s = (0.0, _LATE_S)
        TrialScene((10.0, 100.0), late_s, _DEPTH_S, _DEPTH_HZ, seed=1, motion=kind).write(take)
        recording = open_recording(take)
        segmenter = PersonSegmenter.from_recording(recording, "auto")
        seen = observe(recording, Classifier(None), segmenter, 2 * _DEPTH_HZ, lambda: None)
        fields = ("times_s", "joints", "sigma_m")
        np.savez(path, **{f"{field}{i}": getattr(s.track, field) for i, s in enumerate(seen) for field in fields})
    stored = np.load(path)
    return [JointTrack(stored[f"times_s{i}"], stored[f"joints{i}"], stored[f"sigma_m{i}"]) for i in range(2)]


def _between(track: JointTrack, first_s: float, last_s: float) -> JointTrack:
    kept = (track.times_s >= first_s) & (track.times_s < last_s)
    return JointTrack(track.times_s[kept], track.joints[kept], track.sigma_m[kept])


if __name__ == "__main__":
    run_sync_trial(tyro.cli(SyncTrial), Terminal())
