"""How often a camera that stands still is said to have moved, and how soon one that was bumped is named, in virtual
time.

python benchmarks/bump_trial.py OUT

Rooms with furniture are seen through a sensor that wavers and drifts, while people walk through them, stop and sit
down, chairs are moved and a door is opened and closed. After the still time the camera is bumped.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from jaxtyping import Float
from numpy import ndarray
from rich.console import Console
from scipy.spatial.transform import Rotation

from depthmocap.calibration.scene_watch import SceneWatch
from depthmocap.core.console import Terminal
from depthmocap.core.output import write_json
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.synth.scenes.room import Box, Room, render_room, shelf, table

_HALF_M = 3.0
#: Pictures a second, as many as the watch looks at; and the time that a bump is watched for (seconds).
_HZ, _WATCHED_S = 4.0, 15.0
#: How often a chair is moved or the door used, and how long somebody stays where they stopped (seconds).
_EVENT_S, _STAY_S = 90.0, 40.0


@dataclasses.dataclass(frozen=True)
class BumpTrial:
    """Cameras that stand still for a time, and then are bumped.

    Attributes:
        out: folder for ``bump.json``; rooms that it has are not watched again.
        hours: of standing still, in all.
        minutes: each room for so long.
    """

    out: tyro.conf.Positional[Path]
    hours: float = 24.0
    minutes: float = 10.0
    seed: int = 0


class _Scene:
    """A room, the sensor's errors, and who and what moves in it."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        azimuth = rng.uniform(0, 2 * np.pi)
        eye = np.array([2.6 * np.sin(azimuth), -2.6 * np.cos(azimuth), rng.uniform(1.0, 2.3)])
        pose = look_at(eye, np.array([*rng.uniform(-0.3, 0.3, 2), rng.uniform(0.7, 1.1)]), rng.normal(0, 0.03))
        self.camera = DepthCamera("a", 96, 72, 75.0, 75.0, 47.5, 35.5, pose)
        self._furniture = (*table((-0.75, 2.0), (0.75, 2.7), 0.74), *shelf((-2.9, -1.4), (-2.5, 0.0), 1.8, 5))
        self._chair, self._door = rng.uniform(-1.5, 1.5, 2), False
        self._noise = rng.uniform(0.001, 0.0025)
        self._lost = np.where(rng.random((72, 96)) < 0.03, rng.uniform(0.2, 0.8), rng.uniform(0.0, 0.05))
        self._drift = rng.uniform(-0.002, 0.002)
        self._people = [_Walker(rng) for _ in range(rng.integers(0, 4))]
        self.room_m = self._render(self.camera)
        self._camera_from_world = self.camera.camera_from_world

    def event(self) -> None:
        """A chair is moved, or the door opened or closed."""
        if self._rng.random() < 0.5:
            self._chair = self._rng.uniform(-1.5, 1.5, 2)
        else:
            self._door = not self._door
        self.room_m = self._render(self.camera)

    def bump(self) -> str:
        """Move the camera by 3 to 6 cm or turn it by 2 to 4°; says which."""
        pose = self.camera.world_from_camera.copy()
        axis = self._rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        if shifted := bool(self._rng.random() < 0.5):
            pose[:3, 3] += axis * self._rng.uniform(0.03, 0.06)
        else:
            turn = Rotation.from_rotvec(axis * np.deg2rad(self._rng.uniform(2, 4))).as_matrix()
            pose[:3, :3] = turn @ pose[:3, :3]
        self.camera = dataclasses.replace(self.camera, world_from_camera=pose)
        self.room_m = self._render(self.camera)
        self._camera_from_world = self.camera.camera_from_world
        return "shifted" if shifted else "turned"

    def picture(self, time_s: float) -> Float[ndarray, "72 96"]:
        """What the sensor gives (metres)."""
        depth_m = self.room_m.copy()
        for person in self._people:
            person.draw(self.camera, self._camera_from_world, depth_m, 1 / _HZ)
        scale = 1 + self._drift * np.sin(time_s / 400)
        depth_m *= scale + depth_m * (self._noise / 4) * self._rng.standard_normal(depth_m.shape, np.float32)
        depth_m[self._rng.random(depth_m.shape, np.float32) < self._lost] = 0
        return depth_m

    def _render(self, camera: DepthCamera) -> Float[ndarray, "72 96"]:
        x, y = self._chair
        chair = Box((x - 0.22, y - 0.22, 0.0), (x + 0.22, y + 0.22, 0.9))
        door = (Box((2.2, 1.0, 0.0), (3.0, 1.05, 2.0)),) if self._door else ()
        walls = Box((-_HALF_M, -_HALF_M, 0.0), (_HALF_M, _HALF_M, 2.8))
        return render_room(Room(walls, (*self._furniture, chair, *door)), camera).astype(np.float32)


class _Walker:
    """Somebody who walks to places, and stays there standing or sitting for a while."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng, self._place = rng, rng.uniform(-2, 2, 2)
        self._target, self._stays_s, self._height_m = self._place, 0.0, 1.7

    def draw(
        self,
        camera: DepthCamera,
        camera_from_world: Float[ndarray, "4 4"],
        depth_m: Float[ndarray, "h w"],
        step_s: float,
    ) -> None:
        """Go on, and draw a column of a person's size where it is nearer than what is there."""
        step = self._target - self._place
        if np.linalg.norm(step) > 0.1:
            self._place = self._place + step / np.linalg.norm(step) * min(0.9 * step_s, float(np.linalg.norm(step)))
        elif self._stays_s > 0:
            self._stays_s -= step_s
        else:
            self._target, self._stays_s = self._rng.uniform(-2.4, 2.4, 2), self._rng.exponential(_STAY_S)
            self._height_m = float(self._rng.choice([1.7, 1.7, 1.2]))
        sway = self._rng.normal(0, 0.01, 2)
        feet = camera_from_world[:3] @ [*(self._place + sway), 0.0, 1.0]
        (x0, y0, z0), (x1, y1, z1) = feet.tolist(), (feet + self._height_m * camera_from_world[:3, 2]).tolist()
        if not min(z0, z1) > 0.4:
            return
        u0, v0, u1, v1 = (
            focal * way / z + centre
            for way, z, focal, centre in (
                (x0, z0, camera.fx, camera.cx), (y0, z0, camera.fy, camera.cy),
                (x1, z1, camera.fx, camera.cx), (y1, z1, camera.fy, camera.cy),
            )
        )  # fmt: skip
        half = 0.22 * camera.fx / z0
        top, bottom = sorted((round(v0), round(v1)))
        rows = slice(max(top, 0), max(bottom, 0))
        columns = slice(max(round(min(u0, u1) - half), 0), max(round(max(u0, u1) + half), 0))
        depth_m[rows, columns] = np.minimum(depth_m[rows, columns], (z0 + z1) / 2 - 0.15)


def run_bump_trial(trial: BumpTrial, console: Console) -> dict[str, Any]:
    """Watch; prints and stores the numbers after each room."""
    rooms = round(trial.hours * 60 / trial.minutes)
    path = trial.out / "bump.json"
    empty = {"hours": 0.0, "false alarms": [], "bumps": {"shifted": [], "turned": []}}
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else empty
    for number in range(sum(map(len, document["bumps"].values())), rooms):
        rng = np.random.default_rng([trial.seed, number])
        scene, watch, alarms = _Scene(rng), SceneWatch(), 0
        still_s = 60 * trial.minutes
        for i in range(round(still_s * _HZ)):
            if rng.random() < 1 / (_EVENT_S * _HZ):
                scene.event()
            alarms += watch(View(scene.camera, scene.picture(i / _HZ)), round(i / _HZ * 1e9)) is not None
        kind, told_s = scene.bump(), None
        for i in range(round(_WATCHED_S * _HZ)):
            time_s = still_s + i / _HZ
            if watch(View(scene.camera, scene.picture(time_s)), round(time_s * 1e9)) is not None:
                told_s = i / _HZ
                break
        document["hours"] += trial.minutes / 60
        document["false alarms"] += [number] * alarms
        document["bumps"][kind].append(told_s)
        trial.out.mkdir(parents=True, exist_ok=True)
        write_json(path, document)
        if number % 6 == 5 or number == rooms - 1:
            console.print(_line(document))
    return document


def _line(document: dict[str, Any]) -> str:
    bumps = ", ".join(
        f"{kind} {sum(told is not None and told <= 10 for told in times)} of {len(times)}"
        for kind, times in document["bumps"].items()
    )
    return f"{document['hours']:.1f} hours: {len(document['false alarms'])} false alarms; within 10 s: {bumps}"


if __name__ == "__main__":
    run_bump_trial(tyro.cli(BumpTrial), Terminal())
