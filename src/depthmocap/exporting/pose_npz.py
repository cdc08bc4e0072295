"""Joints and rotations as NumPy's arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from depthmocap.body.landmarks import LANDMARK_NAMES
from depthmocap.body.skeleton import JOINTS, PARENTS
from depthmocap.core.output import atomic_write
from depthmocap.exporting.body_motion import solve_body
from depthmocap.exporting.exported_take import ExportedTake
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.rotation_csv import rig_quaternions
from depthmocap.exporting.timeline import y_up_from
from depthmocap.exporting.virtual_markers import landmark_confidence, landmark_errors_m, landmark_positions
from depthmocap.frames import expected_error_m


def write_npz(path: Path, take: ExportedTake, settings: FileSettings) -> None:
    """Write a person's arrays; docs/guides/export.md has their names.

    Raises:
        InputError: when the file cannot be written, or no joint remains.
    """
    (person,) = take.people
    line = take.rows(person, settings.least_confidence)
    motion = solve_body(line, settings.fill_s)
    with atomic_write(path) as unfinished:
        np.savez_compressed(
            unfinished,
            times_s=line.times_s,
            timestamps_ns=person.table.stamps_ns,
            joints=motion.joints @ y_up_from(take.up),
            confidence=person.table.confidence,
            expected_error_m=expected_error_m(person.table.confidence),
            filled=motion.filled,
            quaternions=rig_quaternions(motion, take.up),
            skeleton_joints=motion.positions() @ y_up_from(take.up),
            held=motion.held,
            standing=motion.standing,
            rest_offsets=motion.offsets,
            joint_names=np.array(JOINTS),
            parents=np.array([JOINTS.index(PARENTS[joint] or joint) for joint in JOINTS]),
            up=np.array(take.up),
            frames_per_second=np.array(1 / line.frame_s),
            person=np.array(take.name(person)),
            marker_times_s=np.array([time_s for time_s, _ in take.markers], np.float64),
            marker_names=np.array([text for _, text in take.markers], np.str_),
            landmarks=landmark_positions(motion) @ y_up_from(take.up),
            landmark_confidence=landmark_confidence(person.table.confidence),
            landmark_expected_error=landmark_errors_m(person.table.confidence, motion.offsets),
            landmark_names=np.array(LANDMARK_NAMES),
        )
