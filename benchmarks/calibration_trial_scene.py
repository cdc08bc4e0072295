"""A person who walks about and moves the arms in a generated room, recorded by cameras with known poses."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from depthmocap.geometry import Rig, look_at
from depthmocap.recordings.recording_writer import RecordingWriter
from depthmocap.synth.body.bones import POSTURE_INDEX
from depthmocap.synth.body.mesh import Body, BodyModel
from depthmocap.synth.motion.perform import Motion, pose_sequence
from depthmocap.synth.motion.stroll import Stop, stroll
from depthmocap.synth.people.bodies import random_dressed_body, random_phenotype
from depthmocap.synth.people.garments import DressedBody, clothe
from depthmocap.synth.people.wardrobe import random_clothes
from depthmocap.synth.render import render_person
from depthmocap.synth.scenes.room import Box, Room, render_room, shelf, table
from depthmocap.synth.sensing.sensor import sense
from depthmocap.synth.sensing.sensors import SENSORS

#: Half the length of the room along x, metres.
_HALF_X = 3.1
#: Half the length of the room along y, metres.
_HALF_Y = 2.9
_ROOM = Room(
    Box((-_HALF_X, -_HALF_Y, 0.0), (_HALF_X, _HALF_Y, 2.8)),
    (
        *table((-0.75, 2.1), (0.75, 2.8), 0.74),
        *shelf((-_HALF_X, -1.4), (-2.75, 0.0), 1.8, 5),
        Box((2.5, -2.6, 0.0), (3.1, -1.8, 1.1)),
    ),
)
#: Sensors of the cameras, in turns.
_SENSORS = ("kinect2", "azure-nfov-binned")
#: Largest distance of the person from the room's middle along x and y, metres.
_REACH_M = 0.9
#: Speed of walking, m/s.
_SPEED_MPS = 0.7
#: Length of each stop, seconds.
_STAND_S = 1.5
#: Standard deviation of the arms' random motion about their swing, radians.
_WAVE_RAD = 0.6
#: Time constant of this motion, seconds.
_WAVE_S = 0.5
#: Radius of a circle, and the number of stops that make it.
_CIRCLE_M, _CORNERS = 0.8, 12
#: Standard deviation of such a stop's place, as nobody walks quite evenly (metres).
_UNEVEN_M = 0.08

#: How the person moves: from stop to stop, in circles, to and fro on a straight line, in circles like clockwork, on one
#: spot with the arms, or not at all. Who walks in circles or on a line swings the arms only.
MotionKind = Literal["about", "circle", "line", "clockwork", "arms", "still"]


@dataclasses.dataclass(frozen=True)
class TrialScene:
    """Settings of the scene.

    Attributes:
        azimuths_deg: azimuths of the cameras around the room's middle, 0 at −Y, towards +X.
        out_of_step_s: how much later than its timestamps each camera captures.
        room: whether there is a room around the person; otherwise the sensors read nothing behind them.
        motion: how the person moves.
        stature_m: height of the body; any without.
    """

    azimuths_deg: tuple[float, ...] = (10.0, 125.0, 245.0)
    out_of_step_s: tuple[float, ...] = ()
    seconds: float = 30.0
    rate_hz: float = 8.0
    room: bool = True
    seed: int = 0
    motion: MotionKind = "about"
    stature_m: float | None = None

    def write(self, path: Path) -> Rig:
        """Write the recording, its rig.json without the truth (all cameras at the origin); returns the true rig."""
        rng = np.random.default_rng([self.seed, 0])
        presets = [SENSORS[_SENSORS[i % 2]] for i in range(len(self.azimuths_deg))]
        rig = Rig(tuple(
            preset.camera(f"cam{i}", _mount(rng, azimuth))
            for i, (azimuth, preset) in enumerate(zip(self.azimuths_deg, presets, strict=True))
        ))  # fmt: skip
        dressed = random_dressed_body(rng, "open") if self.stature_m is None else body_of(self.stature_m, rng)
        times_s = np.arange(round(self.seconds * self.rate_hz)) / self.rate_hz
        motion = person_motion(rng, dressed, self.motion, self.seconds + 2)
        offsets_s = self.out_of_step_s or (0.0,) * len(rig.cameras)
        # Posing a dressed person takes longer than rendering: cameras with the same offset share it.
        moving = {offset_s: pose_sequence(dressed, motion(times_s + offset_s + 0.5)) for offset_s in {0.0, *offsets_s}}
        rooms = [render_room(_ROOM, camera) if self.room else None for camera in rig.cameras]
        unplaced = Rig(tuple(dataclasses.replace(camera, world_from_camera=np.eye(4)) for camera in rig.cameras))
        # Who stays in one place is taken for a part of the room where the room is learnt from the recording.
        empty = {
            camera.name: np.round(room_m / camera.depth_unit_m).astype(np.uint16)
            for camera, room_m in zip(rig.cameras, rooms, strict=True)
            if room_m is not None and self.motion in ("arms", "still")
        }
        with RecordingWriter(path, unplaced, empty) as writer:
            for time_s in times_s:
                posed = {offset_s: next(poses) for offset_s, poses in moving.items()}
                frames = {}
                for camera, preset, offset_s, room_m in zip(rig.cameras, presets, offsets_s, rooms, strict=True):
                    drawn = render_person(posed[offset_s], camera, room_m)
                    depth_m = sense(drawn.depth_m, drawn.material, camera, preset.model, rng)
                    frames[camera.name] = np.round(depth_m / camera.depth_unit_m).astype(np.uint16)
                writer.write(round(float(time_s) * 1e9), frames, posed[0.0].joints)
        return rig


def body_of(stature_m: float, rng: np.random.Generator) -> DressedBody:
    """A dressed body of this height: a child below about 1.5 m, by its age and not by its scale."""
    phenotype = random_phenotype(rng, children=False)
    model = BodyModel.load()

    def shaped(age: float) -> Body:
        return model.shape(dataclasses.replace(phenotype, age=age, height=0.5))

    ages = np.linspace(0.05, 0.6, 23)
    statures = [float(np.ptp(shaped(age).rest_vertices[:, 2])) for age in ages]
    age = float(ages[int(np.argmin(np.abs(np.array(statures) - stature_m)))])
    return clothe(shaped(age), random_clothes(rng, False, phenotype.gender), rng)


def _mount(rng: np.random.Generator, azimuth_deg: float) -> Float[ndarray, "4 4"]:
    """Pose of a camera that looks roughly at the middle of the room, with a little roll."""
    azimuth, reach = np.deg2rad(azimuth_deg), rng.uniform(2.4, 2.7)
    eye = np.array([reach * np.sin(azimuth), -reach * np.cos(azimuth), rng.uniform(1.0, 2.2)])
    return look_at(eye, np.array([*rng.uniform(-0.1, 0.1, 2), 0.95]), rng.normal(0, 0.03))


def person_motion(
    rng: np.random.Generator, dressed: DressedBody, kind: MotionKind, seconds: float
) -> Callable[[Float[ndarray, " n"]], Motion]:
    """The motion at any times from 0 to ``seconds``."""
    stops = _stops(rng, kind, seconds)
    fine_s = np.arange(0, seconds, 0.02)
    bones = [POSTURE_INDEX[f"{bone}.{side}"] for bone in ("upper_arm", "forearm") for side in "RL"]
    wave = gaussian_filter1d(rng.normal(size=(len(fine_s), len(bones), 3)), _WAVE_S / 0.02, axis=0)
    wave *= (_WAVE_RAD if kind in ("about", "arms") else 0.0) / wave.std(0)
    wave[:, 2:] *= 0.5  # elbows less

    def motion(times_s: Float[ndarray, " n"]) -> Motion:
        walk = stroll(dressed, stops, 0.5, _SPEED_MPS, times_s)
        postures = walk.postures.copy()
        for k, bone in enumerate(bones):
            turn = np.stack([np.interp(times_s, fine_s, axis) for axis in wave[:, k].T], 1)
            postures[:, bone] = (Rotation.from_rotvec(turn) * Rotation.from_rotvec(postures[:, bone])).as_rotvec()
        return Motion(walk.times_s, postures, walk.offsets)

    return motion


def _stops(rng: np.random.Generator, kind: MotionKind, seconds: float) -> list[Stop]:
    """The path on the floor, long enough for this time."""
    if kind in ("arms", "still"):
        return [Stop(0.3, 0.5), Stop(0.3, 0.45, seconds)]
    if kind in ("circle", "clockwork"):
        turns = int(seconds * _SPEED_MPS / (2 * np.pi * _CIRCLE_M)) + 2
        angles = rng.uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(turns * _CORNERS) / _CORNERS
        places = _CIRCLE_M * np.stack([np.cos(angles), np.sin(angles)], 1)
        uneven_m = _UNEVEN_M if kind == "circle" else 0.0
        return [Stop(float(x), float(y)) for x, y in places + uneven_m * rng.normal(size=places.shape)]
    if kind == "line":
        angle = rng.uniform(0, np.pi)
        count = int(seconds * _SPEED_MPS / _REACH_M) + 3
        along = _REACH_M * (-1.0) ** np.arange(count) + _UNEVEN_M * rng.normal(size=count)
        return [Stop(float(r * np.cos(angle)), float(r * np.sin(angle))) for r in along]
    stops, walked_s = [Stop(0.3, 0.5)], 0.0
    while walked_s < seconds:
        x, y = rng.uniform(-_REACH_M, _REACH_M, 2)
        walked_s += float(np.hypot(x - stops[-1].x, y - stops[-1].y)) / _SPEED_MPS + _STAND_S
        stops.append(Stop(float(x), float(y), _STAND_S))
    return stops
