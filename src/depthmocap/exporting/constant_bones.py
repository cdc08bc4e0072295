"""Joints moved as little as possible until all bones have their lengths, and branching joints their shape.

The joints x of a frame minimise, from their estimates y,

    Σᵢ |xᵢ − yᵢ|²   subject to |x_a − x_b| = length   for every bone and every pair of joints of one branch,

where a branch is a joint with the several joints that hang from it, which turn as one. Each Newton step solves this for
fixed directions D: with the incidence matrix B of the pairs, the tensions λ from (B Bᵀ ∘ D Dᵀ + τ I) λ = stretch give
x −= Bᵀ (λ D). The damping τ keeps flat branches, whose distances depend on each other, from exploding.
"""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import BONES, JOINT_INDEX, JOINTS
from depthmocap.exporting.bone_rotations import CHILDREN, rest_positions
from depthmocap.kernels.pair_distances import move_to_distances

#: Pairs of joints of constant distance: bones, and the children of one joint.
_PAIRS = np.array(
    [(JOINT_INDEX[a], JOINT_INDEX[b]) for a, b in BONES]
    + [
        (JOINT_INDEX[a], JOINT_INDEX[b])
        for children in CHILDREN.values()
        for a, b in itertools.combinations(children, 2)
    ]
)
_INCIDENCE = np.zeros((len(_PAIRS), len(JOINTS)))
_INCIDENCE[np.arange(len(_PAIRS)), _PAIRS[:, 0]], _INCIDENCE[np.arange(len(_PAIRS)), _PAIRS[:, 1]] = -1, 1
_COUPLING = _INCIDENCE @ _INCIDENCE.T
_DAMPING = 0.02
#: Newton steps at most.
_PASSES = 4
#: The stretch (m) at which there is nothing to do.
_STRETCH_M = 1e-5
#: A distance estimated shorter than this share of its length is left as it is: its direction is unreliable.
_SHORTEST = 0.4


def with_constant_bones(joints: Float[ndarray, "t 18 3"], offsets: Float[ndarray, "18 3"]) -> Float[ndarray, "t 18 3"]:
    """The joints with the lengths and branches of a rest skeleton; NaN stays NaN, and binds nothing."""
    rest = rest_positions(offsets)
    lengths = np.linalg.norm(rest[_PAIRS[:, 1]] - rest[_PAIRS[:, 0]], axis=-1)
    unknown = np.asarray(np.isnan(joints).any(-1))
    moved = np.where(unknown[..., None], np.nan, joints)
    move_to_distances(moved, _PAIRS, _COUPLING, lengths, _DAMPING, _SHORTEST, _PASSES, _STRETCH_M)
    return moved
