"""The lab's frame by its own capture of the same movement, a C3D file: joints, or markers near them, are brought onto
the joints that the cameras see, in time and in space."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.calibration.pairs import LEAST_JOINTS
from depthmocap.calibration.time_search import find_time
from depthmocap.core.reading.input_files import check_file
from depthmocap.errors import InputError, missing_extra
from depthmocap.geometry import rigid_inverse, transform_points, z_up_from

#: Markers of the usual full-body sets whose mean is about a joint; where there is a point of the joint's name, that.
_MARKERS = {
    "Head": ("LFHD", "RFHD", "LBHD", "RBHD"), "Neck": ("C7", "CLAV"), "Spine1": ("T10", "STRN"),
    "Hip": ("LASI", "RASI", "LPSI", "RPSI"), "LShoulder": ("LSHO",), "RShoulder": ("RSHO",),
    "LElbow": ("LELB",), "RElbow": ("RELB",), "LHand": ("LWRA", "LWRB"), "RHand": ("RWRA", "RWRB"),
    "LKnee": ("LKNE",), "RKnee": ("RKNE",), "LFoot": ("LANK",), "RFoot": ("RANK",),
}  # fmt: skip
#: Expected distance of joints from their markers (metres).
_SIGMA_M = 0.06
#: Metres of the units that files tell.
_UNITS_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
#: The lab's up is along one of its axes to within this (degrees).
_MOST_TILT_DEG = 8.0


@dataclasses.dataclass(frozen=True, eq=False)
class C3dMatch:
    """The lab's frame, and when its capture began: ``shift_s`` is added to its times (seconds from its first frame) for
    the recording's."""

    lab_from_world: Float[ndarray, "4 4"]
    up: str
    path: Path
    shift_s: float
    sigma_s: float
    begins_s: float
    apart_m: float
    tilt_deg: float
    joints: int

    def __str__(self) -> str:
        return (
            f"The lab's axes are those of {self.path}, which begins {self.begins_s:.3f} s after the recording (± "
            f"{3e3 * self.sigma_s:.0f} ms): {self.joints} joints are {100 * self.apart_m:.1f} cm apart (median), the "
            f"floor {self.tilt_deg:.1f}° from the lab's."
        )


def find_c3d(path: Path, person: JointTrack, rng: np.random.Generator) -> C3dMatch:
    """Bring a C3D file onto the person.

    Args:
        person: joints in the world, Z up (metres), by the times of the recording.

    Raises:
        InputError: when the file cannot be read, has too few points that are known, or is of another movement.
    """
    theirs = read_c3d_track(path)
    start_s = float(person.times_s[0])
    known = np.isfinite(person.joints).any((1, 2))
    ours = JointTrack(person.times_s[known] - start_s, person.joints[known], person.sigma_m[known])
    match = find_time(ours, theirs, rng)
    if not match.told or match.fit is None:
        raise InputError(f"{path}: it cannot be told when it was captured: {match.why}")
    lab_from_world, up, tilt_deg = _upright(rigid_inverse(match.fit.a_from_b), path)
    period_s = float(np.median(np.diff(theirs.times_s)))
    joints, _ = theirs.interpolate(ours.times_s - match.fit.shift_s, period_s)
    # Turned upright, it is moved to where the joints are.
    lab_from_world[:3, 3] = 0.0
    gaps = joints - transform_points(lab_from_world, ours.joints)
    lab_from_world[:3, 3] = np.nanmedian(gaps.reshape(-1, 3), axis=0)
    apart = np.linalg.norm(joints - transform_points(lab_from_world, ours.joints), axis=-1)
    used = int(np.isfinite(theirs.joints).any((0, 2)).sum())
    return C3dMatch(
        lab_from_world, up, path, match.fit.shift_s + start_s, match.fit.sigma_s, match.fit.shift_s,
        float(np.nanmedian(apart)), tilt_deg, used,
    )  # fmt: skip


def _upright(lab_from_world: Float[ndarray, "4 4"], path: Path) -> tuple[Float[ndarray, "4 4"], str, float]:
    """The nearest frame in which up is along an axis, that axis, and the angle between both (degrees)."""
    ups = {up: z_up_from(up).T[:, 2] for up in ("z", "y", "-y")}
    up = max(ups, key=lambda name: float(ups[name] @ lab_from_world[:3, 2]))
    axis = np.cross(lab_from_world[:3, 2], ups[up])
    angle = float(np.arctan2(np.linalg.norm(axis), ups[up] @ lab_from_world[:3, 2]))
    if np.rad2deg(angle) > _MOST_TILT_DEG:
        raise InputError(f"{path}: up is along none of Z, Y and -Y there (nearest {up}, by {np.rad2deg(angle):.0f}°)")
    turned = lab_from_world.copy()
    if angle > 0:
        turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * angle).as_matrix()
        turned[:3, :3] = turn @ lab_from_world[:3, :3]
    return turned, up, float(np.rad2deg(angle))


def read_c3d_track(path: Path) -> JointTrack:
    """Joints of a C3D file, by points of their names or markers near them, at seconds from its first frame.

    Raises:
        InputError: when ezc3d is not installed, or the file cannot be read or has too few of them.
    """
    check_file(path)
    try:
        import ezc3d
    except ImportError:
        raise missing_extra("ezc3d", "export") from None
    try:
        file: Any = ezc3d.c3d(str(path))
        parameters = file["parameters"]["POINT"]
        rate_hz = float(parameters["RATE"]["value"][0])
        labels = [str(label).rpartition(":")[2] for label in parameters["LABELS"]["value"]]
        unit = str((*parameters.get("UNITS", {"value": ()})["value"], "mm")[0])
        points = np.moveaxis(np.array(file["data"]["points"], np.float64)[:3], 0, -1)
    except Exception as error:  # ezc3d raises many types
        raise InputError(f"{path} is no C3D file that can be read ({error})") from None
    if not (rate_hz > 0 and unit in _UNITS_M and points.ndim == 3 and len(labels) <= len(points)):
        raise InputError(f"{path}: it has {rate_hz:g} frames a second in {unit!r}: mm, cm or m are read")
    points = points[: len(labels)] * _UNITS_M[unit]
    places = {label: place for place, label in reversed(list(enumerate(labels)))}
    joints = np.full((points.shape[1], len(JOINTS), 3), np.nan)
    for joint, index in JOINT_INDEX.items():
        markers = (joint,) if joint in places else _MARKERS.get(joint, ())
        if markers and all(marker in places for marker in markers):
            joints[:, index] = points[[places[marker] for marker in markers]].mean(0)
    used = int(np.isfinite(joints).any((0, 2)).sum())
    if used < LEAST_JOINTS:
        raise InputError(
            f"{path} has points for {used} joints, and {LEAST_JOINTS} are needed: by the names of joints here ("
            f"{', '.join(JOINTS[:4])}, …), or markers such as LASI, RASI, LPSI, RPSI, LKNE, LANK, LSHO, LELB, LWRA"
        )
    times_s = np.arange(len(joints)) / rate_hz
    step = max(round(rate_hz / 30), 1)
    return JointTrack(times_s[::step], joints[::step], np.full(joints[::step].shape[:2], _SIGMA_M))
