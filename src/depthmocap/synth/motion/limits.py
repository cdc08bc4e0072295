"""Joint limits of recorded, sampled and perturbed postures.

The limits are our choice. They are wider than clinical ranges of motion of single joints, because our bones stand for
several joints (a spine bone for a third of the spine, an upper arm for the whole shoulder where a file has no clavicle)
and because clips differ in their rest poses.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.synth.body.bones import POSTURE_BONES, POSTURE_INDEX

#: Largest swing and twist of each kind of bone away from rest (degrees). The pelvis has no limits.
LIMITS_DEG: dict[str, tuple[float, float]] = {
    "spine_low": (75, 60),
    "spine_mid": (50, 40),
    "spine_up": (50, 40),
    "neck": (75, 70),
    "head": (85, 70),
    "clavicle": (45, 60),
    "upper_arm": (145, 150),
    "forearm": (165, 140),
    "hand": (95, 125),
    "thigh": (140, 110),
    "shin": (155, 80),
    "foot": (90, 70),
}
#: Largest hyperextension of a knee (radians).
_KNEE_FORWARDS_RAD = np.deg2rad(20)


def bone_axis(bone: str) -> Float[ndarray, "3"]:
    """Direction of a posture bone at rest: arms 40 degrees down from the side, legs straight, the trunk upright."""
    kind, _, side = bone.partition(".")
    out = -1.0 if side == "R" else 1.0
    axis = np.array({
        "clavicle": [out, 0, 0], "upper_arm": [out * 0.75, 0, -0.66], "forearm": [out * 0.75, -0.3, -0.6],
        "hand": [out * 0.7, -0.4, -0.6], "thigh": [0, 0, -1], "shin": [0, 0, -1], "foot": [0, -0.9, -0.4],
    }.get(kind, [0, 0, 1]), dtype=float)  # fmt: skip
    return axis


def swing_twist(
    postures: Float[ndarray, "n 20 3"],
) -> tuple[Float[ndarray, "n 20"], Float[ndarray, "n 20"]]:
    """Swing (angle between every bone's axis and its axis at rest) and twist (angle about the axis), radians."""
    axes = np.stack([bone_axis(bone) / np.linalg.norm(bone_axis(bone)) for bone in POSTURE_BONES])
    quaternions = Rotation.from_rotvec(postures.reshape(-1, 3)).as_quat().reshape(*postures.shape[:2], 4)
    along = (quaternions[..., :3] * axes).sum(-1)
    real = quaternions[..., 3]
    # q = swing ∘ twist; the twist is the part of q along the axis.
    swing = 2 * np.arccos(np.clip(np.hypot(along, real), 0, 1))
    twist = 2 * np.arctan2(along, real)
    return swing, (twist + np.pi) % (2 * np.pi) - np.pi


def beyond_limits(postures: Float[ndarray, "n 20 3"]) -> Bool[ndarray, "n 20"]:
    """Bones of each posture that exceed :data:`LIMITS_DEG`, and hyperextended knees."""
    swing, twist = swing_twist(postures.astype(np.float64))
    beyond = np.zeros(postures.shape[:2], dtype=bool)
    for bone, index in POSTURE_INDEX.items():
        kind = bone.partition(".")[0]
        if kind in LIMITS_DEG:
            largest_swing, largest_twist = np.deg2rad(LIMITS_DEG[kind])
            beyond[:, index] = (swing[:, index] > largest_swing) | (np.abs(twist[:, index]) > largest_twist)
        if kind == "shin":
            beyond[:, index] |= postures[:, index, 0] < -_KNEE_FORWARDS_RAD
    return beyond


def within_limits(postures: Float[ndarray, "n 20 3"]) -> Bool[ndarray, "n"]:
    """Whether all bones of each posture are within :data:`LIMITS_DEG` and no knee is hyperextended."""
    return np.asarray(~beyond_limits(postures).any(1))
