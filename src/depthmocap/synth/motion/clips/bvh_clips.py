"""BVH files: bvhio parses the hierarchy (extra: train), NumPy the numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.core.reading.input_files import read_text
from depthmocap.errors import InputError, missing_extra
from depthmocap.synth.motion.clips.clip_motion import Motion, frame_step, reason

#: Channels of a joint.
_CHANNELS = {f"{axis}{kind}" for axis in "XYZ" for kind in ("position", "rotation")}


def read_bvh_motion(path: Path, every_frame: bool = True) -> Motion:
    """The motion of a BVH file; without ``every_frame`` about 30 frames a second of it.

    Raises:
        InputError: a file that cannot be parsed, or with numbers that are not finite.
    """
    try:
        import bvhio
    except ImportError:
        raise missing_extra("bvhio", "train") from None
    lines = [line for raw in read_text(path).splitlines() if (line := raw.strip())]
    try:
        rows, frame_time_s = _motion_rows(lines)  # before the parser, which does not return for truncated files
        root = bvhio.readAsBvh(str(path), loadKeyFrames=False).Root
        joints: list[tuple[Any, int]] = []
        _flatten(root, -1, joints)
        step = 1 if every_frame else frame_step(frame_time_s)
        channels, rows = [joint.Channels for joint, _ in joints], rows[::step]
        rotations = _joint_rotations(channels, rows)
        # The parser cuts a name at its first space.
        names = [" ".join(line.split()[1:]) for line in lines if line.split()[0] in ("ROOT", "JOINT")]
    except Exception as error:  # the parser raises bare and various errors on malformed text
        raise InputError(f"{path} is not a readable BVH file: {reason(error)}") from None
    return Motion(
        tuple(names),
        tuple(parent for _, parent in joints),
        np.array([tuple(joint.Offset) for joint, _ in joints], dtype=float),
        np.array([(0.0,) * 3 if joint.Children else tuple(joint.EndSite) for joint, _ in joints], dtype=float),
        rotations,
        frame_time_s * step,
        _root_path(channels[0], rows),
    )


def _flatten(joint: Any, parent: int, out: list[tuple[Any, int]]) -> None:
    out.append((joint, parent))
    index = len(out) - 1
    for child in joint.Children:
        _flatten(child, index, out)


def _motion_rows(lines: list[str]) -> tuple[Float[ndarray, "n c"], float]:
    """Channels of every frame, and the frame time in seconds; raises ValueError unless all frames are there."""
    if "MOTION" not in lines:
        raise ValueError("it has no MOTION section")
    header = lines.index("MOTION") + 1
    words = " ".join(lines[header : header + 2]).split()  # Frames: n Frame Time: s
    if len(words) != 5 or int(words[1]) < 1 or not 0 < float(words[4]) < np.inf:
        raise ValueError("after MOTION must follow Frames: and Frame Time:, both with a number above 0")
    count, first = int(words[1]), header + 2
    if len(lines) < first + count:
        raise ValueError(f"it has {len(lines) - first} of its {count} frames")
    rows = np.loadtxt(lines[first : first + count], dtype=np.float64, ndmin=2)
    if not np.isfinite(rows).all():
        raise ValueError(f"frame {int(np.flatnonzero(~np.isfinite(rows).all(1))[0])} has a number that is not finite")
    return rows, float(words[4])


def _root_path(channels: list[str], rows: Float[ndarray, "n c"]) -> Float[ndarray, "n 3"]:
    """The root's position channels, zeros where it has none."""
    path = np.zeros((len(rows), 3))
    for column, name in enumerate(channels):
        if name.endswith("position"):
            path[:, "XYZ".index(name[0])] = rows[:, column]
    return path


def _joint_rotations(channels: list[list[str]], rows: Float[ndarray, "n c"]) -> Float[ndarray, "n j 3 3"]:
    """Rotation of every joint relative to its parent: the channels' axes in the order they are listed."""
    unknown = {name for names in channels for name in names} - _CHANNELS
    if unknown:
        raise ValueError(f"channel {min(unknown)} is not known")
    needed = sum(map(len, channels))
    if rows.shape[1] != needed:
        raise ValueError(f"frames have {rows.shape[1]} numbers, the joints {needed} channels")
    rotations = np.broadcast_to(np.eye(3), (len(rows), len(channels), 3, 3)).copy()
    column = 0
    for joint, names in enumerate(channels):
        turning = [i for i, name in enumerate(names) if name.endswith("rotation")]
        if turning:
            order = "".join(names[i][0] for i in turning)
            angles = rows[:, [column + i for i in turning]]
            rotations[:, joint] = Rotation.from_euler(order, angles, degrees=True).as_matrix()
        column += len(names)
    return rotations
