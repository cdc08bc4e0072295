"""Extrinsics that are wrong in a known way: inverse, in another axis convention or unit, or of a turned picture.

Every known way is tried on the cameras that do not fit. It is told where with it, and only with it, the joints of all
cameras meet, and the person stands upright. Which camera is wrong is told by those that fit each other.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.calibration.joint_tracks import JointTrack, Skeletons, common_times, resample
from depthmocap.calibration.pairs import LEAST_JOINTS, estimate_pair, usable_joints
from depthmocap.calibration.picture_faults import round_factor
from depthmocap.geometry import DepthCamera, largest_group, rigid_inverse, transform_points, z_up_from
from depthmocap.text import camera_list

#: Two cameras fit if half of their joints are within this (metres): single views of right ones are 3 to 7 cm apart.
FITS_M = 0.1
#: They are told not to from here on.
APART_M = 0.15
#: Fewest moments that two cameras must share.
_LEAST_MOMENTS = 12
#: Most moments at which they are compared.
_MOMENTS = 60
#: Initial fits of a camera that stands elsewhere.
_FITS = 60
#: The person's axis is upright within this angle (degrees),
UPRIGHT_DEG = 25.0
#: and told not to be beyond this one.
TILTED_DEG = 50.0
#: Somebody walks who goes so far (metres, standard deviation); only of them the axis tells what is up.
_WALKS_M = 0.15
#: Greatest height of a walker's hip path (metres, standard deviation).
_LEVEL_M = 0.12
#: A factor on all depth is told beyond this.
_SAME_SCALE = 1.15

_HIP, _NECK = JOINT_INDEX["Hip"], JOINT_INDEX["Neck"]
_FEET = [JOINT_INDEX["LFoot"], JOINT_INDEX["RFoot"]]


def _turn(quarters: int) -> Float[ndarray, "4 4"]:
    """About the optical axis."""
    turn = np.eye(4)
    c, s = (1, 0, -1, 0)[quarters], (0, 1, 0, -1)[quarters]
    turn[:2, :2] = [[c, -s], [s, c]]
    return turn


_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
#: x forward, y left, z up: columns are the OpenCV camera's axes in it.
_ROBOTICS = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
_Y_DOWN = np.diag([1.0, -1.0, 1.0, 1.0])


def _lengths(factor: float) -> Callable[[ndarray], ndarray]:
    def scale(pose: Float[ndarray, "4 4"]) -> Float[ndarray, "4 4"]:
        return np.block([[pose[:3, :3], pose[:3, 3:] * factor], [pose[3:]]])

    return scale


#: What a pose may be instead of ``world_from_camera``, what makes that of it, and what one would write of it.
WAYS: dict[str, tuple[str, Callable[[ndarray], ndarray]]] = {
    "inverse": ("is camera_from_world, the inverse", rigid_inverse),
    "millimetres": ("is in millimetres", _lengths(0.001)),
    "centimetres": ("is in centimetres", _lengths(0.01)),
    "opengl": ("is of a camera with y up that looks along -z (OpenGL, Blender)", lambda pose: pose @ _OPENGL),
    "inverse opengl": (
        "is the view matrix of OpenGL: inverse, and of a camera with y up that looks along -z",
        lambda pose: rigid_inverse(pose) @ _OPENGL,
    ),
    "robotics": ("is of a camera that looks along x, with z up (ROS)", lambda pose: pose @ _ROBOTICS),
    "unity": ("is of a left-handed world and camera with y up (Unity)", lambda pose: _Y_DOWN @ pose @ _Y_DOWN),
    "turned 180": ("is of a picture turned by 180°", lambda pose: pose @ _turn(2)),
    "turned 90": ("is of a picture turned by 90°", lambda pose: pose @ _turn(1)),
    "turned 270": ("is of a picture turned by 90° the other way", lambda pose: pose @ _turn(3)),
}


#: The same of a picture that is turned while intrinsics and pose are not: its principal point is then another one, too.
TURNED_PICTURE = "picture turned 180"


def _of_turned_picture(camera: DepthCamera) -> Float[ndarray, "4 4"]:
    """What makes points that are seen in a picture turned by 180° those of the camera; no rotation, but linear."""
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    turn[0, 2] = (camera.width - 1 - 2 * camera.cx) / camera.fx
    turn[1, 2] = (camera.height - 1 - 2 * camera.cy) / camera.fy
    return turn


@dataclasses.dataclass(frozen=True, eq=False)
class PoseFault:
    """Extrinsics that are wrong.

    Attributes:
        kind: a key of ``WAYS``; ``TURNED_PICTURE``; "up", the world's axis; "unit", depth against the places of the
            cameras; or "elsewhere", in no known way.
        cameras: who is wrong; both of two where it cannot be told which.
        text: the same in words, with what would mend it.
        poses: ``world_from_camera`` as it would be right, by camera.
        factor: on the depth of these cameras.
        up: the world's up axis as it would be right; empty unless that is what is wrong.
        certain: whether all of ``cameras`` are wrong.
    """

    kind: str
    cameras: tuple[str, ...]
    text: str
    poses: dict[str, Float[ndarray, "4 4"]]
    factor: float = 1.0
    up: str = ""
    certain: bool = True


def find_pose_faults(
    cameras: Sequence[DepthCamera], tracks: Sequence[JointTrack], up: str, rng: np.random.Generator
) -> list[PoseFault]:
    """Wrong extrinsics, by camera.

    Args:
        cameras: with the poses that are judged.
        tracks: each camera's joints in its own frame, in metres and not mirrored.
        up: the world's up axis, as the rig says.
    """
    seen = [i for i, track in enumerate(tracks) if len(track.times_s) > 1]
    cameras, tracks = [cameras[i] for i in seen], [tracks[i] for i in seen]
    if not cameras:
        return []
    times_s = common_times(tracks)
    times_s = times_s[:: max(round(len(times_s) / _MOMENTS), 1)]
    judge = _Judge(cameras, resample(tracks, times_s, np.zeros(len(tracks))), up, rng)
    return judge.faults()


class _Judge:
    def __init__(self, cameras: Sequence[DepthCamera], skeletons: Skeletons, up: str, rng: np.random.Generator) -> None:
        self.cameras, self.names = cameras, [camera.name for camera in cameras]
        self.poses = [camera.world_from_camera for camera in cameras]
        self.skeletons, self.up, self.rng = skeletons, z_up_from(up)[2], rng
        self.up_name = up
        self.known = usable_joints(skeletons.joints, skeletons.sigma_m)
        self.pairs = [
            pair for pair in itertools.combinations(range(len(cameras)), 2)
            if (self.common(*pair).sum(1) >= LEAST_JOINTS).sum() >= _LEAST_MOMENTS
        ]  # fmt: skip

    def common(self, a: int, b: int) -> ndarray:
        common = self.known[a] & self.known[b]
        return common & (common.sum(1, keepdims=True) >= LEAST_JOINTS)

    def apart_m(self, a: int, b: int, pose_a: ndarray, pose_b: ndarray) -> float:
        """Median distance of the joints that two cameras share; sides may be exchanged in any view."""
        common = self.common(a, b)
        one = transform_points(pose_a, self.skeletons.joints[a][common])
        other = transform_points(pose_b, self.skeletons.joints[b][common])
        return float(np.median(np.linalg.norm(one - other, axis=1)))

    def fit(self, poses: Sequence[ndarray]) -> bool:
        """Whether all pairs fit with these poses, and the person is not seen lying or upside down."""
        return all(self.apart_m(a, b, poses[a], poses[b]) < FITS_M for a, b in self.pairs)

    def tilt_deg(self, camera: int, pose: Float[ndarray, "4 4"]) -> float | None:
        """Angle between the walker's body and up; None where nobody walks."""
        joints = self.skeletons.joints[camera]
        joints = joints[np.isfinite(joints).all((1, 2))]
        if len(joints) < _LEAST_MOMENTS:
            return None
        axes = joints[:, _NECK] - joints[:, _FEET].mean(1)
        axis = np.median(axes / np.linalg.norm(axes, axis=1, keepdims=True), axis=0)
        axis /= np.linalg.norm(axis)
        along = joints[:, _HIP] @ axis
        across = joints[:, _HIP] - along[:, None] * axis
        if np.sqrt(np.trace(np.cov(across.T))) < _WALKS_M or along.std() > _LEVEL_M:
            return None
        turned = pose[:3, :3] @ axis
        return float(np.rad2deg(np.arccos(np.clip(turned @ self.up / np.linalg.norm(turned), -1, 1))))

    def stands(self, camera: int, pose: Float[ndarray, "4 4"]) -> bool:
        """Whether the person stands upright, as far as it can be told."""
        tilt = self.tilt_deg(camera, pose)
        return tilt is None or tilt < UPRIGHT_DEG

    def faults(self) -> list[PoseFault]:
        count = len(self.poses)
        distances = {(a, b): self.apart_m(a, b, self.poses[a], self.poses[b]) for a, b in self.pairs}
        fitting = {pair for pair, apart in distances.items() if apart < APART_M}
        if len(fitting) == len(self.pairs):
            return self.tilted(range(count))
        group = largest_group(range(count), fitting)
        if len(group) > 1:
            faults = [self.fault_of(i, group) for i in range(count) if i not in group and self.has_pair(i, group)]
            return [fault for fault in faults if fault is not None] + self.tilted(group)
        for whole in (self.common_unit, self.common_way):
            if (fault := whole()) is not None:
                return [fault]
        if count == 2:
            return self.either()
        names = tuple(self.names)
        return [PoseFault("elsewhere", names, f"no two of {camera_list(names)} see the person in one place", {})]

    def has_pair(self, camera: int, group: Sequence[int]) -> bool:
        return any(camera in pair and ({*pair} - {camera}) <= {*group} for pair in self.pairs)

    def readings(self, camera: int) -> list[tuple[str, ndarray]]:
        """A camera's pose in every known way."""
        pose = self.poses[camera]
        readings = [(kind, read(pose)) for kind, (_, read) in WAYS.items()]
        return [*readings, (TURNED_PICTURE, pose @ _of_turned_picture(self.cameras[camera]))]

    def ways(self, camera: int, others: Sequence[int]) -> list[tuple[str, ndarray]]:
        """The ways of reading a camera's pose by which it fits the others."""
        faults = []
        for kind, pose in self.readings(camera):
            apart = [
                self.apart_m(camera, other, pose, self.poses[other])
                for other in others
                if (min(camera, other), max(camera, other)) in self.pairs
            ]
            if apart and max(apart) < FITS_M and self.stands(camera, pose):
                faults.append((kind, pose))
        return faults

    def fault_of(self, camera: int, group: Sequence[int]) -> PoseFault | None:
        """The fault of a camera that does not fit those that fit each other."""
        name, others = self.names[camera], camera_list([self.names[i] for i in group])
        if ways := self.ways(camera, group):
            kind, pose = ways[0]
            if kind == TURNED_PICTURE:
                return PoseFault(kind, (name,), f"{_words(name, kind, pose)}, which fits {others}", {})
            return PoseFault(kind, (name,), f"{_words(name, kind, pose)}, which fits {others}", {name: pose})
        pose = self.placed(camera, group)
        if pose is None:
            return PoseFault("elsewhere", (name,), f"camera {name!r} does not fit {others}: {_CALIBRATE}", {})
        cm, degrees = moved(self.poses[camera], pose, self.person())
        return PoseFault(
            "elsewhere", (name,),
            f"camera {name!r} stands elsewhere than the rig says, by {degrees:.0f}° and {cm:.0f} cm where the person "
            f"is, against {others}, or its clock is off: {_CALIBRATE}",
            {name: pose},
        )  # fmt: skip

    def placed(self, camera: int, group: Sequence[int]) -> Float[ndarray, "4 4"] | None:
        """Where a camera stands by the joints that it shares with one of the group."""
        for other in group:
            if (min(camera, other), max(camera, other)) not in self.pairs:
                continue
            joints, sigma = self.skeletons.joints, self.skeletons.sigma_m
            pair = estimate_pair((joints[other], joints[camera]), (sigma[other], sigma[camera]), self.rng, _FITS)
            if pair is not None and pair.agreed > pair.shared / 2:
                return self.poses[other] @ pair.a_from_b
        return None

    def person(self) -> Float[ndarray, "3"]:
        """Where the person mostly is, by the camera that sees them best."""
        best = int(np.argmax([known.sum() for known in self.known]))
        hips = transform_points(self.poses[best], self.skeletons.joints[best][:, _HIP])
        return np.nanmedian(hips, axis=0)

    def common_unit(self) -> PoseFault | None:
        """A factor on the depth of all cameras, with which they fit."""
        factors = []
        for a, b in self.pairs:
            common = self.common(a, b)
            turned = [self.skeletons.joints[i][common] @ self.poses[i][:3, :3].T for i in (a, b)]
            shift, difference = self.poses[b][:3, 3] - self.poses[a][:3, 3], turned[0] - turned[1]
            factors.append(float(np.median(difference @ shift / np.maximum((difference**2).sum(1), 1e-9))))
        factor = float(np.median(factors)) if factors else 1.0
        if not factor > 0.01 or 1 / _SAME_SCALE < factor < _SAME_SCALE:
            return None
        scaled = [_lengths(1 / factor)(pose) for pose in self.poses]
        # Joints stay, and the places of the cameras are divided instead: distances are then in the cameras' unit.
        if any(self.apart_m(a, b, scaled[a], scaled[b]) * factor > FITS_M for a, b in self.pairs):
            return None
        factor = round_factor(factor)
        return PoseFault(
            "unit", tuple(self.names),
            f"all cameras measure {1 / factor:.3g} of the lengths between the places that the rig tells of them: "
            f"multiply their depth by {factor:g} (depth_factor in rig.json), or the places by {1 / factor:.3g}",
            {}, factor,
        )  # fmt: skip

    def common_way(self) -> PoseFault | None:
        """One way of reading all poses by which they fit."""
        for kind, (words, read) in WAYS.items():
            poses = [read(pose) for pose in self.poses]
            if self.fit(poses) and all(self.stands(i, pose) for i, pose in enumerate(poses)):
                names = tuple(self.names)
                first = f"{names[0]!r} {_matrix(poses[0])}"
                text = f"world_from_camera of all cameras {words}: right would be {first}, and so on"
                return PoseFault(kind, names, text, dict(zip(names, poses, strict=True)))
        return None

    def either(self) -> list[PoseFault]:
        """The fault of one of two cameras, and how either could be read to fit the other."""
        names = camera_list(self.names)
        options = [
            (self.names[i], kind, pose)
            for i in (0, 1)
            for kind, pose in self.ways(i, [1 - i])[:1]
            if self.stands(1 - i, self.poses[1 - i])
        ]
        if not options:
            text = f"{names} do not see the person in one place: one stands elsewhere than the rig says: {_CALIBRATE}"
            return [PoseFault("elsewhere", tuple(self.names), text, {}, certain=False)]
        words = ", or ".join(_words(*option) for option in options)
        option_names = tuple(name for name, _, _ in options)
        poses = {name: pose for name, kind, pose in options if kind != TURNED_PICTURE}
        return [
            PoseFault(options[0][1], option_names, f"{names} do not fit: {words}", poses, certain=len(options) == 1)
        ]

    def tilted(self, group: Sequence[int]) -> list[PoseFault]:
        """What is wrong with cameras that fit each other, or that are alone, if the person does not stand upright."""
        tilts = {i: tilt for i in group if (tilt := self.tilt_deg(i, self.poses[i])) is not None}
        if not tilts or min(tilts.values()) < TILTED_DEG:
            return []
        names = tuple(self.names[i] for i in group)
        if len(names) == 1:
            return self.single(next(iter(tilts)))
        ups = [
            up for up in ("z", "y", "-y")
            if all(self.with_up(up).stands(i, self.poses[i]) for i in tilts) and up != self.up_name
        ]  # fmt: skip
        mend = f'"up": "{ups[0]}" in rig.json would be right' if ups else f"no up of a rig fits: {_CALIBRATE}"
        text = f"the person is not upright in the world of {camera_list(names)}, where {self.up_name} is up: {mend}"
        return [PoseFault("up", names, text, {}, up=ups[0] if ups else "", certain=bool(ups))]

    def single(self, camera: int) -> list[PoseFault]:
        """The ways of reading the only camera's pose by which the person stands upright on the floor."""
        name, pose = self.names[camera], self.poses[camera]
        if np.array_equal(pose, np.eye(4)):
            return []
        faults = []
        for kind, reading in self.readings(camera):
            tilt = self.tilt_deg(camera, reading)
            if tilt is not None and tilt < UPRIGHT_DEG and self.on_floor(camera, reading):
                faults.append((kind, reading))
        ups = [up for up in ("z", "y", "-y") if up != self.up_name and self.with_up(up).stands(camera, pose)]
        words = [_words(name, kind, reading) for kind, reading in faults]
        words += [f'"up": "{up}" would be right' for up in ups]
        lying = f"camera {name!r} sees a person who walks lying or upside down in the rig's world"
        kind, poses = (faults[0][0], {name: faults[0][1]}) if len(faults) == 1 and not ups else ("elsewhere", {})
        return [PoseFault(kind, (name,), f"{lying}: {', or '.join(words) or _CALIBRATE}", poses)]

    def on_floor(self, camera: int, pose: Float[ndarray, "4 4"]) -> bool:
        feet = transform_points(pose, self.skeletons.joints[camera][:, _FEET].reshape(-1, 3)) @ self.up
        return abs(float(np.nanquantile(feet, 0.2))) < 0.35

    def with_up(self, up: str) -> _Judge:
        other = object.__new__(_Judge)
        other.__dict__.update(self.__dict__, up=z_up_from(up)[2], up_name=up)
        return other


_CALIBRATE = "depthmocap calibrate RECORDING --out rig.json"


def moved(old: Float[ndarray, "4 4"], new: Float[ndarray, "4 4"], point: Float[ndarray, "3"]) -> tuple[float, float]:
    """How far two poses are apart: where the person is (cm), and in rotation (degrees)."""
    step = new @ rigid_inverse(old)
    angle = np.arccos(np.clip((np.trace(step[:3, :3]) - 1) / 2, -1, 1))
    return 100 * float(np.linalg.norm(transform_points(step, point) - point)), float(np.rad2deg(angle))


def _words(name: str, kind: str, pose: Float[ndarray, "4 4"]) -> str:
    """What is wrong with a camera, and what would be right."""
    if kind == TURNED_PICTURE:
        return f"the picture of camera {name!r} is turned by 180° against its intrinsics and pose: turn it back"
    return f"world_from_camera of camera {name!r} {WAYS[kind][0]}: right would be {_matrix(pose)}"


def _matrix(pose: Float[ndarray, "4 4"]) -> str:
    rows = (", ".join(f"{value:.4g}" if abs(value) > 1e-9 else "0" for value in row) for row in pose)
    return "[" + ", ".join(f"[{row}]" for row in rows) + "]"
