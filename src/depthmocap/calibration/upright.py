"""The up direction and the floor: from the person's body and feet first, then from the visible floor."""

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
#: Height of an ankle over the floor while its foot stands (metres).
_ANKLE_M = 0.08
#: Least spread of the standing feet in every direction from which they determine the floor (metres, standard
#: deviation).
_LEAST_SPREAD_M = 0.2
#: Standard deviation of the heights of standing ankles (metres).
_ANKLE_SIGMA_M = 0.02
#: A horizontal surface farther than this from the floor of the feet is not the floor (metres).
_FLOOR_TOLERANCE_M = 0.2

FloorSource = Literal["floor", "feet", "body"]


@dataclasses.dataclass(frozen=True, eq=False)
class Upright:
    """A world with Z up and the floor at z = 0. Its origin is below the median position of the person, and the first
    camera looks along +Y.

    Attributes:
        world_from_old: 4×4, from the world that the poses were in.
        source: "floor": cameras see it. "feet": from where the feet stood, to a few centimetres. "body": from the long
            axis of the body, because the feet stood in one place; up may be wrong by several degrees.
    """

    world_from_old: Float[ndarray, "4 4"]
    source: FloorSource


def find_upright(poses: Float[ndarray, "k 4 4"], skeletons: Skeletons, empty: Sequence[View]) -> Upright:
    """Find the up direction and the floor.

    Args:
        poses: ``world_from_camera`` in some world.
        empty: views of the empty scene, of the same cameras.
    """
    joints = mean_joints(poses, skeletons)
    joints = joints[np.isfinite(joints).all((1, 2))]
    neck, ankles = joints[:, JOINT_INDEX["Neck"]], joints[:, _FEET]
    body_axes = neck - ankles.mean(1)
    up = np.median(body_axes / np.linalg.norm(body_axes, axis=1, keepdims=True), axis=0)
    source: FloorSource = "body"
    standing_ankles = _standing(ankles, up)
    if (normal := _feet_normal(standing_ankles, up)) is not None:
        up, source = normal, "feet"
    standing_ankles = _standing(ankles, up)
    world_from_old = np.eye(4)
    world_from_old[:3, :3] = rotation_between(up, np.array([0.0, 0.0, 1.0]))
    world_from_old[2, 3] = _ANKLE_M - np.median(standing_ankles @ world_from_old[2, :3])
    views = [
        View(dataclasses.replace(view.camera, world_from_camera=world_from_old @ pose), view.depth_m)
        for view, pose in zip(empty, poses, strict=True)
    ]
    floor_from_world = find_floor(views, "z")
    centre = np.median(transform_points(world_from_old, joints[:, JOINT_INDEX["Hip"]]), axis=0)
    has_floor = not np.array_equal(floor_from_world, np.eye(4))
    if has_floor and abs((floor_from_world @ [*centre[:2], 0.0, 1.0])[2]) < _FLOOR_TOLERANCE_M:
        world_from_old, source = floor_from_world @ world_from_old, "floor"
    return Upright(_centred(world_from_old, poses[0], joints[:, JOINT_INDEX["Hip"]]), source)


def _standing(ankles: Float[ndarray, "n 2 3"], up: Float[ndarray, "3"]) -> Float[ndarray, "n 3"]:
    """The lower ankle of each frame: its foot carries the body, except in jumps."""
    lower = (ankles @ up).argmin(1)
    return ankles[np.arange(len(ankles)), lower]


def _feet_normal(standing_ankles: Float[ndarray, "n 3"], up: Float[ndarray, "3"]) -> Float[ndarray, "3"] | None:
    """The normal of the plane through the standing ankles; None if they do not determine it."""
    weights = np.ones(len(standing_ankles))
    normal = up
    for _ in range(20):
        normalised = weights / weights.sum()
        centre = normalised @ standing_ankles
        offsets = standing_ankles - centre
        spread, axes = np.linalg.eigh((offsets * normalised[:, None]).T @ offsets)
        if np.sqrt(spread[1]) < _LEAST_SPREAD_M:
            return None
        normal = axes[:, 0] * np.sign(axes[:, 0] @ up)
        weights = geman_mcclure(offsets @ normal / _ANKLE_SIGMA_M)
    return normal


def _centred(
    world_from_old: Float[ndarray, "4 4"], first_pose: Float[ndarray, "4 4"], hips: Float[ndarray, "n 3"]
) -> Float[ndarray, "4 4"]:
    """The same world, translated over the floor and rotated about the vertical."""
    centre = np.median(transform_points(world_from_old, hips), axis=0)
    x, y, _ = world_from_old[:3, :3] @ first_pose[:3, 2]
    length = np.hypot(x, y)
    cos, sin = (y / length, x / length) if length > 1e-6 else (1.0, 0.0)
    recentred = np.eye(4)
    recentred[:2, :2] = [[cos, -sin], [sin, cos]]
    recentred[:2, 3] = -recentred[:2, :2] @ centre[:2]
    return recentred @ world_from_old
