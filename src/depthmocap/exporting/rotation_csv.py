"""``pose.csv`` with the bones' rotations and the joints' expected errors in added columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.landmarks import LANDMARK_NAMES
from depthmocap.body.skeleton import JOINTS
from depthmocap.core.output import write_file
from depthmocap.exporting.body_motion import BodyMotion, solve_body
from depthmocap.exporting.bone_rotations import quaternions
from depthmocap.exporting.exported_take import ExportedTake
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.pose_csv import pose_row
from depthmocap.exporting.timeline import y_up_from
from depthmocap.exporting.virtual_markers import landmark_confidence, landmark_errors_m, landmark_positions
from depthmocap.frames import Pose, expected_error_m
from depthmocap.recordings.pose_table import HEADER

ROTATION_COLUMNS: tuple[str, ...] = tuple(f"{joint}_q{axis}" for joint in JOINTS for axis in "xyzw")
ERROR_COLUMNS: tuple[str, ...] = tuple(f"{joint}_expected_error" for joint in JOINTS)
LANDMARK_COLUMNS: tuple[str, ...] = tuple(
    f"{name}_{field}" for name in LANDMARK_NAMES for field in ("x", "y", "z", "confidence", "expected_error")
)


def rig_quaternions(motion: BodyMotion, up: str) -> Float[ndarray, "t 18 4"]:
    """Rotation of every bone in the rig's own world, x, y, z, w; NaN where it is not observed.

    It takes a vector of the rest pose (x the subject's left, y up, z forward) into the rig's world.
    """
    rotations = quaternions(y_up_from(up).T @ motion.world_rotations())
    return np.where(motion.rotation_held[..., None], np.nan, rotations)


def write_rotation_csv(path: Path, take: ExportedTake, settings: FileSettings) -> None:
    """Write the columns of pose.csv, then ``<Joint>_qx``, ``_qy``, ``_qz`` and ``_qw``, then ``<Joint>_expected_error``
    (metres, NaN where the joint is, or was filled), and, where they are wanted, ``<Landmark>_x``, ``_y``, ``_z``,
    ``_confidence`` and ``_expected_error``.

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
    errors = np.where(confidence > 0, expected_error_m(confidence), np.nan)
    added = [rig_quaternions(motion, take.up).reshape(len(joints), -1), errors]
    header = (*HEADER, *ROTATION_COLUMNS, *ERROR_COLUMNS)
    if settings.landmarks:
        header += LANDMARK_COLUMNS
        places = landmark_positions(motion) @ y_up_from(take.up)
        sure = np.where(np.isnan(places[..., 0]), 0.0, landmark_confidence(confidence))
        off = np.where(sure > 0, landmark_errors_m(confidence, motion.offsets), np.nan)
        added.append(np.concatenate([places, sure[..., None], off[..., None]], -1).reshape(len(joints), -1))
    rows = [",".join(header)]
    for stamp_ns, *values, more in zip(
        table.stamps_ns.tolist(), joints, confidence, np.concatenate(added, 1), strict=True
    ):
        cells = ",".join(f"{value:.6f}" for value in more.tolist())
        rows.append(f"{pose_row(Pose(stamp_ns, *values), take.origin_ns)},{cells}")
    write_file(path, "\n".join(rows) + "\n")
