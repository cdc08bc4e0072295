"""A scenario in a furnished room, seen by depth cameras with their errors.

Ground truth is complete: the person of every pixel, and the joints of every person.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.evaluate.scenarios import DOORS, HALF_X, HALF_Y, Scenario, Stage
from depthmocap.frames import FrameSet, View
from depthmocap.geometry import DepthCamera, Rig, look_at
from depthmocap.synth.render import Layer, Material, PosedPerson, draw_mesh, render_person
from depthmocap.synth.scenes.room import Box, Room, render_room, shelf, table
from depthmocap.synth.scenes.solids import NONE, Solids
from depthmocap.synth.sensing.sensor import sense
from depthmocap.synth.sensing.sensors import SENSORS, SensorPreset

#: Outside the walls, a corridor runs around the room (metres).
_CORRIDOR_M = 1.4
#: Thickness of the walls (metres).
_WALL_M = 0.1
#: Height of the doors (metres).
_DOOR_M = 2.15
#: Height of the ceiling (metres).
_CEILING_M = 3.0
_SHELL = Box(
    (-HALF_X - _CORRIDOR_M, -HALF_Y - _CORRIDOR_M, 0.0), (HALF_X + _CORRIDOR_M, HALF_Y + _CORRIDOR_M, _CEILING_M)
)


def _walls() -> Iterator[Box]:
    """The room's walls, with openings where people come in and leave."""
    for axis, half, along in ((0, HALF_X, HALF_Y), (1, HALF_Y, HALF_X + _WALL_M)):
        for sign in (-1, 1):
            low, high = sorted((sign * half, sign * (half + _WALL_M)))
            door = DOORS.get((axis, sign))
            pieces = [(-along, along, 0.0)]
            if door is not None:
                pieces = [(-along, door[0], 0.0), (*door, _DOOR_M), (door[1], along, 0.0)]
            for start, end, bottom in pieces:
                if axis == 0:
                    yield Box((low, start, bottom), (high, end, _CEILING_M))
                else:
                    yield Box((start, low, bottom), (end, high, _CEILING_M))


_WALLS = tuple(_walls())


@dataclasses.dataclass(frozen=True, eq=False)
class SceneFrame:
    """A frame set and its ground truth.

    Attributes:
        masks: by person and view: pixels of valid depth that show the person.
        joints: by person, in metres; NaN while the person is not in the room.
    """

    frames: FrameSet
    masks: tuple[tuple[Bool[ndarray, "_ _"], ...], ...]
    joints: tuple[Float[ndarray, "18 3"], ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Cover:
    """Cloth over the first person, and which of its faces lie on them and show them, as clothes do."""

    cloth: Layer
    on_person: Bool[ndarray, " faces"]


class ScenarioScene:
    """A random scene: cameras, people and their trajectories.

    Attributes:
        rig: the cameras.
        times_s: time of each frame.
    """

    def __init__(self, rng: np.random.Generator, scenario: Scenario, cameras: int = 3, rate_hz: float = 15.0) -> None:
        """Draw cameras, people and their trajectories."""
        self.times_s = np.arange(round(scenario.seconds * rate_hz)) / rate_hz
        self._seed = int(rng.integers(2**32))
        presets = [SENSORS["kinect2"], SENSORS["azure-nfov-binned"]]
        self._presets = [presets[i % 2] for i in range(cameras)]
        self.rig = Rig(self._mount(rng))
        self._chair = np.array([rng.uniform(1.0, 1.4), rng.uniform(-1.4, -1.0)])
        actors = scenario.actors(rng)
        self._people = tuple(
            zip(actors, scenario.trajectories(rng, Stage(actors, self._chair, self.times_s)), strict=True)
        )
        self._chair_pushed_s = scenario.chair_pushed_s

    @functools.cached_property
    def _rooms(self) -> dict[float, list[Float[ndarray, "_ _"]]]:
        """The room as the rig's cameras see it, before and after the chair is pushed."""
        return {shift: self._draw_room(shift, self.rig.cameras) for shift in (0.0, 1.0)}

    @functools.cached_property
    def backgrounds_m(self) -> dict[str, ndarray]:
        """By camera name: depth of the empty room, as the sensor reads it."""
        noise, backgrounds_m = np.random.default_rng([self._seed, 1]), {}
        for camera, preset, depth_m in zip(self.rig.cameras, self._presets, self._empty_rooms(), strict=True):
            material = np.full(depth_m.shape, Material.SCENE, np.uint8)
            backgrounds_m[camera.name] = sense(depth_m, material, camera, preset.model, noise)
        return backgrounds_m

    def _empty_rooms(self) -> list[Float[ndarray, "_ _"]]:
        """Exact depth of the room by camera before anybody is in it."""
        return self._rooms[0.0]

    @property
    def count(self) -> int:
        """Number of people."""
        return len(self._people)

    def frames(self, *, alone: bool = False) -> Iterator[SceneFrame]:
        """All frame sets, with everybody or with the first person only. The noise is the same at every call."""
        present = [not alone or k == 0 for k in range(self.count)]
        rng = np.random.default_rng([self._seed, 2])
        for i, time_s in enumerate(self.times_s):
            shift = 0.0
            if self._chair_pushed_s is not None and not alone:
                begin_s, end_s = self._chair_pushed_s
                shift = float(np.clip((time_s - begin_s) / (end_s - begin_s), 0, 1))
            cameras = self._cameras_at(i)
            known = self._rooms.get(shift) if cameras is self.rig.cameras else None
            rooms = known or self._draw_room(shift, cameras)
            posed = [
                dressed.pose(motion.postures[i]).moved(np.eye(3), motion.offsets[i]) if is_present else None
                for (dressed, motion), is_present in zip(self._people, present, strict=True)
            ]
            things, cover = self._things(i), self._cover(posed)
            views, masks = [], []
            for of_rig, camera, preset, room_m in zip(self.rig.cameras, cameras, self._presets, rooms, strict=True):
                depth_m, material, person_at = draw_view(camera, room_m, things, posed, cover)
                read_m = sense(depth_m, material, camera, preset.model, rng)
                views.append(View(of_rig, read_m))
                masks.append([(person_at == k + 1) & (read_m > 0) for k in range(self.count)])
            joints = tuple(
                self._told(person.joints, cameras)
                if person is not None and _inside(person.joints)
                else np.full((18, 3), np.nan)
                for person in posed
            )
            yield SceneFrame(
                FrameSet(round(float(time_s) * 1e9), tuple(views), joints[0] if joints else None),
                tuple(tuple(of_view[k] for of_view in masks) for k in range(self.count)), joints,
            )  # fmt: skip

    def _mount(self, rng: np.random.Generator) -> tuple[DepthCamera, ...]:
        """The cameras, as the rig tells of them: all around, near the walls."""
        count = len(self._presets)
        return tuple(_mounted(rng, i, count, preset) for i, preset in enumerate(self._presets))

    def _cameras_at(self, index: int) -> tuple[DepthCamera, ...]:
        """The cameras where they are in a frame set."""
        return self.rig.cameras

    def _told(self, joints: Float[ndarray, "18 3"], cameras: tuple[DepthCamera, ...]) -> Float[ndarray, "18 3"]:
        """Joints (metres) in the world of the rig, from the room's."""
        return joints

    def _things(self, index: int) -> Solids:
        """What is in the room besides its furniture in a frame set."""
        return NONE

    def _cover(self, people: list[PosedPerson | None]) -> Cover | None:
        """Cloth that lies over the first person."""
        return None

    def _draw_room(self, shift: float, cameras: tuple[DepthCamera, ...]) -> list[Float[ndarray, "_ _"]]:
        """Exact depth of the room by camera. The chair has been pushed by the share ``shift`` (0–1) of its path."""
        x, y = self._chair + shift * np.array([0.6, -0.3])
        chair = (
            Box((x - 0.22, y - 0.22, 0.4), (x + 0.22, y + 0.22, 0.46)),
            Box((x + 0.16, y - 0.22, 0.46), (x + 0.22, y + 0.22, 0.9)),
            *(Box((x + i * 0.2 - 0.02, y + j * 0.2 - 0.02, 0.0), (x + i * 0.2 + 0.02, y + j * 0.2 + 0.02, 0.4))
              for i in (-1, 1) for j in (-1, 1)),
        )  # fmt: skip
        still = (
            *table((-0.6, 2.0), (0.9, 2.7), 0.74),
            *shelf((-HALF_X, -2.2), (-2.65, -1.0), 1.8, 5),
            Box((2.4, 0.6, 0.0), (2.98, 1.5, 1.0)),
        )
        room = Room(_SHELL, (*_WALLS, *still, *chair))
        return [render_room(room, camera) for camera in cameras]


def draw_view(
    camera: DepthCamera,
    room_m: Float[ndarray, "h w"],
    things: Solids,
    people: list[PosedPerson | None],
    cover: Cover | None,
) -> tuple[Float[ndarray, "h w"], UInt8[ndarray, "h w"], UInt8[ndarray, "h w"]]:
    """Exact depth, materials and the person of every pixel (from 1; 0 for none)."""
    depth_m, material = room_m, np.full(room_m.shape, Material.SCENE, np.uint8)
    if len(things):
        depth_m = np.where(room_m > 0, room_m, np.inf).astype(np.float32)
        things.draw(camera, depth_m, material)
        depth_m[np.isinf(depth_m)] = 0
    person_at = np.zeros(room_m.shape, np.uint8)
    for k, person in enumerate(people):
        if person is not None:
            drawn = render_person(person, camera, depth_m, material)
            nearer = drawn.person & (drawn.depth_m < np.where(depth_m > 0, depth_m, np.inf))
            person_at[nearer] = k + 1
            depth_m, material = drawn.depth_m, drawn.material
    if cover is not None:
        depth_m, cloth = np.where(depth_m > 0, depth_m, np.inf).astype(np.float32), np.zeros(room_m.shape, np.uint8)
        values = np.where(cover.on_person, 2, 1).astype(np.uint8)
        draw_mesh(cover.cloth.vertices, cover.cloth.faces, values, camera, depth_m, cloth, two_sided=True)
        depth_m[np.isinf(depth_m)] = 0
        material = np.where(cloth > 0, cover.cloth.material, material).astype(np.uint8)
        person_at = np.where(cloth > 0, cloth // 2, person_at).astype(np.uint8)
    return depth_m, material, person_at


def _inside(joints: Float[ndarray, "18 3"]) -> bool:
    x, y, _ = joints[JOINT_INDEX["Hip"]]
    return bool(abs(x) < HALF_X and abs(y) < HALF_Y)


def _mounted(rng: np.random.Generator, index: int, count: int, preset: SensorPreset) -> DepthCamera:
    """A camera near the walls that looks at the middle; the cameras stand all around."""
    azimuth = 2 * np.pi * (index + 0.3 + rng.uniform(-0.15, 0.15)) / count
    reach = rng.uniform(2.5, 2.7)
    eye = np.array([reach * np.sin(azimuth), -reach * np.cos(azimuth), rng.uniform(1.5, 2.2)])
    return preset.camera(f"cam{index}", look_at(eye, np.array([*rng.uniform(-0.15, 0.15, 2), 0.95])))
