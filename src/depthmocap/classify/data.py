"""Training windows made on the fly: bodies, clothes, cameras and sensors of all kinds, and what segmentation spoils."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from numpy import ndarray

from depthmocap.body.model import BodyModel, PosedBody
from depthmocap.body.regions import REGION, UNLABELLED
from depthmocap.classify.preprocess import make_window
from depthmocap.geometry.cameras import DepthCamera
from depthmocap.synth.postures import PostureSource
from depthmocap.synth.render import render_body
from depthmocap.synth.sample import KINECT2, CameraRange, Sensor, Subset, random_body, random_camera
from depthmocap.synth.sensor import apply_noise, random_noise

#: Kinect 2, Azure Kinect narrow (binned), PrimeSense, RealSense; the picture's scale is what matters here.
_SENSORS = (
    KINECT2,
    Sensor(320, 288, 252.0, 252.0, 160.0, 144.0),
    Sensor(320, 240, 285.0, 285.0, 160.0, 120.0),
    Sensor(424, 240, 213.0, 213.0, 212.0, 120.0),
)
_PLACES = CameraRange(distance_m=(1.2, 4.5), height_m=(0.2, 2.8), aim_m=0.1, roll_rad=0.06)
_FEET = np.isin(np.arange(44), [REGION[f"{part} {side}"] for part in ("ankle", "forefoot") for side in "RL"])


@dataclasses.dataclass(frozen=True)
class Spoiling:
    """How often a training picture is spoilt in each way."""

    truncate: float = 0.12
    occlude: float = 0.12
    floor: float = 0.3


def _floor_patch(
    camera: DepthCamera, posed: PosedBody, depth: ndarray, labels: ndarray, rng: np.random.Generator
) -> None:
    """Let some floor around the feet into the mask, as background subtraction does."""
    feet = _FEET[np.where(labels == UNLABELLED, 0, labels)].astype(np.uint8)
    if not feet.any():
        return
    size = int(rng.integers(2, 9))
    ring = cv2.dilate(feet, np.ones((size, 2 * size), np.uint8)).astype(bool) & (labels == UNLABELLED)
    rotation, eye = camera.world_from_camera[:3, :3], camera.world_from_camera[:3, 3]
    floor = float(posed.vertices[:, 2].min()) - 0.005
    v, u = np.nonzero(ring)
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))], -1) @ rotation[2]
    with np.errstate(divide="ignore"):
        z = (floor - eye[2]) / rays
    depth[v, u] = np.where((rays < 0) & (z > 0.2) & (z < 8), z, 0)
    labels[v, u] = 0


def training_window(
    seed: int, index: int, subset: Subset, postures: PostureSource, spoiling: Spoiling | None
) -> tuple[ndarray, ndarray]:
    """The ``index``-th window of a seed: inputs (3, s, s) float32 and labels (s, s) uint8, 255 where unknown.

    Depends on the seed and index alone, so that any number of workers makes the same data.
    ``spoiling=None`` gives whole, clean-edged bodies with sensor noise, for validation.
    """
    for attempt in range(20):
        rng = np.random.default_rng([seed, index, attempt])
        model = BodyModel.load()
        posed = random_body(rng, subset, model).pose(postures.sample(rng)[0])
        sensor = _SENSORS[rng.integers(len(_SENSORS))]
        truncate = spoiling is not None and rng.random() < spoiling.truncate
        places = dataclasses.replace(_PLACES, aim_m=0.7) if truncate else _PLACES
        camera = random_camera(rng, posed, places, sensor, "camera")
        depth, labels = render_body(posed, camera)
        rows, columns = np.flatnonzero(labels.any(1)), np.flatnonzero(labels.any(0))
        if np.count_nonzero(labels) < 300:
            continue
        # Around the body nothing is known: jitter makes pixels there read its depth. Floor is known background.
        labels[labels == 0] = UNLABELLED
        if spoiling is not None and rng.random() < spoiling.floor:
            _floor_patch(camera, posed, depth, labels, rng)
        top, bottom = max(rows[0] - 12, 0), rows[-1] + 13
        left, right = max(columns[0] - 20, 0), columns[-1] + 21
        depth = apply_noise(np.ascontiguousarray(depth[top:bottom, left:right]), random_noise(rng), rng)
        labels = np.ascontiguousarray(labels[top:bottom, left:right])
        mask = depth > 0
        if spoiling is not None and rng.random() < spoiling.occlude:
            mask &= ~_occluder(mask.shape, rng)
        window = make_window(depth, mask, camera)
        if window is not None and np.count_nonzero(mask & (labels != UNLABELLED)) > 200:
            return window.inputs, window.labels_from_image(labels, UNLABELLED)
    raise RuntimeError(f"no body in view in 20 attempts (seed {seed}, index {index})")


def _occluder(shape: tuple[int, ...], rng: np.random.Generator) -> ndarray:
    """A bar or a box somewhere on the picture, cut out of the mask as furniture in front would be."""
    height, width = shape
    centre = (float(rng.uniform(0, width)), float(rng.uniform(0, height)))
    size = (float(rng.uniform(0.05, 0.35) * width), float(rng.uniform(0.1, 0.7) * height))
    corners = cv2.boxPoints((centre, size, float(rng.uniform(0, 180)))).astype(np.int32)
    return cv2.fillConvexPoly(np.zeros((height, width), np.uint8), corners, 1).astype(bool)
