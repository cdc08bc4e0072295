"""Bones of constant length: lengths are learnt on the run, and joints are moved as little as possible to have them.

The length of a bone is the running median of what was seen of it and of its mirror image, weighted by the confidence of
the less sure of its ends. Joints x are moved from where they were estimated, y, to

    min Σᵢ |xᵢ − yᵢ|² / sᵢ²   subject to |x_parent − x_child| = length   for every steady bone,

where sᵢ² is how unsure a joint is. Each pass solves this with the bones' directions D as they are: with B the bones'
incidence (−1 parent, +1 child), the tensions λ of (B S² Bᵀ ∘ D Dᵀ) λ = stretch give x −= S² Bᵀ (λ D). This is
Newton's method: two passes leave less than 0.1 mm of a tenth of a length.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64
from numpy import ndarray

from depthmocap.body.skeleton import BONES, JOINT_INDEX, JOINTS, MIRROR
from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.smooth.pose_filter import FORGET_S, seen_joints

#: Bones that have one length: not those across the low spine and the shoulder blades, which bend and glide.
STEADY_BONES = tuple(bone for bone in BONES if bone[1] not in ("Spine", "RShoulder", "LShoulder"))
_PARENT, _CHILD = np.array([[JOINT_INDEX[name] for name in bone] for bone in STEADY_BONES]).T
_CHILDREN = _CHILD.tolist()
#: Each bone's mirror image; bones in the middle are their own.
_MIRRORED = np.array([_CHILDREN.index(MIRROR[child]) for child in _CHILDREN])
#: The bones' incidence.
_ENDS = np.zeros((len(STEADY_BONES), len(JOINTS)))
_ENDS[np.arange(len(_ENDS)), _PARENT], _ENDS[np.arange(len(_ENDS)), _CHILD] = -1, 1
#: Lengths are counted in steps of this, up to so many (metres): no bone of ours is longer.
_STEP_M, _STEPS = 0.004, 200
#: The direction of a bone that is shorter than this share of its length means nothing: it is left as it is.
_SHORTEST = 0.5
_PASSES = 2


@dataclasses.dataclass(frozen=True)
class BoneSettings:
    """How lengths are learnt and kept.

    Attributes:
        half_life_s: what was seen so long ago counts half.
        unsure: deviation of a joint with confidence 0, in those of one with confidence 1; between them geometrically.
    """

    half_life_s: float = 20.0
    unsure: float = 3.0

    def __post_init__(self) -> None:
        if not (self.half_life_s > 0 and self.unsure >= 1):
            raise InputError(f"bones: the half-life must be above 0, and unsure at least 1; got {self}")


class SteadyBones:
    """Gives the bones of a stream of poses constant lengths, at once; gaps stay gaps. Lengths are forgotten when nobody
    was seen for ``FORGET_S``, or a timestamp goes back."""

    def __init__(self, settings: BoneSettings | None = None) -> None:
        self.settings = settings or BoneSettings()
        self.reset()

    def reset(self) -> None:
        """Forget the lengths: another person."""
        self._seen = np.zeros((len(STEADY_BONES), _STEPS))
        self._seen_ns = -(10**18)

    @property
    def lengths_m(self) -> Float64[ndarray, "14"]:
        """The length of each of ``STEADY_BONES`` by now; NaN where it was not seen."""
        return _weighted_median(self._seen)

    def __call__(self, pose: Pose) -> Pose:
        """The pose with the lengths known by now, its own among them."""
        joints, confidence = pose.joints.astype(np.float64), np.clip(pose.confidence.astype(np.float64), 0, 1)
        if not seen_joints(pose).any():
            return pose
        self._learn(pose.timestamp_ns, joints, confidence)
        spread = self.settings.unsure ** (1 - confidence)
        return dataclasses.replace(pose, joints=with_lengths(joints, spread**2, self.lengths_m))

    def _learn(self, now_ns: int, joints: Float64[ndarray, "18 3"], confidence: Float64[ndarray, "18"]) -> None:
        away_s = (now_ns - self._seen_ns) / 1e9
        if not 0 <= away_s <= FORGET_S:
            self.reset()
        elif away_s == 0:
            return  # a frame given twice, as the first is by filters that wait
        self._seen_ns = now_ns
        self._seen *= 0.5 ** (away_s / self.settings.half_life_s)
        lengths = np.linalg.norm(joints[_CHILD] - joints[_PARENT], axis=1)
        known = np.flatnonzero(lengths < _STEP_M * _STEPS)
        trust = np.minimum(confidence[_PARENT], confidence[_CHILD])
        steps = (lengths[known] / _STEP_M).astype(int)
        self._seen[known, steps] += trust[known]
        self._seen[_MIRRORED[known], steps] += trust[known]


def _weighted_median(counts: Float64[ndarray, "n steps"]) -> Float64[ndarray, "n"]:
    """Median length (metres) of rows of weights by ``_STEP_M``, between steps linearly; NaN where all are 0."""
    below = counts.cumsum(1)
    half = below[:, -1] / 2
    rows, step = np.arange(len(counts)), (below >= half[:, None]).argmax(1)
    inside = counts[rows, step]
    share = 1 - (below[rows, step] - half) / np.where(inside > 0, inside, np.nan)
    return (step + share) * _STEP_M


def with_lengths(
    joints: Float64[ndarray, "18 3"],
    variance: Float64[ndarray, "18"],
    lengths_m: Float64[ndarray, "14"],
) -> Float64[ndarray, "18 3"]:
    """Joints moved as little as possible, those with the larger variance (of any unit) more, until bones have their
    lengths. Bones whose length or either end is not known (NaN), or that are far too short, are left out."""
    seen = np.asarray(np.isfinite(joints).all(1))
    moved = np.where(seen[:, None], joints, 0)
    found = np.linalg.norm(moved[_CHILD] - moved[_PARENT], axis=1)
    known = seen[_PARENT] & seen[_CHILD] & (found > _SHORTEST * lengths_m)  # false where the length is NaN
    if not known.any():
        return joints
    ends, wanted = _ENDS[known], lengths_m[known]
    shared = ends * variance @ ends.T
    for _ in range(_PASSES):
        bones = ends @ moved
        length = np.linalg.norm(bones, axis=1)
        direction = bones / length[:, None]
        tension = np.linalg.solve(shared * (direction @ direction.T), length - wanted)
        moved = moved - variance[:, None] * (ends.T @ (tension[:, None] * direction))
    return np.where(seen[:, None], moved, np.nan)
