"""Training pictures of people in rooms for the network that finds people, made on the fly (extra: train)."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, UInt8
from numpy import ndarray

from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.geometry.transforms import transform_points
from depthmocap.segment.depth_grid import CELL_FOCAL_PX, CHANNELS, DepthGrid
from depthmocap.synth.body.mesh import BodyModel
from depthmocap.synth.motion.extreme_postures import rest_on_floor
from depthmocap.synth.motion.lying import lying_posture
from depthmocap.synth.motion.postures import TRAINING_VARIATION, Variation, posture_source
from depthmocap.synth.people.bodies import random_dressed_body, random_phenotype
from depthmocap.synth.people.garments import DressedBody, clothe
from depthmocap.synth.people.pockets import pose_in_clothes
from depthmocap.synth.people.wardrobe import random_clothes
from depthmocap.synth.render import PosedPerson
from depthmocap.synth.sample import Split
from depthmocap.synth.scenes.populated import PopulatedScene, populated_scene
from depthmocap.synth.sensing.sensor import sense
from depthmocap.synth.sensing.sensors import SensorPreset, random_model, random_preset

#: Rows and columns of a training picture, in cells: wider pictures are cropped, smaller ones padded.
PICTURE = (72, 88)
#: Pictures of one scene.
VIEWS = 10
#: How often each is read by a sensor with other errors.
READINGS = 2
#: Share of readings with errors drawn around the sensor's own.
_RANDOM_ERRORS = 0.5
#: Dressed bodies kept to appear again in other postures: to dress somebody takes longer than to pose them.
_KEPT = 12
#: Share of people whose body is one of these.
_AGAIN = 0.7
#: Share of bodies that are small children's.
_INFANTS = 0.2
#: Share of those less than about a year old among them.
_BABIES = 0.4
#: Share of people who lie, besides those of recordings.
_LIE = 0.2
#: Share of them who lie at rest.
_AT_REST = 0.7
#: Children smaller than this (metres) lie more often,
_INFANT_M = 0.95
#: with this probability.
_INFANTS_LIE = 0.7
#: Target of samples without depth.
IGNORED = 255
#: A person far from everything seen of them is not taught (metres).
_FARTHEST_CENTRE_M = 2.5


class PeopleExample(NamedTuple):
    """A training example.

    Attributes:
        inputs: of the network.
        people: at every sample the number of its person from 1, 0 for none, ``IGNORED`` where there is no depth.
        offsets: metres from the surface of each cell to the centre of its person, in the axes of the camera; NaN where
            the cell shows nobody.
    """

    inputs: Float32[ndarray, "8 rows columns"]
    people: UInt8[ndarray, "rows2 columns2"]
    offsets: Float32[ndarray, "3 rows columns"]


class PeopleScenes:
    """Scenes by index, of a seed, each with its pictures. Cheap to send to another process."""

    def __init__(self, postures: Path | None, split: Split, seed: int) -> None:
        variation = TRAINING_VARIATION if split == "train" else Variation(mirror=0.5, beyond=0.1, as_recorded=0.7)
        variation = dataclasses.replace(variation, sit=0.3)
        self._postures, self._split, self._seed = posture_source(postures, split, False, variation), split, seed
        self._bodies: list[DressedBody] = []

    def __call__(self, index: int) -> list[PeopleExample]:
        """The examples of a scene."""
        rng = np.random.default_rng([self._seed, index])
        scene = populated_scene(rng, self._person)
        examples = []
        for _ in range(VIEWS):
            preset = random_preset(rng)
            camera = scene.camera(rng, _on_grid(preset))
            if camera is not None:
                examples += _examples(rng, scene, camera, preset, READINGS if self._split == "train" else 1)
        return examples

    def _person(self, rng: np.random.Generator) -> PosedPerson:
        """Somebody in any posture, often in a body that appeared before."""
        if len(self._bodies) < _KEPT or rng.random() > _AGAIN:
            body = _infant(rng) if rng.random() < _INFANTS else random_dressed_body(rng, "open", wardrobe="any")
            self._bodies = [*self._bodies[1 - _KEPT :], body]
        body = self._bodies[int(rng.integers(len(self._bodies)))]
        posture = self._postures.sample(rng)[0]
        if rng.random() < (_INFANTS_LIE if _height_m(body) < _INFANT_M else _LIE):
            posture = lying_posture(rng) if rng.random() < _AT_REST else rest_on_floor(posture, rng)
        return pose_in_clothes(body, posture, rng)


def _height_m(dressed: DressedBody) -> float:
    return float(np.ptp(dressed.body.rest_vertices[:, 2]))


def _infant(rng: np.random.Generator) -> DressedBody:
    """A child of less than about a metre."""
    phenotype = dataclasses.replace(
        random_phenotype(rng), age=float(rng.uniform(0, 0.06 if rng.random() < _BABIES else 0.2))
    )
    return clothe(BodyModel.load().shape(phenotype), random_clothes(rng, False, phenotype.gender), rng)


def _on_grid(preset: SensorPreset) -> SensorPreset:
    """The sensor with pixels as large as the samples of a grid: one in some pixels is read by the network."""
    x, y = 2 * CELL_FOCAL_PX / preset.fx, 2 * CELL_FOCAL_PX / preset.fy
    return dataclasses.replace(
        preset, width=round(preset.width * x), height=round(preset.height * y), fx=2 * CELL_FOCAL_PX,
        fy=2 * CELL_FOCAL_PX, cx=preset.cx * x, cy=preset.cy * y,
    )  # fmt: skip


def _examples(
    rng: np.random.Generator, scene: PopulatedScene, camera: DepthCamera, preset: SensorPreset, readings: int
) -> list[PeopleExample]:
    picture = scene.render(camera)
    grid = DepthGrid(camera)
    centres = np.full((256, 3), np.nan, np.float32)
    if len(scene.people):
        centres[1 : len(scene.people) + 1] = transform_points(camera.camera_from_world, scene.centres)
    person = grid.samples(picture.person.astype(np.float32)).astype(np.uint8)
    examples = []
    for _ in range(readings):
        model = random_model(rng, preset) if rng.random() < _RANDOM_ERRORS else preset.model
        samples_m = grid.samples(sense(picture.depth_m, picture.material, camera, model, rng))
        examples.append(_example(rng, samples_m, person, centres, grid, camera))
    return examples


def _example(
    rng: np.random.Generator,
    samples_m: Float32[ndarray, "rows2 columns2"],
    person: UInt8[ndarray, "rows2 columns2"],
    centres: Float32[ndarray, "256 3"],
    grid: DepthGrid,
    camera: DepthCamera,
) -> PeopleExample:
    people = np.where(samples_m > 0, person, IGNORED).astype(np.uint8)
    rows, columns = grid.shape
    shown = np.where(samples_m > 0, person, 0)
    quads = shown.reshape(rows, 2, columns, 2).transpose(0, 2, 1, 3).reshape(rows, columns, 4)
    depths = samples_m.reshape(rows, 2, columns, 2).transpose(0, 2, 1, 3).reshape(rows, columns, 4)
    whose = quads.max(-1)
    of_whom = (quads == whose[..., None]) & (whose[..., None] > 0)
    z = (depths * of_whom).sum(-1) / np.maximum(of_whom.sum(-1), 1)
    u, v = 2 * np.arange(columns) + 0.5, 2 * np.arange(rows)[:, None] + 0.5
    surface = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z])
    offsets = (centres[whose].transpose(2, 0, 1) - surface).astype(np.float32)
    offsets[:, np.abs(offsets).max(0) > _FARTHEST_CENTRE_M] = np.nan
    return _fitted(rng, PeopleExample(grid.inputs(samples_m), people, offsets))


def _fitted(rng: np.random.Generator, example: PeopleExample) -> PeopleExample:
    """The example cropped or padded to ``PICTURE`` at a random place."""
    rows, columns = example.inputs.shape[1:]
    inputs = np.zeros((CHANNELS, *PICTURE), np.float32)
    people = np.full((2 * PICTURE[0], 2 * PICTURE[1]), IGNORED, np.uint8)
    offsets = np.full((3, *PICTURE), np.nan, np.float32)
    spans = []
    for size, wanted in ((rows, PICTURE[0]), (columns, PICTURE[1])):
        start = int(rng.integers(0, abs(size - wanted) + 1))
        length = min(size, wanted)
        spans.append((start, 0, length) if size > wanted else (0, start, length))
    (r, tr, nr), (c, tc, nc) = spans
    inputs[:, tr : tr + nr, tc : tc + nc] = example.inputs[:, r : r + nr, c : c + nc]
    offsets[:, tr : tr + nr, tc : tc + nc] = example.offsets[:, r : r + nr, c : c + nc]
    people[2 * tr : 2 * (tr + nr), 2 * tc : 2 * (tc + nc)] = example.people[2 * r : 2 * (r + nr), 2 * c : 2 * (c + nc)]
    return PeopleExample(inputs, people, offsets)
