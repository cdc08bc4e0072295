"""Regions with smooth borders: the body's mesh, its faces cut along them.

A face has one region (``region_map``), so that borders between faces are as jagged as the mesh is coarse, one to two
centimetres on the trunk, in a way that no depth image shows. Here each vertex has a share of every region, which
changes smoothly over the surface, and edges are cut where two shares are equal. The surface stays as it is.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray
from scipy import sparse
from scipy.spatial import KDTree

#: Standard deviation of the Gaussian over which regions are mixed (metres, on the default body at rest): about an edge
#: of the trunk, so that single faces do not show in a border; regions are three times as wide and more.
_SMOOTH_M = 0.015


@dataclasses.dataclass(frozen=True, eq=False)
class RegionMesh:
    """A triangle mesh cut along borders of regions.

    Attributes:
        ends: the two vertices of every edge that is cut.
        shares: where it is cut: 0 at the first of them, 1 at the second.
        faces: triangles over the vertices followed by the points of the cuts, wound as the uncut ones.
        regions: of every triangle.
    """

    ends: Int[ndarray, "c 2"]
    shares: Float[ndarray, "c"]
    faces: Int[ndarray, "f 3"]
    regions: UInt8[ndarray, "f"]

    def points(self, vertices: Float[ndarray, "v 3"]) -> Float[ndarray, "p 3"]:
        """What ``faces`` index: the mesh's vertices in any posture, and the points of the cuts on its edges."""
        first, second = vertices[self.ends[:, 0]], vertices[self.ends[:, 1]]
        return np.concatenate([vertices, first + self.shares[:, None] * (second - first)])


def cut_along_borders(
    vertices: Float[ndarray, "v 3"], faces: Int[ndarray, "f 3"], regions: UInt8[ndarray, "f"]
) -> RegionMesh:
    """The mesh with smooth borders close to those between the faces' ``regions``."""
    shares = _shares(vertices, faces, regions)
    strongest = shares.argmax(1)
    a, b = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).T
    ends, edge_of_side = np.unique(np.stack([a, b], 1), axis=0, return_inverse=True)
    a, b = ends.T
    is_cut = strongest[a] != strongest[b]
    a, b = a[is_cut], b[is_cut]
    # At either end, the lead of the first end's region over the other's.
    ahead_a = shares[a, strongest[a]] - shares[a, strongest[b]]
    ahead_b = shares[b, strongest[a]] - shares[b, strongest[b]]
    cut = np.full(len(ends), -1)
    cut[is_cut] = len(vertices) + np.arange(len(a))
    pieces, piece_regions = _pieces(faces, strongest, cut[edge_of_side.reshape(-1, 3)], shares)
    return RegionMesh(
        np.stack([a, b], 1).astype(np.int32),
        np.clip(ahead_a / (ahead_a - ahead_b), 0.02, 0.98).astype(np.float32),
        pieces.astype(np.int32),
        piece_regions.astype(np.uint8),
    )


def _shares(
    vertices: Float[ndarray, "v 3"], faces: Int[ndarray, "f 3"], regions: UInt8[ndarray, "f"]
) -> Float[ndarray, "v r"]:
    """Share of each region around a vertex: areas of faces, weighted with a Gaussian of their distance."""
    corners = vertices[faces].astype(np.float64)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    used, row = np.unique(faces, return_inverse=True)  # a model may have vertices that no face has
    near = KDTree(vertices[used]).sparse_distance_matrix(
        KDTree(corners.mean(1)), 3 * _SMOOTH_M, output_type="coo_matrix"
    )
    weights = np.exp(-0.5 * (near.data / _SMOOTH_M) ** 2) * areas[near.col]
    shape = (len(used), int(regions.max()) + 1)
    around = sparse.coo_matrix((weights, (near.row, regions[near.col])), shape=shape).toarray()
    # A vertex always has the faces that it is a corner of, however large they are.
    touching = np.stack([row.reshape(-1), np.repeat(regions, 3)])
    around += 1e-9 * sparse.coo_matrix((np.repeat(areas, 3), touching), shape=shape).toarray()
    out = np.zeros((len(vertices), shape[1]))
    out[used] = around / around.sum(1, keepdims=True)
    return out


def _pieces(
    faces: Int[ndarray, "f 3"], strongest: Int[ndarray, "v"], cuts: Int[ndarray, "f 3"], shares: Float[ndarray, "v r"]
) -> tuple[Int[ndarray, "g 3"], Int[ndarray, "g"]]:
    """Triangles and their regions; ``cuts`` are the points on the sides 0–1, 1–2 and 2–0 of a face, −1 for none."""
    cut_count = (cuts >= 0).sum(1)
    whole, thirds = cut_count == 0, cut_count == 3
    pieces = [(faces[whole], strongest[faces[whole, 0]])]
    for lone in range(3):
        # One corner differs from the other two: a triangle at it, and two that fill the rest.
        of = (cut_count == 2) & (cuts[:, (lone + 1) % 3] < 0)
        first, second, third = (faces[of, (lone + i) % 3] for i in range(3))
        out, back = cuts[of, lone], cuts[of, (lone + 2) % 3]
        pieces.append((np.stack([first, out, back], 1), strongest[first]))
        pieces.append((np.stack([out, second, third], 1), strongest[second]))
        pieces.append((np.stack([out, third, back], 1), strongest[second]))
        # Three regions meet: one at each corner, and the middle is of whichever has most there.
        corner = faces[thirds, lone]
        pieces.append((np.stack([corner, cuts[thirds, lone], cuts[thirds, (lone + 2) % 3]], 1), strongest[corner]))
    pieces.append((cuts[thirds], shares[faces[thirds]].mean(1).argmax(1)))
    triangles, regions = zip(*pieces, strict=True)
    return np.concatenate(triangles), np.concatenate(regions)
