"""Constant bone lengths: they are learnt while running, and the joints are moved as little as possible to fit them.

The length of a bone is the running median of its measured lengths and those of its mirror image, weighted by the lower
confidence of its two ends. The joints x minimise, from their estimates y,

    Σᵢ |xᵢ − yᵢ|² / sᵢ²   subject to |x_parent − x_child| = length   for every rigid bone,

where sᵢ² is the variance of a joint. Each Newton step solves this for fixed bone directions D: with the incidence
matrix B of the bones (−1 parent, +1 child), the tensions λ from (B S² Bᵀ ∘ D Dᵀ) λ = stretch give x −= S² Bᵀ (λ D). Two
steps reduce a stretch of a tenth of the length to less than 0.1 mm.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64
from numpy import ndarray

from depthmocap.body.skeleton import BONES, JOINT_INDEX, JOINTS, MIRROR
from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.smooth.pose_filter import MAX_GAP_S, observed_joints

#: Bones of constant length: not those across the low spine and the shoulder blades, which bend and glide.
RIGID_BONES = tuple(bone for bone in BONES if bone[1] not in ("Spine", "RShoulder", "LShoulder"))
_PARENT, _CHILD = np.array([[JOINT_INDEX[name] for name in bone] for bone in RIGID_BONES]).T
_CHILDREN = _CHILD.tolist()
#: Index of each bone's mirror image; a bone in the middle is its own.
_MIRRORED = np.array([_CHILDREN.index(MIRROR[child]) for child in _CHILDREN])
#: Incidence matrix of the bones.
_ENDS = np.zeros((len(RIGID_BONES), len(JOINTS)))
_ENDS[np.arange(len(_ENDS)), _PARENT], _ENDS[np.arange(len(_ENDS)), _CHILD] = -1, 1
#: Width of the bins of the length histograms (metres).
_STEP_M = 0.004
#: Number of bins: no bone is longer than 0.8 m.
_STEPS = 200
#: A bone estimated shorter than this share of its length is left as it is: its direction is unreliable.
_SHORTEST = 0.5
#: Newton steps.
_PASSES = 2


@dataclasses.dataclass(frozen=True)
class BoneLengthSettings:
    """How lengths are learnt and enforced.

    Attributes:
        half_life_s: age at which a measured length counts half (seconds).
        unsure: deviation of a joint with confidence 0, relative to confidence 1; geometric between.
    """

    half_life_s: float = 20.0
    unsure: float = 3.0

    def __post_init__(self) -> None:
        if not (self.half_life_s > 0 and self.unsure >= 1):
            raise InputError(f"bones: the half-life must be above 0, and unsure at least 1; got {self}")


class BoneLengthConstraint:
    """Gives the bones in a stream of poses constant lengths, without delay; missing joints stay missing.

    The lengths are forgotten after ``MAX_GAP_S`` without any joint, or when a timestamp goes back.
    """

    def __init__(self, settings: BoneLengthSettings | None = None) -> None:
        self.settings = settings or BoneLengthSettings()
        self.reset()

    def reset(self) -> None:
        """Forget the lengths, for another person."""
        self._histogram = np.zeros((len(RIGID_BONES), _STEPS))
        self._last_ns = -(10**18)

    @property
    def lengths_m(self) -> Float64[ndarray, "14"]:
        """The present length of each of ``RIGID_BONES`` (metres); NaN before it was measured."""
        return _weighted_median(self._histogram)

    def __call__(self, pose: Pose) -> Pose:
        """The pose with the present lengths, which include this pose's."""
        joints, confidence = pose.joints.astype(np.float64), np.clip(pose.confidence.astype(np.float64), 0, 1)
        if not observed_joints(pose).any():
            return pose
        self._learn(pose.timestamp_ns, joints, confidence)
        spread = self.settings.unsure ** (1 - confidence)
        return dataclasses.replace(pose, joints=enforce_lengths(joints, spread**2, self.lengths_m))

    def _learn(self, now_ns: int, joints: Float64[ndarray, "18 3"], confidence: Float64[ndarray, "18"]) -> None:
        gap_s = (now_ns - self._last_ns) / 1e9
        if not 0 <= gap_s <= MAX_GAP_S:
            self.reset()
        elif gap_s == 0:
            return  # a repeated frame: filters with a delay repeat the first
        self._last_ns = now_ns
        self._histogram *= 0.5 ** (gap_s / self.settings.half_life_s)
        lengths = np.linalg.norm(joints[_CHILD] - joints[_PARENT], axis=1)
        known = np.flatnonzero(lengths < _STEP_M * _STEPS)
        weight = np.minimum(confidence[_PARENT], confidence[_CHILD])
        steps = (lengths[known] / _STEP_M).astype(int)
        self._histogram[known, steps] += weight[known]
        self._histogram[_MIRRORED[known], steps] += weight[known]


def _weighted_median(counts: Float64[ndarray, "n steps"]) -> Float64[ndarray, "n"]:
    """Median length (metres) of each row of a histogram, linear within a bin; NaN where all counts are 0."""
    below = counts.cumsum(1)
    half = below[:, -1] / 2
    rows, step = np.arange(len(counts)), (below >= half[:, None]).argmax(1)
    inside = counts[rows, step]
    share = 1 - (below[rows, step] - half) / np.where(inside > 0, inside, np.nan)
    return (step + share) * _STEP_M


def enforce_lengths(
    joints: Float64[ndarray, "18 3"],
    variance: Float64[ndarray, "18"],
    lengths_m: Float64[ndarray, "14"],
) -> Float64[ndarray, "18 3"]:
    """Joints moved as little as possible until the bones have their lengths.

    Joints with a larger variance (in any unit) move more. Bones with an unknown length or end (NaN), and bones that are
    far too short, are left as they are.
    """
    observed = np.asarray(np.isfinite(joints).all(1))
    adjusted = np.where(observed[:, None], joints, 0)
    estimated_m = np.linalg.norm(adjusted[_CHILD] - adjusted[_PARENT], axis=1)
    known = (
        observed[_PARENT] & observed[_CHILD] & (estimated_m > _SHORTEST * lengths_m)
    )  # false where the length is NaN
    if not known.any():
        return joints
    ends, target_m = _ENDS[known], lengths_m[known]
    coupling = ends * variance @ ends.T
    for _ in range(_PASSES):
        bones = ends @ adjusted
        length = np.linalg.norm(bones, axis=1)
        direction = bones / length[:, None]
        tension = np.linalg.solve(coupling * (direction @ direction.T), length - target_m)
        adjusted = adjusted - variance[:, None] * (ends.T @ (tension[:, None] * direction))
    return np.where(observed[:, None], adjusted, np.nan)
