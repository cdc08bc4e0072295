"""Motion capture files as postures: BVH (through bvhio; extra: train), retargeted by world rotations."""

from __future__ import annotations

import csv
import dataclasses
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.posture import POSTURE_BONES, POSTURE_INDEX, heading, local_rotations, turn_posture
from depthmocap.errors import InputError, missing_extra
from depthmocap.geometry.transforms import rotation_between, z_up_from

SPLITS = ("train", "valid", "test")

_LIMB_BONES = ("clavicle", "upper_arm", "forearm", "hand", "thigh", "shin", "foot")
_TRUNK_BONES = ("pelvis", "spine_low", "spine_mid", "spine_up", "neck", "head")


def _scheme(trunk: str, right: str, left: str, limbs: str) -> dict[str, str]:
    """BVH joint of each posture bone: names of the trunk, prefixes of the two sides, names of the limbs."""
    table: dict[str, str] = dict(zip(_TRUNK_BONES, trunk.split(), strict=True))
    for side, prefix in (("R", right), ("L", left)):
        for bone, joint in zip(_LIMB_BONES, limbs.split(), strict=True):
            table[f"{bone}.{side}"] = prefix + joint
    return table


#: By naming scheme; one fits when a file has all of its joints.
_SCHEMES: dict[str, dict[str, str]] = {
    "cmu": _scheme(
        "Hips LowerBack Spine Spine1 Neck1 Head", "Right", "Left", "Shoulder Arm ForeArm Hand UpLeg Leg Foot"
    ),
    "daz": _scheme("hip abdomen abdomen chest neck head", "r", "l", "Collar Shldr ForeArm Hand Thigh Shin Foot"),
    "motionbuilder": _scheme(
        "Hips lowerback Chest Chest2 Neck Head", "Right", "Left", "Collar Shoulder Elbow Wrist Hip Knee Ankle"
    ),
}

#: Bones whose direction at rest differs between skeletons (T-pose, arms down): from their own head to this bone's.
_AIMS: dict[str, tuple[str, str]] = {
    "upper_arm": ("upperarm01", "lowerarm01"),
    "forearm": ("lowerarm01", "wrist"),
    "hand": ("wrist", "finger3-1"),
    "thigh": ("upperleg01", "lowerleg01"),
    "shin": ("lowerleg01", "foot"),
    "foot": ("foot", "toe3-1"),
}
#: A bone that turns faster than this between two frames at 30 frames a second has flipped.
_FLIP_RAD_PER_S = np.deg2rad(55) * 30


@dataclasses.dataclass(frozen=True, eq=False)
class Clip:
    """Postures of one motion capture clip, heading kept. ``simple`` marks what is described as walk or run."""

    name: str
    postures: Float[ndarray, "n 20 3"]
    simple: bool
    split: str


def split_of(clip: str) -> str:
    """The split a clip belongs to, by its name alone: about 80 % train, 10 % valid, 10 % test."""
    bucket = zlib.crc32(clip.encode()) % 10
    return "test" if bucket == 0 else "valid" if bucket == 1 else "train"


def _flatten(joint: Any, parent: int, out: list[tuple[Any, int]]) -> None:
    out.append((joint, parent))
    index = len(out) - 1
    for child in joint.Children:
        _flatten(child, index, out)


def read_bvh(path: Path, anny_rest: dict[str, Float[ndarray, "3"]]) -> tuple[Float[ndarray, "n 20 3"], float]:
    """Postures of a BVH file and its frame time in seconds.

    The retargeting takes each bone's world rotation as it is and turns the rest direction of our bone into that of
    the file's, so that limbs point the same way whatever the two rest poses are.

    Args:
        path: the file; Y up, facing +Z at rest, as all the common conversions are.
        anny_rest: head of every bone of the body at rest (Z up), which gives our rest directions.

    Raises:
        InputError: a file that cannot be parsed, or whose joints fit no known naming scheme.
    """
    try:
        import bvhio
    except ImportError:
        raise missing_extra("bvhio", "train") from None
    try:
        _require_all_frames(path)
        document = bvhio.readAsBvh(str(path))
    except Exception as error:  # the parser raises bare and various errors on malformed text
        raise InputError(f"{path} is not a readable BVH file: {error}") from None
    joints: list[tuple[Any, int]] = []
    _flatten(document.Root, -1, joints)
    names = [joint.Name for joint, _ in joints]
    scheme = next((table for table in _SCHEMES.values() if set(table.values()) <= set(names)), None)
    if scheme is None:
        raise InputError(f"{path}: joints {names[:6]}… fit no known naming scheme ({', '.join(_SCHEMES)})")
    z_up = z_up_from("y")
    quaternions = np.array([[tuple(key.Rotation) for key in joint.Keyframes] for joint, _ in joints])  # w x y z
    if not np.isfinite(quaternions).all():
        raise InputError(f"{path} is not a readable BVH file: a rotation is not a finite number")
    world = _quaternion_matrices(quaternions)
    for i, (_, parent) in enumerate(joints):
        if parent >= 0:
            world[i] = world[parent] @ world[i]
    world = z_up @ world @ z_up.T
    result = np.empty((document.FrameCount, len(POSTURE_BONES), 3, 3))
    for bone, joint in scheme.items():
        index = names.index(joint)
        align = np.eye(3)
        kind, _, side = bone.partition(".")
        if kind in _AIMS:
            head, tail = (anny_rest[f"{name}.{side}"] for name in _AIMS[kind])
            direction = z_up @ _rest_direction(joints[index][0])
            if np.linalg.norm(direction) > 1e-6:  # some files end a foot without an offset
                align = rotation_between(tail - head, direction)
        result[:, POSTURE_INDEX[bone]] = world[index] @ align
    return local_rotations(result).astype(np.float32), float(document.FrameTime)


def _require_all_frames(path: Path) -> None:
    """Raise ValueError unless the motion section is whole: at the end of a cut file the parser would wait for ever."""
    lines = [line for raw in path.read_text().splitlines() if (line := raw.strip())]
    if "MOTION" not in lines:
        raise ValueError("it has no MOTION section")
    header = lines.index("MOTION") + 1
    words = " ".join(lines[header : header + 2]).split()  # Frames: n Frame Time: s
    if len(words) != 5 or int(words[1]) < 1 or not 0 < float(words[4]) < np.inf:
        raise ValueError("after MOTION must follow Frames: and Frame Time:, both with a number above 0")
    if len(lines) < header + 2 + int(words[1]):
        raise ValueError(f"it has {len(lines) - header - 2} of its {words[1]} frames")


def _rest_direction(joint: Any) -> Float[ndarray, "3"]:
    """Direction to the nearest descendant that is not at the joint itself (the middle finger for a hand)."""
    children = sorted(joint.Children, key=lambda child: "Mid" not in child.Name)
    for child in children:
        offset = np.array(tuple(child.Offset), dtype=float)
        if np.linalg.norm(offset) > 1e-6:
            return offset
    for child in children:
        if "umb" not in child.Name:
            return _rest_direction(child)
    return np.array(tuple(joint.EndSite), dtype=float)


def _quaternion_matrices(q: Float[ndarray, "j n 4"]) -> Float[ndarray, "j n 3 3"]:
    return Rotation.from_quat(q[..., [1, 2, 3, 0]].reshape(-1, 4)).as_matrix().reshape(*q.shape[:-1], 3, 3)


def _unflipped(postures: Float[ndarray, "n 20 3"], frame_time: float) -> Bool[ndarray, "n"]:
    """Frames more than a few frames away from a flip of any bone."""
    flat = Rotation.from_rotvec(postures.reshape(-1, 3))
    n, bones = postures.shape[:2]
    keep = np.ones(n, dtype=bool)
    if n < 2:
        return keep
    turn = (flat[:-bones].inv() * flat[bones:]).magnitude().reshape(n - 1, bones).max(1)
    for frame in np.flatnonzero(turn > _FLIP_RAD_PER_S * frame_time):
        keep[max(frame - 2, 0) : frame + 4] = False
    return keep


def read_clips(directory: Path, anny_rest: dict[str, Float[ndarray, "3"]]) -> Iterator[Clip]:
    """Every BVH file of a directory, about 30 postures a second, flips left out.

    ``manifest.csv`` (columns file, description), where there is one, tells which clips are walking or running.

    Raises:
        InputError: no directory, no BVH file in it, an unreadable one, or a manifest without these columns.
    """
    files = sorted(directory.glob("*.bvh"))
    if not files:
        raise InputError(f"{directory}: no .bvh files; give a folder of motion capture clips")
    descriptions: dict[str, str] = {}
    manifest = directory / "manifest.csv"
    if manifest.exists():
        with manifest.open(newline="") as handle:
            rows = csv.DictReader(handle)
            if not {"file", "description"} <= set(rows.fieldnames or ()):
                raise InputError(f"{manifest} must have the columns file and description, has {rows.fieldnames}")
            descriptions = {row["file"]: (row["description"] or "").lower() for row in rows}
    for path in files:
        postures, frame_time = read_bvh(path, anny_rest)
        step = max(1, round(1 / 30 / frame_time))
        postures = postures[::step][_unflipped(postures[::step], frame_time * step)]
        words = descriptions.get(path.name, "")
        simple = any(word in words for word in ("walk", "run", "jog"))
        yield Clip(path.stem, postures, simple, split_of(path.stem))


def without_heading(postures: Float[ndarray, "n 20 3"]) -> Float[ndarray, "n 20 3"]:
    """The postures turned about the vertical so that every pelvis faces −Y."""
    return turn_posture(postures, -heading(postures))
