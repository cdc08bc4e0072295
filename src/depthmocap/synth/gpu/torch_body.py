"""Posing batches of bodies on a GPU (extra: train): linear blend skinning in torch, the same as ``body.model``'s.

Bones that share a row of the posture move as one, so a body has 20 rigid transforms, not 163. Products of matrices are
made in double precision, which neither TF32 nor autocast touches: single precision there would move the skin by
millimetres. They are few: about 7 MFLOP a body.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from numpy import ndarray
from torch import Tensor

from depthmocap.body.model import Body, BodyModel
from depthmocap.body.posture import POSTURE_PARENTS


@dataclasses.dataclass(frozen=True, eq=False)
class TorchModel:
    """What all bodies share, on a device.

    Attributes:
        faces: triangles over ``points``, counter-clockwise seen from outside, cut along the borders of regions.
        face_regions: region 1–43 of every triangle.
        cut_ends, cut_shares: the edges that are cut, and where (see ``borders.RegionMesh``).
        weights: how much a vertex follows each of the 20 bones of a posture.
        tops: per bone of a posture, the first of the model's bones that turn with it.
    """

    faces: Int[Tensor, "f 3"]
    face_regions: UInt8[Tensor, "f"]
    cut_ends: Int[Tensor, "c 2"]
    cut_shares: Float[Tensor, "c"]
    weights: Float[Tensor, "v 20"]
    tops: Int[ndarray, "20"]

    @classmethod
    def of(cls, model: BodyModel, device: torch.device | str = "cpu") -> TorchModel:
        """The model's arrays, copied to a device."""
        parents = np.full(len(model.bone_names), -1)
        for bones, above in model.levels:
            parents[bones] = above
        group = model.posture_of_bone
        tops = np.flatnonzero((parents < 0) | (group[parents] != group))
        tops = tops[np.argsort(group[tops])]
        expected = [-1 if parents[top] < 0 else group[parents[top]] for top in tops]
        if expected != list(POSTURE_PARENTS):
            raise ValueError("the bones that share a row of the posture do not hang together in this model")
        mesh = model.region_mesh
        return cls(
            torch.from_numpy(mesh.faces.astype(np.int64)).to(device),
            torch.from_numpy(mesh.regions).to(device),
            torch.from_numpy(mesh.ends.astype(np.int64)).to(device),
            torch.from_numpy(mesh.shares).to(device),
            posture_weights(model, model.skin_indices, model.skin_weights).to(device),
            tops,
        )

    def points(self, vertices: Float[Tensor, "b v 3"]) -> Float[Tensor, "b p 3"]:
        """What ``faces`` index: the vertices of meshes, and the points of the cuts on their edges."""
        first, second = vertices[:, self.cut_ends[:, 0]], vertices[:, self.cut_ends[:, 1]]
        return torch.cat([vertices, first + self.cut_shares[:, None] * (second - first)], 1)

    def pivots(self, body: Body) -> Float[ndarray, "20 3"]:
        """The points of a body at rest that the bones of a posture turn about, metres."""
        return body.rest_heads[self.tops]


def posture_weights(
    model: BodyModel, indices: Int[ndarray, "v k"], weights: Float[ndarray, "v k"]
) -> Float[Tensor, "v 20"]:
    """Skin weights by bones of the model (as ``BoneTransforms.skin`` takes them) as weights by bones of a posture."""
    out = np.zeros((len(indices), len(POSTURE_PARENTS)), dtype=np.float32)
    np.add.at(out, (np.arange(len(indices))[:, None], model.posture_of_bone[indices]), weights)
    return torch.from_numpy(out)


def torch_world_rotations(postures: Float[Tensor, "b 20 3"]) -> Float[Tensor, "b 20 3 3"]:
    """Rotation of every posture bone away from rest, in the world (double precision; see ``body.posture``)."""
    local = _rotation_matrices(postures.double())
    world = list(local.unbind(1))
    for i, parent in enumerate(POSTURE_PARENTS):  # parents come before their children
        if parent >= 0:
            world[i] = world[parent] @ world[i]
    return torch.stack(world, 1)


def _rotation_matrices(vectors: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3 3"]:
    """Rodrigues' formula: ``I + sin(a)/a · K + (1 − cos(a))/a² · K²``, K the cross product with the vector."""
    angle = vectors.norm(dim=-1)[..., None, None]
    x, y, z = vectors.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    first, half = torch.sinc(angle / torch.pi), torch.sinc(angle / (2 * torch.pi))
    return torch.eye(3, dtype=vectors.dtype, device=vectors.device) + first * cross + 0.5 * half**2 * (cross @ cross)


def torch_bone_transforms(
    pivots: Float[Tensor, "b 20 3"], postures: Float[Tensor, "b 20 3"]
) -> Float[Tensor, "b 20 3 4"]:
    """What carries meshes from rest into postures: ``point → [:3] @ point + [3]``, the pelvis where it was at rest.

    A bone's offset is its parent's plus what keeps the point it turns about on the parent:
    ``o = o_parent + (R_parent − R) @ pivot``. In double precision.
    """
    rotations, pivots = torch_world_rotations(postures), pivots.double()
    offsets: list[Tensor] = []
    for i, parent in enumerate(POSTURE_PARENTS):
        pivot = pivots[:, i, :, None]
        if parent < 0:
            offsets.append(pivot - rotations[:, i] @ pivot)
        else:
            offsets.append(offsets[parent] + (rotations[:, parent] - rotations[:, i]) @ pivot)
    return torch.cat([rotations, torch.stack(offsets, 1)], -1)


def pose_batch(
    rest_vertices: Float[Tensor, "b v 3"], weights: Float[Tensor, "*own v 20"], transforms: Float[Tensor, "b 20 3 4"]
) -> Float[Tensor, "b v 3"]:
    """Linear blend skinning: ``Σ_k weights[k] · (R_k @ rest + o_k)``, metres, float32.

    Args:
        rest_vertices: bodies at rest (a body may be expanded along the batch).
        weights: of the bones of a posture, shared by the batch or one set each.
        transforms: of :func:`torch_bone_transforms`, or those in the frame of a camera.

    About 350 bytes a vertex are taken while it runs (5 MB a body).
    """
    blended = (weights.double() @ transforms.flatten(2)).float().unflatten(-1, (3, 4))
    return (blended[..., :3] * rest_vertices[..., None, :]).sum(-1) + blended[..., 3]


def pose_packed(
    rest_vertices: Float[Tensor, "n 3"],
    indices: Int[Tensor, "n k"],
    weights: Float[Tensor, "n k"],
    picture: Int[Tensor, "n"],
    transforms: Float[Tensor, "b 20 3 4"],
) -> Float[Tensor, "n 3"]:
    """Linear blend skinning of any vertices in one list, each by the transforms of its own picture of the batch.

    Args:
        indices, weights: the few bones of a posture that a vertex follows; a weight may be 0.
    """
    flat = transforms.float().flatten(0, 1).flatten(1)
    blended = torch.zeros(len(rest_vertices), 12, device=rest_vertices.device)
    for k in range(indices.shape[1]):
        blended += weights[:, k, None] * flat[picture * len(POSTURE_PARENTS) + indices[:, k]]
    blended = blended.unflatten(-1, (3, 4))
    return (blended[..., :3] * rest_vertices[:, None]).sum(-1) + blended[..., 3]
