"""People who lie at rest, as in bed, which motion capture hardly shows: on the back, a side or the front."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.synth.body.bones import POSTURE_BONES, POSTURE_INDEX
from depthmocap.synth.motion.extreme_postures import LegAngles, arm_rotations, capsule_points, self_intersects
from depthmocap.synth.motion.limits import within_limits

#: Shares of people who lie on the back, on a side and on the front.
_ON = (0.55, 0.3, 0.15)
#: Share of people on the back with a knee drawn up.
_KNEE_UP = 0.2
#: Share of arms whose hand lies on the trunk or by the head.
_ARM_BENT = 0.4
#: Standard deviation of the roll of a lying body about its length (radians).
_ROLL_RAD = 0.2
#: Arms are no deeper than this below the lowest part of the trunk and legs (metres).
_SINK_M = 0.06
_ARMS = tuple(f"{bone}.{side}" for bone in ("upper_arm", "forearm", "hand") for side in "RL")
_TRIES = 30


def lying_posture(rng: np.random.Generator) -> Float[ndarray, "20 3"]:
    """Somebody at rest, lying with the head towards +Y: rotation vectors of the posture's bones."""
    side = float(rng.choice([0.0, np.pi / 2, np.pi], p=_ON))
    roll = side * rng.choice([-1.0, 1.0]) + rng.normal(0, _ROLL_RAD)
    laid = Rotation.from_euler("zx", [roll, -np.pi / 2]).as_rotvec()
    posture = np.zeros((len(POSTURE_BONES), 3))
    for _ in range(_TRIES):
        posture = _relaxed(rng, side)
        posture[0] = laid
        if within_limits(posture[None])[0] and not self_intersects(posture) and _arms_lie(posture):
            return posture
    for name in _ARMS:
        posture[POSTURE_INDEX[name]] = 0.0
    return posture


def _arms_lie(posture: Float[ndarray, "20 3"]) -> bool:
    """Whether no arm is deep in what the trunk lies on."""
    heights = capsule_points(posture)[..., 2].min(1)
    arms = [POSTURE_INDEX[name] for name in _ARMS]
    trunk = [i for i in range(len(POSTURE_BONES)) if i not in arms]
    return bool(heights[arms].min() > heights[trunk].min() - _SINK_M)


def _relaxed(rng: np.random.Generator, side: float) -> Float[ndarray, "20 3"]:
    posture = np.zeros((len(POSTURE_BONES), 3))
    curled = np.deg2rad(rng.uniform(0, 80)) if side == np.pi / 2 else 0.0
    for name in "RL":
        flexion, knee = np.abs(np.deg2rad(rng.normal(0, [6, 8])))
        if side == 0 and rng.random() < _KNEE_UP:
            flexion, knee = np.deg2rad([rng.uniform(30, 55), rng.uniform(60, 110)])
        flexion, knee = flexion + curled, knee + curled * rng.uniform(0.8, 1.3)
        spread, about, foot = np.deg2rad([rng.uniform(0, 3 if curled else 10), rng.normal(10, 12), rng.uniform(-40, 0)])
        for bone, angles in LegAngles(flexion, spread, about, knee, foot, 0.0).rotations(name).items():
            posture[POSTURE_INDEX[bone]] = angles
        out = 1.0 if name == "L" else -1.0
        bent = rng.uniform(60, 125) if rng.random() < _ARM_BENT else abs(rng.normal(0, 15))
        forward = rng.uniform(0.2, 1.0) if curled else rng.uniform(-0.05, 0.25)
        direction = np.array([out * rng.uniform(0.1, 0.5), -forward, -1.0])
        arm = arm_rotations(
            name, direction / np.linalg.norm(direction), np.deg2rad(rng.uniform(-40, 40)), np.deg2rad(bent),
            np.deg2rad(rng.uniform(-50, 50)),
        )  # fmt: skip
        for bone, angles in arm.items():
            posture[POSTURE_INDEX[bone]] = angles
    for bone in ("spine_low", "spine_mid", "spine_up", "neck", "head"):
        posture[POSTURE_INDEX[bone]] = np.deg2rad(rng.normal([curled * 8, 0, 0], [4, 3, 4]))
    return posture
