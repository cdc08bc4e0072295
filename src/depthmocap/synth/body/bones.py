"""Postures: local rotations of 20 bones, the form that postures are stored, sampled and retargeted in.

A posture is ``(20, 3)`` rotation vectors. The first is the rotation of the pelvis away from the rest pose, in the
world; every other is the rotation of its bone away from rest, in the frame of its parent. In the rest pose all
rotations are the identity; a body stands upright (+Z up), faces −Y and has its left at +X.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

#: (posture bone, its parent, the Anny bones that turn with it).
_TABLE: tuple[tuple[str, str | None, tuple[str, ...]], ...] = (
    ("pelvis", None, ("root",)),
    ("spine_low", "pelvis", ("spine05", "spine04")),
    ("spine_mid", "spine_low", ("spine03", "spine02")),
    ("spine_up", "spine_mid", ("spine01",)),
    ("neck", "spine_up", ("neck01", "neck02", "neck03")),
    ("head", "neck", ("head",)),
    *(
        row
        for side in ("R", "L")
        for row in (
            (f"clavicle.{side}", "spine_up", (f"clavicle.{side}", f"shoulder01.{side}")),
            (f"upper_arm.{side}", f"clavicle.{side}", (f"upperarm01.{side}", f"upperarm02.{side}")),
            (f"forearm.{side}", f"upper_arm.{side}", (f"lowerarm01.{side}", f"lowerarm02.{side}")),
            (f"hand.{side}", f"forearm.{side}", (f"wrist.{side}",)),
            (f"thigh.{side}", "pelvis", (f"upperleg01.{side}", f"upperleg02.{side}")),
            (f"shin.{side}", f"thigh.{side}", (f"lowerleg01.{side}", f"lowerleg02.{side}")),
            (f"foot.{side}", f"shin.{side}", (f"foot.{side}",)),
        )
    ),
)

POSTURE_BONES: tuple[str, ...] = tuple(name for name, _, _ in _TABLE)
POSTURE_INDEX: dict[str, int] = {name: i for i, name in enumerate(POSTURE_BONES)}
POSTURE_PARENTS: tuple[int, ...] = tuple(POSTURE_INDEX[parent] if parent else -1 for _, parent, _ in _TABLE)
#: Anny bone → posture bone, for the bones that have a rotation of their own; the others follow their parent.
POSTURE_OF_ANNY: dict[str, int] = {bone: POSTURE_INDEX[name] for name, _, bones in _TABLE for bone in bones}


def _mirror(name: str) -> str:
    return name[:-1] + {"R": "L", "L": "R"}[name[-1]] if name[-2] == "." else name


_MIRROR_ORDER = np.array([POSTURE_INDEX[_mirror(name)] for name in POSTURE_BONES])


def world_rotations(postures: Float[ndarray, "*n 20 3"]) -> Float[ndarray, "*n 20 3 3"]:
    """Rotation of every posture bone away from rest, in the world."""
    local = Rotation.from_rotvec(postures.reshape(-1, 3)).as_matrix().reshape(*postures.shape[:-1], 3, 3)
    world = local.copy()
    for i, parent in enumerate(POSTURE_PARENTS):
        if parent >= 0:
            world[..., i, :, :] = world[..., parent, :, :] @ local[..., i, :, :]
    return world


def local_rotations(world: Float[ndarray, "*n 20 3 3"]) -> Float[ndarray, "*n 20 3"]:
    """Postures of world rotations away from rest: the inverse of :func:`world_rotations`."""
    local = world.copy()
    for i, parent in enumerate(POSTURE_PARENTS):
        if parent >= 0:
            local[..., i, :, :] = np.swapaxes(world[..., parent, :, :], -1, -2) @ world[..., i, :, :]
    return Rotation.from_matrix(local.reshape(-1, 3, 3)).as_rotvec().reshape(*world.shape[:-2], 3)


def mirror_posture(postures: Float[ndarray, "*n 20 3"]) -> Float[ndarray, "*n 20 3"]:
    """The mirror image in the sagittal (x = 0) plane: left and right exchanged."""
    return postures[..., _MIRROR_ORDER, :] * np.array([1.0, -1.0, -1.0], dtype=postures.dtype)


def turn_posture(postures: Float[ndarray, "*n 20 3"], heading_rad: float | ndarray) -> Float[ndarray, "*n 20 3"]:
    """The posture turned about the vertical by an angle (or one angle each)."""
    turned = postures.copy()
    flat = postures[..., 0, :].reshape(-1, 3)
    heading = np.broadcast_to(np.asarray(heading_rad, dtype=float), postures.shape[:-2]).reshape(-1)
    turns = Rotation.from_rotvec(heading[:, None] * np.array([0.0, 0.0, 1.0]))
    turned[..., 0, :] = (turns * Rotation.from_rotvec(flat)).as_rotvec().reshape(postures[..., 0, :].shape)
    return turned


def heading(postures: Float[ndarray, "*n 20 3"]) -> Float[ndarray, "*n"]:
    """Angle about the vertical of the pelvis: the twist about +Z of its rotation (radians)."""
    quaternions = Rotation.from_rotvec(postures[..., 0, :].reshape(-1, 3)).as_quat()
    return (2 * np.arctan2(quaternions[:, 2], quaternions[:, 3])).reshape(postures.shape[:-2])
