"""Joint positions of a BVH file, with the ends of limbs, in the file's own axes and unit of length.

They are the ground truth of data sets with motion capture as BVH. (``synth.motion.clips`` reads rotations of BVH files,
for retargeting, without the ends of limbs.)
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Float, Integer
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.core.reading.input_files import read_text
from depthmocap.errors import InputError

_POSITIONS = ("Xposition", "Yposition", "Zposition")
#: Larger numbers are not those of a skeleton.
_LARGEST = 1e12


@dataclasses.dataclass(frozen=True, eq=False)
class BvhSkeleton:
    """Joints and ends ("End Site") depth first, as in the file; an end is called after its joint, with "End" added.

    Attributes:
        parents: index of every joint's parent, −1 for the root.
        channels: of every joint, in the order of the file's columns; of an end none.
        is_end: whether it is the end of a limb.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Float[ndarray, "j 3"]
    channels: tuple[tuple[str, ...], ...]
    is_end: tuple[bool, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class BvhJoints:
    """A read file: ``values`` are the channels of every frame."""

    skeleton: BvhSkeleton
    values: Float[ndarray, "n c"]
    frame_time_s: float

    def positions(self, frames: Integer[ndarray, "k"] | None = None) -> Float[ndarray, "_ j 3"]:
        """Positions of all joints and ends in some frames (by default all). The root is at its offset plus its
        position."""
        values = self.values if frames is None else self.values[frames]
        skeleton, column = self.skeleton, 0
        places = np.zeros((len(values), len(skeleton.names), 3))
        turns: list[ndarray] = []
        for joint, (parent, names) in enumerate(zip(skeleton.parents, skeleton.channels, strict=True)):
            columns = {name: values[:, column + i] for i, name in enumerate(names)}
            column += len(names)
            if parent < 0:
                moved = np.stack([columns.get(name, np.zeros(len(values))) for name in _POSITIONS], -1)
                places[:, joint] = skeleton.offsets[joint] + moved
                turn = np.broadcast_to(np.eye(3), (len(values), 3, 3))
            else:
                places[:, joint] = places[:, parent] + turns[parent] @ skeleton.offsets[joint]
                turn = turns[parent]
            turning = [name for name in names if name.endswith("rotation")]
            if turning:
                order = "".join(name[0] for name in turning)
                angles = np.stack([columns[name] for name in turning], -1)
                turn = turn @ Rotation.from_euler(order, angles, degrees=True).as_matrix()
            turns.append(turn)
        return places


def read_bvh_joints(path: Path) -> BvhJoints:
    """Read a BVH file.

    Raises:
        InputError: when it is missing, malformed or cut off, or has numbers that are not finite.
    """
    lines = [line.strip() for line in read_text(path).splitlines()]
    try:
        if "MOTION" not in lines:
            raise ValueError("it has no MOTION section")
        motion = lines.index("MOTION")
        skeleton = _hierarchy(" ".join(lines[:motion]).split())
        values, frame_time_s = _motion([line for line in lines[motion + 1 :] if line])
        needed = sum(map(len, skeleton.channels))
        if values.shape[1] != needed:
            raise ValueError(f"frames have {values.shape[1]} numbers, its joints {needed} channels")
        if not max(np.abs(skeleton.offsets).max(initial=0), np.abs(values).max(initial=0)) < _LARGEST:
            raise ValueError("it has a number that no length or angle can be")
    except FileNotFoundError:
        raise InputError(f"{path} not found") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a BVH file: it is not text") from None
    except (ValueError, IndexError) as error:
        reason = "its hierarchy is cut off" if isinstance(error, IndexError) else str(error)
        raise InputError(f"{path} is not a whole BVH file: {reason}") from None
    return BvhJoints(skeleton, values, frame_time_s)


def _hierarchy(words: list[str]) -> BvhSkeleton:
    """The joints of a HIERARCHY section given as words; raises ValueError or IndexError where it is malformed."""
    names: list[str] = []
    parents: list[int] = []
    offsets: list[list[float]] = []
    channels: list[tuple[str, ...]] = []
    is_end: list[bool] = []
    above, at = [-1], 0
    while at < len(words):
        word = words[at]
        if word in ("ROOT", "JOINT", "End"):
            brace = words.index("{", at)
            end = word == "End"
            # A name may hold spaces.
            names.append(f"{names[above[-1]]}End" if end else " ".join(words[at + 1 : brace]))
            parents.append(above[-1])
            is_end.append(end)
            channels.append(())
            above.append(len(names) - 1)
            at = brace + 1
        elif word == "OFFSET":
            if len(offsets) != len(names) - 1:
                raise ValueError("every joint needs one OFFSET")
            offsets.append([float(number) for number in words[at + 1 : at + 4]])
            at += 4
        elif word == "CHANNELS":
            count = int(words[at + 1])
            names_read = tuple(words[at + 2 : at + 2 + count])
            allowed = {f"{axis}rotation" for axis in "XYZ"} | (set(_POSITIONS) if parents[-1] < 0 else set())
            if unknown := set(names_read) - allowed:
                raise ValueError(f"channel {min(unknown)!r} of {names[-1]} is none that can be read")
            if len(set(names_read)) < len(names_read):
                raise ValueError(f"{names[-1]} has a channel twice")
            channels[-1] = names_read
            at += 2 + count
        else:
            if word == "}":
                above.pop()
            elif word != "HIERARCHY":
                raise ValueError(f"{word!r} is not expected in its hierarchy")
            at += 1
    if len(above) != 1 or len(offsets) != len(names) or not names or parents.count(-1) > 1:
        raise ValueError("its hierarchy must be one tree of joints with an OFFSET each")
    return BvhSkeleton(tuple(names), tuple(parents), np.array(offsets), tuple(channels), tuple(is_end))


def _motion(lines: list[str]) -> tuple[Float[ndarray, "n c"], float]:
    """Channels of every frame and the frame time (s); raises ValueError unless all frames are there."""
    words = " ".join(lines[:2]).split()  # Frames: n Frame Time: s
    if len(words) != 5 or words[0] != "Frames:" or int(words[1]) < 1 or not 0 < float(words[4]) < np.inf:
        raise ValueError("after MOTION must follow Frames: and Frame Time:, both with a number above 0")
    count = int(words[1])
    if len(lines) < 2 + count:
        raise ValueError(f"it has {len(lines) - 2} of its {count} frames")
    values = np.loadtxt(lines[2 : 2 + count], dtype=np.float64, ndmin=2)
    if not np.isfinite(values).all():
        raise ValueError("it has numbers that are not finite")
    return values, float(words[4])
