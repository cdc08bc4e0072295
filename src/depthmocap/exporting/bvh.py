"""BVH animations: a skeleton of constant bone lengths, rooted at the pelvis; Y up, at rest facing +Z."""

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
from depthmocap.exporting.body_motion import BodyMotion, solve_body
from depthmocap.exporting.bone_rotations import CHILDREN, END_SITES, ROOT, euler_zxy_deg, joint_positions
from depthmocap.exporting.exported_take import ExportedTake
from depthmocap.exporting.file_settings import BvhUnit, FileSettings
from depthmocap.exporting.target_skeleton import PosedSkeleton, RestPose, SkeletonName, rest_turns, retarget
from depthmocap.exporting.timeline import LEAST_CONFIDENCE, Y_UP_FROM_Z_UP, evenly_spaced, timeline
from depthmocap.frames import Pose

_PER_METRE: dict[BvhUnit, float] = {"cm": 100.0, "m": 1.0}
_ROTATIONS = "Zrotation Xrotation Yrotation"
_CHANNELS = f"CHANNELS 3 {_ROTATIONS}"
_ROOT_CHANNELS = f"CHANNELS 6 Xposition Yposition Zposition {_ROTATIONS}"
#: Larger numbers cannot belong to a skeleton.
_LARGEST = 1e12
#: The longest bone of a person (m): of more, a file's unit is the centimetre.
_LONGEST_BONE_M = 2.0
#: The tips of toes from the ball of the foot (m).
_TOES = np.array([0.0, 0.0, 0.06])


def _depth_first(joint: str) -> list[str]:
    return [joint, *(name for child in CHILDREN[joint] for name in _depth_first(child))]


#: Joints in the order of the file.
_ORDER = [JOINT_INDEX[name] for name in _depth_first(ROOT)]


def _numbers(values: ndarray, decimals: int) -> str:
    return " ".join(f"{value:.{decimals}f}" for value in np.round(values, decimals) + 0.0)  # + 0.0: no "-0.0000"


class _Hierarchy:
    """The file's first part, and the bones in its order."""

    def __init__(self, skeleton: PosedSkeleton, rest: RestPose, per_metre: float) -> None:
        self._skeleton, self._turns, self._per_metre = skeleton, rest_turns(rest), per_metre
        self._decimals = 4 if per_metre > 1 else 6
        self.order: list[int] = []
        self.lines = ["HIERARCHY", *self._bone(0, "")]

    def _bone(self, number: int, indent: str) -> list[str]:
        self.order.append(number)
        bone, inner = self._skeleton.bones[number], indent + "\t"
        offset = np.zeros(3) if self.moves(number) else self._skeleton.offsets[number]
        lines = [
            f"{indent}{'ROOT' if bone.parent < 0 else 'JOINT'} {bone.name}",
            f"{indent}{{",
            f"{inner}OFFSET {self._length(offset)}",
            inner + (_ROOT_CHANNELS if self.moves(number) else _CHANNELS),
        ]
        children = self._skeleton.children(number)
        for child in children:
            lines += self._bone(child, inner)
        if not children:
            end = _TOES
            if bone.joint is not None:
                end = self._turns[JOINT_INDEX[bone.joint]] @ END_SITES[bone.joint]
            lines += [f"{inner}End Site", f"{inner}{{", f"{inner}\tOFFSET {self._length(end)}", f"{inner}}}"]
        return [*lines, f"{indent}}}"]

    def _length(self, vector: Float[ndarray, "3"]) -> str:
        return _numbers(vector * self._per_metre, self._decimals)

    def moves(self, number: int) -> bool:
        """Whether a bone has channels of its position: the first, and the hips."""
        return number in (0, self._skeleton.hips)

    def rows(self, angles_deg: Float[ndarray, "t b 3"]) -> list[str]:
        """The lines of the motion."""
        columns, formats = [], []
        for number in self.order:
            if self.moves(number):
                root = self._skeleton.root * self._per_metre
                columns.append(root if number == self._skeleton.hips else np.zeros_like(root))
                formats += [f"%.{self._decimals}f"] * 3
            columns.append(angles_deg[:, number])
            formats += ["%.4f"] * 3
        line = " ".join(formats)
        table = np.concatenate(columns, 1)
        table[np.abs(table) < 0.5 * 10.0**-self._decimals] = 0.0  # no "-0.0000"
        return [line % tuple(row) for row in table.tolist()]


def write_bvh(
    path: Path,
    poses: Sequence[Pose],
    up: str,
    least_confidence: float = LEAST_CONFIDENCE,
    *,
    fill_s: float = 0.0,
    skeleton: SkeletonName = "depthmocap",
    rest: RestPose = "t",
    unit: BvhUnit = "cm",
) -> Bool[ndarray, "n 18"]:
    """Write poses whose world has the up axis ``up`` ("z", "y" or "-y"); returns the mask of held joints, by frame.

    BVH has one frame time: the poses' typical interval. Each frame shows the nearest pose in time, from the first pose
    on. Where a joint, the whole person or the frame is missing, or a joint's confidence is below ``least_confidence``,
    the bones that it determines hold their last rotation; before their first observation that of the rest pose. Bone
    lengths are medians over the recording (:func:`rest_offsets`). The joints of the file therefore differ from the
    poses by as much as the estimated lengths vary.

    Args:
        fill_s: gaps of a joint up to so long (s) are filled instead (:func:`fill_gaps`).
        skeleton: whose names the bones have, and whose bones are added.
        rest: a T pose or an A pose.
        unit: of lengths; Blender takes a file's numbers for metres.

    Raises:
        InputError: when there is no pose, none shows a person, timestamps do not increase or pause for very long, or
            the file cannot be written.
    """
    motion = solve_body(evenly_spaced(timeline(poses, up, least_confidence)), fill_s)
    write_bvh_motion(path, motion, skeleton, rest, unit)
    return motion.held


def write_bvh_motion(path: Path, motion: BodyMotion, skeleton: SkeletonName, rest: RestPose, unit: BvhUnit) -> None:
    """Write a motion in evenly spaced frames, as :func:`write_bvh` does.

    Raises:
        InputError: when the file cannot be written.
    """
    posed = retarget(motion, skeleton, rest)
    hierarchy = _Hierarchy(posed, rest, _PER_METRE[unit])
    angles_deg = euler_zxy_deg(posed.local)
    lines = [
        *hierarchy.lines,
        "MOTION",
        f"Frames: {len(motion.times_s)}",
        f"Frame Time: {motion.frame_s:.9f}",
        *hierarchy.rows(angles_deg),
    ]
    write_file(path, "\n".join(lines) + "\n")


def write_take_bvh(path: Path, take: ExportedTake, settings: FileSettings) -> None:
    """Write a person of a take as :func:`write_bvh` does.

    Raises:
        InputError: when the file cannot be written, or no joint remains.
    """
    (person,) = take.people
    motion = solve_body(evenly_spaced(take.rows(person, settings.least_confidence)), settings.fill_s)
    write_bvh_motion(path, motion, settings.skeleton, settings.rest, settings.bvh_unit)


def _read_offsets(lines: list[str]) -> Float[ndarray, "18 3"]:
    """Offsets of the hierarchy; ValueError if it is not the hierarchy that ``write_bvh`` writes."""
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
    """Times (s) and joints (m, Z up) of a file that ``write_bvh`` wrote with the project's own names, in centimetres or
    metres; other skeletons are rejected.

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
    per_metre = _PER_METRE["cm" if np.linalg.norm(offsets, axis=-1).max() > _LONGEST_BONE_M else "m"]
    joints = joint_positions(local, rows[:, :3] / per_metre, offsets / per_metre)
    return np.arange(count) * frame_s, joints @ Y_UP_FROM_Z_UP
