"""Motion capture clips as postures: the files of a folder, without flips and impossible frames."""

from __future__ import annotations

import csv
import dataclasses
import io
import re
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.core.reading.input_files import read_text
from depthmocap.errors import InputError
from depthmocap.synth.body.bones import POSTURE_INDEX, heading, turn_posture
from depthmocap.synth.motion.clips.amc_clips import AMC_FPS, AsfSkeleton, read_amc_motion, read_asf
from depthmocap.synth.motion.clips.bvh_clips import read_bvh_motion
from depthmocap.synth.motion.clips.clip_motion import Motion
from depthmocap.synth.motion.clips.retarget import Retargeted, Up, retarget
from depthmocap.synth.motion.clips.skeletons import Joints, map_skeleton
from depthmocap.synth.motion.limits import beyond_limits, within_limits

SPLITS = ("train", "valid", "test")
#: Least angular speed of a flip. (A shin turns by 60 degrees in a thirtieth of a second in a kick, and about as fast in
#: the neighbouring frames.)
_FLIP_RAD_PER_S = np.deg2rad(55) * 30
#: Least ratio of a flip's angular speed to that of the neighbouring frames.
_FLIP_RATIO = 3.0
#: Angular speed that no person reaches: a flip whatever the neighbouring frames are.
_FASTEST_RAD_PER_S = np.deg2rad(95) * 30
#: Bones at the ends of limbs and trunk.
_END_BONES = np.array([POSTURE_INDEX[bone] for bone in ("head", "hand.R", "hand.L", "foot.R", "foot.L")])
#: Largest cosine between a lying pelvis's axis and the vertical.
_LYING_COSINE = 0.5
#: Share of lying frames above which the clip, or the world of its file, counts as lying.
_LYING_SHARE = 0.95
#: Descriptions of clips of easy postures, as in the paper.
_SIMPLE_PATTERN = re.compile(r"\b(walk|run|jog)(s|ing|ning|ging)?\b", re.IGNORECASE)
_SUFFIXES = (".bvh", ".amc")


@dataclasses.dataclass(frozen=True, eq=False)
class Clip:
    """Postures of one motion capture clip, with headings.

    Attributes:
        simple: the clip is described as walking or running.
        frames: number of frames, about 30 a second, with flips and impossible frames.
        flipped, impossible: number of these frames, which ``postures`` lacks.
        skeleton: description of the skeleton map.
        up: up axis of the file's world, if it differs from that of the rest pose.
        lies: the person neither stands nor sits in nearly all frames.
    """

    name: str
    postures: Float[ndarray, "n 20 3"]
    simple: bool
    split: str
    frames: int = 0
    flipped: int = 0
    impossible: int = 0
    skeleton: str = ""
    up: Up | None = None
    lies: bool = False


@dataclasses.dataclass(frozen=True)
class SkippedClip:
    """A file without usable postures, and the reason in one line."""

    name: str
    reason: str


@dataclasses.dataclass(frozen=True)
class ClipReading:
    """Settings for reading the files of a folder.

    Attributes:
        joints: the file's joint of each posture bone, for names that fit no scheme.
        skeletons: ASF file by subject (the part of an AMC file's name before the underscore), if it has another name.
        up: up axis of the files' worlds; by default it is estimated from each file (``retarget``).
    """

    joints: Joints = dataclasses.field(default_factory=dict)
    skeletons: dict[str, str] = dataclasses.field(default_factory=dict)
    up: Up | None = None


def split_of(clip: str) -> str:
    """The split of a clip, a function of its name: about 80 % train, 10 % valid, 10 % test."""
    bucket = zlib.crc32(clip.encode()) % 10
    return "test" if bucket == 0 else "valid" if bucket == 1 else "train"


def read_bvh(
    path: Path, anny_rest: dict[str, Float[ndarray, "3"]], joints: Joints | None = None
) -> tuple[Float[ndarray, "n 20 3"], float]:
    """Postures of a BVH file and its frame time in seconds.

    Args:
        path: the file.
        anny_rest: head of every bone of the body at rest (Z up), which gives our rest directions.
        joints: the file's joint of each posture bone, for names that fit no scheme.

    Raises:
        InputError: a file that cannot be parsed, whose joints fit no naming scheme, or that lacks the length of a limb.
    """
    motion = read_bvh_motion(path)
    return _postures(path, motion, anny_rest, ClipReading(joints or {}))[0].postures, motion.frame_time_s


def read_amc(
    path: Path,
    asf: Path,
    anny_rest: dict[str, Float[ndarray, "3"]],
    fps: float = AMC_FPS,
    joints: Joints | None = None,
) -> tuple[Float[ndarray, "n 20 3"], float]:
    """Postures of an AMC file on the skeleton of an ASF file, as :func:`read_bvh`."""
    motion = read_amc_motion(path, read_asf(asf), fps)
    return _postures(path, motion, anny_rest, ClipReading(joints or {}))[0].postures, motion.frame_time_s


def _postures(
    path: Path, motion: Motion, anny_rest: dict[str, Float[ndarray, "3"]], reading: ClipReading
) -> tuple[Retargeted, str]:
    try:
        skeleton = map_skeleton(motion, reading.joints)
        return retarget(motion, skeleton, anny_rest, reading.up), skeleton.describe(motion)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _reset_impossible_ends(postures: Float[ndarray, "n 20 3"]) -> Float[ndarray, "n 20 3"]:
    """The postures with hands, feet and heads beyond the limits at rest: one wrong marker does not spoil a frame."""
    is_beyond = beyond_limits(postures)
    is_kept = np.ones_like(is_beyond)
    is_kept[:, _END_BONES] = ~is_beyond[:, _END_BONES]
    return np.where(is_kept[..., None], postures, np.float32(0))


def _away_from_flips(postures: Float[ndarray, "n 20 3"], frame_time: float) -> Bool[ndarray, "n"]:
    """Frames more than a few frames away from a flip of any bone. Changes to and from the rest rotation of
    :func:`_reset_impossible_ends` do not count as flips."""
    n, bones = postures.shape[:2]
    is_steady = np.ones(n, dtype=bool)
    if n < 2:
        return is_steady
    rotations = Rotation.from_rotvec(postures.reshape(-1, 3))
    speed = (rotations[:-bones].inv() * rotations[bones:]).magnitude().reshape(n - 1, bones) / frame_time
    is_reset = np.asarray(~postures.any(2))
    speed[is_reset[1:] != is_reset[:-1]] = 0
    padded = np.pad(speed, ((1, 1), (0, 0)))
    neighbours = np.maximum(padded[:-2], padded[2:])
    flips = (speed > _FLIP_RAD_PER_S) & (speed > _FLIP_RATIO * neighbours) | (speed > _FASTEST_RAD_PER_S)
    for frame in np.flatnonzero(flips.any(1)):
        is_steady[max(frame - 2, 0) : frame + 4] = False
    return is_steady


@dataclasses.dataclass(frozen=True)
class ClipFolder:
    """The clips of a folder, read one by one.

    An optional ``manifest.csv`` (columns file, description and optionally fps) marks the clips of walking or running,
    and gives the frame rate of AMC files, which they do not store (120 by default).
    """

    directory: Path
    files: Sequence[Path]
    descriptions: dict[str, str]
    fps: dict[str, float]
    reading: ClipReading

    @classmethod
    def open(cls, directory: Path, reading: ClipReading | None = None) -> ClipFolder:
        """List the clips of a folder by name.

        Raises:
            InputError: no directory, no clip in it, or a manifest without these columns.
        """
        # A clip's BVH file is sorted before its AMC file: it needs no other file.
        if not directory.is_dir():
            raise InputError(f"{directory} is not a folder; give one of motion capture clips")
        files = [path for suffix in _SUFFIXES for path in directory.glob(f"*{suffix}")]
        files.sort(key=lambda path: (path.stem, _SUFFIXES.index(path.suffix)))
        if not files:
            raise InputError(f"{directory}: no .bvh or .amc files; give a folder of motion capture clips")
        descriptions: dict[str, str] = {}
        fps: dict[str, float] = {}
        manifest = directory / "manifest.csv"
        if manifest.exists():
            rows = csv.DictReader(io.StringIO(read_text(manifest)))
            try:
                if not {"file", "description"} <= set(rows.fieldnames or ()):
                    raise InputError(f"{manifest} must have the columns file and description, has {rows.fieldnames}")
                for row in rows:
                    descriptions[row["file"]] = row["description"] or ""
                    if row.get("fps"):
                        fps[row["file"]] = _rate(row["fps"], manifest)
            except csv.Error as error:
                raise InputError(f"{manifest} cannot be read as CSV: {error}") from None
        return cls(directory, files, descriptions, fps, reading or ClipReading())

    def __len__(self) -> int:
        return len(self.files)

    def read(self, anny_rest: dict[str, Float[ndarray, "3"]]) -> Iterator[Clip | SkippedClip]:
        """Every clip at about 30 postures a second, or the reason for skipping it; one clip at a time is in memory."""
        skeletons: dict[Path, AsfSkeleton] = {}
        stems: set[str] = set()
        for path in self.files:
            if path.stem in stems:
                yield SkippedClip(path.name, "a clip of this name was read from a .bvh file")
                continue
            try:
                motion = self._motion(path, skeletons)
                (postures, up), skeleton = _postures(path, motion, anny_rest, self.reading)
            except InputError as error:
                yield SkippedClip(path.name, str(error).removeprefix(f"{path} ").removeprefix(f"{path}: "))
                continue
            stems.add(path.stem)
            postures = _reset_impossible_ends(postures)
            is_steady = _away_from_flips(postures, motion.frame_time_s)
            is_possible = within_limits(postures)
            yield Clip(
                path.stem,
                postures[is_steady & is_possible],
                _SIMPLE_PATTERN.search(self.descriptions.get(path.name, "")) is not None,
                split_of(path.stem),
                len(postures),
                int((~is_steady).sum()),
                int((is_steady & ~is_possible).sum()),
                skeleton,
                up,
                bool((_upright(postures) < _LYING_COSINE).mean() > _LYING_SHARE),
            )

    def _motion(self, path: Path, skeletons: dict[Path, AsfSkeleton]) -> Motion:
        if path.suffix == ".bvh":
            return read_bvh_motion(path, every_frame=False)
        subject = path.stem.partition("_")[0]
        asf = self.directory / self.reading.skeletons.get(subject, f"{subject}.asf")
        if not asf.exists():
            raise InputError(f"{path} has no skeleton: {asf.name} is missing")
        if asf not in skeletons:
            skeletons[asf] = read_asf(asf)
        return read_amc_motion(path, skeletons[asf], self.fps.get(path.name, AMC_FPS), every_frame=False)


def _upright(postures: Float[ndarray, "n 20 3"]) -> Float[ndarray, "n"]:
    """Cosine between the axis of each pelvis and the vertical."""
    return Rotation.from_rotvec(postures[:, POSTURE_INDEX["pelvis"]]).as_matrix()[:, 2, 2]


def _rate(text: str, manifest: Path) -> float:
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not 0 < rate < np.inf:
        raise InputError(f"{manifest}: fps must be a number above 0, got {text!r}")
    return rate


def check_any_read(directory: Path, read: int, skipped: Sequence[SkippedClip]) -> None:
    """Raise InputError when no clip of a directory could be read."""
    if not read:
        first = skipped[0]
        raise InputError(f"{directory}: none of its {len(skipped)} clips is readable; {first.name}: {first.reason}")


def without_heading(postures: Float[ndarray, "n 20 3"]) -> Float[ndarray, "n 20 3"]:
    """The postures rotated about the vertical so that every pelvis faces −Y."""
    return turn_posture(postures, -heading(postures))
