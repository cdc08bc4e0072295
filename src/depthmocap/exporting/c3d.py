"""C3D files of biomechanics: joints as points, bones as rotations; millimetres, Z up. Needs ezc3d (extra: export)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.landmarks import LANDMARK_NAMES
from depthmocap.body.skeleton import JOINTS
from depthmocap.core.output import atomic_write
from depthmocap.core.version import __version__
from depthmocap.errors import InputError, missing_extra
from depthmocap.exporting.body_motion import BodyMotion, solve_body
from depthmocap.exporting.exported_take import ExportedTake
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.timeline import Y_UP_FROM_Z_UP, FrameTimes, Timeline, evenly_spaced, frame_times
from depthmocap.exporting.virtual_markers import landmark_confidence, landmark_errors_m, landmark_positions
from depthmocap.frames import expected_error_m

#: What a C3D file's header can count.
MOST_FRAMES = 65535
#: C3D's mark of a point or rotation that is not known.
_INVALID = -1.0


def write_c3d(path: Path, take: ExportedTake, settings: FileSettings) -> None:
    """Write everybody of a take into one file.

    Points have the expected error as residual (:func:`~depthmocap.frames.expected_error_m`), 0 where they were filled,
    and -1 where they are not known. Surface landmarks, where they are wanted, are points after a person's joints; their
    residual has their own error as well. The group ROTATION has every bone's 4×4 matrix of rotation and origin; the
    axes of a bone are, at rest, x the subject's left, y up and z forward. Markers are events, in time from the first
    frame.

    Raises:
        InputError: when ezc3d is not installed, the take is longer than a file can be, or it cannot be written.
    """
    try:
        import ezc3d
    except ImportError:
        raise missing_extra("ezc3d", "export") from None

    lines = [take.rows(person, settings.least_confidence) for person in take.people]
    frames = frame_times(lines)
    if frames.count > MOST_FRAMES:
        raise InputError(
            f"no pose.c3d: it holds {MOST_FRAMES:,} frames, and the take has {frames.count:,}: record it in parts"
        )
    file: Any = ezc3d.c3d()
    _describe(file["parameters"], file.add_parameter, take, frames, settings.landmarks)
    for time_s, text in take.markers:
        if text and time_s >= frames.start_s:
            minutes, seconds = divmod(time_s - frames.start_s, 60)
            file.add_event([minutes, seconds], "General", text)
    motions = [solve_body(evenly_spaced(line, frames), settings.fill_s) for line in lines]
    parts = []
    for motion, line, person in zip(motions, lines, take.people, strict=True):
        confidence = _evenly_spaced_confidence(line, person.table.confidence, frames)
        parts += [_points(motion, confidence)] + [_landmarks(motion, confidence)] * settings.landmarks
    points, residuals = (np.concatenate(arrays, axis=1) for arrays in zip(*parts, strict=True))
    file["data"]["points"] = np.moveaxis(points, -1, 0).transpose(0, 2, 1)
    file["data"]["meta_points"] = {"residuals": residuals.T[None]}
    file["data"]["rotations"] = np.concatenate([_matrices(motion) for motion in motions], 1).transpose(2, 3, 1, 0)
    with atomic_write(path) as unfinished:
        file.write(str(unfinished))


def _describe(
    parameters: Any, add: Callable[[str, str, list[Any]], None], take: ExportedTake, frames: FrameTimes, landmarks: bool
) -> None:
    """Names, units, axes, rates and times of a file."""
    names = [take.name(person) for person in take.people]

    def labels(of_person: tuple[str, ...]) -> list[str]:
        return [f"{name}:{label}" if name else label for name in names for label in of_person]

    parameters["POINT"]["RATE"]["value"] = [1 / frames.frame_s]
    parameters["POINT"]["LABELS"]["value"] = labels(JOINTS + LANDMARK_NAMES * landmarks)
    parameters["POINT"]["UNITS"]["value"] = ["mm"]
    for group, values in {
        "POINT": {"X_SCREEN": "+X", "Y_SCREEN": "+Z"},
        "ROTATION": {"USED": len(labels(JOINTS)), "RATE": 1 / frames.frame_s},
        "MANUFACTURER": {"SOFTWARE": "depthmocap", "VERSION_LABEL": __version__},
        "DEPTHMOCAP": {"START_S": frames.start_s, "FIRST_TIMESTAMP_NS": str(take.origin_ns)},
    }.items():
        for name, value in values.items():
            add(group, name, [value])
    add("ROTATION", "LABELS", labels(JOINTS))
    if names[0]:
        add("SUBJECTS", "USED", [len(names)])
        add("SUBJECTS", "NAMES", names)
        add("SUBJECTS", "USES_PREFIXES", [1])
        add("SUBJECTS", "LABEL_PREFIXES", [f"{name}:" for name in names])


def _evenly_spaced_confidence(
    line: Timeline, confidence: Float[ndarray, "t 18"], frames: FrameTimes
) -> Float[ndarray, "n 18"]:
    as_points = np.repeat(confidence[..., None], 3, -1)
    return evenly_spaced(Timeline(line.times_s, as_points, line.frame_s), frames).joints_y_up[..., 0]


def _points(
    motion: BodyMotion, confidence: Float[ndarray, "n 18"]
) -> tuple[Float[ndarray, "n 18 4"], Float[ndarray, "n 18"]]:
    """Points (mm, with the 1 that C3D's readers expect) and residuals."""
    residuals = np.where(motion.filled, 0.0, 1000 * expected_error_m(np.nan_to_num(confidence)))
    return _marked(motion.joints, residuals)


def _landmarks(
    motion: BodyMotion, confidence: Float[ndarray, "n 18"]
) -> tuple[Float[ndarray, "n m 4"], Float[ndarray, "n m"]]:
    """The same of surface landmarks; a filled joint tells nothing of their error, and a residual of 0 says so."""
    errors_m = landmark_errors_m(np.nan_to_num(confidence), motion.offsets)
    filled = landmark_confidence(1.0 - motion.filled) < 1
    return _marked(landmark_positions(motion), np.where(filled, 0.0, 1000 * errors_m))


def _marked(
    points_y_up: Float[ndarray, "n m 3"], residuals: Float[ndarray, "n m"]
) -> tuple[Float[ndarray, "n m 4"], Float[ndarray, "n m"]]:
    unknown = np.asarray(np.isnan(points_y_up).any(-1))
    points = np.concatenate([points_y_up @ Y_UP_FROM_Z_UP * 1000, np.ones((*unknown.shape, 1))], -1)
    points[unknown] = 0.0  # as C3D has it
    return points, np.where(unknown, _INVALID, residuals)


def _matrices(motion: BodyMotion) -> Float[ndarray, "n 18 4 4"]:
    """World from bone, in millimetres; NaN where the rotation is not observed."""
    matrices = np.zeros((*motion.held.shape, 4, 4))
    matrices[..., :3, :3] = Y_UP_FROM_Z_UP.T @ motion.world_rotations()
    matrices[..., :3, 3] = motion.positions() @ Y_UP_FROM_Z_UP * 1000
    matrices[..., 3, 3] = 1.0
    matrices[motion.rotation_held] = np.nan
    return matrices
