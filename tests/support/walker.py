"""A stick figure that walks in circles and waves its arms, and cameras that estimate its joints with errors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d

from depthmocap.body.skeleton import JOINTS
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.geometry import look_at, rigid_inverse, transform_points

_STICKS = {
    "Head": (0, 0, 1.6), "Neck": (0, 0, 1.5), "Spine2": (0, 0.02, 1.35), "Spine1": (0, 0.03, 1.2),
    "Spine": (0, 0.02, 1.08), "Hip": (0, 0, 0.95), "RHip": (-0.1, 0, 0.93), "RKnee": (-0.11, 0, 0.5),
    "RFoot": (-0.12, 0, 0.08), "LHip": (0.1, 0, 0.93), "LKnee": (0.11, 0, 0.5), "LFoot": (0.12, 0, 0.08),
    "RShoulder": (-0.19, 0, 1.42), "RElbow": (-0.3, 0, 1.2), "RHand": (-0.4, -0.1, 1.0),
    "LShoulder": (0.19, 0, 1.42), "LElbow": (0.3, 0, 1.2), "LHand": (0.4, -0.1, 1.0),
}  # fmt: skip
REST = np.array([_STICKS[name] for name in JOINTS])
_ENDS = [i for i, name in enumerate(JOINTS) if name.endswith(("Elbow", "Hand", "Knee", "Foot"))]
_ARMS = [i for i, name in enumerate(JOINTS) if "Elbow" in name or "Hand" in name]


def walk(times_s: Float[ndarray, " n"]) -> Float[ndarray, "n 18 3"]:
    """Joints in the world: once around in 8 s, facing where it goes."""
    turn = 2 * np.pi * times_s / 8
    cos, sin = np.cos(turn), np.sin(turn)
    joints = np.tile(REST, (len(times_s), 1, 1))
    joints[:, _ARMS, 1] += 0.25 * np.sin(3 * times_s)[:, None]
    joints[:, _ARMS, 2] += 0.15 * np.cos(2 * times_s)[:, None]
    turned = joints.copy()
    turned[..., 0] = joints[..., 0] * cos[:, None] - joints[..., 1] * sin[:, None]
    turned[..., 1] = joints[..., 0] * sin[:, None] + joints[..., 1] * cos[:, None]
    return turned + np.stack([0.6 * cos, 0.6 * sin, 0 * cos], 1)[:, None]


def wander(times_s: Float[ndarray, " n"], seed: int = 0) -> Float[ndarray, "n 18 3"]:
    """Joints in the world: here and there, arms and legs in movements that do not repeat."""
    rng = np.random.default_rng(seed)
    fine_s = np.arange(times_s.min() - 2, times_s.max() + 2, 0.05)

    def drawn(count: int, smooth_s: float) -> Float[ndarray, "n count"]:
        smooth = gaussian_filter1d(rng.normal(size=(len(fine_s), count)), smooth_s / 0.05, axis=0)
        smooth /= smooth.std(0)
        return np.stack([np.interp(times_s, fine_s, column) for column in smooth.T], 1)

    joints = np.tile(REST, (len(times_s), 1, 1))
    joints[:, _ENDS] += 0.12 * drawn(3 * len(_ENDS), 0.3).reshape(len(times_s), -1, 3)
    turn = drawn(1, 2.0)[:, 0]
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    turned = joints.copy()
    turned[..., 0] = joints[..., 0] * cos - joints[..., 1] * sin
    turned[..., 1] = joints[..., 0] * sin + joints[..., 1] * cos
    place = 0.6 * drawn(2, 1.5)
    return turned + np.stack([place[:, 0], place[:, 1], 0 * turn], 1)[:, None]


def stand(azimuth_deg: float, height_m: float = 1.6) -> Float[ndarray, "4 4"]:
    """``world_from_camera`` of a camera that looks at the middle."""
    azimuth = np.deg2rad(azimuth_deg)
    return look_at(np.array([2.6 * np.sin(azimuth), -2.6 * np.cos(azimuth), height_m]), np.array([0.0, 0.0, 0.9]))


def track(
    pose: Float[ndarray, "4 4"],
    times_s: Float[ndarray, " n"],
    rng: np.random.Generator,
    noise_m: float = 0.03,
    offset_s: float = 0.0,
    movement: Callable[[Float[ndarray, " n"]], Float[ndarray, "n 18 3"]] = walk,
) -> JointTrack:
    """The figure as a camera estimates it; the camera exposes ``offset_s`` after its timestamps."""
    joints = transform_points(rigid_inverse(pose), movement(times_s + offset_s))
    sigma = np.full(joints.shape[:2], np.sqrt(3) * noise_m)
    return JointTrack(times_s, joints + rng.normal(0, noise_m, joints.shape), sigma)


def errors(
    estimated: Float[ndarray, "4 4"], true: Float[ndarray, "4 4"], point: tuple[float, float, float]
) -> tuple[float, float]:
    """A pose's errors: of the position of a point (metres), and of the rotation (radians)."""
    difference = estimated @ rigid_inverse(true)
    distance = np.linalg.norm(transform_points(difference, np.array(point)) - point)
    return float(distance), float(np.arccos(np.clip((np.trace(difference[:3, :3]) - 1) / 2, -1, 1)))
