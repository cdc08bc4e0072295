"""BVH animations: a skeleton of constant bone lengths, rooted at the pelvis; centimetres, Y up, rest pose facing +Z."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS, PARENTS
from depthmocap.core.output import write_file
from depthmocap.core.reading.input_files import read_text
from depthmocap.errors import InputError
from depthmocap.exporting.bone_rotations import (
    CHILDREN,
    END_SITES,
    ROOT,
    bone_rotations,
    euler_zxy_deg,
    joint_positions,
    rest_offsets,
)
from depthmocap.exporting.timeline import LEAST_CONFIDENCE, Y_UP_FROM_Z_UP, timeline, uniform_frames
from depthmocap.frames import Pose

_CM = 100.0
_ROTATIONS = "Zrotation Xrotation Yrotation"
_CHANNELS = f"CHANNELS 3 {_ROTATIONS}"
_ROOT_CHANNELS = f"CHANNELS 6 Xposition Yposition Zposition {_ROTATIONS}"
#: Larger numbers cannot belong to a skeleton.
_LARGEST = 1e12


def _depth_first(joint: str) -> list[str]:
    return [joint, *(name for child in CHILDREN[joint] for name in _depth_first(child))]


#: Joints in the order of the file.
_ORDER = [JOINT_INDEX[name] for name in _depth_first(ROOT)]


def _numbers(values: ndarray, decimals: int) -> str:
    return " ".join(f"{value:.{decimals}f}" for value in np.round(values, decimals) + 0.0)  # + 0.0: no "-0.0000"


def _hierarchy(joint: str, offsets_cm: Float[ndarray, "18 3"], indent: str = "") -> list[str]:
    inner = indent + "\t"
    lines = [
        f"{indent}{'ROOT' if joint == ROOT else 'JOINT'} {joint}",
        f"{indent}{{",
        f"{inner}OFFSET {_numbers(offsets_cm[JOINT_INDEX[joint]], 4)}",
        inner + (_ROOT_CHANNELS if joint == ROOT else _CHANNELS),
    ]
    for child in CHILDREN[joint]:
        lines += _hierarchy(child, offsets_cm, inner)
    if joint in END_SITES:
        end = _numbers(np.array(END_SITES[joint]) * _CM, 4)
        lines += [f"{inner}End Site", f"{inner}{{", f"{inner}\tOFFSET {end}", f"{inner}}}"]
    return [*lines, f"{indent}}}"]


def write_bvh(
    path: Path, poses: Sequence[Pose], up: str, least_confidence: float = LEAST_CONFIDENCE
) -> Bool[ndarray, "n 18"]:
    """Write poses whose world has the up axis ``up`` ("z", "y" or "-y"); returns the mask of held joints, by frame.

    BVH has one frame time: the poses' typical interval. Each frame shows the nearest pose in time, from the first pose
    on. Where a joint, the whole person or the frame is missing, or a joint's confidence is below ``least_confidence``,
    the bones that it determines hold their last rotation; before their first observation that of the rest pose. Bone
    lengths are medians over the recording (:func:`rest_offsets`). The joints of the file therefore differ from the
    poses by as much as the estimated lengths vary.

    Raises:
        InputError: when there is no pose, none shows a person, timestamps do not increase or pause for very long, or
            the file cannot be written.
    """
    line = timeline(poses, up, least_confidence)
    source, repeated = uniform_frames(line)
    offsets = rest_offsets(line.joints_y_up)
    local, root, held = bone_rotations(line.joints_y_up[source], offsets)
    angles_deg = euler_zxy_deg(local)[:, _ORDER].reshape(len(source), -1)
    rows = np.concatenate([root * _CM, angles_deg], 1)
    lines = [
        "HIERARCHY",
        *_hierarchy(ROOT, offsets * _CM),
        "MOTION",
        f"Frames: {len(rows)}",
        f"Frame Time: {line.frame_s:.9f}",
        *(_numbers(row, 4) for row in rows),
    ]
    write_file(path, "\n".join(lines) + "\n")
    return held | repeated[:, None]


def _read_offsets(lines: list[str]) -> Float[ndarray, "18 3"]:
    """Offsets (cm) of the hierarchy; ValueError if it is not the hierarchy that ``write_bvh`` writes."""
    offsets = np.zeros((len(JOINTS), 3))
    order: list[str] = []
    ancestors: list[str] = []
    joint = ""
    for line in lines:
        words = line.split()
        if words[0] in ("ROOT", "JOINT"):
            joint = words[1]
            if PARENTS.get(joint, "") != (ancestors[-1] if ancestors else None):
                raise ValueError(f"unexpected joint {joint}")
            order.append(joint)
        elif words[0] == "End":
            joint = ""
        elif words[0] == "{":
            ancestors.append(joint)
        elif words[0] == "}":
            ancestors.pop()
        elif words[0] == "OFFSET" and joint:
            offsets[JOINT_INDEX[joint]] = [float(word) for word in words[1:4]]
        elif words[0] == "CHANNELS" and " ".join(words) != (_ROOT_CHANNELS if joint == ROOT else _CHANNELS):
            raise ValueError(f"unexpected channels of {joint}")
    if [JOINT_INDEX[name] for name in order] != _ORDER:
        raise ValueError("other joints, or in another order")
    return offsets


def read_bvh(path: Path) -> tuple[Float[ndarray, " t"], Float[ndarray, "t 18 3"]]:
    """Times (s) and joints (m, Z up) of a file that ``write_bvh`` wrote; other skeletons are rejected.

    Raises:
        InputError: when the file is missing, or is not such a file.
    """
    lines = [line for line in read_text(path).splitlines() if line.strip()]
    try:
        motion = [line.strip() for line in lines].index("MOTION")
        offsets = _read_offsets(lines[1:motion])
        count = int(lines[motion + 1].removeprefix("Frames:"))
        frame_s = float(lines[motion + 2].removeprefix("Frame Time:"))
        rows = np.array([line.split() for line in lines[motion + 3 :]], dtype=np.float64)
        rows = rows.reshape(count, 3 + 3 * len(JOINTS))
        if not max(np.abs(rows).max(initial=0), np.abs(offsets).max(), abs(frame_s)) < _LARGEST:
            raise ValueError("it has a number that no length, angle or time can be")
    except (ValueError, IndexError) as error:
        raise InputError(f"{path} is not a BVH file written by depthmocap: {error}") from None
    local = np.empty((count, len(JOINTS), 3, 3))
    angles_deg = rows[:, 3:].reshape(-1, 3)
    local[:, _ORDER] = Rotation.from_euler("ZXY", angles_deg, degrees=True).as_matrix().reshape(count, -1, 3, 3)
    joints = joint_positions(local, rows[:, :3] / _CM, offsets / _CM)
    return np.arange(count) * frame_s, joints @ Y_UP_FROM_Z_UP
