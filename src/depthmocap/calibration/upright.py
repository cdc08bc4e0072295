"""Which way is up, and where the floor is: from how the person stands, then from the floor itself."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.calibration.camera_placement import mean_joints
from depthmocap.calibration.joint_tracks import Skeletons
from depthmocap.calibration.pairs import geman_mcclure
from depthmocap.frames import View
from depthmocap.geometry import rotation_between, transform_points
from depthmocap.segment.floor import find_floor

_FEET = [JOINT_INDEX["LFoot"], JOINT_INDEX["RFoot"]]
#: An ankle is this high over the floor while its foot stands (metres).
_ANKLE_M = 0.08
#: Feet tell how the floor lies if they stood this far apart in every direction (metres, standard deviation).
_LEAST_SPREAD_M = 0.2
#: Heights of standing ankles vary by this (metres).
_ANKLE_SIGMA_M = 0.02
#: A level surface further from where the feet stand is not the floor (metres).
_OFF_M = 0.2

Floor = Literal["floor", "feet", "body"]


@dataclasses.dataclass(frozen=True, eq=False)
class Upright:
    """A world with Z up and the floor at z = 0, its origin under the middle of where the person was, the first camera
    looking along +Y.

    Attributes:
        world_from_old: from the world that the poses were in.
        told_by: "floor": cameras see it. "feet": by where the feet stood, to a few centimetres. "body": by the body's
            long axis, the feet having stood in one place; up may be off by several degrees.
    """

    world_from_old: Float[ndarray, "4 4"]
    told_by: Floor


def stand_up(poses: Float[ndarray, "k 4 4"], seen: Skeletons, empty: Sequence[View]) -> Upright:
    """Find up and the floor.

    Args:
        poses: ``world_from_camera`` in some world.
        empty: views of the empty scene, of the same cameras.
    """
    joints = mean_joints(poses, seen)
    joints = joints[np.isfinite(joints).all((1, 2))]
    neck, ankles = joints[:, JOINT_INDEX["Neck"]], joints[:, _FEET]
    along = neck - ankles.mean(1)
    up = np.median(along / np.linalg.norm(along, axis=1, keepdims=True), axis=0)
    told_by: Floor = "body"
    standing = _standing(ankles, up)
    if (normal := _feet_normal(standing, up)) is not None:
        up, told_by = normal, "feet"
    standing = _standing(ankles, up)
    world_from_old = np.eye(4)
    world_from_old[:3, :3] = rotation_between(up, np.array([0.0, 0.0, 1.0]))
    world_from_old[2, 3] = _ANKLE_M - np.median(standing @ world_from_old[2, :3])
    views = [
        View(dataclasses.replace(view.camera, world_from_camera=world_from_old @ pose), view.depth_m)
        for view, pose in zip(empty, poses, strict=True)
    ]
    floor_from_world = find_floor(views, "z")
    middle = np.median(transform_points(world_from_old, joints[:, JOINT_INDEX["Hip"]]), axis=0)
    found = not np.array_equal(floor_from_world, np.eye(4))
    if found and abs((floor_from_world @ [*middle[:2], 0.0, 1.0])[2]) < _OFF_M:
        world_from_old, told_by = floor_from_world @ world_from_old, "floor"
    return Upright(_centred(world_from_old, poses[0], joints[:, JOINT_INDEX["Hip"]]), told_by)


def _standing(ankles: Float[ndarray, "n 2 3"], up: Float[ndarray, "3"]) -> Float[ndarray, "n 3"]:
    """The lower ankle of every moment: its foot carries the body, but for jumps."""
    lower = (ankles @ up).argmin(1)
    return ankles[np.arange(len(ankles)), lower]


def _feet_normal(standing: Float[ndarray, "n 3"], up: Float[ndarray, "3"]) -> Float[ndarray, "3"] | None:
    """The normal of the plane through standing ankles; None where they do not tell it."""
    weights = np.ones(len(standing))
    normal = up
    for _ in range(20):
        share = weights / weights.sum()
        middle = share @ standing
        off = standing - middle
        spread, axes = np.linalg.eigh((off * share[:, None]).T @ off)
        if np.sqrt(spread[1]) < _LEAST_SPREAD_M:
            return None
        normal = axes[:, 0] * np.sign(axes[:, 0] @ up)
        weights = geman_mcclure(off @ normal / _ANKLE_SIGMA_M)
    return normal


def _centred(
    world_from_old: Float[ndarray, "4 4"], first: Float[ndarray, "4 4"], hips: Float[ndarray, "n 3"]
) -> Float[ndarray, "4 4"]:
    """The same world, moved over the floor and turned about the vertical."""
    middle = np.median(transform_points(world_from_old, hips), axis=0)
    x, y, _ = world_from_old[:3, :3] @ first[:3, 2]
    length = np.hypot(x, y)
    cos, sin = (y / length, x / length) if length > 1e-6 else (1.0, 0.0)
    turned = np.eye(4)
    turned[:2, :2] = [[cos, -sin], [sin, cos]]
    turned[:2, 3] = -turned[:2, :2] @ middle[:2]
    return turned @ world_from_old
