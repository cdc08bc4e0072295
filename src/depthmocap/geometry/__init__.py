"""Rigid transforms, depth cameras and rigs."""

from depthmocap.geometry.camera_groups import largest_group
from depthmocap.geometry.depth_camera import DepthCamera, Rig, check_extrinsics, load_rig, save_rig
from depthmocap.geometry.transforms import (
    is_rigid,
    look_at,
    rigid_inverse,
    rotation_between,
    transform_points,
    z_up_from,
)

__all__ = [
    "DepthCamera",
    "Rig",
    "check_extrinsics",
    "is_rigid",
    "largest_group",
    "load_rig",
    "look_at",
    "rigid_inverse",
    "rotation_between",
    "save_rig",
    "transform_points",
    "z_up_from",
]
