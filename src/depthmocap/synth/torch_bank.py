"""Bodies for a GPU to draw from: shaped and dressed on the CPU beforehand, at rest, with what poses them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from numpy import ndarray
from torch import Tensor

from depthmocap.body.model import Body, BodyModel
from depthmocap.errors import InputError
from depthmocap.synth.render import Material
from depthmocap.synth.torch_body import TorchModel, pose_batch, pose_packed, posture_weights, torch_bone_transforms
from depthmocap.synth.torch_render import TorchLayers

#: Bones of a posture that a vertex of a layer follows at most; on the skin it is never more.
MOST_BONES = 6


@dataclasses.dataclass(frozen=True, eq=False)
class RestLayer:
    """What a body wears, at rest, with its own skin weights by bones of the model (as ``BoneTransforms.skin``)."""

    vertices: Float[ndarray, "v 3"]
    faces: Int[ndarray, "f 3"]
    material: Material
    skin_indices: Int[ndarray, "v k"]
    skin_weights: Float[ndarray, "v k"]


@dataclasses.dataclass(frozen=True, eq=False)
class _Worn:
    """The layers of all bodies in one list. Those of body i are vertices ``vertex_starts[i:i + 2]`` and faces
    ``face_starts[i:i + 2]``, whose corners count from the body's first vertex."""

    vertices: Float[Tensor, "n 3"]
    indices: Int[Tensor, "n k"]
    weights: Float[Tensor, "n k"]
    faces: Int[Tensor, "f 3"]
    materials: UInt8[Tensor, "f"]
    vertex_starts: Int[Tensor, "starts"]
    face_starts: Int[Tensor, "starts"]

    @classmethod
    def of(cls, model: BodyModel, worn: Sequence[Sequence[RestLayer]], device: torch.device | str) -> _Worn:
        layers = [layer for body in worn for layer in body]
        weights = torch.cat([posture_weights(model, layer.skin_indices, layer.skin_weights) for layer in layers])
        largest, indices = weights.topk(MOST_BONES, 1)
        before = [np.cumsum([0, *(len(layer.vertices) for layer in body)]) for body in worn]
        faces = [layer.faces + start for body, b in zip(worn, before, strict=True) for layer, start in zip(body, b)]  # noqa: B905
        tensors = (
            torch.from_numpy(np.concatenate([layer.vertices for layer in layers]).astype(np.float32)),
            indices,
            largest / largest.sum(1, keepdim=True),
            torch.from_numpy(np.concatenate(faces).astype(np.int64)),
            torch.from_numpy(np.concatenate([np.full(len(f.faces), f.material) for f in layers]).astype(np.uint8)),
            torch.tensor(np.cumsum([0, *(sum(len(layer.vertices) for layer in body) for body in worn)])),
            torch.tensor(np.cumsum([0, *(sum(len(layer.faces) for layer in body) for body in worn)])),
        )
        return cls(*(tensor.to(device) for tensor in tensors))

    def posed(self, bodies: Tensor, transforms: Tensor) -> TorchLayers:
        """The layers of some bodies of the bank (b,), a picture each, moved by transforms (b, 20, 3, 4)."""
        vertex, picture = _runs(self.vertex_starts, bodies)
        face, picture_of_face = _runs(self.face_starts, bodies)
        counts = self.vertex_starts[bodies + 1] - self.vertex_starts[bodies]
        first = counts.cumsum(0) - counts
        points = pose_packed(self.vertices[vertex], self.indices[vertex], self.weights[vertex], picture, transforms)
        faces = self.faces[face] + first[picture_of_face, None]
        return TorchLayers(points, faces, self.materials[face], picture, picture_of_face)


def _runs(starts: Tensor, chosen: Tensor) -> tuple[Tensor, Tensor]:
    """Indices ``starts[c]`` to ``starts[c + 1] − 1`` of every chosen c, in one list, and which choice each is of."""
    counts = starts[chosen + 1] - starts[chosen]
    of = torch.arange(len(chosen), device=starts.device).repeat_interleave(counts)
    within = torch.arange(len(of), device=starts.device) - (counts.cumsum(0) - counts)[of]
    return starts[chosen][of] + within, of


@dataclasses.dataclass(frozen=True, eq=False)
class BodyBank:
    """Bodies at rest on a device: 160 kB each, and about 70 bytes a vertex and 25 a face of what they wear."""

    model: TorchModel
    rest_vertices: Float[Tensor, "n v 3"]
    pivots: Float[Tensor, "n 20 3"]
    worn: _Worn | None

    @classmethod
    def of(
        cls,
        bodies: Sequence[Body],
        layers: Sequence[Sequence[RestLayer]] | None = None,
        device: torch.device | str = "cpu",
    ) -> BodyBank:
        """A bank of bodies and, if given, what each of them wears.

        Raises:
            InputError: when there is no body, or not one list of layers for each.
        """
        if not bodies:
            raise InputError("a bank of bodies needs at least one body")
        if layers is not None and len(layers) != len(bodies):
            raise InputError(f"a bank needs one list of layers for each of its {len(bodies)} bodies, got {len(layers)}")
        model = TorchModel.of(bodies[0].model, device)
        rest = torch.from_numpy(np.stack([body.rest_vertices for body in bodies])).to(device)
        pivots = torch.from_numpy(np.stack([model.pivots(body) for body in bodies])).to(device)
        dressed = layers is not None and any(len(body) for body in layers)
        return cls(model, rest, pivots, _Worn.of(bodies[0].model, layers, device) if dressed and layers else None)

    def __len__(self) -> int:
        return len(self.rest_vertices)

    def pose(
        self, bodies: Int[Tensor, "b"], postures: Float[Tensor, "b 20 3"]
    ) -> tuple[Float[Tensor, "b v 3"], TorchLayers | None]:
        """Skins and layers of some of the bodies (indices into the bank) in postures, in the world, metres."""
        transforms = torch_bone_transforms(self.pivots[bodies], postures)
        vertices = pose_batch(self.rest_vertices[bodies], self.model.weights, transforms)
        return vertices, None if self.worn is None else self.worn.posed(bodies, transforms)
