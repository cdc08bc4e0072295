"""Training windows made on the fly: bodies, clothes, cameras and sensors of all kinds, and what segmentation spoils."""

from __future__ import annotations

import dataclasses
import functools
from typing import NamedTuple, TypeAlias

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from depthmocap.body.regions import REGION, UNLABELLED
from depthmocap.classify.window import Window, make_window
from depthmocap.errors import InputError
from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.synth.cut import cut_plane, random_cut
from depthmocap.synth.motion.postures import PostureSource
from depthmocap.synth.render import Material, PosedPerson, Rendering, render_person
from depthmocap.synth.sample import CameraRange, Subset, random_camera, random_person
from depthmocap.synth.scenes.scene import TRAINING, random_scene, render_scene
from depthmocap.synth.sensing.sensor import sense
from depthmocap.synth.sensing.sensors import random_model, random_preset

#: Where cameras of training stand, and how often: about people, close to them, far off, under the ceiling.
_PLACES: tuple[tuple[float, CameraRange], ...] = (
    (0.7, CameraRange(distance_m=(1.2, 4.5), height_m=(0.0, 3.0))),
    (0.12, CameraRange(distance_m=(0.5, 1.4), height_m=(0.3, 2.2))),
    (0.1, CameraRange(distance_m=(4.0, 8.0), height_m=(0.0, 3.0))),
    (0.08, CameraRange(distance_m=(0.5, 1.5), height_m=(2.2, 3.5), steepest_deg=90.0)),
)
#: Those of validation.
_VALID_PLACES = CameraRange(distance_m=(1.2, 4.5), height_m=(0.1, 3.0), roll_rad=0.06)
#: Deviation of a camera's roll (radians), and of that of one which hangs askew; the share of the latter.
_ROLL_RAD, _ASKEW_RAD, _ASKEW = 0.06, 0.4, 0.2
_FEET = np.isin(np.arange(44), [REGION[f"{part} {side}"] for part in ("ankle", "forefoot") for side in "RL"])
#: Fewest labelled pixels of a picture worth training on.
_FEWEST = 300
#: Fewest pixels of a window that show the person: of who is far from a poor sensor little but dust is left.
_FEWEST_IN_WINDOW = 600
#: Share of pictures with errors drawn around the sensor's; the others have just those.
_RANDOM_ERRORS = 0.5
#: So many windows in a row show the same person in the same posture, from anywhere by any sensor: making and dressing
#: people would be half of the work.
_WINDOWS_A_PERSON = 4
#: Room around the person in the picture that is drawn (pixels): what clings to them or flies beside them.
_MARGIN = 16
#: Cloth within this of the skin's outline is not taught as background (metres).
_HALO_M = 0.05

#: Joints farther from the window's middle than this are not taught (metres).
_REACH_M = 3.0


class LabelledWindow(NamedTuple):
    """What a network learns from: a window's inputs, its labels, 255 where they are not known, and the places of the
    joints in it (see ``Window.positions_from_world``), NaN where they are not."""

    inputs: Float[ndarray, "c h w"]
    labels: UInt8[ndarray, "h w"]
    joints: Float[ndarray, "18 3"]


def joint_places(window: Window, joints: Float[ndarray, "18 3"], camera: DepthCamera) -> Float[ndarray, "18 3"]:
    """Where to teach the joints, given in the world; NaN where they are behind the camera or far away."""
    places = window.positions_from_world(joints, camera)
    near = (np.abs(places) < _REACH_M).all(1, keepdims=True)
    return np.where(near, places, np.nan).astype(np.float32)


#: Depth and materials of what is around a person.
_Background: TypeAlias = tuple[Float[ndarray, "h w"], UInt8[ndarray, "h w"]]


@dataclasses.dataclass(frozen=True)
class Spoiling:
    """How often a training picture is spoilt in each way.

    Attributes:
        truncate: the camera looks past the person, so that the picture ends within them.
        cut: some of the person is hidden beyond a plane (see ``synth.cut``).
        scene: things hide the person or are held, worn, or a second person is near.
        floor: there is a floor, and some of it around the feet is taken for the person.
        objects: what is held or worn is taken for the person, where there is any.
        second: a second person is, too.
        occlude: a bar or a box is cut out.
        erode: the person loses their outermost pixels.
    """

    truncate: float = 0.12
    cut: float = 0.4
    scene: float = 0.4
    floor: float = 0.4
    objects: float = 0.6
    second: float = 0.2
    occlude: float = 0.08
    erode: float = 0.1


def training_window(
    seed: int,
    index: int,
    subset: Subset,
    postures: PostureSource,
    spoiling: Spoiling | None,
    *,
    clothes: bool = True,
    errors: bool = True,
) -> LabelledWindow:
    """The ``index``-th window of a seed.

    Depends on the seed and index alone, so that any number of workers makes the same data. ``spoiling=None`` gives
    well segmented people alone, with the sensor's errors, for validation. Without ``clothes`` people are bare, without
    ``errors`` depth is exact.

    Raises:
        InputError: when nobody can be seen however often it is drawn.
    """
    for attempt in range(20):
        rng = np.random.default_rng([seed, index, attempt])
        person = _person(seed, index // _WINDOWS_A_PERSON, attempt, subset, postures)
        if not clothes:
            person = PosedPerson(person.body)
        preset = random_preset(rng)
        places = _VALID_PLACES if spoiling is None else _random_places(rng, spoiling)
        camera = _cropped(random_camera(rng, person.body, places, preset, "camera"), person)
        if camera is None:
            continue
        background = _background(rng, person, camera, postures, spoiling)
        rendering = render_person(person, camera, *(background or ()))
        if np.count_nonzero(rendering.labels) < _FEWEST:
            continue
        model = random_model(rng, preset) if rng.random() < _RANDOM_ERRORS else preset.model
        depth = rendering.depth_m
        if errors:
            depth = sense(depth, rendering.material, camera, model, rng)
        mask, labels = _segment(rng, rendering, camera.fx, background, depth, spoiling)
        if spoiling is not None and rng.random() < spoiling.cut:
            mask &= cut_plane(rng, random_cut(rng), person.joints, camera).keeps(depth, camera)
        window = make_window(depth, mask, camera)
        known = mask & (labels > 0) & (labels != UNLABELLED)
        if window is None or np.count_nonzero(window.inputs[1]) < _FEWEST_IN_WINDOW:
            continue
        if np.count_nonzero(known) > _FEWEST // 2:
            joints = joint_places(window, person.joints, camera)
            return LabelledWindow(window.inputs, window.labels_from_image(labels, UNLABELLED), joints)
    raise InputError(f"no person could be drawn in 20 tries (seed {seed}, index {index})")


def _random_places(rng: np.random.Generator, spoiling: Spoiling) -> CameraRange:
    places = _PLACES[int(rng.choice(len(_PLACES), p=[share for share, _ in _PLACES]))][1]
    roll = _ASKEW_RAD if rng.random() < _ASKEW else _ROLL_RAD
    return dataclasses.replace(places, roll_rad=roll, truncated=spoiling.truncate)


@functools.lru_cache(maxsize=1)
def _person(seed: int, number: int, attempt: int, subset: Subset, postures: PostureSource) -> PosedPerson:
    """Whom the windows of a number share."""
    rng = np.random.default_rng([seed, number, attempt, 1])
    return random_person(rng, subset, postures)


def _cropped(camera: DepthCamera, person: PosedPerson) -> DepthCamera | None:
    """The part of a camera's picture around the person, which is all that training needs; None where it is empty."""
    points = np.concatenate([person.vertices, *(layer.vertices for layer in person.layers)])
    u, v, z = camera.project(points[::4]).T
    seen = z > 0.2
    if not seen.any():
        return None
    left, right = max(int(u[seen].min()) - _MARGIN, 0), min(int(u[seen].max()) + _MARGIN + 1, camera.width)
    top, bottom = max(int(v[seen].min()) - _MARGIN, 0), min(int(v[seen].max()) + _MARGIN + 1, camera.height)
    if right - left < _MARGIN or bottom - top < _MARGIN:
        return None
    return dataclasses.replace(camera, width=right - left, height=bottom - top, cx=camera.cx - left, cy=camera.cy - top)


def _background(
    rng: np.random.Generator,
    person: PosedPerson,
    camera: DepthCamera,
    postures: PostureSource,
    spoiling: Spoiling | None,
) -> _Background | None:
    """Depth and materials of what is around the person, None where nothing is."""
    if spoiling is None:
        return None
    depth = material = None
    if rng.random() < spoiling.scene:
        scene = random_scene(rng, person, [camera], TRAINING, lambda rng: random_person(rng, "open", postures))
        depth, material = render_scene(scene, camera)
    if rng.random() < spoiling.floor:
        floor = _floor(camera, person.lowest_m)
        if depth is None or material is None:
            depth, material = np.zeros_like(floor), np.zeros(floor.shape, np.uint8)
        nearer = (floor > 0) & ((depth == 0) | (floor < depth))
        depth[nearer] = floor[nearer]
        material[nearer] = Material.SCENE
    return None if depth is None or material is None else (depth, material)


def _floor(camera: DepthCamera, height_m: float) -> Float[ndarray, "h w"]:
    """Depth of a floor up to 9 m, 0 above the horizon."""
    rotation, eye = camera.world_from_camera[:3, :3], camera.world_from_camera[:3, 3]
    u = (np.arange(camera.width) - camera.cx) / camera.fx
    v = (np.arange(camera.height) - camera.cy) / camera.fy
    down = rotation[2, 0] * u[None] + rotation[2, 1] * v[:, None] + rotation[2, 2]  # of a ray of depth 1
    with np.errstate(divide="ignore"):
        z = (height_m - eye[2]) / down
    return np.where((down < 0) & (z > 0.2) & (z < 9), z, 0).astype(np.float32)


def _segment(
    rng: np.random.Generator,
    rendering: Rendering,
    focal_px: float,
    background: _Background | None,
    depth: Float[ndarray, "h w"],
    spoiling: Spoiling | None,
) -> tuple[Bool[ndarray, "h w"], UInt8[ndarray, "h w"]]:
    """The person's mask as background subtraction finds it, and what is known of the pixels in it: regions of the
    skin; 0 where there is none near behind (wide clothes, things); 255 beside the silhouette, where pixels fly."""
    person, material = rendering.person, rendering.material
    labels = np.where(person, rendering.labels, np.uint8(UNLABELLED))
    # Where cloth reaches a little over the skin's outline, any label serves; only far from it is cloth background.
    bare = cv2.distanceTransform((rendering.labels == 0).astype(np.uint8), cv2.DIST_L2, 3)
    labels[(labels == 0) & (bare * depth < _HALO_M * focal_px)] = UNLABELLED
    if spoiling is None:
        return person & (depth > 0), labels
    taken = person.copy()
    for kind, chance in ((Material.OBJECT, spoiling.objects), (Material.SECOND_PERSON, spoiling.second)):
        if rng.random() < chance:
            taken |= material == kind
    labels[(material == Material.OBJECT) | (material == Material.SECOND_PERSON)] = 0
    around = cv2.dilate(taken.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=int(rng.integers(0, 3))) > 0
    if background is None:
        mask = around & (depth > 0)
    else:
        # What differs from the empty scene; a held thing and a second person are in no picture of that.
        empty = np.where(background[1] == Material.SCENE, background[0], 0)
        threshold = rng.uniform(0.02, 0.08) + rng.uniform(0, 0.02) * depth
        mask = around & (depth > 0) & ((empty == 0) | (empty - depth > threshold) | (depth - empty > 2 * threshold))
        if rng.random() < 0.6:  # some of the floor or of furniture beside the feet, a shadow of theirs
            feet = _FEET[np.where(labels == UNLABELLED, 0, labels)].astype(np.uint8)
            size = int(rng.integers(2, 9))
            ring = cv2.dilate(feet, np.ones((size, 2 * size), np.uint8)) > 0
            leaked = ring & (material == Material.SCENE) & (depth > 0)
            mask |= leaked
            labels[leaked] = 0
    if rng.random() < spoiling.occlude:
        mask &= ~_occluder(mask.shape, rng)
    if rng.random() < spoiling.erode:
        mask = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return mask, labels


def _occluder(shape: tuple[int, ...], rng: np.random.Generator) -> Bool[ndarray, "h w"]:
    """A bar or a box somewhere on the picture, cut out of the mask."""
    height, width = shape
    centre = (float(rng.uniform(0, width)), float(rng.uniform(0, height)))
    size = (float(rng.uniform(0.05, 0.35) * width), float(rng.uniform(0.1, 0.7) * height))
    corners = cv2.boxPoints((centre, size, float(rng.uniform(0, 180)))).astype(np.int32)
    return cv2.fillConvexPoly(np.zeros((height, width), np.uint8), corners, 1).astype(bool)
