"""Joint angles by the conventions of the International Society of Biomechanics, as far as joints tell them.

After Wu et al. 2002 (hip, knee, spine; Grood and Suntay's sequence: flexion about the proximal segment's lateral axis
first, then ab- or adduction) and Wu et al. 2005 (shoulder: plane of elevation, elevation, axial rotation; elbow). The
segments' frames are made of joint centres, not of the bony landmarks of these papers, so that zeros may differ by a
constant few degrees; pelvis and thorax are those of the take's skeleton of constant bones (``solve_body``).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.analysis.steady_joints import SteadyJoints
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.exporting.body_motion import solve_body

#: Below this elevation an arm's plane of elevation and axial rotation are undefined (degrees).
_LEAST_ELEVATION = 15.0
#: Below this flexion an elbow does not show how the upper arm is turned (degrees).
_LEAST_FLEXION = 30.0
#: Sides by the first letter of their joints.
SIDES = {"left": "L", "right": "R"}
#: Angles of a side, and of the whole person; positive is what the name says.
SIDE_ANGLES = (
    "hip_flexion", "hip_adduction", "knee_flexion", "shoulder_plane", "shoulder_elevation", "shoulder_rotation",
    "elbow_flexion",
)  # fmt: skip
BODY_ANGLES = (
    "pelvis_tilt", "pelvis_obliquity", "pelvis_heading", "trunk_lean", "trunk_flexion", "trunk_bend", "trunk_rotation",
)  # fmt: skip
#: Angles that joints do not tell.
UNKNOWN = "ankle angles, hip rotation, knee ab-/adduction and rotation, pronation, wrist, neck and head"


def column(angle: str, side: str = "") -> str:
    """The name of an angle of a side, such as ``knee_flexion_left``."""
    return f"{angle}_{side}" if side else angle


def joint_angles(steady: SteadyJoints) -> dict[str, Float[ndarray, " t"]]:
    """Every angle in degrees over time by its name (:func:`column`), NaN where a joint that it needs was not seen."""
    motion = solve_body(steady.timeline())
    world, hidden = motion.world_rotations(), motion.rotation_held
    pelvis, thorax = (_isb_frame(world[:, JOINT_INDEX[joint]]) for joint in ("Hip", "Spine2"))
    for frame, joint in ((pelvis, "Hip"), (thorax, "Spine2")):
        frame[hidden[:, JOINT_INDEX[joint]]] = np.nan
    angles = _of_the_trunk(pelvis, thorax)
    for side, letter in SIDES.items():
        points = {name: steady.of(f"{letter}{name}") for name in ("Hip", "Knee", "Foot", "Shoulder", "Elbow", "Hand")}
        thigh = _mirrored(_in_frame(pelvis, points["Hip"] - points["Knee"]), side)
        angles[column("hip_flexion", side)] = _unwrapped(np.degrees(np.arctan2(-thigh[:, 0], thigh[:, 1])))
        angles[column("hip_adduction", side)] = np.degrees(np.arcsin(np.clip(thigh[:, 2], -1, 1)))
        angles[column("knee_flexion", side)] = _flexion(points["Hip"], points["Knee"], points["Foot"])
        elbow = angles[column("elbow_flexion", side)] = _flexion(points["Shoulder"], points["Elbow"], points["Hand"])
        arm = _mirrored(_in_frame(thorax, points["Shoulder"] - points["Elbow"]), side)
        forearm = _mirrored(_in_frame(thorax, points["Elbow"] - points["Hand"]), side)
        plane, elevation, rotation = _shoulder(arm, forearm, elbow)
        angles[column("shoulder_plane", side)] = plane
        angles[column("shoulder_elevation", side)] = elevation
        angles[column("shoulder_rotation", side)] = rotation
    return angles


def _isb_frame(rotation: Float[ndarray, "t 3 3"]) -> Float[ndarray, "t 3 3"]:
    """Columns X forward, Y up, Z to the right, of a bone whose axes at rest are x left, y up, z forward."""
    return np.stack([rotation[..., 2], rotation[..., 1], -rotation[..., 0]], -1)


def _in_frame(frame: Float[ndarray, "t 3 3"], vectors: Float[ndarray, "t 3"]) -> Float[ndarray, "t 3"]:
    """Unit vectors in a frame's axes."""
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.einsum("tji,tj->ti", frame, unit)


def _mirrored(vectors: Float[ndarray, "t 3"], side: str) -> Float[ndarray, "t 3"]:
    """A left limb as a right one."""
    return vectors * [1.0, 1.0, -1.0] if side == "left" else vectors


def _flexion(
    proximal: Float[ndarray, "t 3"], joint: Float[ndarray, "t 3"], distal: Float[ndarray, "t 3"]
) -> Float[ndarray, " t"]:
    """How far a hinge is bent, 0 straight; without a sign, so that nothing is overextended."""
    first, second = joint - proximal, distal - joint
    across = np.linalg.norm(np.cross(first, second), axis=-1)
    return np.degrees(np.arctan2(across, (first * second).sum(-1)))


def _of_the_trunk(pelvis: Float[ndarray, "t 3 3"], thorax: Float[ndarray, "t 3 3"]) -> dict[str, Float[ndarray, " t"]]:
    """The pelvis in the world (heading first, so that tilt and obliquity do not depend on where the person walks), and
    the thorax on the pelvis (flexion, bend, rotation)."""
    between = np.swapaxes(pelvis, 1, 2) @ thorax
    obliquity = np.degrees(np.arcsin(np.clip(pelvis[:, 1, 2], -1, 1)))  # the right side up
    heading = np.degrees(np.arctan2(-pelvis[:, 2, 0], pelvis[:, 0, 0]))
    return {
        "pelvis_tilt": np.degrees(np.arctan2(-pelvis[:, 1, 0], np.hypot(pelvis[:, 0, 0], pelvis[:, 2, 0]))),
        "pelvis_obliquity": obliquity,
        "pelvis_heading": _unwrapped(heading),
        "trunk_lean": np.degrees(np.arctan2(-thorax[:, 1, 0], thorax[:, 1, 1])),
        "trunk_flexion": np.degrees(np.arctan2(between[:, 0, 1], between[:, 1, 1])),
        "trunk_bend": np.degrees(np.arcsin(np.clip(between[:, 2, 1], -1, 1))),  # to the right
        "trunk_rotation": np.degrees(np.arctan2(-between[:, 2, 0], between[:, 2, 2])),  # to the left
    }


def _shoulder(
    arm: Float[ndarray, "t 3"], forearm: Float[ndarray, "t 3"], elbow: Float[ndarray, " t"]
) -> tuple[Float[ndarray, " t"], Float[ndarray, " t"], Float[ndarray, " t"]]:
    """Plane of elevation (0 sideways, 90 forwards), elevation and axial rotation (inwards positive) of a right arm.

    The humerus' frame is the second option of Wu et al. 2005, which takes its lateral axis across the forearm.
    """
    elevation = np.degrees(np.arccos(np.clip(arm[:, 1], -1, 1)))
    defined = (elevation >= _LEAST_ELEVATION) & (elevation <= 180 - _LEAST_ELEVATION)
    azimuth = np.arctan2(-arm[:, 0], -arm[:, 2])
    plane = np.where(defined, np.degrees(azimuth), np.nan)
    lateral = np.cross(arm, forearm)
    with np.errstate(invalid="ignore", divide="ignore"):
        lateral = lateral / np.linalg.norm(lateral, axis=-1, keepdims=True)
    # The lateral axis of an arm that is elevated in its plane without being turned.
    raised = np.radians(elevation)
    plain = np.stack([np.sin(azimuth) * np.cos(raised), np.sin(raised), np.cos(azimuth) * np.cos(raised)], axis=-1)
    across = np.cross(arm, plain)
    turned = np.degrees(np.arctan2((lateral * across).sum(-1), (lateral * plain).sum(-1)))
    shown = defined & (elbow >= _LEAST_FLEXION)
    return plane, elevation, np.where(shown, turned, np.nan)


def _unwrapped(angle: Float[ndarray, " t"]) -> Float[ndarray, " t"]:
    """Degrees without jumps of 360 between seen frames; the first is between -180 and 180."""
    known = ~np.isnan(angle)
    smooth = angle.copy()
    smooth[known] = np.degrees(np.unwrap(np.radians(angle[known])))
    return smooth
