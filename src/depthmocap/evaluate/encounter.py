"""A story in a furnished room, as cameras with their errors see it.

Everything is known: whose every pixel is, and where everybody's joints are.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.evaluate.scenarios import HALF_X, HALF_Y, Stage, Story
from depthmocap.frames import FrameSet, View
from depthmocap.geometry import Rig, look_at
from depthmocap.synth.render import Material, render_person
from depthmocap.synth.scenes.room import Box, Room, render_room, shelf, table
from depthmocap.synth.sensing.sensor import sense
from depthmocap.synth.sensing.sensors import SENSORS, SensorPreset


@dataclasses.dataclass(frozen=True, eq=False)
class Moment:
    """A set of frames and the truth about it.

    Attributes:
        masks: by person and view: who is seen, where the depth is valid.
        joints: by person; NaN while they are not in the room.
    """

    frames: FrameSet
    masks: tuple[tuple[Bool[ndarray, "_ _"], ...], ...]
    joints: tuple[Float[ndarray, "18 3"], ...]


class Encounter:
    """One scene, drawn from a generator.

    Attributes:
        rig: the cameras.
        backgrounds_m: what each camera reads of the room before anybody comes.
    """

    def __init__(self, rng: np.random.Generator, story: Story, cameras: int = 3, rate_hz: float = 15.0) -> None:
        """Draw cameras, people and their ways."""
        self.times_s = np.arange(round(story.seconds * rate_hz)) / rate_hz
        self._seed = int(rng.integers(2**32))
        presets = [SENSORS["kinect2"], SENSORS["azure-nfov-binned"]]
        self._presets = [presets[i % 2] for i in range(cameras)]
        self.rig = Rig(tuple(_mount(rng, i, cameras, preset) for i, preset in enumerate(self._presets)))
        self._chair = np.array([rng.uniform(1.0, 1.4), rng.uniform(-1.4, -1.0)])
        people = story.cast(rng)
        self._people = tuple(zip(people, story.ways(rng, Stage(people, self._chair, self.times_s)), strict=True))
        self._pushed_s = story.pushed_s
        self._rooms = {shift: self._draw_room(shift) for shift in (0.0, 1.0)}
        noise = np.random.default_rng([self._seed, 1])
        self.backgrounds_m = {}
        for camera, preset, depth_m in zip(self.rig.cameras, self._presets, self._rooms[0.0], strict=True):
            material = np.full(depth_m.shape, Material.SCENE, np.uint8)
            self.backgrounds_m[camera.name] = sense(depth_m, material, camera, preset.model, noise)

    @property
    def count(self) -> int:
        """How many people there are."""
        return len(self._people)

    def moments(self, *, alone: bool = False) -> Iterator[Moment]:
        """All sets, with everybody or the first person only; noise is the same whenever it is asked for."""
        present = [not alone or k == 0 for k in range(self.count)]
        rng = np.random.default_rng([self._seed, 2])
        for i, time_s in enumerate(self.times_s):
            shift = 0.0
            if self._pushed_s is not None and not alone:
                begin_s, end_s = self._pushed_s
                shift = float(np.clip((time_s - begin_s) / (end_s - begin_s), 0, 1))
            rooms = self._rooms.get(shift) or self._draw_room(shift)
            posed = [
                dressed.pose(motion.postures[i]).moved(np.eye(3), motion.offsets[i]) if here else None
                for (dressed, motion), here in zip(self._people, present, strict=True)
            ]
            views, masks = [], []
            for camera, preset, room_m in zip(self.rig.cameras, self._presets, rooms, strict=True):
                depth_m, material = room_m, np.full(room_m.shape, Material.SCENE, np.uint8)
                who = np.zeros(room_m.shape, np.uint8)
                for k, person in enumerate(posed):
                    if person is not None:
                        drawn = render_person(person, camera, depth_m, material)
                        nearer = drawn.person & (drawn.depth_m < np.where(depth_m > 0, depth_m, np.inf))
                        who[nearer] = k + 1
                        depth_m, material = drawn.depth_m, drawn.material
                read_m = sense(depth_m, material, camera, preset.model, rng)
                views.append(View(camera, read_m))
                masks.append([(who == k + 1) & (read_m > 0) for k in range(self.count)])
            joints = tuple(
                person.joints if person is not None and _inside(person.joints) else np.full((18, 3), np.nan)
                for person in posed
            )
            yield Moment(
                FrameSet(round(float(time_s) * 1e9), tuple(views), joints[0] if joints else None),
                tuple(tuple(each[k] for each in masks) for k in range(self.count)), joints,
            )  # fmt: skip

    def _draw_room(self, shift: float) -> list[Float[ndarray, "_ _"]]:
        """What each camera would read of the room without errors; the chair is at the share ``shift`` of its way."""
        x, y = self._chair + shift * np.array([0.6, -0.3])
        chair = (
            Box((x - 0.22, y - 0.22, 0.4), (x + 0.22, y + 0.22, 0.46)),
            Box((x + 0.16, y - 0.22, 0.46), (x + 0.22, y + 0.22, 0.9)),
            *(Box((x + i * 0.2 - 0.02, y + j * 0.2 - 0.02, 0.0), (x + i * 0.2 + 0.02, y + j * 0.2 + 0.02, 0.4))
              for i in (-1, 1) for j in (-1, 1)),
        )  # fmt: skip
        shell = Box((-HALF_X, -HALF_Y, 0.0), (HALF_X, HALF_Y, 3.0))
        still = (
            *table((-0.6, 2.0), (0.9, 2.7), 0.74),
            *shelf((-HALF_X, -2.2), (-2.65, -1.0), 1.8, 5),
            Box((2.4, 0.6, 0.0), (2.98, 1.5, 1.0)),
        )
        room = Room(shell, (*still, *chair))
        return [render_room(room, camera) for camera in self.rig.cameras]


def _inside(joints: Float[ndarray, "18 3"]) -> bool:
    x, y, _ = joints[JOINT_INDEX["Hip"]]
    return abs(x) < HALF_X and abs(y) < HALF_Y


def _mount(rng: np.random.Generator, index: int, count: int, preset: SensorPreset):
    """A camera near the walls, all around, which looks at the middle."""
    azimuth = 2 * np.pi * (index + 0.3 + rng.uniform(-0.15, 0.15)) / count
    reach = rng.uniform(2.5, 2.7)
    eye = np.array([reach * np.sin(azimuth), -reach * np.cos(azimuth), rng.uniform(1.5, 2.2)])
    return preset.camera(f"cam{index}", look_at(eye, np.array([*rng.uniform(-0.15, 0.15, 2), 0.95])))
