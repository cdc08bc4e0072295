"""Feet that stand: found by how little their ankles move, and held in one place, with the legs bent to reach it.

A foot stands wherever it rests, on the floor, a step or a footstool, so that no floor need be known. Offline the
ankle's speed is that of a span of frames around each, its place is the median of the contact, and the way into it and
out of it is spread over the frames before and after.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.exporting.timeline import SHORTEST_FRAME_S
from depthmocap.geometry import rotation_between

LEGS = tuple(tuple(JOINT_INDEX[side + name] for name in ("Hip", "Knee", "Foot")) for side in "RL")
#: A foot is caught at this share of the speed below which it stands,
_CATCH = 0.8
#: and let go at this multiple of it.
_LEAVE = 1.0
#: The place of a standing foot follows its ankle within so long (s),
_FOLLOW_S = 0.5
#: but no faster than this (m/s).
_CREEP_MPS = 0.03
#: Less is no shift (m).
_LEAST_SHIFT_M = 1e-5
#: How far a knee is moved from the line between hip and ankle (m).
_KNEE_M = 0.003
#: A knee that is nearer to the line from hip to ankle tells no plane (m).
_STRAIGHT_M = 1e-4


@dataclasses.dataclass(frozen=True)
class ContactSettings:
    """When a foot stands.

    Attributes:
        slow_mps: an ankle that stands moves slower.
        smooth_s: standard deviation of the smoothing of its path before its speed is taken (s).
        least_s: a contact lasts at least so long.
        away_m: the ankle stays within this of its place; where it leaves it, the contact ends.
        blend_s: into a contact and out of it the ankle is led over so long.
    """

    slow_mps: float = 0.08
    smooth_s: float = 0.05
    least_s: float = 0.12
    away_m: float = 0.03
    blend_s: float = 0.13


def standing_feet(
    joints: Float[ndarray, "t 18 3"], frame_s: float, settings: ContactSettings | None = None
) -> Bool[ndarray, "t 2"]:
    """Frames in which the right and the left foot stand.

    Args:
        joints: NaN where unknown; an ankle that is unknown does not stand.
    """
    settings = settings or ContactSettings()
    return np.stack([_stands(joints[:, leg[2]], frame_s, settings) for leg in LEGS], 1)


def _stands(ankle: Float[ndarray, "t 3"], frame_s: float, settings: ContactSettings) -> Bool[ndarray, " t"]:
    known = np.asarray(np.isfinite(ankle).all(-1))
    if len(ankle) < 3 or not known.any():
        return np.zeros(len(ankle), dtype=bool)
    index = np.flatnonzero(known)
    path = np.stack([np.interp(np.arange(len(ankle)), index, axis[index]) for axis in ankle.T], 1)
    from scipy.ndimage import gaussian_filter1d  # slow to import

    smooth_frames = max(settings.smooth_s / max(frame_s, SHORTEST_FRAME_S), 1e-3)
    smooth = gaussian_filter1d(path, smooth_frames, axis=0, mode="nearest")
    speed = np.linalg.norm(np.gradient(smooth, frame_s, axis=0), axis=-1)
    stands = known & (speed < settings.slow_mps)
    for first, last in _stretches(stands):
        place = np.median(path[first:last], axis=0)
        near = np.linalg.norm(path[first:last] - place, axis=-1) < settings.away_m
        stands[first:last] = near
    for first, last in _stretches(stands):
        if (last - first) * frame_s < settings.least_s:
            stands[first:last] = False
    return stands


def _stretches(mask: Bool[ndarray, " t"]) -> list[tuple[int, int]]:
    """First frames and those after the last of each run of frames."""
    edges = np.flatnonzero(np.diff(np.r_[False, mask, False].astype(np.int8)))
    return [(int(first), int(last)) for first, last in zip(edges[::2], edges[1::2], strict=True)]


def hold_feet(
    joints: Float[ndarray, "t 18 3"],
    stands: Bool[ndarray, "t 2"],
    frame_s: float,
    settings: ContactSettings | None = None,
) -> Float[ndarray, "t 18 3"]:
    """The joints with feet that stand in one place for as long as they do; bones keep their lengths."""
    settings = settings or ContactSettings()
    joints = joints.copy()
    ramp = max(1, round(settings.blend_s / frame_s))
    for leg, mask in zip(LEGS, stands.T, strict=True):
        ankle = joints[:, leg[2]]
        shift = np.zeros_like(ankle)
        stretches = _stretches(np.asarray(mask))
        for number, (first, last) in enumerate(stretches):
            place = np.median(ankle[first:last], axis=0)
            shift[first:last] = place - ankle[first:last]
            before = stretches[number - 1][1] if number else 0
            after = stretches[number + 1][0] if number + 1 < len(stretches) else len(ankle)
            for edge, way, room in ((first, -1, first - before), (last - 1, 1, after - last)):
                count = min(ramp, room)
                share = 1 - np.arange(1, count + 1) / (ramp + 1)
                frames = edge + way * np.arange(1, count + 1)
                shift[frames] += (share**2 * (3 - 2 * share))[:, None] * shift[edge]
        moved = np.linalg.norm(shift, axis=-1) > 0  # False for NaN
        joints[moved] = reach_ankles(joints[moved], leg, (ankle + shift)[moved])
    return joints


class RunningFeet:
    """The same while poses come: a foot whose ankle has hardly moved for a moment stands, and its place follows the
    ankle slowly; where the ankle leaves it, the foot is let go little by little."""

    def __init__(self, settings: ContactSettings | None = None) -> None:
        self.settings = settings or ContactSettings()
        self._recent: list[list[tuple[float, Float[ndarray, "3"]]]] = [[], []]
        self._places: list[Float[ndarray, "3"] | None] = [None, None]
        self._shifts = [np.zeros(3), np.zeros(3)]

    def __call__(self, joints: Float[ndarray, "1 18 3"], step_s: float) -> Float[ndarray, "1 18 3"]:
        """The joints with feet that stand in their places.

        Args:
            step_s: time since the pose before.
        """
        for i, leg in enumerate(LEGS):
            ankle = joints[0, leg[2]]
            recent = self._recent[i]
            if not np.isfinite(ankle).all() or not 0 < step_s < self.settings.least_s:
                recent.clear()
                self._places[i] = None
                self._shifts[i] = np.zeros(3)
                if np.isfinite(ankle).all():
                    recent.append((0.0, ankle))
                continue
            recent[:] = [(age + step_s, place) for age, place in recent if age + step_s <= self.settings.least_s + 1e-3]
            recent.append((0.0, ankle))
            place = self._places[i]
            span_s, oldest = recent[0]
            if place is None:
                if span_s >= 0.7 * self.settings.least_s:
                    speed = math.dist(ankle, oldest) / span_s
                    if speed < _CATCH * self.settings.slow_mps:
                        self._places[i] = place = ankle + self._shifts[i]
            elif (
                math.dist(ankle, place) > _LEAVE * self.settings.away_m
                or math.dist(ankle, oldest) > _LEAVE * self.settings.slow_mps * span_s
            ):
                self._places[i] = place = None
            if place is None:
                self._shifts[i] = self._shifts[i] * np.exp(-step_s / (0.5 * self.settings.blend_s))
            else:
                follow = (ankle - place) * min(1.0, step_s / _FOLLOW_S)
                most = _CREEP_MPS * step_s
                follow *= min(1.0, most / max(math.hypot(*follow), 1e-9))
                self._places[i] = place + follow
                self._shifts[i] = place + follow - ankle
            if math.hypot(*self._shifts[i]) > _LEAST_SHIFT_M:
                joints = reach_ankles(joints, leg, (ankle + self._shifts[i])[None])
        return joints


def reach_ankles(
    joints: Float[ndarray, "t 18 3"], leg: tuple[int, ...], target: Float[ndarray, "t 3"]
) -> Float[ndarray, "t 18 3"]:
    """A leg's knee and ankle moved so that the ankle is at its target: the hip stays, and the knee in its plane.

    A straight leg would throw its knee about to be a little shorter. The distance from hip to ankle is therefore
    changed only so far that the knee moves by up to ``_KNEE_M`` from the line between them. Legs with an unknown joint
    stay as they are.
    """
    hip, knee, ankle = (joints[:, i] for i in leg)
    limbs = np.stack([knee - hip, ankle - knee, ankle - hip, target - hip])
    sizes = np.linalg.norm(limbs, axis=-1, keepdims=True)
    known = (sizes[[0, 2, 3]] > _STRAIGHT_M).all(0) & ~np.isnan(sizes[1])  # False for NaN
    if not known.all():
        limbs, sizes = np.where(known, limbs, [0.0, -1.0, 0.0]), np.where(known, sizes, 1.0)
    (thigh, _, before, way), (a, b, _, length) = limbs, sizes
    along = way / length
    # The way from the hip to the ankle takes the knee along as it turns.
    turn = rotation_between(before, along)
    front = (turn @ thigh[..., None])[..., 0]
    front = front - (front * along).sum(-1, keepdims=True) * along
    size = np.linalg.norm(front, axis=-1, keepdims=True)
    shortest, longest = (
        sum(np.sqrt(np.maximum(bone**2 - aside**2, 1e-12)) for bone in (a, b))
        for aside in (np.minimum(size + _KNEE_M, 0.9 * np.minimum(a, b)), np.maximum(size - _KNEE_M, 0.0))
    )
    bent = (thigh * before).sum(-1, keepdims=True) < 0  # a heel drawn up behind the hip
    length = np.where(bent, np.clip(length, np.abs(a - b) + 1e-6, a + b - 1e-6), np.clip(length, shortest, longest))
    front = front / np.maximum(size, 1e-9)
    if (straight := size <= _STRAIGHT_M).any():
        front = np.where(straight, _across(along), front)
    cos = np.clip((a**2 + length**2 - b**2) / np.maximum(2 * a * length, 1e-9), -1, 1)
    result = joints.copy()
    result[:, leg[1]] = np.where(known, hip + a * (cos * along + np.sqrt(1 - cos**2) * front), knee)
    result[:, leg[2]] = np.where(known, hip + length * along, ankle)
    return result


def _across(along: Float[ndarray, "t 3"]) -> Float[ndarray, "t 3"]:
    """Any direction perpendicular to each."""
    seed = np.where(np.abs(along[:, :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    across = np.cross(along, seed)
    return across / np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-9)
