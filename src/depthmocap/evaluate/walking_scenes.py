"""People who walk, turn, sit down and stand up, with what is true of them: for ``depthmocap evaluate analysis``.

Motion is made by rule (:mod:`~depthmocap.synth.motion.stroll` and a score for a seat), or is that of motion capture
clips of walking, whose path over the floor is kept. A foot is on the floor from when its heel or toe comes to rest
until both have gone: two points of the sole, which the joints do not have.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import itertools
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.analysis.gait_events import Swing
from depthmocap.core.reading.input_files import read_text
from depthmocap.errors import InputError
from depthmocap.evaluate.moving_people import FPS
from depthmocap.frames import FrameSet, View
from depthmocap.geometry import look_at, rotation_between
from depthmocap.synth.body.mesh import Body, BodyModel, Phenotype
from depthmocap.synth.motion.clips.bvh_clips import read_bvh_motion
from depthmocap.synth.motion.clips.retarget import AXES, retarget
from depthmocap.synth.motion.clips.skeletons import map_skeleton
from depthmocap.synth.motion.mocap import split_of
from depthmocap.synth.motion.perform import Motion, Score, leg_length, perform, pose_sequence
from depthmocap.synth.motion.postures import anny_rest
from depthmocap.synth.motion.stroll import Stop, stroll
from depthmocap.synth.people.bodies import random_dressed_body
from depthmocap.synth.people.garments import DressedBody
from depthmocap.synth.render import render_person
from depthmocap.synth.sample import Split
from depthmocap.synth.sensing.sensor import sense
from depthmocap.synth.sensing.sensors import SensorPreset

#: Distances of cameras, which stand all around (m),
_DISTANCE_M = (3.3, 4.2)
#: their heights (m),
_HEIGHT_M = (1.0, 2.0)
#: and how far each is from an even spread (radians).
_SPREAD_RAD = 0.35
#: They look at this height (m).
_AIM_M = 0.9
#: Speed at which the slower of heel and toe has come to rest (m/s),
RESTS_MPS = 0.5
#: and at which it has gone (m/s).
GONE_MPS = 1.0
_WALK = re.compile(r"\bwalk\b", re.IGNORECASE)
_ODD = re.compile(r"uneven|backward|sideways|start|stop", re.IGNORECASE)
#: A clip that goes further is cut (m),
_LONGEST_M = 4.6
#: and one that is shorter left out (s).
_SHORTEST_S = 2.0


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """Somebody who moves at ``FPS`` frames a second.

    Attributes:
        name: of the motion.
        kind: walking, turning, seat or clip.
        joints: true ones (m, Z up).
        swings: true ones of both feet, in the order of heel strikes; where feet stand is left open (NaN).
    """

    name: str
    kind: str
    dressed: DressedBody
    motion: Motion
    joints: Float[ndarray, "t 18 3"]
    swings: list[Swing]


def made_scenes(count: int, rng: np.random.Generator) -> Iterator[Scene]:
    """So many of each kind of motion that is made by rule."""
    for i in range(count):
        for kind in ("walking", "turning", "seat"):
            person_rng = rng.spawn(1)[0]
            dressed = random_dressed_body(person_rng, "open")
            if kind == "seat":
                motion = _seat(dressed, person_rng)
            else:
                speed = person_rng.uniform(0.7, 1.3)
                stops = [Stop(0.0, 1.9), Stop(0.0, -1.9)]
                if kind == "turning":
                    stops = [Stop(-1.1, 1.0), Stop(-1.0, -1.0), Stop(1.0, -1.1), Stop(1.1, 1.0)]
                way = sum(np.hypot(b.x - a.x, b.y - a.y) for a, b in itertools.pairwise(stops))
                times_s = np.arange(round((way / speed + 1.0) * FPS)) / FPS
                motion = stroll(dressed, stops, 0.4, speed, times_s)
            yield _scene(f"{kind} {i}", kind, dressed, motion)


def clip_scenes(folder: Path, split: Split, count: int, rng: np.random.Generator) -> Iterator[Scene]:
    """Up to so many clips of walking, of BVH files whose up axis is Y. A ``manifest.csv`` (columns file, description)
    tells which those are. The path of the pelvis is the file's, scaled by the length of legs.

    Raises:
        InputError: when the folder has no manifest, or no such clip of the split.
    """
    names = walks(folder, split)
    order = rng.permutation(len(names))[:count]
    for i in sorted(order.tolist()):
        person_rng = rng.spawn(1)[0]
        dressed = random_dressed_body(person_rng, "open")
        motion = captured_walk(folder / names[i], dressed.body)
        if motion is not None:
            motion = _on_the_floor(motion, dressed)
            yield _scene(f"clip {Path(names[i]).stem}", "clip", dressed, motion)


def walks(folder: Path, split: Split) -> list[str]:
    """Names of the clips of a split that show ordinary walking.

    Raises:
        InputError: as :func:`clip_scenes`.
    """
    manifest = folder / "manifest.csv"
    if not manifest.is_file():
        raise InputError(f"{folder} has no manifest.csv, which tells what clips show")
    rows = csv.DictReader(io.StringIO(read_text(manifest)))
    names = [
        row["file"]
        for row in rows
        if row.get("file", "").endswith(".bvh")
        and _WALK.search(row.get("description") or "")
        and not _ODD.search(row["description"])
        and split_of(Path(row["file"]).stem) == split
    ]
    if not names:
        raise InputError(f"{folder}: no BVH clip of the {split} split is described as a walk")
    return sorted(names)


def captured_walk(path: Path, body: Body) -> Motion | None:
    """The motion of a clip by a body, at any height; None of one that is short."""
    motion = read_bvh_motion(path, every_frame=False)
    skeleton = map_skeleton(motion)
    postures = retarget(motion, skeleton, anny_rest(), "y").postures.astype(np.float64)
    limbs = [f"{bone}.{side}" for bone in ("thigh", "shin") for side in "RL"]
    leg = sum(float(np.linalg.norm(motion.tail(skeleton.joints[limb]))) for limb in limbs) / 2
    z_up = rotation_between(AXES["y"], np.array([0.0, 0.0, 1.0]))
    path_m = motion.root_path @ z_up.T * (leg_length(body) / leg)
    far = np.linalg.norm(path_m[:, :2] - path_m[0, :2], axis=1) > _LONGEST_M
    end = int(far.argmax()) if far.any() else len(far)
    if end < _SHORTEST_S * FPS:
        return None
    postures, path_m = postures[:end], path_m[:end].copy()
    path_m[:, :2] -= (path_m[:, :2].max(0) + path_m[:, :2].min(0)) / 2
    return Motion(np.arange(end) / FPS, postures, path_m - body.rest_heads[0])


def _on_the_floor(made: Motion, dressed: DressedBody) -> Motion:
    lowest = np.array([person.lowest_m for person in pose_sequence(dressed, made)])
    return dataclasses.replace(made, offsets=made.offsets - [0.0, 0.0, float(np.quantile(lowest, 0.1))])


def _seat(dressed: DressedBody, rng: np.random.Generator) -> Motion:
    """Somebody sits, stands up, stands, and sits down again; the seat itself is not there."""
    rise, stand, down = rng.uniform(0.9, 1.8), rng.uniform(1.0, 1.6), rng.uniform(1.0, 2.0)
    at = np.cumsum([1.0, rise, stand, down])
    end = float(at[-1] + 1.0)
    drop, back, lean = rng.uniform(0.4, 0.47), rng.uniform(0.36, 0.42), rng.uniform(20, 35)

    def keys(seated: float, moving: float, upright: float) -> list[tuple[float, float]]:
        return [
            (0.0, seated), (at[0], seated), (at[0] + 0.4 * rise, moving), (at[1], upright), (at[2], upright),
            (at[2] + 0.6 * down, moving), (at[3], seated), (end, seated),
        ]  # fmt: skip

    half = 0.55  # the hips have hardly risen when the trunk leans furthest
    score: Score = {
        "drop": keys(drop, half * drop + 0.35 * drop, 0.0),
        "back": keys(back, 0.8 * back, 0.0),
        "lean": keys(-5.0, lean, 0.0),
        "bend": keys(5.0, 0.6 * lean, 3.0),
        "nod": keys(2.0, -8.0, 2.0),
        **{name: [(0.0, 0.0)] for name in ("sway", "twist", "look")},
        **{f"out.{side}": keys(8.0, 8.0, 9.0) for side in "LR"},
        **{f"forward.{side}": keys(32.0, 45.0, 4.0) for side in "LR"},
        **{f"inward.{side}": [(0.0, 20.0)] for side in "LR"},
        **{f"elbow.{side}": keys(55.0, 40.0, 12.0) for side in "LR"},
    }
    return perform(dressed, np.arange(round(end * FPS)) / FPS, score, [], (0.0, -0.2, 0.0))


def _scene(name: str, kind: str, dressed: DressedBody, motion: Motion) -> Scene:
    soles = sole_points()
    joints, points = [], []
    for person in pose_sequence(dressed, motion):
        joints.append(person.joints)
        points.append({side: person.vertices[list(soles[side])].astype(np.float64) for side in soles})
    scene_swings = [
        swing
        for side in soles
        for swing in true_swings(np.stack([of_frame[side] for of_frame in points]), side)
    ]  # fmt: skip
    scene_swings.sort(key=lambda swing: swing.heel_strike_s)
    return Scene(name, kind, dressed, motion, np.stack(joints), scene_swings)


def true_swings(points: Float[ndarray, "t 2 3"], side: str) -> list[Swing]:
    """Swings of a foot by its heel and toe: from when both have gone until one of them has come to rest."""
    speed = np.linalg.norm(np.gradient(points, 1 / FPS, axis=0), axis=-1).min(1)
    foot_swings, gone_s = [], None
    for i, (before, after) in enumerate(itertools.pairwise(speed.tolist())):
        if gone_s is None and before < GONE_MPS <= after:
            gone_s = (i + (GONE_MPS - before) / (after - before)) / FPS
        if after < RESTS_MPS <= before and gone_s is not None:
            rests_s = (i + (before - RESTS_MPS) / (before - after)) / FPS
            foot_swings.append(Swing(side, gone_s, rests_s, np.full(2, np.nan)))
            gone_s = None
    return foot_swings


def sole_points() -> dict[str, tuple[int, int]]:
    """Vertices of heel and toe of each foot: the hindmost and the foremost near the floor."""
    model = BodyModel.load()
    vertices = model.shape(Phenotype()).rest_vertices
    bones = np.array(model.bone_names)[model.skin_indices[:, 0]]
    points = {}
    for side in ("left", "right"):
        letter = side[0].upper()
        foot = np.array([bone.startswith(("foot", "toe")) and bone.endswith(letter) for bone in bones])
        low = np.flatnonzero(foot & (vertices[:, 2] < vertices[foot, 2].min() + 0.02))
        points[side] = (int(low[vertices[low, 1].argmax()]), int(low[vertices[low, 1].argmin()]))
    return points


def seen_frames(
    scene: Scene, views: int, sensors: tuple[SensorPreset, ...], rng: np.random.Generator
) -> Iterator[FrameSet]:
    """The scene as cameras all around see it, with their errors and true masks; timestamps start at 0."""
    first = rng.uniform(-np.pi, np.pi)
    cameras = []
    for i in range(views):
        preset = sensors[int(rng.integers(len(sensors)))]
        azimuth = first + 2 * np.pi * i / views + rng.uniform(-_SPREAD_RAD, _SPREAD_RAD)
        distance, height = rng.uniform(*_DISTANCE_M), rng.uniform(*_HEIGHT_M)
        eye = np.array([distance * np.sin(azimuth), -distance * np.cos(azimuth), height])
        cameras.append((preset, preset.camera(f"cam{i}", look_at(eye, np.array([0.0, 0.0, _AIM_M])))))
    for index, person in enumerate(pose_sequence(scene.dressed, scene.motion)):
        captured = []
        for preset, camera in cameras:
            drawn = render_person(person, camera)
            depth = sense(drawn.depth_m, drawn.material, camera, preset.model, rng)
            captured.append(View(camera, depth, drawn.person & (depth > 0)))
        yield FrameSet(round(index / FPS * 1e9), tuple(captured), person.joints)
