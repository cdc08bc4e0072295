"""How right a moving skeleton is: rotations of its bones with their twist, joints, lengths, and whether feet stand.

Rotations and joints are of the same frames at a constant rate, Y up, metres, bones by the joint that they start at.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.body.landmarks import LANDMARKS, POINT_MIRROR, POINT_ROWS, POINTS
from depthmocap.body.skeleton import BONES, JOINT_INDEX, JOINTS
from depthmocap.evaluate.temporal_metrics import REST_MPS
from depthmocap.exporting.bone_rotations import rest_offsets
from depthmocap.exporting.landmark_model import LandmarkModel

#: A foot swings while its true ankle moves faster than this. Between this and ``REST_MPS`` it does neither.
SWING_MPS = 0.25
#: A foot that moves less than this in a frame (m) is held.
_HELD_STEP_M = 0.002
#: Limb bones of constant direction in the T pose, by the joint that they start at.
_DIRECTIONS = {
    side + name: np.array(direction)
    for side, left in (("R", -1.0), ("L", 1.0))
    for name, direction in (
        ("Shoulder", (left, 0.0, 0.0)),
        ("Elbow", (left, 0.0, 0.0)),
        ("Hip", (0.0, -1.0, 0.0)),
        ("Knee", (0.0, -1.0, 0.0)),
    )
}
_LIMBS = [JOINT_INDEX[name] for name in _DIRECTIONS]
_AXES = np.stack(list(_DIRECTIONS.values()))
#: Groups of bones whose whole error is told.
_WHOLE = {
    "pelvis": ("Hip",),
    "spine": ("Spine", "Spine1", "Spine2"),
    "neck": ("Neck",),
    "head": ("Head",),
    "trunk_head": ("Hip", "Spine", "Spine1", "Spine2", "Neck", "Head"),
    "hands": ("RHand", "LHand"),
    "feet": ("RFoot", "LFoot"),
}
#: Groups of limb bones whose twist is told by itself.
_TWISTED = {"upper_arm": "Shoulder", "forearm": "Elbow", "thigh": "Hip", "shin": "Knee"}
#: Groups of surface landmarks: by the bone that they move with, without its side; finger tips by themselves.
LANDMARK_GROUPS: dict[str, tuple[str, ...]] = {
    "head": ("Head",),
    "trunk": ("Spine1", "Spine2"),
    "pelvis": ("Hip",),
    "arms": (".Shoulder", ".Elbow"),
    "hands": (".Hand",),
    "legs": (".Hip", ".Knee"),
    "feet": (".Foot",),
    "tips": (),
}
_FEET = [JOINT_INDEX["LFoot"], JOINT_INDEX["RFoot"]]
_HINGES = {"knee": ("Hip", "Knee", "Foot"), "elbow": ("Shoulder", "Elbow", "Hand")}


@dataclasses.dataclass(frozen=True, eq=False)
class SkeletonTrack:
    """Joints (m), rotations and surface landmarks (m; None where they are not asked for) of one sequence."""

    joints: Float[ndarray, "t 18 3"]
    rotations: Float[ndarray, "t 18 3 3"]
    landmarks: Float[ndarray, "t m 3"] | None = None


def skeleton_metrics(
    tracks: Sequence[SkeletonTrack], truths: Sequence[SkeletonTrack], period_s: float
) -> dict[str, float]:
    """Numbers over sequences one frame period (s) apart; means are over all frames and bones together.

    ``limb_swing_deg`` is the angle between the directions of a limb's bone, ``limb_twist_deg`` the error about it, and
    so for each bone; ``<group>_deg`` are whole rotation errors of trunk, head, hands and feet. ``joint_error_cm``,
    ``foot_skate_mm`` (way a frame of ankles that truly stand), ``held_in_swing`` (0–1, of frames in which an ankle
    truly swings, those in which it hardly moves), ``length_variation_mm`` (range of a bone's length in a sequence, the
    largest), ``knee_rms_deg`` and ``elbow_rms_deg`` of flexion. Where both have landmarks, ``landmarks_cm`` and
    ``landmarks_<group>_cm``: their distances, finger tips by themselves. NaN where there is nothing to measure.
    """
    pairs = list(zip(tracks, truths, strict=True))
    swing, twist = (
        np.concatenate(errors)
        for errors in zip(*(limb_errors_deg(f.rotations, t.rotations) for f, t in pairs), strict=True)
    )
    whole = np.concatenate([angles_deg(f.rotations, t.rotations) for f, t in pairs])
    numbers = {"limb_swing_deg": _mean(swing), "limb_twist_deg": _mean(twist)}
    for group, name in _TWISTED.items():
        columns = [i for i, joint in enumerate(_DIRECTIONS) if joint[1:] == name]
        numbers[f"{group}_swing_deg"] = _mean(swing[:, columns])
        numbers[f"{group}_twist_deg"] = _mean(twist[:, columns])
    for group, joints in _WHOLE.items():
        numbers[f"{group}_deg"] = _mean(whole[:, [JOINT_INDEX[joint] for joint in joints]])
    errors = np.concatenate([np.linalg.norm(f.joints - t.joints, axis=-1) for f, t in pairs])
    numbers["joint_error_cm"] = 100 * _mean(errors)
    steps = [_ankle_steps(f.joints, t.joints, period_s) for f, t in pairs]
    numbers["foot_skate_mm"] = 1e3 * _mean(np.concatenate([step[stands] for step, stands, _ in steps]))
    swinging = np.concatenate([step[swings] for step, _, swings in steps])
    numbers["held_in_swing"] = _mean((swinging < _HELD_STEP_M).astype(float))
    numbers["length_variation_mm"] = 1e3 * max(float(length_ranges(f.joints).max()) for f, _ in pairs)
    for name, limb in _HINGES.items():
        off = np.concatenate([flexions_deg(f.joints, limb) - flexions_deg(t.joints, limb) for f, t in pairs])
        numbers[f"{name}_rms_deg"] = float(np.sqrt(np.nanmean(off**2))) if np.isfinite(off).any() else float("nan")
    return numbers | _landmark_errors(pairs)


def point_errors_mm(
    beside: Sequence[Float[ndarray, "t 18 3"] | None], truths: Sequence[SkeletonTrack]
) -> dict[str, dict[str, Any]]:
    """Of each of ``POINTS``, without its side, as seen from its joint (m, Y up): how far it is from its place on its
    bone (``mean``, in the axes of the true bone, of those on the right; a median of sequences), and the deviation
    besides."""
    places = LandmarkModel.load()
    found: dict[str, list[Float[ndarray, "n 3"]]] = {name: [] for name in POINTS}
    for seen, truth in zip(beside, truths, strict=True):
        if seen is None:
            continue
        at = places.offsets_m(rest_offsets(truth.joints))[POINT_ROWS]
        for i, name in enumerate(POINTS):
            bone = truth.rotations[:, JOINT_INDEX[LANDMARKS[POINT_ROWS[i]].bone]]
            off = np.einsum("tji,tj->ti", bone, seen[:, i]) - at[i]
            off[:, 0] *= -1.0 if name[0] == "L" else 1.0
            if len(off := off[np.isfinite(off).all(1)]):
                found[name].append(1000 * off)
    errors = {}
    for i, name in enumerate(POINTS):
        sides = [found[name], found[POINTS[POINT_MIRROR[i]]]]
        if all(sides):
            mean = np.mean([np.median([np.median(off, 0) for off in side], 0) for side in sides], 0)
            if POINT_MIRROR[i] == i:
                mean[0] = 0.0
            deviation = [np.sqrt(np.mean([((off - mean) ** 2).mean() for off in side])) for side in sides]
            errors[name if POINT_MIRROR[i] == i else name[1:]] = {
                "mean": mean.round(1).tolist(), "deviation": float(np.mean(deviation).round(1))
            }  # fmt: skip
    return errors


def _landmark_errors(pairs: Sequence[tuple[SkeletonTrack, SkeletonTrack]]) -> dict[str, float]:
    apart = [
        np.linalg.norm(found.landmarks - truth.landmarks, axis=-1)
        for found, truth in pairs
        if found.landmarks is not None and truth.landmarks is not None
    ]
    if not apart:
        return {}
    errors = np.concatenate(apart)
    tips = np.array([landmark.name.endswith("Tip") for landmark in LANDMARKS])
    bones = [f".{point.bone[1:]}" if point.bone[0] in "RL" else point.bone for point in LANDMARKS]
    numbers = {"landmarks_cm": 100 * _mean(errors)}
    for group, names in LANDMARK_GROUPS.items():
        among = np.array([bone in names for bone in bones]) & ~tips if names else tips
        numbers[f"landmarks_{group}_cm"] = 100 * _mean(errors[:, among])
    return numbers


def limb_errors_deg(
    estimate: Float[ndarray, "t 18 3 3"], truth: Float[ndarray, "t 18 3 3"]
) -> tuple[Float[ndarray, "t 8"], Float[ndarray, "t 8"]]:
    """Of upper arms, forearms, thighs and shins: the angle between directions, and that about the bone (degrees)."""
    estimate, truth = estimate[:, _LIMBS], truth[:, _LIMBS]
    cosine = np.einsum("tbij,bj,tbik,bk->tb", estimate, _AXES, truth, _AXES)
    off = np.swapaxes(truth, -1, -2) @ estimate
    turns = np.stack(
        [off[..., 2, 1] - off[..., 1, 2], off[..., 0, 2] - off[..., 2, 0], off[..., 1, 0] - off[..., 0, 1]], -1
    )
    # Of the quaternion (w, v) the twist about an axis a is 2 atan2(v·a, w); v = turns / 4w, w² = (1 + trace) / 4.
    along = (turns * _AXES).sum(-1)
    trace = np.trace(off, axis1=-2, axis2=-1)
    twist = 2 * np.arctan2(np.abs(along), np.maximum(1 + trace, 1e-12))
    return np.rad2deg(np.arccos(np.clip(cosine, -1, 1))), np.rad2deg(twist)


def angles_deg(estimate: Float[ndarray, "t 18 3 3"], truth: Float[ndarray, "t 18 3 3"]) -> Float[ndarray, "t 18"]:
    """Whole angles between rotations (degrees)."""
    trace = np.einsum("tbij,tbij->tb", estimate, truth)
    return np.rad2deg(np.arccos(np.clip((trace - 1) / 2, -1, 1)))


def length_ranges(joints: Float[ndarray, "t 18 3"]) -> Float[ndarray, "17"]:
    """From the shortest to the longest that each bone is (m)."""
    ends = np.array([[JOINT_INDEX[name] for name in bone] for bone in BONES])
    lengths = np.linalg.norm(joints[:, ends[:, 0]] - joints[:, ends[:, 1]], axis=-1)
    return np.nanmax(lengths, 0) - np.nanmin(lengths, 0)


def flexions_deg(joints: Float[ndarray, "t 18 3"], limb: tuple[str, str, str]) -> Float[ndarray, "t 2"]:
    """Angles by which both sides' limbs are bent (degrees, 0 straight)."""
    flexions = []
    for side in "RL":
        start, middle, end = (joints[:, JOINT_INDEX[side + name]] for name in limb)
        upper, lower = middle - start, end - middle
        flexions.append(np.arctan2(np.linalg.norm(np.cross(upper, lower), axis=-1), (upper * lower).sum(-1)))
    return np.rad2deg(np.stack(flexions, 1))


def _ankle_steps(
    estimate: Float[ndarray, "t 18 3"], truth: Float[ndarray, "t 18 3"], period_s: float
) -> tuple[Float[ndarray, "u 2"], Bool[ndarray, "u 2"], Bool[ndarray, "u 2"]]:
    """Ways of ankles from frame to frame (m); where they truly stand; where they truly swing."""
    step, true_step = (np.linalg.norm(np.diff(joints[:, _FEET], axis=0), axis=-1) for joints in (estimate, truth))
    known = np.isfinite(step)
    return step, known & (true_step < REST_MPS * period_s), known & (true_step > SWING_MPS * period_s)


def _mean(values: Float[ndarray, "..."]) -> float:
    values = values[np.isfinite(values)]
    return float(values.mean()) if values.size else float("nan")


assert set(_DIRECTIONS) < set(JOINTS)
