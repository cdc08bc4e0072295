"""Gauss–Newton solution for the poses of all cameras, and its uncertainty by a block bootstrap.

A row is the residual between two cameras' points of the same thing along a direction n: r = n · (p_a - p_b), in the
world. Poses change by twists (ω, v) of the world, p' = p + ω x p + v, in which r is linear. Gauss–Newton minimises the
sum of w r² with the weights of :func:`geman_mcclure`. The first camera stays fixed.

Errors of neighbouring rows are correlated; treated as independent they would give too small an uncertainty. Rows
therefore belong to blocks of time or of space, and the uncertainty is the spread of the poses solved again from blocks
drawn at random.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.calibration.pairs import geman_mcclure

#: Damping as a share of the trace: a pose that no row determines stays as it is.
_DAMPING = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class ResidualRows:
    """Residuals of one pair of cameras.

    Attributes:
        cameras: the pair, a and b.
        a, b: corresponding points of the two cameras in the world (metres).
        normals: direction of each residual.
        weights: robust weights of the squared residuals (1/m²).
        blocks: bootstrap block of each row; all pairs share one numbering.
    """

    cameras: tuple[int, int]
    a: Float[ndarray, "n 3"]
    b: Float[ndarray, "n 3"]
    normals: Float[ndarray, "n 3"]
    weights: Float[ndarray, " n"]
    blocks: Int[ndarray, " n"]


@dataclasses.dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations of the twists of all cameras (m = 6 · cameras), one set for each of k blocks."""

    matrices: Float[ndarray, "k m m"]
    vectors: Float[ndarray, "k m"]

    def solve(self, counts: Float[ndarray, " k"] | None = None) -> Float[ndarray, "c 6"]:
        """The twists that solve the equations, with each block counted ``counts`` times; the first camera's are 0."""
        counts = np.ones(len(self.vectors)) if counts is None else counts
        return self.solve_for(counts @ self.vectors, counts)

    def solve_for(
        self, vector: Float[ndarray, " m"], counts: Float[ndarray, " k"] | None = None
    ) -> Float[ndarray, "c 6"]:
        """The twists for another right-hand side."""
        counts = np.ones(len(self.vectors)) if counts is None else counts
        matrix = np.tensordot(counts, self.matrices, 1)[6:, 6:]
        matrix = matrix + np.eye(len(matrix)) * max(_DAMPING * float(np.trace(matrix)), 1e-9)
        return np.concatenate([np.zeros(6), np.linalg.solve(matrix, vector[6:])]).reshape(-1, 6)

    def bootstrap(self, rng: np.random.Generator, draws: int) -> Float[ndarray, "d c 6"]:
        """Solutions from as many blocks drawn with replacement, minus the solution from all blocks."""
        occupied = np.flatnonzero(np.abs(self.matrices).sum((1, 2)) > 0)
        samples = []
        for _ in range(draws):
            counts = np.bincount(rng.choice(occupied, len(occupied)), minlength=len(self.vectors)).astype(float)
            samples.append(self.solve(counts))
        return np.stack(samples) - self.solve()


def normal_equations(rows: Sequence[ResidualRows], cameras: int) -> NormalEquations:
    """The normal equations of the rows for this number of cameras."""
    count = 1 + max((int(row_set.blocks.max()) for row_set in rows if len(row_set.blocks)), default=0)
    matrices, vectors = np.zeros((count, 6 * cameras, 6 * cameras)), np.zeros((count, 6 * cameras))
    for row_set in rows:
        jacobian = np.concatenate(
            [
                np.cross(row_set.a, row_set.normals), row_set.normals,
                -np.cross(row_set.b, row_set.normals), -row_set.normals,
            ], 1
        )  # fmt: skip
        residual = ((row_set.a - row_set.b) * row_set.normals).sum(1)
        columns = np.concatenate([6 * camera + np.arange(6) for camera in row_set.cameras])
        order = np.argsort(row_set.blocks, kind="stable")
        for indices in np.split(order, np.flatnonzero(np.diff(row_set.blocks[order])) + 1):
            block, weighted = row_set.blocks[indices[0]], jacobian[indices] * row_set.weights[indices, None]
            matrices[block][np.ix_(columns, columns)] += weighted.T @ jacobian[indices]
            vectors[block][columns] -= weighted.T @ residual[indices]
    return NormalEquations(matrices, vectors)


def apply_twists(poses: Float[ndarray, "c 4 4"], twists: Float[ndarray, "c 6"]) -> Float[ndarray, "c 4 4"]:
    """Poses changed by twists of the world."""
    world_from_old = np.tile(np.eye(4), (len(poses), 1, 1))
    world_from_old[:, :3, :3] = Rotation.from_rotvec(twists[:, :3]).as_matrix()
    world_from_old[:, :3, 3] = twists[:, 3:]
    return world_from_old @ poses


def point_rows(
    cameras: tuple[int, int],
    a: Float[ndarray, "n 3"],
    b: Float[ndarray, "n 3"],
    expected_m: Float[ndarray, " n"],
    blocks: Int[ndarray, " n"],
) -> ResidualRows:
    """Residuals between corresponding points along all three axes."""
    weights = geman_mcclure(np.linalg.norm(a - b, axis=1) / expected_m) / expected_m**2
    three = np.repeat(np.arange(len(a)), 3)
    return ResidualRows(cameras, a[three], b[three], np.tile(np.eye(3), (len(a), 1)), weights[three], blocks[three])
