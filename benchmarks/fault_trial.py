"""Faults of cameras in generated takes: told rightly, told wrongly, and false alarms. Needs the extra ``train``.

python benchmarks/fault_trial.py OUT

Takes of a person who walks about are seen by four cameras, of which every rig has some. Pictures that are mirrored,
turned, or in half or 0.7 of their unit go through the network; other units and poses are changed in what it saw, and so
are units in which the first look does not find the person as they are.
"""

from __future__ import annotations

import collections
import dataclasses
import itertools
import pickle
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from calibration_trial_scene import TrialScene
from jaxtyping import Float
from numpy import ndarray
from rich.console import Console
from scipy.spatial.transform import Rotation

from depthmocap.calibration.first_look import joints_in
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.picture_faults import STATURE_PER_CHAIN, STATURES_M, chain_m, find_picture_faults, scaled
from depthmocap.calibration.recording_check import pose_faults_of
from depthmocap.calibration.turned_pictures import find_turned_pictures
from depthmocap.classify.classifier import Classifier
from depthmocap.core.console import Terminal
from depthmocap.core.output import write_json
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera, Rig, load_rig, rigid_inverse, save_rig
from depthmocap.recordings.open_recording import open_recording
from depthmocap.segment.static_scene import PersonSegmenter

_AZIMUTHS_DEG = (10.0, 100.0, 190.0, 280.0)
#: Heights of the people, in turns (metres): children of 0.9 m among them.
_STATURES_M = (0.9, 1.75, 0.9, 1.6, 1.9, 1.1)
#: Least surface of a person (m²).
_LEAST_M2 = 0.05
_FLIP, _OPENGL, _Y_DOWN = np.diag([-1.0, -1, 1, 1]), np.diag([1.0, -1, -1, 1]), np.diag([1.0, -1, 1, 1])
_TURN_15 = np.eye(4)
_TURN_15[:3, :3] = Rotation.from_euler("y", 15, degrees=True).as_matrix()

Pose = Float[ndarray, "4 4"]
#: Faults of one camera's pictures: what the network sees of them, and a factor on it.
PICTURES: dict[str, tuple[str, float]] = {
    "unit × 0.1": ("plain", 0.1), "unit × 0.25": ("plain", 0.25), "unit × 0.5": ("half", 1.0),
    "unit × 0.7": ("0.7", 1.0), "unit × 2": ("plain", 2.0), "unit × 4": ("plain", 4.0), "unit × 10": ("plain", 10.0),
    "mirrored": ("mirror", 1.0), "turned 180": ("rot2", 1.0),
}  # fmt: skip
#: Pictures that went through the network in another unit.
SCALES = {"half": 0.5, "0.7": 0.7}
#: What goes through the network of every picture.
VARIANTS = ("plain", "mirror", "rot2", *SCALES)
#: Faults of one camera's pose: what is written of it.
POSES: dict[str, Callable[[Pose], Pose]] = {
    "inverse": rigid_inverse,
    "millimetres": lambda pose: np.block([[pose[:3, :3], 1000 * pose[:3, 3:]], [pose[3:]]]),
    "opengl": lambda pose: pose @ _OPENGL,
    "unity": lambda pose: _Y_DOWN @ pose @ _Y_DOWN,
    "elsewhere (15°)": lambda pose: pose @ _TURN_15,
}


@dataclasses.dataclass(frozen=True)
class FaultTrial:
    """Takes with every fault in rigs of one to four cameras.

    Attributes:
        out: folder for the takes, and for ``trial.json`` with the counts. What is there is not made again.
        takes: people, each with another path and other cameras; half of them children.
        faults: give cameras faults; otherwise right rigs alone are judged, which is quick, so that there may be many.
        seconds: length of each.
        rate_hz: frame sets per second.
    """

    out: tyro.conf.Positional[Path]
    takes: int = 6
    faults: bool = True
    seconds: float = 12.0
    rate_hz: float = 5.0
    seed: int = 101


@dataclasses.dataclass(frozen=True, eq=False)
class Take:
    """A rig, and what its cameras see of one person, by the kind of picture."""

    rig: Rig
    tracks: dict[str, dict[str, JointTrack]]


def make_take(trial: FaultTrial, number: int) -> Take:
    """The take of this number; made, and seen by the network, where it is not there yet."""
    seed, stature_m = trial.seed + number, _STATURES_M[number % len(_STATURES_M)]
    path = trial.out / f"take-{seed}"
    rig_path, tracks_path = path.with_suffix(".rig.json"), path.with_suffix(".pickle")
    if not rig_path.exists():
        scene = TrialScene(_AZIMUTHS_DEG, (), trial.seconds, trial.rate_hz, seed=seed, stature_m=stature_m)
        save_rig(scene.write(path), rig_path)
    if not trial.faults:
        return Take(load_rig(rig_path), _see(path, ("plain",)))
    if not tracks_path.exists():
        tracks_path.write_bytes(pickle.dumps(_see(path)))
    return Take(load_rig(rig_path), pickle.loads(tracks_path.read_bytes()))


def _see(path: Path, kinds: Collection[str] = VARIANTS) -> dict[str, dict[str, JointTrack]]:
    recording, classifier = open_recording(path), Classifier()
    segmenter = PersonSegmenter.from_recording(recording)
    tracks = {}
    for camera in recording.rig.cameras:
        camera = dataclasses.replace(camera, world_from_camera=np.eye(4))
        turned = dataclasses.replace(camera.turned(2), world_from_camera=np.eye(4))
        times_s, seen = [], collections.defaultdict(list)
        for stamp in recording.stamps(camera.name):
            view = View(camera, camera.to_metres(recording.raw(camera.name, stamp)))
            mask = segmenter(view)
            if (view.depth_m[mask] ** 2).sum() / (camera.fx * camera.fy) < _LEAST_M2:
                continue
            times_s.append(stamp / 1e9)
            flipped, upside_down = (np.ascontiguousarray(each) for each in (mask[:, ::-1], mask[::-1, ::-1]))
            variants = {
                "plain": (view, mask),
                "mirror": (View(camera, np.ascontiguousarray(view.depth_m[:, ::-1])), flipped),
                "rot2": (View(turned, np.ascontiguousarray(view.depth_m[::-1, ::-1])), upside_down),
                "half": (View(camera, view.depth_m * np.float32(0.5)), mask),
                "0.7": (View(camera, view.depth_m * np.float32(0.7)), mask),
            }
            for name in kinds:
                seen[name].append(joints_in(*variants[name], classifier))
        tracks[camera.name] = {
            name: JointTrack(np.array(times_s), np.stack(joints)[..., :3], np.stack(joints)[..., 3])
            for name, joints in seen.items()
        }
    return tracks


def judge(cameras: list[DepthCamera], tracks: list[JointTrack]) -> list[tuple[str, tuple[str, ...]]]:
    """Kinds of the faults that are told, and of which cameras."""
    rng = np.random.default_rng(0)
    pictures = find_picture_faults(cameras, tracks, rng)
    pictures += find_turned_pictures(cameras, tracks, pictures, rng)
    poses = pose_faults_of(cameras, tracks, pictures, "z", rng)
    return [(fault.kind, fault.cameras) for fault in (*pictures, *poses)]


def outcome(told: list[tuple[str, tuple[str, ...]]], kind: str, wrong: str, count: int) -> str:
    """Whether what was told is what is wrong."""
    named = {name for _, names in told for name in names}
    expected = "unit" if kind.startswith("unit ") else "mirror" if kind == "mirrored" else kind.split(" (")[0]
    if not told:
        return "nothing told"
    if named == {wrong}:
        return "named rightly" if [each for each, _ in told] == [expected] else "right camera, other words"
    return "both named" if wrong in named and count == 2 else "wrong camera"


def run_trial(trial: FaultTrial, console: Console) -> dict[str, Any]:
    """Every fault in every take; stores and prints the counts after each take."""
    counts: dict[str, dict[str, collections.Counter[str]]] = collections.defaultdict(
        lambda: collections.defaultdict(collections.Counter)
    )
    document: dict[str, Any] = {"right rigs": 0, "false alarms": [], "faults": counts}
    false_alarms: list[str] = document["false alarms"]
    rng = np.random.default_rng(trial.seed)
    for number in range(trial.takes):
        take = make_take(trial, number)
        everybody = take.rig.cameras
        for size in range(1, 5):
            for chosen in itertools.combinations(everybody, size):
                tracks = [take.tracks[camera.name]["plain"] for camera in chosen]
                told = judge([_calibrated(camera, rng) for camera in chosen], tracks)
                document["right rigs"] += 1
                false_alarms += [f"take {number}, {size} cameras: {told}"] if told else []
            chosen = [everybody[(number + i) % 4] for i in range(size)]
            wrong = chosen[number % size]
            for kind in (*PICTURES, *POSES) if trial.faults else ():
                told = judge(*_with_fault(take, chosen, wrong, kind))
                counts[kind][str(size)][outcome(told, kind, wrong.name, size)] += 1
        write_json(trial.out / "trial.json", document)
        console.print(f"{number + 1} takes: {len(false_alarms)} false alarms in {document['right rigs']} right rigs")
    for line in table(counts) if trial.faults else ():
        console.print(line)
    return document


def _calibrated(camera: DepthCamera, rng: np.random.Generator) -> DepthCamera:
    """The camera where a calibration places it: 5 mm and 0.2° off."""
    pose = camera.world_from_camera.copy()
    pose[:3, :3] = Rotation.from_rotvec(np.deg2rad(rng.normal(0, 0.12, 3))).as_matrix() @ pose[:3, :3]
    pose[:3, 3] += rng.normal(0, 0.003, 3)
    return dataclasses.replace(camera, world_from_camera=pose)


def _with_fault(
    take: Take, chosen: list[DepthCamera], wrong: DepthCamera, kind: str
) -> tuple[list[DepthCamera], list[JointTrack]]:
    cameras, tracks = [], []
    for camera in chosen:
        seen, factor = PICTURES.get(kind, ("plain", 1.0)) if camera is wrong else ("plain", 1.0)
        if seen in SCALES and not STATURES_M[0] < SCALES[seen] * _stature_m(take, camera) < STATURES_M[1]:
            seen, factor = "plain", SCALES[seen]
        pose = camera.world_from_camera
        if camera is wrong and kind in POSES:
            pose = POSES[kind](pose)
        cameras.append(dataclasses.replace(camera, world_from_camera=pose))
        tracks.append(scaled(take.tracks[camera.name][seen], factor))
    return cameras, tracks


def _stature_m(take: Take, camera: DepthCamera) -> float:
    return STATURE_PER_CHAIN * chain_m(take.tracks[camera.name]["plain"])


def table(counts: dict[str, dict[str, collections.Counter[str]]]) -> list[str]:
    """A row for each fault, a column for each number of cameras."""
    lines = ["| | 1 camera | 2 | 3 | 4 |", "|---|---|---|---|---|"]
    for kind, by_size in counts.items():
        cells = ("; ".join(f"{times} {what}" for what, times in by_size[size].items()) for size in "1234")
        lines.append(f"| {kind} | {' | '.join(cells)} |")
    return lines


if __name__ == "__main__":
    run_trial(tyro.cli(FaultTrial), Terminal())
