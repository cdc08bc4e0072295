"""Four Kinects around the demo's person in the demo's room, with the sensor's errors: the scene of a soak test."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.frames import FrameSet, View
from depthmocap.geometry import Rig, look_at
from depthmocap.synth.demo_scene import ROOM, demo_body
from depthmocap.synth.motion.perform import pose_sequence
from depthmocap.synth.motion.sequence import demo_motion
from depthmocap.synth.render import Material, render_person
from depthmocap.synth.scenes.room import render_room
from depthmocap.synth.sensing.sensor import sense
from depthmocap.synth.sensing.sensors import SENSORS

SENSOR = SENSORS["kinect2"]
#: Of each camera: azimuth (degrees), distance from the room's middle, height, and the height of its aim (metres).
_MOUNTS = ((8.0, 2.6, 1.2, 1.1), (100.0, 2.65, 1.9, 1.05), (188.0, 2.4, 1.5, 1.1), (-85.0, 2.6, 1.0, 1.1))


class Studio:
    """The scene.

    Attributes:
        rig: four cameras of 512×424.
        backgrounds_m: depth of the empty room by camera name, as the sensor reads it.
    """

    def __init__(self, seconds: float, rate_hz: float, seed: int = 0) -> None:
        self._times_s, self._seed = np.arange(round(seconds * rate_hz)) / rate_hz, seed
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
        body = demo_body()
        for time_s, posed in zip(self._times_s, pose_sequence(body, demo_motion(body, self._times_s)), strict=True):
            views = []
            for camera in self.rig.cameras:
                rendering = render_person(posed, camera, self._rooms[camera.name])
                views.append(View(camera, sense(rendering.depth_m, rendering.material, camera, SENSOR.model, rng)))
            yield FrameSet(round(float(time_s) * 1e9), tuple(views), posed.joints)
