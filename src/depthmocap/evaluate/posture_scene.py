"""Scenes of acts that need more than a room: a wheelchair, a bed, one camera close up or carried about."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import KDTree

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.evaluate.posture_scenarios import ONE_CAMERA, PostureScenario
from depthmocap.evaluate.scenario_scene import Cover, ScenarioScene, draw_view
from depthmocap.geometry import DepthCamera, look_at, transform_points
from depthmocap.synth.body.bones import heading
from depthmocap.synth.motion.perform import Motion
from depthmocap.synth.people.garments import DressedBody
from depthmocap.synth.render import PosedPerson
from depthmocap.synth.scenes.blanket import blanket_over
from depthmocap.synth.scenes.placing import Place, seat
from depthmocap.synth.scenes.populated import bed_under, wheels
from depthmocap.synth.scenes.solids import NONE, Solids, join

#: Height of a bed (metres).
_BED_M = (0.4, 0.6)
#: A blanket shows who is under it where the skin is no farther from it than this (metres).
_ON_PERSON_M = 0.1
#: A camera close up is so far from the middle of somebody's breast (metres),
_CLOSE_M = (0.9, 1.2)
#: so high (metres),
_CLOSE_HEIGHT_M = (1.0, 1.6)
#: and so far aside (radians).
_ASIDE_RAD = 0.6
#: A camera that is carried stays about so far from the person (metres),
_CARRIED_M = (1.7, 2.2)
#: so high (metres),
_CARRIED_HEIGHT_M = (1.3, 1.6)
#: and goes about them so far (radians).
_ABOUT_RAD = 0.9
#: Standard deviation of the shake of a hand: of its place (metres),
_SHAKE_M = 0.015
#: and of its aim (metres),
_SHAKE_AIM_M = 0.04
#: each within about this time (seconds).
_SHAKE_S = 0.25
#: Slow changes of a carried camera's way take about so long (seconds).
_WANDER_S = 2.0


class PostureScene(ScenarioScene):
    """A random scene of an act. Of one camera alone the pose is not known: it is the origin of its own world."""

    def __init__(self, rng: np.random.Generator, scenario: PostureScenario, cameras: int = 3, rate_hz: float = 15.0):
        self._act = scenario.act
        super().__init__(rng, scenario, 1 if scenario.act in ONE_CAMERA else cameras, rate_hz)
        self._blanket_seed = int(rng.integers(2**31))
        self._furniture = NONE
        if self._act in ("wheelchair", "in bed"):
            self._furnish(rng)
        self._paths = self._draw_path(rng) if self._act in ONE_CAMERA else ()

    def _furnish(self, rng: np.random.Generator) -> None:
        """What the person sits or lies on."""
        ((dressed, motion),) = self._people
        person = dressed.pose(motion.postures[0]).moved(np.eye(3), motion.offsets[0])
        if self._act == "in bed":
            raised, self._furniture = bed_under(rng, person, rng.uniform(*_BED_M))
            offsets = motion.offsets + (raised.joints[0] - person.joints[0])
            self._people = ((dressed, dataclasses.replace(motion, offsets=offsets)),)
            return
        place = Place(np.zeros((0, 3)), person.joints, 0.0, 0.0)
        place.occupy(np.concatenate([person.vertices, *(layer.vertices for layer in person.layers)]).astype(float))
        self._furniture = join([seat(rng, place), wheels(rng, person)])

    def _empty_rooms(self) -> list[Float[ndarray, "_ _"]]:
        """The room without people and what came with them, but with the bed."""
        if self._act != "in bed":
            return self._draw_room(0.0, self._cameras_at(0))
        rooms = super()._empty_rooms()
        return [
            draw_view(camera, room_m, self._furniture, [], None)[0]
            for camera, room_m in zip(self.rig.cameras, rooms, strict=True)
        ]

    def _draw_path(self, rng: np.random.Generator) -> tuple[DepthCamera, ...]:
        """Where the one camera is in every frame set."""
        ((dressed, motion),) = self._people
        preset, (told,) = self._presets[0], self.rig.cameras
        breasts = _breasts(dressed, motion)
        facing = _facing(dressed, motion)
        azimuth = facing + rng.uniform(-_ASIDE_RAD, _ASIDE_RAD)
        if self._act == "close up":
            ground = rng.uniform(*_CLOSE_M) * np.array([np.cos(azimuth), np.sin(azimuth)])
            eye = np.array([*breasts[0, :2] + ground, rng.uniform(*_CLOSE_HEIGHT_M)])
            return (preset.camera(told.name, look_at(eye, breasts[0] - [0.0, 0.0, 0.1])),) * len(self.times_s)
        rate_hz = (len(self.times_s) - 1) / (self.times_s[-1] - self.times_s[0])

        def wander(seconds: float, *shape: int) -> Float[ndarray, "..."]:
            drawn = gaussian_filter1d(rng.normal(size=(len(self.times_s), *shape)), seconds * rate_hz, axis=0)
            return drawn / drawn.std(0)

        followed = gaussian_filter1d(breasts, 0.5 * rate_hz, axis=0)
        azimuths = azimuth + _ABOUT_RAD / 2 * wander(_WANDER_S)
        reach = np.clip(np.mean(_CARRIED_M) + 0.2 * wander(_WANDER_S), *_CARRIED_M)
        ground = reach[:, None] * np.stack([np.cos(azimuths), np.sin(azimuths)], 1)
        heights = np.clip(np.mean(_CARRIED_HEIGHT_M) + 0.1 * wander(_WANDER_S), *_CARRIED_HEIGHT_M)
        eyes = np.column_stack([followed[:, :2] + ground, heights]) + _SHAKE_M * wander(_SHAKE_S, 3)
        aims = followed - [0.0, 0.0, 0.25] + _SHAKE_AIM_M * wander(_SHAKE_S, 3)
        return tuple(preset.camera(told.name, look_at(eye, aim)) for eye, aim in zip(eyes, aims, strict=True))

    def _mount(self, rng: np.random.Generator) -> tuple[DepthCamera, ...]:
        if self._act not in ONE_CAMERA:
            return super()._mount(rng)
        return (self._presets[0].camera("cam0", np.eye(4)),)

    def _cameras_at(self, index: int) -> tuple[DepthCamera, ...]:
        return (self._paths[index],) if self._paths else super()._cameras_at(index)

    def _told(self, joints: Float[ndarray, "18 3"], cameras: tuple[DepthCamera, ...]) -> Float[ndarray, "18 3"]:
        return transform_points(cameras[0].camera_from_world, joints) if self._paths else joints

    def _things(self, index: int) -> Solids:
        if not len(self._furniture):
            return NONE
        ((_, motion),) = self._people
        rolled = (motion.offsets[index] - motion.offsets[0]) * [1, 1, 0]
        return self._furniture.moved(np.eye(3), rolled) if self._act == "wheelchair" else self._furniture

    def _cover(self, people: list[PosedPerson | None]) -> Cover | None:
        person = people[0]
        if self._act != "in bed" or person is None:
            return None
        blanket = blanket_over(np.random.default_rng(self._blanket_seed), person)
        distances, _ = KDTree(person.vertices).query(blanket.vertices[blanket.faces].mean(1))
        return Cover(blanket, distances < _ON_PERSON_M)


def _breasts(dressed: DressedBody, motion: Motion) -> Float[ndarray, "n 3"]:
    """The middle of the breast in every frame, for a body that stands or walks."""
    rest = dressed.pose(motion.postures[0]).joints[JOINT_INDEX["Spine2"]]
    return motion.offsets + rest


def _facing(dressed: DressedBody, motion: Motion) -> float:
    """The azimuth (radians) to which somebody faces at first: −Y, turned by the heading."""
    return float(heading(motion.postures[:1])[0]) - np.pi / 2
