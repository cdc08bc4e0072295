"""Algorithm 1 of the paper: a random body, a random posture, n random cameras; and recipes of data sets."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.core.settings import check_seed
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.geometry.transforms import look_at
from depthmocap.synth.body.mesh import PosedBody
from depthmocap.synth.body.mesh_landmarks import landmark_vertices
from depthmocap.synth.cut import CUTS, Cut, cut_plane, random_cut
from depthmocap.synth.motion.extreme_postures import FAMILIES, Family
from depthmocap.synth.motion.postures import (
    TRAINING_VARIATION,
    LeaningPostures,
    PostureSource,
    Variation,
    posture_source,
)
from depthmocap.synth.people.bodies import Wardrobe, random_dressed_body
from depthmocap.synth.people.garments import DressedBody
from depthmocap.synth.people.pockets import pose_in_clothes
from depthmocap.synth.render import PosedPerson, Rendering, render_person
from depthmocap.synth.scenes.scene import OFF, SCENE_PRESETS, Scene, random_scene, render_scene
from depthmocap.synth.sensing.sensor import sense
from depthmocap.synth.sensing.sensors import (
    HELD_OUT_SENSOR,
    SENSORS,
    TRAINED_SENSORS,
    SensorPreset,
    find_sensor,
    random_model,
)

Subset = Literal["easy", "inter", "hard", "open"]
Split = Literal["train", "valid", "test"]
SPLITS: tuple[Split, ...] = ("train", "valid", "test")
#: Exact depth; depth as the sensor reads it; or with errors drawn around the sensor's, up to three times as strong.
Noise = Literal["none", "sensor", "random"]

#: Stands for every sensor but the one kept out of training.
ANY_SENSOR = "any"
#: Least number of the body's pixels in one view; a sample with fewer is drawn again.
_FEWEST_PIXELS = 50
#: Largest number of draws of a sample.
_TRIES = 20
#: Least distance of a camera from the body's middle, and least height above the floor, metres.
_LEAST_M = {"distance_m": 0.5, "height_m": 0.0}


@dataclasses.dataclass(frozen=True)
class CameraRange:
    """Where cameras stand (paper, Sec. III): any azimuth, 1.5–4 m from the person, heights above the floor that a
    user would mount at.

    Attributes:
        distance_m: from the body's middle, nearest and farthest; a sensor that reads less far stands nearer.
        height_m: above the floor, lowest and highest.
        aim_m: standard deviation of the point they look at from the body's middle.
        roll_rad: standard deviation of the roll; UBC3V's layout cannot store any.
        truncated: share of cameras that look past the person, so that the picture ends within them.
        steepest_deg: steepest angle of view, 90 for straight down; a camera that would look more steeply stands
            farther off.
    """

    distance_m: tuple[float, float] = (1.5, 4.0)
    height_m: tuple[float, float] = (0.5, 2.5)
    aim_m: float = 0.1
    roll_rad: float = 0.0
    truncated: float = 0.0
    steepest_deg: float = 65.38

    def __post_init__(self) -> None:
        for name in _LEAST_M:
            low, high = getattr(self, name)
            option = f"--{name.replace('_', '-')}"
            if not (np.isfinite([low, high]).all() and low <= high):
                raise InputError(f"{option} must be a minimum and a maximum, got {low} and {high}")
            if low < (least := _LEAST_M[name]):
                raise InputError(f"{option} must be at least {least}, got {low}")
        for name in ("aim_m", "roll_rad"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputError(
                    f"--{name.replace('_', '-')} must be a number of at least 0, got {getattr(self, name)}"
                )
        if not 0 <= self.truncated <= 1:
            raise InputError(f"--truncated must be from 0 to 1, got {self.truncated}")
        if not 0 < self.steepest_deg <= 90:
            raise InputError(f"--steepest-deg must be more than 0 and at most 90, got {self.steepest_deg}")


#: Standard deviation of the aim of a camera that looks past the person, metres.
_PAST_M = 0.7
#: A sensor stands this much nearer than its range, so that the far side of the person is in range, metres.
_REACH_M = 0.4


def random_camera(
    rng: np.random.Generator, body: PosedBody, places: CameraRange, sensor: SensorPreset, name: str
) -> DepthCamera:
    """A camera of the range that looks at the body."""
    low, high = body.vertices.min(0).astype(float), body.vertices.max(0).astype(float)
    centre = (low + high) / 2
    azimuth = rng.uniform(-np.pi, np.pi)
    height = low[2] + rng.uniform(*places.height_m) - centre[2]
    nearest, farthest = places.distance_m
    farthest = max(min(farthest, sensor.range_m[1] - _REACH_M), nearest)
    distance = max(rng.uniform(nearest, farthest), abs(height) / np.sin(np.deg2rad(places.steepest_deg)))
    ground = np.sqrt(max(distance**2 - height**2, 0.0))
    eye = centre + np.array([ground * np.sin(azimuth), -ground * np.cos(azimuth), height])
    past = places.truncated > 0 and rng.random() < places.truncated
    aim = centre + rng.normal(0, _PAST_M if past else places.aim_m, 3)
    return sensor.camera(name, look_at(eye, aim, rng.normal(0, places.roll_rad)))


@dataclasses.dataclass(frozen=True)
class Recipe:
    """What a data set shows. A sample depends on the recipe, the seed and its index alone.

    Attributes:
        subset: easy (one character, walking and running), inter (one character, all postures), hard (sixteen), or
            open (bodies and outfits of all kinds).
        split: postures of the splits come from different motion clips.
        views: cameras around each posture.
        postures: folder of motion capture clips, or a pool made of them; without it the packaged prior.
        vary: recombine and perturb postures, for training.
        sensors: names of sensors (see docs/guides/sensors.md), one is drawn for each view; "any" stands for all but the
            one that is kept out of training.
        noise: "none" for exact depth, "sensor" for the sensor's errors, "random" for errors drawn around them.
        scene: what is around the person: "off" nothing, "training" objects that hide the person or touch them,
            "full" furnished rooms.
        cameras: positions of the cameras.
        wardrobe: what people of open wear: "indoors", "any" (that, and outdoor jackets and hoods over it) or "outdoors"
            (a jacket, all of them); in the last two they also put their hands in their pockets.
        held_out_clothes: everybody wears the family of garments that is kept out of training.
        seated: everybody sits.
        hands_on_body: everybody lays a hand or both on the body, if possible: folded arms, hands on hips, at the chin.
        family: everybody is in a posture of a family that is rare in recordings: "floor" lying, kneeling, crawling,
            "acrobatic" kicks, splits, scales, bends, "air" any way up.
        leaning: everybody's trunk leans: crawling, lying, bending, falling as recordings have it.
        cut: the part of the body is hidden that lies below the knees, thighs, hips or chest, above the waist or the
            neck, to one side, or beyond an edge of the picture; "any" for all of these in turn.
        cut_share: share of the people who are cut off.
        overhead: share of the people whom all cameras see from overhead.
    """

    subset: Subset = "hard"
    split: Split = "train"
    views: int = 3
    postures: Path | None = None
    vary: bool = False
    sensors: tuple[str, ...] = ("ubc3v",)
    noise: Noise = "none"
    scene: Literal["off", "training", "full"] = "off"
    cameras: CameraRange = CameraRange()
    wardrobe: Wardrobe = "any"
    held_out_clothes: bool = False
    seated: bool = False
    hands_on_body: bool = False
    family: Family | None = None
    leaning: bool = False
    cut: Cut | Literal["any"] | None = None
    cut_share: float = 1.0
    overhead: float = 0.0

    def __post_init__(self) -> None:
        for option, value, known in (
            ("subset", self.subset, get_args(Subset)), ("split", self.split, get_args(Split)),
            ("wardrobe", self.wardrobe, get_args(Wardrobe)), ("family", self.family, (*FAMILIES, None)),
            ("cut", self.cut, (*CUTS, "any", None)),
        ):  # fmt: skip
            if value not in known:
                raise InputError(f"--{option} takes {', '.join(filter(None, known))}, got {value!r}")
        for option, share in (("cut-share", self.cut_share), ("overhead", self.overhead)):
            if not 0 <= share <= 1:
                raise InputError(f"--{option} must be from 0 to 1, got {share}")
        if self.views < 1:
            raise InputError(f"--views must be at least 1, got {self.views}")
        if not self.sensors:
            raise InputError(f"--sensors must name at least one sensor of {', '.join(SENSORS)}, or {ANY_SENSOR}")
        self.presets  # noqa: B018 - names that are no sensors raise

    @functools.cached_property
    def presets(self) -> tuple[SensorPreset, ...]:
        """The sensors.

        Raises:
            InputError: when a name is no sensor's.
        """
        named = (TRAINED_SENSORS if name == ANY_SENSOR else (find_sensor(name),) for name in self.sensors)
        return tuple(dict.fromkeys(preset for presets in named for preset in presets))


#: Cameras that look down on somebody from the ceiling.
_OVERHEAD = CameraRange(distance_m=(0.5, 1.5), height_m=(2.3, 3.5), roll_rad=0.03, steepest_deg=90.0)
_BENCH = Recipe(
    "open", "test", sensors=(ANY_SENSOR,), noise="sensor", cameras=CameraRange(roll_rad=0.03), wardrobe="indoors"
)
#: The project's own test sets: ordinary people; clothes and a sensor that training never shows; people in outdoor
#: jackets, with hands in pockets; and people who sit or touch themselves, which is rare in recordings.
BENCH: dict[str, Recipe] = {
    "seen": _BENCH,
    "new clothes": dataclasses.replace(_BENCH, held_out_clothes=True),
    "new sensor": dataclasses.replace(_BENCH, sensors=(HELD_OUT_SENSOR,)),
    "outdoors": dataclasses.replace(_BENCH, wardrobe="outdoors"),
    "seated": dataclasses.replace(_BENCH, seated=True),
    "hands on body": dataclasses.replace(_BENCH, hands_on_body=True),
    "floor": dataclasses.replace(_BENCH, family="floor"),
    "acrobatic": dataclasses.replace(_BENCH, family="acrobatic"),
    "leaning": dataclasses.replace(_BENCH, leaning=True),
    "overhead": dataclasses.replace(_BENCH, cameras=_OVERHEAD),
    **{f"cut {cut}": dataclasses.replace(_BENCH, cut=cut) for cut in CUTS},
}


@dataclasses.dataclass(frozen=True, eq=False)
class Sample:
    """One posture seen by n cameras; the group is the clip (or component) the posture came from. Of a generated person
    the surface landmarks are known, too, in the order of ``body.landmarks.LANDMARKS`` (world, metres)."""

    views: tuple[View, ...]
    joints: Float[ndarray, "18 3"]
    group: int
    landmarks: Float[ndarray, "58 3"] | None = None


def see(person: PosedPerson, scene: Scene | None, camera: DepthCamera) -> Rendering:
    """Exact depth, labels and materials of a person in a scene."""
    background = (None, None) if scene is None else render_scene(scene, camera)
    return render_person(person, camera, *background)


def random_person(
    rng: np.random.Generator, subset: Subset, postures: PostureSource, wardrobe: Wardrobe = "any"
) -> PosedPerson:
    """A random person of a subset in a random posture."""
    dressed = random_dressed_body(rng, subset, wardrobe=wardrobe)
    return _posed(rng, subset, dressed, postures.sample(rng)[0], wardrobe)


def _posed(
    rng: np.random.Generator, subset: Subset, dressed: DressedBody, posture: Float[ndarray, "20 3"], wardrobe: Wardrobe
) -> PosedPerson:
    """A person in a posture; people of "open" hold their arms as outdoor clothes allow."""
    if subset != "open" or wardrobe == "indoors":
        return dressed.pose(posture)
    return pose_in_clothes(dressed, posture, rng)


def draw_sample(rng: np.random.Generator, recipe: Recipe, postures: PostureSource) -> Sample:
    """One call of the paper's SAMPLE. Labels are exact; masks are the person's pixels (clothes and hair included)
    where the depth is valid."""
    posture, group = postures.sample(rng)
    dressed = random_dressed_body(rng, recipe.subset, recipe.held_out_clothes, recipe.wardrobe)
    person = _posed(rng, recipe.subset, dressed, posture, recipe.wardrobe)
    presets = [recipe.presets[int(rng.integers(len(recipe.presets)))] for _ in range(recipe.views)]
    places = _OVERHEAD if recipe.overhead and rng.random() < recipe.overhead else recipe.cameras
    cameras = [random_camera(rng, person.body, places, preset, f"Cam{i + 1}") for i, preset in enumerate(presets)]
    settings = SCENE_PRESETS[recipe.scene]
    scene = None
    if settings != OFF:
        scene = random_scene(
            rng, person, cameras, settings, lambda rng: random_person(rng, "open", postures, recipe.wardrobe)
        )
    cut, cut_seed = _drawn_cut(rng, recipe)
    views = []
    for camera, preset in zip(cameras, presets, strict=True):
        rendering = see(person, scene, camera)
        depth = rendering.depth_m
        if recipe.noise != "none":
            model = preset.model if recipe.noise == "sensor" else random_model(rng, preset)
            depth = sense(depth, rendering.material, camera, model, rng)
        mask, labels = rendering.person & (depth > 0), rendering.labels
        if cut is not None:
            # The generator starts anew in each view, because one table hides the same part from all cameras.
            plane = cut_plane(np.random.default_rng(cut_seed), cut, person.joints, camera)
            hidden = rendering.person & ~plane.keeps(depth, camera)
            mask &= ~hidden
            depth, labels = np.where(hidden, 0, depth), np.where(hidden, 0, labels)
        views.append(View(camera, depth, mask, labels))
    return Sample(tuple(views), person.joints, group, person.vertices[landmark_vertices()])


def _drawn_cut(rng: np.random.Generator, recipe: Recipe) -> tuple[Cut | None, int]:
    """The kind of cut, None for none, and its seed."""
    if recipe.cut is None:
        return None, 0
    seed = int(rng.integers(2**31))
    cut_rng = np.random.default_rng([seed, 1])
    if cut_rng.random() >= recipe.cut_share:
        return None, 0
    return (random_cut(cut_rng) if recipe.cut == "any" else recipe.cut), seed


def _shows_somebody(view: View) -> bool:
    """Whether there are enough of the person's pixels, with some skin behind them."""
    assert view.mask is not None and view.labels is not None
    return bool(np.count_nonzero(view.mask) >= _FEWEST_PIXELS and view.labels.any())


class Sampler:
    """Draws the samples of a recipe by index; cheap to call in any order and in any process."""

    def __init__(self, recipe: Recipe, seed: int) -> None:
        check_seed(seed)
        self.recipe, self.seed = recipe, seed
        variation = TRAINING_VARIATION if recipe.vary else Variation(mirror=0.5)
        if recipe.seated:
            variation = dataclasses.replace(variation, sit=1.0, as_recorded=0.0, beyond=0.0)
        if recipe.hands_on_body:
            variation = dataclasses.replace(variation, touch=1.0, as_recorded=0.0, beyond=0.0)
        if recipe.family is not None:
            variation = Variation(mirror=0.5, beyond=1.0, family=recipe.family)
        self._postures: PostureSource = posture_source(
            recipe.postures, recipe.split, recipe.subset == "easy", variation
        )
        if recipe.leaning:
            self._postures = LeaningPostures(self._postures, 1.0)

    def __call__(self, index: int) -> Sample:
        """The sample of an index, from 0. A sample that no camera sees is drawn again.

        Raises:
            InputError: when no camera sees the person in all draws.
        """
        for attempt in range(_TRIES):
            rng = np.random.default_rng([self.seed, SPLITS.index(self.recipe.split), index, attempt])
            sample = draw_sample(rng, self.recipe, self._postures)
            if any(_shows_somebody(view) for view in sample.views):
                return sample
        raise InputError(
            f"sample {index}: no camera sees the person in {_TRIES} tries; bring the cameras nearer (within the "
            "sensor's range), let them aim closer, or take more views"
        )
