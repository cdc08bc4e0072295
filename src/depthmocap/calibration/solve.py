"""Where all cameras stand, from everything that two of them see of the same things.

A row says that two cameras' points of one thing should meet along a direction n: r = n · (p_a - p_b), in the world.
Poses change by twists (ω, v) of the world, p' = p + ω x p + v, to which r is linear: the sum of w r² is minimised by
Gauss-Newton, with the weights of :func:`geman_mcclure`. The first camera stays where it is.

Errors of neighbouring rows are alike, so that sums over them would promise too much. Rows therefore belong to blocks,
of time or of space, and the uncertainty is that of poses which are solved again from blocks drawn at random (a
bootstrap).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.calibration.pairs import geman_mcclure

#: Keeps what nothing tells where it is (of the mean weight of the rows).
_DAMPING = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class Rows:
    """Rows of one pair of cameras.

    Attributes:
        cameras: the pair, a and b.
        a: points of the first in the world. ``b``: of the second.
        normals: directions along which they should meet.
        weights: of the squared distances (1/m²), robust ones.
        blocks: of each row; numbers of all pairs are from one count.
    """

    cameras: tuple[int, int]
    a: Float[ndarray, "n 3"]
    b: Float[ndarray, "n 3"]
    normals: Float[ndarray, "n 3"]
    weights: Float[ndarray, " n"]
    blocks: Int[ndarray, " n"]


@dataclasses.dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations by block, for the twists of all cameras."""

    matrices: Float[ndarray, "k m m"]
    vectors: Float[ndarray, "k m"]

    def twists(self, counts: Float[ndarray, " k"] | None = None) -> Float[ndarray, "c 6"]:
        """The solution, each block counted so many times (once by default); the first camera's is zero."""
        counts = np.ones(len(self.vectors)) if counts is None else counts
        return self.respond(counts @ self.vectors, counts)

    def respond(
        self, vector: Float[ndarray, " m"], counts: Float[ndarray, " k"] | None = None
    ) -> Float[ndarray, "c 6"]:
        """The twists that another right side of the equations gives."""
        counts = np.ones(len(self.vectors)) if counts is None else counts
        matrix = np.tensordot(counts, self.matrices, 1)[6:, 6:]
        matrix = matrix + np.eye(len(matrix)) * max(_DAMPING * float(np.trace(matrix)), 1e-9)
        return np.concatenate([np.zeros(6), np.linalg.solve(matrix, vector[6:])]).reshape(-1, 6)

    def bootstrap(self, rng: np.random.Generator, draws: int) -> Float[ndarray, "d c 6"]:
        """Solutions from as many blocks drawn with replacement, less the solution from all."""
        filled = np.flatnonzero(np.abs(self.matrices).sum((1, 2)) > 0)
        drawn = []
        for _ in range(draws):
            counts = np.bincount(rng.choice(filled, len(filled)), minlength=len(self.vectors)).astype(float)
            drawn.append(self.twists(counts))
        return np.stack(drawn) - self.twists()


def equations(rows: Sequence[Rows], cameras: int) -> Equations:
    """The equations that rows make for so many cameras."""
    count = 1 + max((int(each.blocks.max()) for each in rows if len(each.blocks)), default=0)
    matrices, vectors = np.zeros((count, 6 * cameras, 6 * cameras)), np.zeros((count, 6 * cameras))
    for each in rows:
        jacobian = np.concatenate(
            [
                np.cross(each.a, each.normals), each.normals,
                -np.cross(each.b, each.normals), -each.normals,
            ], 1
        )  # fmt: skip
        residual = ((each.a - each.b) * each.normals).sum(1)
        columns = np.concatenate([6 * camera + np.arange(6) for camera in each.cameras])
        order = np.argsort(each.blocks, kind="stable")
        for own in np.split(order, np.flatnonzero(np.diff(each.blocks[order])) + 1):
            block, weighted = each.blocks[own[0]], jacobian[own] * each.weights[own, None]
            matrices[block][np.ix_(columns, columns)] += weighted.T @ jacobian[own]
            vectors[block][columns] -= weighted.T @ residual[own]
    return Equations(matrices, vectors)


def moved(poses: Float[ndarray, "c 4 4"], twists: Float[ndarray, "c 6"]) -> Float[ndarray, "c 4 4"]:
    """Poses after twists of the world."""
    world_from_old = np.tile(np.eye(4), (len(poses), 1, 1))
    world_from_old[:, :3, :3] = Rotation.from_rotvec(twists[:, :3]).as_matrix()
    world_from_old[:, :3, 3] = twists[:, 3:]
    return world_from_old @ poses


def meeting_rows(
    cameras: tuple[int, int],
    a: Float[ndarray, "n 3"],
    b: Float[ndarray, "n 3"],
    expected_m: Float[ndarray, " n"],
    blocks: Int[ndarray, " n"],
) -> Rows:
    """Rows that say that points should meet in all directions."""
    weights = geman_mcclure(np.linalg.norm(a - b, axis=1) / expected_m) / expected_m**2
    three = np.repeat(np.arange(len(a)), 3)
    return Rows(cameras, a[three], b[three], np.tile(np.eye(3), (len(a), 1)), weights[three], blocks[three])
