"""Sources of postures: motion capture clips, a pool of their postures, or the packaged prior learnt from clips."""

from __future__ import annotations

import dataclasses
import functools
import importlib.resources
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.core.reading.array_files import ArrayType, error_reason, read_npz
from depthmocap.errors import InputError
from depthmocap.synth.body.bones import (
    POSTURE_BONES,
    POSTURE_INDEX,
    POSTURE_PARENTS,
    mirror_posture,
    turn_posture,
    world_rotations,
)
from depthmocap.synth.body.mesh import BodyModel, Phenotype
from depthmocap.synth.motion.extreme_postures import Family, extreme_posture
from depthmocap.synth.motion.limits import bone_axis
from depthmocap.synth.motion.mocap import Clip, ClipFolder, SkippedClip, check_any_read, without_heading
from depthmocap.synth.motion.pool import PosturePool
from depthmocap.synth.motion.seat import seated
from depthmocap.synth.motion.touch import hands_on_body

_LOG = logging.getLogger(__name__)

_PELVIS = POSTURE_INDEX["pelvis"]
#: Bones of each limb, which recombination takes from another posture.
_LIMBS = [
    np.array([POSTURE_INDEX[f"{bone}.{side}"] for bone in bones])
    for bones in (("upper_arm", "forearm", "hand"), ("thigh", "shin", "foot"))
    for side in "RL"
]
#: Largest number of skipped clips in a message.
_SKIPS_LISTED = 3
#: A trunk leans from this angle with the vertical on, radians.
_LEANING_RAD = 0.6
#: Largest number of draws of a posture whose trunk leans.
_LEANING_TRIES = 100
#: Bones above the pelvis, which recombination takes from another posture.
UPPER_BONES = np.array([i for i, name in enumerate(POSTURE_BONES) if name.partition(".")[0] not in
                   ("pelvis", "thigh", "shin", "foot")])  # fmt: skip


@runtime_checkable
class PostureSource(Protocol):
    """Draws random postures with uniform headings, each with its group: the index of its clip or component."""

    def sample(self, rng: np.random.Generator) -> tuple[Float[ndarray, "20 3"], int]: ...


@dataclasses.dataclass(frozen=True)
class Variation:
    """Random changes of sampled postures.

    Attributes:
        mirror: share of mirrored postures.
        recombine: share with the trunk, head and arms of another posture.
        noise_rad: standard deviation of the noise of every rotation.
        limb: probability of each arm and leg to come from another posture.
        tilt: share of bodies tilted as a whole, by any angle to any side: lying, falling, upside down.
        sit: share of bodies with the legs of a sitting person.
        touch: share of bodies with one or both hands on the body.
        as_recorded: share of postures that are only mirrored.
        beyond: share of extreme postures, which recordings lack (``motion.extreme_postures``).
        family: of extreme postures; any by default.
    """

    mirror: float = 0.5
    recombine: float = 0.0
    noise_rad: float = 0.0
    limb: float = 0.0
    tilt: float = 0.0
    sit: float = 0.0
    touch: float = 0.0
    as_recorded: float = 0.0
    beyond: float = 0.0
    family: Family | None = None

    def of(self, simple: bool) -> Variation:
        """The variation, if ``simple`` limited to changes that suit people who walk and run."""
        return dataclasses.replace(self, limb=0.0, tilt=0.0, sit=0.0, touch=0.0, beyond=0.0) if simple else self

    def draw(self, rng: np.random.Generator) -> Variation:
        """The variation of one posture: mirroring only, an extreme posture, or all other changes."""
        if not (self.as_recorded or self.beyond):
            return self
        kind = rng.random()
        if kind < self.as_recorded:
            return Variation(mirror=self.mirror)
        if kind < self.as_recorded + self.beyond:
            return Variation(mirror=self.mirror, beyond=1.0, family=self.family)
        return dataclasses.replace(self, as_recorded=0.0, beyond=0.0)


#: For training: recorded postures, which are the common ones, and more varied ones.
TRAINING_VARIATION = Variation(
    mirror=0.5, recombine=0.25, noise_rad=0.06, limb=0.2, tilt=0.12, sit=0.12, touch=0.3, as_recorded=0.48, beyond=0.25
)


def joint_positions(postures: Float[ndarray, "n 20 3"]) -> Float[ndarray, "n 20 3"]:
    """Ends of bones of typical lengths, to compare postures (metres).

    Differences are approximately those between the joints of an adult.
    """
    lengths = {"pelvis": 0.0, "spine_low": 0.12, "spine_mid": 0.12, "spine_up": 0.16, "neck": 0.1, "head": 0.2,
               "clavicle": 0.17, "upper_arm": 0.29, "forearm": 0.25, "hand": 0.15, "thigh": 0.42, "shin": 0.42,
               "foot": 0.18}  # fmt: skip
    world = world_rotations(postures)
    ends = np.zeros((*postures.shape[:-1], 3))
    for i, (name, parent) in enumerate(zip(POSTURE_BONES, POSTURE_PARENTS, strict=True)):
        start = ends[:, parent] if parent >= 0 else 0.0
        ends[:, i] = start + world[:, i] @ (bone_axis(name) * lengths[name.partition(".")[0]])
    return ends


def thin_frames(postures: Float[ndarray, "n 20 3"], spacing_m: float) -> Int[ndarray, "m"]:
    """Indices of frames with a joint farther than ``spacing_m`` from that of the previous selected frame."""
    if not len(postures):
        return np.zeros(0, dtype=np.int64)
    ends = joint_positions(postures)
    indices = [0]
    for i in range(1, len(ends)):
        if np.abs(ends[i] - ends[indices[-1]]).max() > spacing_m:
            indices.append(i)
    return np.array(indices)


class ClipPostures:
    """Postures of motion capture clips without headings, thinned to a spacing of ``spacing_m``.

    Raises:
        InputError: when no clip is left.
    """

    def __init__(
        self, clips: Sequence[Clip], split: str, simple: bool, variation: Variation, spacing_m: float = 0.05
    ) -> None:
        selected = [
            clip for clip in clips if clip.split == split and (clip.simple or not simple) and len(clip.postures)
        ]
        if not selected:
            kind = "walking or running " if simple else ""
            raise InputError(f"no {kind}clips fall in the {split} split: give more clips or leave --postures out")
        self.names = [clip.name for clip in selected]
        parts = [without_heading(clip.postures)[thin_frames(clip.postures, spacing_m)] for clip in selected]
        self.postures = np.concatenate(parts).astype(np.float32)
        self.groups = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        self._variation = variation.of(simple)

    @classmethod
    def of_pool(cls, pool: PosturePool, split: str, simple: bool, variation: Variation) -> ClipPostures:
        """The postures of a split of a pool, which are already distinct.

        Raises:
            InputError: when there are none.
        """
        selected = pool.select(split, simple)
        if not len(selected):
            kind = "walking or running " if simple else ""
            raise InputError(f"the pool has no {kind}postures of the {split} split: build it from more clips")
        clips, groups = np.unique(pool.clips[selected], return_inverse=True)
        source = cls.__new__(cls)
        source.names = [pool.clip_names[clip] for clip in clips]
        source.postures, source.groups = pool.postures[selected], groups
        source._variation = variation.of(simple)
        return source

    def __len__(self) -> int:
        return len(self.postures)

    def sample(self, rng: np.random.Generator) -> tuple[Float[ndarray, "20 3"], int]:
        """A posture with a random heading, and the index of its clip."""
        index = int(rng.integers(len(self.postures)))
        posture = self.postures[index].astype(np.float64)
        variation = self._variation.draw(rng)
        if rng.random() < variation.recombine:
            posture[UPPER_BONES] = self.postures[rng.integers(len(self.postures))][UPPER_BONES]
        if variation.limb > 0:
            for bones in _LIMBS:
                if rng.random() < variation.limb:
                    posture[bones] = self.postures[rng.integers(len(self.postures))][bones]
        return _vary(posture, variation, rng), int(self.groups[index])


def _vary(posture: Float[ndarray, "20 3"], variation: Variation, rng: np.random.Generator) -> Float[ndarray, "20 3"]:
    if rng.random() < variation.mirror:
        posture = mirror_posture(posture)
    posture = posture + rng.normal(0, variation.noise_rad, posture.shape)
    # Each change has its own generator, so that the rest of a seed's people does not depend on it.
    go_beyond = functools.partial(extreme_posture, family=variation.family)
    changes = ((variation.sit, seated), (variation.touch, hands_on_body), (variation.beyond, go_beyond))
    for share, change in changes:
        (change_rng,) = rng.spawn(1)
        if change_rng.random() < share:
            posture = change(posture, change_rng)
    if variation.tilt > 0 and rng.random() < variation.tilt:
        side, angle = rng.uniform(-np.pi, np.pi), rng.uniform(0, np.pi)
        tilt = Rotation.from_rotvec([angle * np.cos(side), angle * np.sin(side), 0])
        posture[_PELVIS] = (tilt * Rotation.from_rotvec(posture[_PELVIS])).as_rotvec()
    return turn_posture(posture, rng.uniform(-np.pi, np.pi))


@dataclasses.dataclass(frozen=True, eq=False)
class LeaningPostures:
    """Postures of a source, of which a share have a trunk that does not point up.

    Attributes:
        share: of postures that are drawn again until their trunk leans; after a number of draws the last one is taken.
    """

    source: PostureSource
    share: float

    def sample(self, rng: np.random.Generator) -> tuple[Float[ndarray, "20 3"], int]:
        """A posture with a random heading, and its group in the source."""
        leaning = rng.random() < self.share
        posture, group = self.source.sample(rng)
        for _ in range(_LEANING_TRIES if leaning else 0):
            if trunk_angle(posture) > _LEANING_RAD:
                break
            posture, group = self.source.sample(rng)
        return posture, group


def trunk_angle(posture: Float[ndarray, "20 3"]) -> float:
    """Angle between the vertical and the line from the middle of the pelvis to the neck, radians."""
    neck = joint_positions(posture[None])[0, POSTURE_INDEX["spine_up"]]
    return float(np.arccos(neck[2] / np.linalg.norm(neck)))


_PRIOR = {
    "weights": ArrayType("k", "f"), "simple_weights": ArrayType("k", "f"), "means": ArrayType("k 60", "f"),
    "factors": ArrayType("k 60 r", "f"),
}  # fmt: skip


@dataclasses.dataclass(frozen=True, eq=False)
class PosturePrior:
    """A Gaussian mixture over local joint rotations, fitted on training clips, with a second set of weights for
    walking and running. Samples stay within two deviations of a component."""

    weights: Float[ndarray, "k"]
    simple_weights: Float[ndarray, "k"]
    means: Float[ndarray, "k 60"]
    factors: Float[ndarray, "k 60 r"]
    simple: bool = False
    variation: Variation = Variation()

    @classmethod
    def load(cls, path: Path | None = None, simple: bool = False, variation: Variation = Variation()) -> PosturePrior:
        """The packaged prior, or that of a file.

        Raises:
            InputError: when the file is missing or not a prior.
        """
        source = path or Path(str(importlib.resources.files("depthmocap.synth.motion") / "posture_prior.npz"))
        try:
            arrays = {name: array.astype(np.float64) for name, array in read_npz(source, _PRIOR).items()}
            if not all(np.isfinite(array).all() for array in arrays.values()):
                raise InputError("a number in it is not finite")
            if any((arrays[name] < 0).any() or arrays[name].sum() <= 0 for name in ("weights", "simple_weights")):
                raise InputError("its weights must be at least 0, and one above")
        except InputError as error:
            raise InputError(f"{source} is not a posture prior: {error_reason(error, source)}") from None
        return cls(**arrays, simple=simple, variation=variation.of(simple))

    def sample(self, rng: np.random.Generator) -> tuple[Float[ndarray, "20 3"], int]:
        """A posture with a random heading, and the index of its component."""
        weights = self.simple_weights if self.simple else self.weights
        component = int(rng.choice(len(weights), p=weights / weights.sum()))
        latent = np.clip(rng.normal(size=self.factors.shape[2]), -2.5, 2.5) * 0.8
        posture = (self.means[component] + self.factors[component] @ latent).reshape(-1, 3)
        return _vary(posture, self.variation.draw(rng), rng), component


def anny_rest() -> dict[str, Float[ndarray, "3"]]:
    """Head of every bone of the default body in the rest pose (metres), for retargeting."""
    model = BodyModel.load()
    return dict(zip(model.bone_names, model.shape(Phenotype()).rest_heads, strict=True))


def load_clips(directory: Path) -> list[Clip]:
    """All readable clips of a directory; skipped clips are logged.

    Raises:
        InputError: no directory, no clip in it, or none that is readable.
    """
    clips: list[Clip] = []
    skipped: list[SkippedClip] = []
    for clip in ClipFolder.open(directory).read(anny_rest()):
        if isinstance(clip, Clip):
            clips.append(clip)
        else:
            skipped.append(clip)
    check_any_read(directory, len(clips), skipped)
    if skipped:
        _LOG.warning(
            "%s: skipped %d of %d clips: %s%s",
            directory,
            len(skipped),
            len(skipped) + len(clips),
            "; ".join(f"{clip.name}: {clip.reason}" for clip in skipped[:_SKIPS_LISTED]),
            "; …; depthmocap postures build tells all" if len(skipped) > _SKIPS_LISTED else "",
        )
    return clips


def posture_source(
    postures: Path | None, split: str, simple: bool = False, variation: Variation = Variation()
) -> ClipPostures | PosturePrior:
    """Postures of a pool file or of a folder of clips; without either, of the packaged prior.

    Raises:
        InputError: a folder without readable clips, a file that is no pool, or no posture of the split.
    """
    if postures is None:
        return PosturePrior.load(simple=simple, variation=variation)
    if not postures.exists():
        raise InputError(f"{postures} does not exist: --postures is a folder of motion capture clips or a pool of them")
    if postures.is_file():
        return ClipPostures.of_pool(PosturePool.load(postures), split, simple, variation)
    return ClipPostures(load_clips(postures), split, simple, variation)
