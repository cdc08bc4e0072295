"""``pose.csv`` with the bones' rotations in added columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINTS
from depthmocap.core.output import write_file
from depthmocap.exporting.body_motion import BodyMotion, solve_body
from depthmocap.exporting.bone_rotations import quaternions
from depthmocap.exporting.exported_take import ExportedTake
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.pose_csv import pose_row
from depthmocap.exporting.timeline import y_up_from
from depthmocap.frames import Pose
from depthmocap.recordings.pose_table import HEADER

ROTATION_COLUMNS: tuple[str, ...] = tuple(f"{joint}_q{axis}" for joint in JOINTS for axis in "xyzw")


def rig_quaternions(motion: BodyMotion, up: str) -> Float[ndarray, "t 18 4"]:
    """Rotation of every bone in the rig's own world, x, y, z, w; NaN where it is not observed.

    It takes a vector of the rest pose (x the subject's left, y up, z forward) into the rig's world.
    """
    rotations = quaternions(y_up_from(up).T @ motion.world_rotations())
    return np.where(motion.rotation_held[..., None], np.nan, rotations)


def write_rotation_csv(path: Path, take: ExportedTake, settings: FileSettings) -> None:
    """Write the columns of pose.csv, then ``<Joint>_qx``, ``_qy``, ``_qz`` and ``_qw``.

    Joints below the least confidence are NaN with confidence 0, and filled ones have confidence 0.

    Raises:
        InputError: when the file cannot be written, or no joint remains.
    """
    (person,) = take.people
    table = person.table
    line = take.rows(person, settings.least_confidence)
    motion = solve_body(line, settings.fill_s)
    joints, confidence = table.joints.copy(), table.confidence.copy()
    gaps = np.isnan(line.joints_y_up).any(-1)
    joints[gaps], confidence[gaps] = np.nan, 0.0
    joints[motion.filled] = (motion.joints @ y_up_from(take.up))[motion.filled]
    rows = [",".join((*HEADER, *ROTATION_COLUMNS))]
    for stamp_ns, *values, rotations in zip(
        table.stamps_ns.tolist(), joints, confidence, rig_quaternions(motion, take.up).reshape(len(joints), -1),
        strict=True,
    ):  # fmt: skip
        cells = ",".join(f"{value:.6f}" for value in rotations.tolist())
        rows.append(f"{pose_row(Pose(stamp_ns, *values), take.origin_ns)},{cells}")
    write_file(path, "\n".join(rows) + "\n")
