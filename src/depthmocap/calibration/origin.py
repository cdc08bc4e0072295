"""The lab's frame: where its origin and axes lie in the world of a calibration, told by how the person walks, by points
of the floor, or by the lab's own capture of the same movement."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.calibration.c3d_origin import find_c3d
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.core.reading.json_text import array, number, read_json
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig

#: ``--origin walk``.
WALK = "walk"
_FEET = [JOINT_INDEX["LFoot"], JOINT_INDEX["RFoot"]]
#: Somebody stands whose feet stay within this (metres)
_STILL_M = 0.12
#: for this long (seconds).
_STAND_S = 0.8
#: The second place is at least so far from the first (metres).
_LEAST_WALK_M = 0.8
#: Feet are averaged over this time around the moment when somebody stands on a point (seconds).
_AROUND_S = 0.4
#: Two points of the floor are at least so far apart (metres);
_LEAST_APART_M = 0.5
#: they fit if none is further off than this (metres).
_MOST_OFF_M = 0.15


@dataclasses.dataclass(frozen=True, eq=False)
class LabFrame:
    """The lab's frame.

    Attributes:
        lab_from_world: from the world of a calibration, Z up, floor at z = 0.
        up: the lab's up axis.
        lines: what it is based on, and how well that fits.
    """

    lab_from_world: Float[ndarray, "4 4"]
    up: str
    lines: list[str]

    def rig(self, rig: Rig) -> Rig:
        """The cameras in the lab's frame."""
        cameras = (
            dataclasses.replace(camera, world_from_camera=self.lab_from_world @ camera.world_from_camera)
            for camera in rig.cameras
        )
        return Rig(tuple(cameras), self.up)


def check_origin(origin: str) -> None:
    """Check what ``--origin`` says, before anything is computed.

    Raises:
        InputError: when it is neither "walk" nor a file of points or of the lab's capture.
    """
    if origin != WALK and Path(origin).suffix.lower() not in (".json", ".c3d"):
        raise InputError(
            "--origin takes walk, a .json file of points of the floor, or a .c3d file of the same movement, "
            f"not {origin}"
        )
    if origin != WALK and not Path(origin).is_file():
        raise InputError(f"--origin: {origin} not found")


def find_lab(origin: str, person: JointTrack, rig: Rig, rng: np.random.Generator) -> LabFrame:
    """The lab's frame.

    Args:
        origin: "walk", or a file: of points (.json) or of the lab's capture of the same movement (.c3d).
        person: joints in the world (metres), by the times of the recording.
        rig: the cameras.

    Raises:
        InputError: when it cannot be told.
    """
    if origin == WALK:
        return by_walk(person)
    path = Path(origin)
    if path.suffix.lower() == ".c3d":
        motion = find_c3d(path, person, rng)
        return LabFrame(motion.lab_from_world, motion.up, [str(motion)])
    return by_points(path, person, rig)


def by_walk(person: JointTrack) -> LabFrame:
    """The origin is where the person first stands, and +X is towards where they stand next.

    Raises:
        InputError: when they do not stand, walk, and stand again.
    """
    stands = _stands(person)
    if not stands:
        raise InputError("--origin walk: the person never stands still; stand for a second, walk straight, stand again")
    first_s, first = stands[0]
    later = [(time_s, place) for time_s, place in stands[1:] if np.linalg.norm(place - first) >= _LEAST_WALK_M]
    if not later:
        raise InputError(
            f"--origin walk: the person stands once, {first_s - person.times_s[0]:.1f} s after the start; walk a metre "
            "or more from there, straight, and stand again"
        )
    then_s, then = later[0]
    distance_m = float(np.linalg.norm(then - first))
    x, y = (then - first) / distance_m
    lab_from_world = np.eye(4)
    lab_from_world[:2, :2] = [[x, y], [-y, x]]
    lab_from_world[:2, 3] = -lab_from_world[:2, :2] @ first
    start_s = float(person.times_s[0])
    return LabFrame(lab_from_world, "z", [
        f"The origin is between the feet of who stood {first_s - start_s:.1f} s after the start, and +X is towards "
        f"where they stood at {then_s - start_s:.1f} s, {distance_m:.2f} m away: to a few centimetres, and about "
        f"{np.rad2deg(np.arctan2(0.04, distance_m)):.0f}°."
    ])  # fmt: skip


def _stands(person: JointTrack) -> list[tuple[float, Float[ndarray, "2"]]]:
    """Middle time and place on the floor of every time that both feet stay where they are."""
    feet = person.joints[:, _FEET, :2].mean(1)
    known = np.isfinite(feet).all(1)
    times_s, feet = person.times_s[known], feet[known]
    stands: list[tuple[float, Float[ndarray, "2"]]] = []
    start = 0
    while start < len(times_s):
        end = start + 1
        while end < len(times_s) and np.linalg.norm(feet[end] - np.median(feet[start:end], axis=0)) < _STILL_M / 2:
            end += 1
        if times_s[end - 1] - times_s[start] >= _STAND_S:
            stands.append((float(times_s[start:end].mean()), np.median(feet[start:end], axis=0)))
            start = end
        else:
            start += 1
    return stands


def by_points(path: Path, person: JointTrack, rig: Rig) -> LabFrame:
    """By points of the floor whose places in the lab are known: ``{"points": [{"name": …, "at_m": [x, y], …}]}``, each
    with ``time_s``, when somebody stands on it (seconds after the recording's start), or with ``camera`` and
    ``pixel`` [u, v], where a camera sees it.

    Raises:
        InputError: when the file is malformed, a point cannot be found, or they do not fit each other.
    """
    document = read_json(path)
    entries = document.get("points") if isinstance(document, dict) else None
    if not isinstance(entries, list) or len(entries) < 2:
        raise InputError(f'{path} must hold {{"points": [...]}} with at least two points of the floor')
    names = [_name(entry, i) for i, entry in enumerate(entries)]
    in_lab = np.stack([
        array(_get(entry, "at_m", f"{path}: {name}"), (2,), f"{path}: {name}: at_m")
        for entry, name in zip(entries, names, strict=True)
    ])  # fmt: skip
    in_world = np.stack([
        _seen(entry, person, rig, f"{path}: {name}") for entry, name in zip(entries, names, strict=True)
    ])  # fmt: skip
    for places, where in ((in_lab, "at_m"), (in_world, "where they are seen")):
        if np.linalg.norm(places - places[0], axis=1).max() < _LEAST_APART_M:
            raise InputError(f"{path}: the points are within {100 * _LEAST_APART_M:.0f} cm of each other by {where}")
    a, b = in_world - in_world.mean(0), in_lab - in_lab.mean(0)
    angle = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    lab_from_world = np.eye(4)
    lab_from_world[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    lab_from_world[:2, 3] = in_lab.mean(0) - lab_from_world[:2, :2] @ in_world.mean(0)
    off_m = np.linalg.norm(in_world @ lab_from_world[:2, :2].T + lab_from_world[:2, 3] - in_lab, axis=1)
    errors = ", ".join(f"{name} {100 * metres:.1f} cm" for name, metres in zip(names, off_m.tolist(), strict=True))
    if off_m.max() > _MOST_OFF_M:
        raise InputError(f"{path}: the points do not fit each other (exchanged, mirrored?): they are off by {errors}")
    return LabFrame(lab_from_world, "z", [f"The lab's axes are by points of the floor, which are off by {errors}."])


def _name(entry: Any, index: int) -> str:
    name = entry.get("name", index + 1) if isinstance(entry, dict) else index + 1
    return f"point {str(name)[:40]!r}"


def _get(entry: Any, key: str, where: str) -> Any:
    if not isinstance(entry, dict) or key not in entry:
        raise InputError(f"{where} lacks {key}")
    return entry[key]


def _seen(entry: Any, person: JointTrack, rig: Rig, where: str) -> Float[ndarray, "2"]:
    """Where a point is on the floor of the world (metres)."""
    if "time_s" in entry:
        time_s = number(entry["time_s"], f"{where}: time_s")
        near = np.abs(person.times_s - person.times_s[0] - time_s) <= _AROUND_S
        feet = person.joints[near][:, _FEET, :2].mean(1)
        feet = feet[np.isfinite(feet).all(1)]
        if not len(feet):
            raise InputError(f"{where}: nobody is seen {time_s:g} s after the start")
        if np.linalg.norm(feet - np.median(feet, axis=0), axis=1).max() > _STILL_M:
            raise InputError(f"{where}: the person does not stand {time_s:g} s after the start")
        return np.median(feet, axis=0)
    name = _get(entry, "camera", f"{where} (or time_s)")
    if name not in rig.names:
        raise InputError(f"{where}: there is no camera {name!r} in the rig")
    return _on_floor(rig[name], array(_get(entry, "pixel", where), (2,), f"{where}: pixel"), where)


def _on_floor(camera: DepthCamera, pixel: Float[ndarray, "2"], where: str) -> Float[ndarray, "2"]:
    """Where the ray through a pixel meets the floor."""
    ray = np.append(camera.undistorted(pixel[None])[0], 1.0)
    eye = camera.world_from_camera[:3, 3]
    along = camera.world_from_camera[:3, :3] @ ray
    if not (np.isfinite(along).all() and along[2] * eye[2] < 0):
        raise InputError(f"{where}: the pixel of camera {camera.name!r} does not show the floor")
    return (eye - along * eye[2] / along[2])[:2]
