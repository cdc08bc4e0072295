"""Algorithm 1 of the paper: a random body, a random posture, n random cameras."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.model import Body, BodyModel, PosedBody
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry.cameras import DepthCamera
from depthmocap.geometry.transforms import look_at
from depthmocap.synth.bodies import ONE_CHARACTER, dress, random_outfit, random_phenotype, sixteen_characters
from depthmocap.synth.postures import PostureSource, Variation, posture_source
from depthmocap.synth.render import render_body
from depthmocap.synth.sensor import SensorNoise, apply_noise_near

Subset = Literal["easy", "inter", "hard", "open"]
Split = Literal["train", "valid", "test"]


@dataclasses.dataclass(frozen=True)
class CameraRange:
    """Where cameras stand (paper, Sec. III): any azimuth, 1.5–4 m from the person, heights above the floor that a
    user would mount at. ``aim_m`` is the deviation of the point they look at from the body's middle."""

    distance_m: tuple[float, float] = (1.5, 4.0)
    height_m: tuple[float, float] = (0.5, 2.5)
    aim_m: float = 0.1
    roll_rad: float = 0.0


@dataclasses.dataclass(frozen=True)
class Sensor:
    """Size and focal length of a depth camera (pixels); the centre is the picture's."""

    width: int = 512
    height: int = 424
    fx: float = 368.74
    fy: float = 367.93
    cx: float = 253.15
    cy: float = 205.13


#: UBC3V's ray table, as a pinhole.
KINECT2 = Sensor()


def random_body(rng: np.random.Generator, subset: Subset, model: BodyModel) -> Body:
    """A body of a subset: easy and inter have one character, hard sixteen, open any; hard and open are dressed."""
    if subset in ("easy", "inter"):
        return model.shape(ONE_CHARACTER)
    if subset == "hard":
        characters = sixteen_characters()
        index = int(rng.integers(len(characters)))
        # Each of the sixteen always wears the same.
        fixed = np.random.default_rng([16, index])
        return dress(model.shape(characters[index]), random_outfit(fixed), fixed)
    return dress(model.shape(random_phenotype(rng)), random_outfit(rng), rng)


def random_camera(
    rng: np.random.Generator, body: PosedBody, places: CameraRange, sensor: Sensor, name: str
) -> DepthCamera:
    """A camera of the range that looks at the body."""
    low, high = body.vertices.min(0).astype(float), body.vertices.max(0).astype(float)
    centre = (low + high) / 2
    azimuth = rng.uniform(-np.pi, np.pi)
    height = low[2] + rng.uniform(*places.height_m) - centre[2]
    distance = max(rng.uniform(*places.distance_m), abs(height) * 1.1)
    ground = np.sqrt(distance**2 - height**2)
    eye = centre + np.array([ground * np.sin(azimuth), -ground * np.cos(azimuth), height])
    aim = centre + rng.normal(0, places.aim_m, 3)
    pose = look_at(eye, aim, rng.normal(0, places.roll_rad))
    return DepthCamera(name, sensor.width, sensor.height, sensor.fx, sensor.fy, sensor.cx, sensor.cy, pose)


@dataclasses.dataclass(frozen=True, eq=False)
class Sample:
    """One posture seen by n cameras; the group is the clip (or component) the posture came from."""

    views: tuple[View, ...]
    joints: Float[ndarray, "18 3"]
    group: int


def draw_sample(
    rng: np.random.Generator,
    subset: Subset,
    postures: PostureSource,
    views: int = 3,
    places: CameraRange = CameraRange(),
    sensor: Sensor = KINECT2,
    noise: SensorNoise | None = None,
) -> Sample:
    """One call of the paper's SAMPLE: labels are exact; depth has the sensor's noise if any is given, and masks
    are where it is valid."""
    model = BodyModel.load()
    body = random_body(rng, subset, model)
    posture, group = postures.sample(rng)
    posed = body.pose(posture)
    drawn = []
    for i in range(views):
        camera = random_camera(rng, posed, places, sensor, f"Cam{i + 1}")
        depth, labels = render_body(posed, camera)
        mask = labels > 0
        if noise is not None:
            depth = apply_noise_near(depth, mask, noise, rng)
            mask = mask & (depth > 0)
        drawn.append(View(camera, depth, mask, labels))
    return Sample(tuple(drawn), posed.joints, group)


@dataclasses.dataclass(frozen=True)
class Recipe:
    """What a data set shows. A sample depends on the recipe, the seed and its index alone.

    Attributes:
        subset: easy (one character, walking and running), inter (one character, all postures), hard (sixteen), or
            open (bodies and outfits of all kinds).
        split: postures of the splits come from different motion clips.
        views: cameras around each posture.
        postures: folder of motion capture clips; without it postures come from the packaged prior.
        noise: sensor noise on the depth; UBC3V itself has none.
    """

    subset: Subset = "hard"
    split: Split = "train"
    views: int = 3
    postures: Path | None = None
    noise: bool = False

    def __post_init__(self) -> None:
        if self.views < 1:
            raise InputError(f"--views must be at least 1, got {self.views}")


class Sampler:
    """Draws the samples of a recipe by index; cheap to call in any order and in any process."""

    def __init__(self, recipe: Recipe, seed: int) -> None:
        self.recipe, self.seed = recipe, seed
        self._postures = posture_source(recipe.postures, recipe.split, recipe.subset == "easy", Variation(mirror=0.5))

    def __call__(self, index: int) -> Sample:
        """The sample of an index, from 0."""
        split = ("train", "valid", "test").index(self.recipe.split)
        rng = np.random.default_rng([self.seed, split, index])
        noise = SensorNoise() if self.recipe.noise else None
        return draw_sample(rng, self.recipe.subset, self._postures, self.recipe.views, noise=noise)
