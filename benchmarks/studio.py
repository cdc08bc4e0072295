"""Four Kinects around the demo's person in the demo's room, with the sensor's errors: the scene of long live runs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.frames import FrameSet, View
from depthmocap.geometry import DepthCamera, Rig, look_at
from depthmocap.synth.body.mesh import BodyModel, Phenotype
from depthmocap.synth.demo_scene import ROOM, demo_body
from depthmocap.synth.motion.perform import pose_sequence
from depthmocap.synth.motion.sequence import demo_motion
from depthmocap.synth.people.garments import DressedBody, clothe
from depthmocap.synth.people.wardrobe import ORDINARY_CLOTHES
from depthmocap.synth.render import Material, PosedPerson, Rendering, render_person
from depthmocap.synth.scenes.room import render_room
from depthmocap.synth.sensing.sensor import sense
from depthmocap.synth.sensing.sensors import SENSORS

SENSOR = SENSORS["kinect2"]
#: Of each camera: azimuth (degrees), distance from the room's middle, height, and the height of its aim (metres).
_MOUNTS = ((8.0, 2.6, 1.2, 1.1), (100.0, 2.65, 1.9, 1.05), (188.0, 2.4, 1.5, 1.1), (-85.0, 2.6, 1.0, 1.1))
#: The second person, how far both are from the middle (metres), and by how much the second is behind (seconds).
_SECOND, _ASIDE_M, _BEHIND_S = Phenotype(gender=0.8, age=0.6, muscle=0.5, weight=0.5, height=0.7), 0.55, 1.5


class Studio:
    """The scene.

    Attributes:
        rig: four cameras of 512×424.
        backgrounds_m: depth of the empty room by camera name, as the sensor reads it.
    """

    def __init__(self, seconds: float, rate_hz: float, seed: int = 0, people: int = 1) -> None:
        """``people``: one or two."""
        self._times_s, self._seed = np.arange(round(seconds * rate_hz)) / rate_hz, seed
        self._people = people
        cameras = []
        for i, (azimuth_deg, distance_m, height_m, aim_m) in enumerate(_MOUNTS):
            azimuth = np.deg2rad(azimuth_deg)
            eye = np.array([np.sin(azimuth) * distance_m, -np.cos(azimuth) * distance_m, height_m])
            cameras.append(SENSOR.camera(f"cam{i}", look_at(eye, np.array([0.0, 0.0, aim_m]))))
        self.rig = Rig(tuple(cameras))
        self._rooms = {camera.name: render_room(ROOM, camera) for camera in cameras}
        rng = np.random.default_rng([seed, 0])
        self.backgrounds_m: dict[str, Float[ndarray, "_ _"]] = {}
        for camera in cameras:
            material = np.full(self._rooms[camera.name].shape, Material.SCENE, np.uint8)
            self.backgrounds_m[camera.name] = sense(self._rooms[camera.name], material, camera, SENSOR.model, rng)

    def __len__(self) -> int:
        return len(self._times_s)

    def __iter__(self) -> Iterator[FrameSet]:
        rng = np.random.default_rng([self._seed, 1])
        people = [_moving(demo_body(), self._times_s, 0.0 if self._people == 1 else -_ASIDE_M)]
        if self._people == 2:
            second = clothe(BodyModel.load().shape(_SECOND), ORDINARY_CLOTHES, np.random.default_rng(11))
            people.append(_moving(second, np.maximum(self._times_s - _BEHIND_S, 0.0), _ASIDE_M))
        for time_s, *posed in zip(self._times_s, *people, strict=True):
            views = []
            for camera in self.rig.cameras:
                rendering = _render(posed, camera, self._rooms[camera.name])
                views.append(View(camera, sense(rendering.depth_m, rendering.material, camera, SENSOR.model, rng)))
            yield FrameSet(round(float(time_s) * 1e9), tuple(views), posed[0].joints)


def _moving(body: DressedBody, times_s: Float[ndarray, " n"], aside_m: float) -> Iterator[PosedPerson]:
    for posed in pose_sequence(body, demo_motion(body, times_s)):
        yield posed.moved(np.eye(3), np.array([aside_m, 0.0, 0.0])) if aside_m else posed


def _render(people: list[PosedPerson], camera: DepthCamera, room_m: Float[ndarray, "_ _"]) -> Rendering:
    """One person after the other, each before what was drawn so far."""
    rendering = render_person(people[0], camera, room_m)
    for person in people[1:]:
        rendering = render_person(person, camera, rendering.depth_m, rendering.material)
    return rendering
