"""Joints as one camera estimates them, simulated: the true joints of the data engine's bodies with errors that are
correlated over time, larger along the view, behind the trunk and on limbs, and now and then with the sides exchanged.

Quick stand-ins for tracks from depth pictures, of which the trial has fewer.
"""

from __future__ import annotations

import numpy as np
from calibration_trial_scene import MotionKind, person_motion
from jaxtyping import Float
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d

from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.calibration.joint_tracks import JointTrack
from depthmocap.geometry import look_at, rigid_inverse, transform_points
from depthmocap.synth.people.garments import DressedBody

#: Standard deviation of a joint's error along the view and across it (metres), of the trunk and of the limbs.
_TRUNK_M, _LIMB_M = (0.017, 0.010), (0.026, 0.016)
#: Time constant of these errors (seconds), and the part of them that differs from frame to frame (metres).
_CORRELATED_S, _JITTER_M = 0.35, 0.010
#: Errors of limbs behind the trunk are so many times larger.
_HIDDEN = 2.5
#: Share of the time in which left and right are exchanged, and the length of each (seconds).
_SWAPPED, _SWAP_S = 0.03, 0.5
_LIMBS = np.array([any(part in name for part in ("Elbow", "Hand", "Knee", "Foot")) for name in JOINTS])
_MIRRORED = np.array([JOINT_INDEX[{"R": "L", "L": "R"}.get(n[0], n[0]) + n[1:]] for n in JOINTS])


def true_joints(
    dressed: DressedBody, rng: np.random.Generator, kind: MotionKind, seconds: float, rate_hz: float = 60.0
) -> tuple[Float[ndarray, " n"], Float[ndarray, "n 18 3"]]:
    """Times (seconds) and the joints in the world (metres) of a person who moves so."""
    times_s = np.arange(round(seconds * rate_hz)) / rate_hz
    motion = person_motion(rng, dressed, kind, seconds)(times_s)
    bones = dressed.body.model.joint_bones
    heads = [dressed.body.bone_transforms(posture).heads[bones] for posture in motion.postures]
    return times_s, np.stack(heads) + motion.offsets[:, None]


def camera_pose(rng: np.random.Generator, azimuth_deg: float) -> Float[ndarray, "4 4"]:
    """``world_from_camera`` of a camera that looks at the middle from about 2.6 m."""
    azimuth = np.deg2rad(azimuth_deg)
    eye = np.array([2.6 * np.sin(azimuth), -2.6 * np.cos(azimuth), rng.uniform(1.0, 2.2)])
    return look_at(eye, np.array([0.0, 0.0, 0.95]))


def simulated_track(
    true: tuple[Float[ndarray, " n"], Float[ndarray, "n 18 3"]],
    exposed_s: Float[ndarray, " t"],
    world_from_camera: Float[ndarray, "4 4"],
    rng: np.random.Generator,
) -> JointTrack:
    """The track of a camera that exposes at these times (seconds of the true joints), with them as its timestamps."""
    fine_s, joints_world = true
    flat = joints_world.reshape(len(fine_s), -1)
    world = np.stack([np.interp(exposed_s, fine_s, column) for column in flat.T], 1).reshape(-1, len(JOINTS), 3)
    joints = transform_points(rigid_inverse(world_from_camera), world)
    period_s = float(np.median(np.diff(exposed_s)))
    along, across = np.where(_LIMBS, _LIMB_M[0], _TRUNK_M[0]), np.where(_LIMBS, _LIMB_M[1], _TRUNK_M[1])
    trunk = joints[:, [JOINT_INDEX["Spine1"]]]
    hidden = (joints[..., 2] > trunk[..., 2] + 0.03) & (np.abs(joints[..., 0] - trunk[..., 0]) < 0.18) & _LIMBS
    size = np.where(hidden, _HIDDEN, 1.0)
    noise = gaussian_filter1d(rng.normal(size=joints.shape), _CORRELATED_S / period_s, axis=0)
    noise /= noise.std(0)
    rays = joints / np.linalg.norm(joints, axis=-1, keepdims=True)
    ahead = (noise * rays).sum(-1, keepdims=True) * rays
    errors = size[..., None] * (along[:, None] * ahead + across[:, None] * (noise - ahead))
    seen = joints + errors + _JITTER_M * rng.normal(size=joints.shape)
    swap = gaussian_filter1d(rng.normal(size=len(exposed_s)), _SWAP_S / period_s)
    swap = swap > np.quantile(swap, 1 - _SWAPPED)
    seen[swap] = seen[swap][:, _MIRRORED]
    sigma_m = size * np.sqrt(along**2 + 2 * across**2 + 3 * _JITTER_M**2) * rng.uniform(0.8, 1.3, size.shape)
    return JointTrack(exposed_s, seen, sigma_m)
