"""Furnished rooms without people, in some of which a thing moves: nobody must be found there."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.evaluate.scenario_scene import SceneFrame
from depthmocap.frames import FrameSet, View
from depthmocap.synth.render import Material
from depthmocap.synth.scenes.furniture import FREE_STANDING
from depthmocap.synth.scenes.lookalikes import LOOKALIKES
from depthmocap.synth.scenes.populated import populated_scene
from depthmocap.synth.scenes.solids import NONE, Solids
from depthmocap.synth.sensing.sensor import sense
from depthmocap.synth.sensing.sensors import SENSORS

#: Share of rooms in which something moves.
_MOVING = 1 / 3
#: Speed of what moves (m/s).
_SPEED_MPS = (0.2, 1.2)
_PRESETS = ("kinect2", "azure-nfov-binned", "realsense-d435")
#: Attempts to place a camera.
_TRIES = 20


class EmptyRoomScene:
    """A random room without people.

    Attributes:
        times_s: time of each frame set.
        backgrounds_m: the empty scenes, none of which is known.
        count: number of people.
    """

    count = 0

    def __init__(self, rng: np.random.Generator, cameras: int, rate_hz: float, sets: int) -> None:
        self.times_s = np.arange(sets) / rate_hz
        self.backgrounds_m: dict[str, ndarray] = {}
        self._scene = populated_scene(rng, None)
        makers = (*LOOKALIKES, *FREE_STANDING)
        piece = makers[int(rng.integers(len(makers)))](rng) if rng.random() < _MOVING else NONE
        azimuth = rng.uniform(-np.pi, np.pi)
        self._velocity = rng.uniform(*_SPEED_MPS) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        self._piece: Solids = piece.moved(np.eye(3), np.array([*rng.uniform(-1.5, 1.5, 2), 0.0]))
        self._views = []
        for _ in range(_TRIES):
            preset = SENSORS[_PRESETS[int(rng.integers(len(_PRESETS)))]]
            camera = self._scene.camera(rng, preset, f"cam{len(self._views)}")
            if camera is not None and len(self._views) < cameras:
                picture = self._scene.render(camera)
                self._views.append((camera, preset, picture.depth_m, picture.material))
        self._rng = rng

    def frames(self, *, alone: bool = False) -> Iterator[SceneFrame]:
        """All frame sets."""
        for time_s in self.times_s:
            piece = self._piece.moved(np.eye(3), float(time_s) * self._velocity)
            views = []
            for camera, preset, room_m, materials in self._views:
                depth_m: Float[ndarray, "h w"] = np.where(room_m > 0, room_m, np.inf).astype(np.float32)
                material = materials.copy()
                piece.draw(camera, depth_m, material)
                depth_m[np.isinf(depth_m)] = 0
                material[(depth_m > 0) & (material == Material.NOTHING)] = Material.SCENE
                views.append(View(camera, sense(depth_m, material, camera, preset.model, self._rng)))
            yield SceneFrame(FrameSet(round(float(time_s) * 1e9), tuple(views)), (), ())
