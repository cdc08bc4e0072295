"""ASF/AMC files (Acclaim, the format of the CMU database): a skeleton in one file, its motions in others.

A bone's rotation is ``C R(x, y, z) Cᵀ`` away from the rest pose, ``C`` the bone's ``axis`` and both in fixed axes; its
direction at rest is in the world's axes.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.core.reading.input_files import read_text
from depthmocap.errors import InputError
from depthmocap.synth.motion.clips.clip_motion import Motion, frame_step, reason

#: Channels of a bone.
_KNOWN_CHANNELS = {"L", *(f"{kind}{axis}" for kind in "TR" for axis in "XYZ")}
#: Frame rate of the database; AMC files do not store it.
AMC_FPS = 120.0


@dataclasses.dataclass(frozen=True, eq=False)
class AsfSkeleton:
    """The skeleton of an ASF file: bones (the first is the root), parents, rest axes and channels."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Float[ndarray, "j 3"]
    ends: Float[ndarray, "j 3"]
    axes: Float[ndarray, "j 3 3"]
    #: Channels of every bone as an AMC file lists them, such as TX … RZ of the root.
    channels: tuple[tuple[str, ...], ...]


def read_asf(path: Path) -> AsfSkeleton:
    """The skeleton of an ASF file.

    Raises:
        InputError: when it cannot be parsed.
    """
    text = read_text(path)
    try:
        return _parse_asf(text)
    except (ValueError, KeyError, IndexError) as error:
        raise InputError(f"{path} is not a readable ASF file: {reason(error)}") from None


def _parse_asf(text: str) -> AsfSkeleton:
    sections: dict[str, list[list[str]]] = {}
    section: list[list[str]] = []
    for raw in text.splitlines():
        words = raw.split("#")[0].split()
        if words and words[0].startswith(":"):
            section = sections.setdefault(words[0][1:].lower(), [])
            section.append(words[1:])
        elif words:
            section.append(words)
    for name in ("root", "bonedata", "hierarchy"):
        if name not in sections:
            raise ValueError(f"it has no :{name} section")
    root = {words[0]: words[1:] for words in sections["root"] if words}
    root_bone = {
        "name": ["root"],
        "direction": ["0"] * 3,
        "length": ["0"],
        "axis": [*root.get("orientation", ["0"] * 3), *root["axis"]],
        "dof": root["order"],
    }
    bones = {bone["name"][0]: bone for bone in (root_bone, *_blocks(sections["bonedata"]))}
    parents: dict[str, str] = {}
    for words in sections["hierarchy"]:
        if words and words[0] not in ("begin", "end"):
            parents.update(dict.fromkeys(words[1:], words[0]))
    if "root" in parents:
        raise ValueError("the root hangs from another bone")
    order = ["root"]
    for name in order:  # grows during the iteration
        order += [child for child, parent in parents.items() if parent == name]
    if missing := (set(order) - set(bones)) | (set(bones) - set(order)):
        raise ValueError(f"bone {min(missing)} is not in both :bonedata and :hierarchy")
    with np.errstate(over="ignore", invalid="ignore"):  # the retargeting checks the lengths
        vectors = {
            name: np.array(bone["direction"], dtype=float) * float(bone["length"][0]) for name, bone in bones.items()
        }
    channels = [tuple(word.upper() for word in bones[name].get("dof", [])) for name in order]
    if unknown := {channel for names in channels for channel in names} - _KNOWN_CHANNELS:
        raise ValueError(f"channel {min(unknown)} is not known")
    if any(len(set(names)) < len(names) for names in channels):
        raise ValueError("a bone has a channel twice")
    units = {words[0]: words[1] for words in sections.get("units", []) if len(words) > 1}
    degrees = units.get("angle", "deg") != "rad"
    return AsfSkeleton(
        tuple(order),
        tuple(order.index(parents[name]) if name in parents else -1 for name in order),
        np.array([vectors[parents[name]] if name in parents else np.zeros(3) for name in order]),
        np.array([np.zeros(3) if name in parents.values() else vectors[name] for name in order]),
        np.array([_axis(bones[name]["axis"], degrees) for name in order]),
        tuple(channels),
    )


def _blocks(lines: list[list[str]]) -> list[dict[str, list[str]]]:
    """The begin … end blocks, each as a table from the first words of its lines to the other words."""
    blocks: list[dict[str, list[str]]] = []
    for words in lines:
        if words == ["begin"]:
            blocks.append({})
        elif words and words != ["end"] and blocks:
            blocks[-1][words[0]] = words[1:]
    return blocks


def _axis(words: list[str], degrees: bool) -> Float[ndarray, "3 3"]:
    """Rotation of ``axis x y z ORDER``: about the world's axes in the order's sequence."""
    angles, order = [float(word) for word in words[:3]], words[3].lower()
    by_axis = ["xyz".index(letter) for letter in order]
    return Rotation.from_euler(order, [angles[i] for i in by_axis], degrees=degrees).as_matrix()


def read_amc_motion(path: Path, asf: AsfSkeleton, fps: float = AMC_FPS, every_frame: bool = True) -> Motion:
    """The motion of an AMC file on its skeleton; without ``every_frame`` about 30 frames a second of it.

    Raises:
        InputError: a file that cannot be parsed or is cut off, whose bones are not the skeleton's, or with numbers that
            are not finite.
    """
    text = read_text(path)
    step = 1 if every_frame else frame_step(1 / fps)
    try:
        values, degrees = _parse_amc(text, asf, step)
    except ValueError as error:
        raise InputError(f"{path} is not a readable AMC file: {reason(error)}") from None
    rotations = np.broadcast_to(np.eye(3), (len(values), len(asf.names), 3, 3)).copy()
    root_path = np.zeros((len(values), 3))
    for column, name in enumerate(asf.channels[0]):
        if name.startswith("T"):
            root_path[:, "XYZ".index(name[1])] = values[:, column]
    column = 0
    for joint, channels in enumerate(asf.channels):
        turning = [i for i, name in enumerate(channels) if name.startswith("R")]
        if turning:
            order = "".join(channels[i][1] for i in turning).lower()
            angles = values[:, [column + i for i in turning]]
            turns = Rotation.from_euler(order, angles, degrees=degrees).as_matrix()
            rotations[:, joint] = asf.axes[joint] @ turns @ asf.axes[joint].T
        column += len(channels)
    return Motion(asf.names, asf.parents, asf.offsets, asf.ends, rotations, step / fps, root_path)


def _parse_amc(text: str, asf: AsfSkeleton, step: int) -> tuple[Float[ndarray, "n c"], bool]:
    """Channels of every ``step``-th frame in the skeleton's order, and whether angles are degrees."""
    lines = [line for raw in text.splitlines() if (line := raw.split("#")[0].strip())]
    header = [line.upper() for line in lines if line.startswith(":")]
    body = [line for line in lines if not line.startswith(":")]
    starts = [i for i, line in enumerate(body) if line.isdigit()]
    if not starts or starts[0] != 0:
        raise ValueError("it has no frames")
    size = (starts[1] if len(starts) > 1 else len(body)) - starts[0]
    if len(body) != size * len(starts):
        raise ValueError(f"its frames are not all of {size - 1} bones: it is damaged or cut off")
    names = [line.split()[0] for line in body[1:size]]
    moving = {name: channels for name, channels in zip(asf.names, asf.channels, strict=True) if channels}
    if set(names) != set(moving):
        raise ValueError(f"bone {min(set(names) ^ set(moving))} is not in both the motion and the skeleton")
    starts = starts[::step]
    words = " ".join(" ".join(body[start : start + size]) for start in starts).split()
    per_frame = 1 + sum(1 + len(moving[name]) for name in names)
    if len(words) != per_frame * len(starts):
        raise ValueError("its numbers are not as many as the skeleton's degrees of freedom: it is damaged or cut off")
    table = np.array(words).reshape(len(starts), per_frame)
    column, columns = 1, {}
    for name in names:
        if (table[:, column] != name).any():
            raise ValueError(f"bone {name} is not in the same place in every frame")
        columns[name] = range(column + 1, column + 1 + len(moving[name]))
        column += 1 + len(moving[name])
    values = table[:, [i for name in moving for i in columns[name]]].astype(np.float64)
    if not np.isfinite(values).all():
        first = int(np.flatnonzero(~np.isfinite(values).all(1))[0])
        raise ValueError(f"frame {first * step} has a number that is not finite")
    return values, ":RADIANS" not in header
