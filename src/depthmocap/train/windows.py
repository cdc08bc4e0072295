"""Training windows made on the fly: bodies, clothes, cameras and sensors of all kinds, and errors of segmentation."""

from __future__ import annotations

import dataclasses
import functools
from typing import NamedTuple, TypeAlias

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.regions import REGION, UNLABELLED
from depthmocap.body.trunk import trunk_lean
from depthmocap.classify.window import Window, make_window
from depthmocap.errors import InputError
from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.geometry.transforms import transform_points
from depthmocap.synth.cut import cut_plane, random_cut
from depthmocap.synth.motion.postures import PostureSource
from depthmocap.synth.render import Material, PosedPerson, Rendering, render_person
from depthmocap.synth.sample import CameraRange, Subset, random_camera, random_person
from depthmocap.synth.scenes.scene import TRAINING, random_scene, render_scene
from depthmocap.synth.sensing.sensor import sense
from depthmocap.synth.sensing.sensors import random_model, random_preset

#: Camera positions of training, and the share of each: around people, close to them, far away, under the ceiling.
_PLACES: tuple[tuple[float, CameraRange], ...] = (
    (0.7, CameraRange(distance_m=(1.2, 4.5), height_m=(0.0, 3.0))),
    (0.12, CameraRange(distance_m=(0.5, 1.4), height_m=(0.3, 2.2))),
    (0.1, CameraRange(distance_m=(4.0, 8.0), height_m=(0.0, 3.0))),
    (0.08, CameraRange(distance_m=(0.5, 1.5), height_m=(2.2, 3.5), steepest_deg=90.0)),
)
#: Camera positions of validation.
_VALID_PLACES = CameraRange(distance_m=(1.2, 4.5), height_m=(0.1, 3.0), roll_rad=0.06)
#: Standard deviation of a camera's roll, radians.
_ROLL_RAD = 0.06
#: The same of a camera that hangs at a slant, radians.
_SLANTED_RAD = 0.4
#: Share of cameras that hang at a slant.
_SLANTED = 0.2
#: A trunk that leans by less than this in the picture is shown as it is, radians.
_LEANING_RAD = 0.5
#: The camera sees some of the others with the trunk upright, as the classifier sees them again, but for an error of
#: this standard deviation, radians.
_UPRIGHT_RAD = 0.15
#: Share of errors that are larger, as where the classifier was wrong about the trunk,
_MISTAKEN = 0.1
#: and their standard deviation, radians.
_MISTAKEN_RAD = 0.6
#: Regions (by number) whose pixels lie near the floor.
_FEET = np.isin(np.arange(44), [REGION[f"{part} {side}"] for part in ("ankle", "forefoot") for side in "RL"])
#: Least number of labelled pixels of a training picture.
_FEWEST = 300
#: Least number of the person's pixels in a window: a poor sensor shows little of a distant person.
_FEWEST_IN_WINDOW = 600
#: Share of pictures with random errors drawn around the sensor's; the others have the sensor's errors.
_RANDOM_ERRORS = 0.5
#: Number of consecutive windows with the same person in the same posture, with other cameras and sensors: making and
#: dressing people would otherwise be half of the work.
_WINDOWS_PER_PERSON = 4
#: Margin around the person in the rendered picture, pixels: for things they hold and for flying pixels.
_MARGIN = 16
#: Cloth within this distance of the skin's outline is not taught as background, metres.
_HALO_M = 0.05

#: Joints farther than this from the window's middle are not taught, metres.
_REACH_M = 3.0


class LabelledWindow(NamedTuple):
    """A training example.

    Attributes:
        inputs: of the window.
        labels: of the window, 255 where unknown.
        joints: positions in the window (``Window.positions_from_world``), metres, NaN where unknown.
    """

    inputs: Float[ndarray, "c h w"]
    labels: UInt8[ndarray, "h w"]
    joints: Float[ndarray, "18 3"]


def default_subset(data: str) -> Subset:
    """The people of training data where none are named: "open" where the data are made, "hard" in a UBC3V folder."""
    return "open" if data == "synth" else "hard"


def labelled_window(
    window: Window, labels: UInt8[ndarray, "h w"], joints: Float[ndarray, "18 3"], camera: DepthCamera
) -> LabelledWindow:
    """The training example of a window: labels of the picture, and joints in the world."""
    return LabelledWindow(
        window.inputs, window.labels_from_image(labels, UNLABELLED), joint_targets(window, joints, camera)
    )


def joint_targets(window: Window, joints: Float[ndarray, "18 3"], camera: DepthCamera) -> Float[ndarray, "18 3"]:
    """Target positions in the window of joints in the world; NaN where they are behind the camera or far away."""
    places = window.positions_from_world(joints, camera)
    near = (np.abs(places) < _REACH_M).all(1, keepdims=True)
    return np.where(near, places, np.nan).astype(np.float32)


#: Depth and materials around a person.
_Background: TypeAlias = tuple[Float[ndarray, "h w"], UInt8[ndarray, "h w"]]


@dataclasses.dataclass(frozen=True)
class Degradations:
    """Shares of training pictures with each kind of degradation.

    Attributes:
        truncate: the camera looks past the person, so that the picture ends within the body.
        cut: a part of the person is hidden behind a plane (``synth.cut``).
        scene: objects hide the person or are held or worn, or a second person is near.
        floor: there is a floor, and the mask includes some of it around the feet.
        objects: the mask includes held and worn objects.
        second: the mask includes the second person.
        occlude: a bar or a box is cut out of the mask.
        erode: the mask lacks the outermost pixels.
        upright: of the trunks that do not point up in the picture, share which the camera is turned for, so that they
            do, as the classifier sees them again.
    """

    truncate: float = 0.12
    cut: float = 0.4
    scene: float = 0.4
    floor: float = 0.4
    objects: float = 0.6
    second: float = 0.2
    occlude: float = 0.08
    erode: float = 0.1
    upright: float = 0.65


def training_window(
    seed: int,
    index: int,
    subset: Subset,
    postures: PostureSource,
    degradations: Degradations | None,
    *,
    clothes: bool = True,
    errors: bool = True,
) -> LabelledWindow:
    """The ``index``-th window of a seed.

    It depends on the seed and the index alone, so that any number of workers makes the same data.
    ``degradations=None`` gives well segmented people alone, with the sensor's errors, for validation. Without
    ``clothes`` people are bare, without ``errors`` depth is exact.

    Raises:
        InputError: when no person is visible in 20 tries.
    """
    for attempt in range(20):
        rng = np.random.default_rng([seed, index, attempt])
        person = _person(seed, index // _WINDOWS_PER_PERSON, attempt, subset, postures)
        if not clothes:
            person = PosedPerson(person.body)
        preset = random_preset(rng)
        places = _VALID_PLACES if degradations is None else _random_places(rng, degradations)
        camera = random_camera(rng, person.body, places, preset, "camera")
        if degradations is not None:
            camera = _sees_upright(
                np.random.default_rng([seed, index, attempt, 2]), camera, person, degradations.upright
            )
        camera = _cropped(camera, person)
        if camera is None:
            continue
        background = _background(rng, person, camera, postures, degradations)
        rendering = render_person(person, camera, *(background or ()))
        if np.count_nonzero(rendering.labels) < _FEWEST:
            continue
        model = random_model(rng, preset) if rng.random() < _RANDOM_ERRORS else preset.model
        depth = rendering.depth_m
        if errors:
            depth = sense(depth, rendering.material, camera, model, rng)
        mask, labels = _segment(rng, rendering, camera.fx, background, depth, degradations)
        if degradations is not None and rng.random() < degradations.cut:
            mask &= cut_plane(rng, random_cut(rng), person.joints, camera).keeps(depth, camera)
        window = make_window(depth, mask, camera)
        known = mask & (labels > 0) & (labels != UNLABELLED)
        if window is None or np.count_nonzero(window.inputs[1]) < _FEWEST_IN_WINDOW:
            continue
        if np.count_nonzero(known) > _FEWEST // 2:
            return labelled_window(window, labels, person.joints, camera)
    raise InputError(f"no person could be drawn in 20 tries (seed {seed}, index {index})")


def _random_places(rng: np.random.Generator, degradations: Degradations) -> CameraRange:
    places = _PLACES[int(rng.choice(len(_PLACES), p=[share for share, _ in _PLACES]))][1]
    roll = _SLANTED_RAD if rng.random() < _SLANTED else _ROLL_RAD
    return dataclasses.replace(places, roll_rad=roll, truncated=degradations.truncate)


def _sees_upright(rng: np.random.Generator, camera: DepthCamera, person: PosedPerson, share: float) -> DepthCamera:
    """The camera, in a share of the pictures of a trunk that does not point up turned about its axis so it does."""
    wanted, error = rng.random() < share, rng.normal(0, _MISTAKEN_RAD if rng.random() < _MISTAKEN else _UPRIGHT_RAD)
    lean = trunk_lean(transform_points(camera.camera_from_world, person.joints))
    if not wanted or abs(lean) < _LEANING_RAD:
        return camera
    pose = camera.world_from_camera.copy()
    pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec([0, 0, lean + error]).as_matrix()
    return dataclasses.replace(camera, world_from_camera=pose)


@functools.lru_cache(maxsize=1)
def _person(seed: int, number: int, attempt: int, subset: Subset, postures: PostureSource) -> PosedPerson:
    """The person that the windows of a number share."""
    rng = np.random.default_rng([seed, number, attempt, 1])
    return random_person(rng, subset, postures)


def _cropped(camera: DepthCamera, person: PosedPerson) -> DepthCamera | None:
    """The camera cropped to the person, which is all that training needs; None where the crop is empty."""
    points = np.concatenate([person.vertices, *(layer.vertices for layer in person.layers)])
    u, v, z = camera.project(points[::4]).T
    in_front = z > 0.2
    if not in_front.any():
        return None
    left, right = max(int(u[in_front].min()) - _MARGIN, 0), min(int(u[in_front].max()) + _MARGIN + 1, camera.width)
    top, bottom = max(int(v[in_front].min()) - _MARGIN, 0), min(int(v[in_front].max()) + _MARGIN + 1, camera.height)
    if right - left < _MARGIN or bottom - top < _MARGIN:
        return None
    return dataclasses.replace(camera, width=right - left, height=bottom - top, cx=camera.cx - left, cy=camera.cy - top)


def _background(
    rng: np.random.Generator,
    person: PosedPerson,
    camera: DepthCamera,
    postures: PostureSource,
    degradations: Degradations | None,
) -> _Background | None:
    """Depth and materials around the person, None without any."""
    if degradations is None:
        return None
    depth = material = None
    if rng.random() < degradations.scene:
        scene = random_scene(rng, person, [camera], TRAINING, lambda rng: random_person(rng, "open", postures))
        depth, material = render_scene(scene, camera)
    if rng.random() < degradations.floor:
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
    degradations: Degradations | None,
) -> tuple[Bool[ndarray, "h w"], UInt8[ndarray, "h w"]]:
    """The person's mask as background subtraction gives it, and the labels of its pixels: regions of the skin; 0 where
    no skin is near behind (wide clothes, objects); 255 beside the silhouette, where pixels fly."""
    person, material = rendering.person, rendering.material
    labels = np.where(person, rendering.labels, np.uint8(UNLABELLED))
    # Cloth close to the skin's outline may have any label; only cloth far from it is background.
    to_skin = cv2.distanceTransform((rendering.labels == 0).astype(np.uint8), cv2.DIST_L2, 3)
    labels[(labels == 0) & (to_skin * depth < _HALO_M * focal_px)] = UNLABELLED
    if degradations is None:
        return person & (depth > 0), labels
    included = person.copy()
    for kind, chance in ((Material.OBJECT, degradations.objects), (Material.SECOND_PERSON, degradations.second)):
        if rng.random() < chance:
            included |= material == kind
    labels[(material == Material.OBJECT) | (material == Material.SECOND_PERSON)] = 0
    around = cv2.dilate(included.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=int(rng.integers(0, 3))) > 0
    if background is None:
        mask = around & (depth > 0)
    else:
        # What differs from the empty scene, which shows neither held objects nor the second person.
        empty = np.where(background[1] == Material.SCENE, background[0], 0)
        threshold = rng.uniform(0.02, 0.08) + rng.uniform(0, 0.02) * depth
        mask = around & (depth > 0) & ((empty == 0) | (empty - depth > threshold) | (depth - empty > 2 * threshold))
        if rng.random() < 0.6:  # floor or furniture beside the feet, in their shadow
            feet = _FEET[np.where(labels == UNLABELLED, 0, labels)].astype(np.uint8)
            size = int(rng.integers(2, 9))
            ring = cv2.dilate(feet, np.ones((size, 2 * size), np.uint8)) > 0
            leaked = ring & (material == Material.SCENE) & (depth > 0)
            mask |= leaked
            labels[leaked] = 0
    if rng.random() < degradations.occlude:
        mask &= ~_occluder(mask.shape, rng)
    if rng.random() < degradations.erode:
        mask = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return mask, labels


def _occluder(shape: tuple[int, ...], rng: np.random.Generator) -> Bool[ndarray, "h w"]:
    """A bar or a box somewhere on the picture, cut out of the mask."""
    height, width = shape
    centre = (float(rng.uniform(0, width)), float(rng.uniform(0, height)))
    size = (float(rng.uniform(0.05, 0.35) * width), float(rng.uniform(0.1, 0.7) * height))
    corners = cv2.boxPoints((centre, size, float(rng.uniform(0, 180)))).astype(np.int32)
    return cv2.fillConvexPoly(np.zeros((height, width), np.uint8), corners, 1).astype(bool)
