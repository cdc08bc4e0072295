"""People for a GPU to draw from: made on the CPU beforehand, kept on the device.

``BodiesInPostures`` poses bodies there, any of them in any posture of a pool; clothes then follow the skin, without
hanging or folding anew. ``PosedPeople`` were posed on the CPU, clothes and all, each in its own posture.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from numpy import ndarray
from scipy.spatial import KDTree
from torch import Tensor

from depthmocap.body.model import REST_POSTURE, Body
from depthmocap.errors import InputError
from depthmocap.synth.gpu.torch_body import TorchModel, pose_batch, pose_packed, posture_weights, torch_bone_transforms
from depthmocap.synth.gpu.torch_render import TorchLayers
from depthmocap.synth.motion.postures import PostureSource
from depthmocap.synth.people.garments import DressedBody
from depthmocap.synth.render import Layer, PosedPerson

#: Bones of a posture that a vertex of a layer follows at most; on the skin it is never more.
MOST_BONES = 6
#: Vertices of the skin whose bones a vertex of a layer follows, the nearest at rest.
NEIGHBOURS = 8
_STEADY_M = 0.005


@runtime_checkable
class PeopleSource(Protocol):
    """Anything that draws posed people on a device."""

    @property
    def model(self) -> TorchModel: ...

    def draw(
        self, count: int, generator: torch.Generator
    ) -> tuple[Float[Tensor, "b v 3"], TorchLayers | None]: ...  # fmt: skip


@dataclasses.dataclass(frozen=True, eq=False)
class RestLayer:
    """What a body wears, at rest; vertices follow bones of the model as ``BoneTransforms.skin`` takes them."""

    layer: Layer
    skin_indices: Int[ndarray, "v k"]
    skin_weights: Float[ndarray, "v k"]


def rest_layers(dressed: DressedBody) -> list[RestLayer]:
    """What a dressed body wears, bound to its skeleton by the skin that is nearest at rest.

    Posed by these weights clothes go with the body and keep their folds. What hangs free does not fall and may be
    entered by a leg: it is the price of posing on a GPU, in a thousandth of the time.
    """
    model, tree = dressed.body.model, KDTree(dressed.body.rest_vertices)
    out = []
    for layer in dressed.pose(REST_POSTURE).layers:
        away, nearest = tree.query(layer.vertices, NEIGHBOURS)
        share = 1 / (away + _STEADY_M)
        share /= share.sum(1, keepdims=True)
        weights = (share[..., None] * model.skin_weights[nearest]).reshape(len(away), -1)
        indices = model.skin_indices[nearest].reshape(len(away), -1)
        out.append(RestLayer(layer, indices, weights.astype(np.float32)))
    return out


@dataclasses.dataclass(frozen=True, eq=False)
class _Worn:
    """Layers of many people in one list. Those of person i are vertices ``vertex_starts[i]`` to
    ``vertex_starts[i + 1] − 1`` and so the faces, whose corners count from the person's first vertex."""

    vertices: Float[Tensor, "n 3"]
    faces: Int[Tensor, "f 3"]
    materials: UInt8[Tensor, "f"]
    vertex_starts: Int[Tensor, "starts"]
    face_starts: Int[Tensor, "starts"]

    @classmethod
    def of(cls, worn: Sequence[Sequence[Layer]], device: torch.device | str) -> _Worn:
        vertices, faces, materials = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros(0)]
        for layers in worn:
            count = 0
            for layer in layers:
                vertices.append(layer.vertices)
                faces.append(layer.faces + count)
                materials.append(np.full(len(layer.faces), layer.material))
                count += len(layer.vertices)
        vertex_starts = np.cumsum([0, *(sum(len(layer.vertices) for layer in layers) for layers in worn)])
        face_starts = np.cumsum([0, *(sum(len(layer.faces) for layer in layers) for layers in worn)])
        return cls(
            torch.from_numpy(np.concatenate(vertices).astype(np.float32)).to(device),
            torch.from_numpy(np.concatenate(faces).astype(np.int64)).to(device),
            torch.from_numpy(np.concatenate(materials).astype(np.uint8)).to(device),
            torch.from_numpy(vertex_starts).to(device),
            torch.from_numpy(face_starts).to(device),
        )

    def chosen(self, people: Int[Tensor, "b"]) -> tuple[Int[Tensor, "n"], TorchLayers]:
        """The layers of some people, a picture each, and which vertices of this list they have."""
        vertex, picture = _runs(self.vertex_starts, people)
        face, picture_of_face = _runs(self.face_starts, people)
        counts = self.vertex_starts[people + 1] - self.vertex_starts[people]
        first = counts.cumsum(0) - counts
        faces = self.faces[face] + first[picture_of_face, None]
        return vertex, TorchLayers(self.vertices[vertex], faces, self.materials[face], picture, picture_of_face)


def _runs(starts: Tensor, chosen: Tensor) -> tuple[Tensor, Tensor]:
    """Indices ``starts[c]`` to ``starts[c + 1] − 1`` of every chosen c, in one list, and which choice each is of."""
    counts = starts[chosen + 1] - starts[chosen]
    of = torch.arange(len(chosen), device=starts.device).repeat_interleave(counts)
    within = torch.arange(len(of), device=starts.device) - (counts.cumsum(0) - counts)[of]
    return starts[chosen][of] + within, of


@dataclasses.dataclass(frozen=True, eq=False)
class BodyBank:
    """Bodies at rest on a device: 160 kB each, and about 100 bytes a vertex and 25 a face of what they wear."""

    model: TorchModel
    rest_vertices: Float[Tensor, "n v 3"]
    pivots: Float[Tensor, "n 20 3"]
    worn: _Worn | None
    indices: Int[Tensor, "m k"]
    weights: Float[Tensor, "m k"]

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
        base = bodies[0].model
        model = TorchModel.of(base, device)
        every = [layer for worn in layers or [] for layer in worn]
        weights = [posture_weights(base, layer.skin_indices, layer.skin_weights) for layer in every]
        largest, indices = torch.cat([model.weights.new_zeros(0, 20).cpu(), *weights]).topk(MOST_BONES, 1)
        return cls(
            model,
            torch.from_numpy(np.stack([body.rest_vertices for body in bodies])).to(device),
            torch.from_numpy(np.stack([model.pivots(body) for body in bodies])).to(device),
            _Worn.of([[part.layer for part in worn] for worn in layers], device) if layers and every else None,
            indices.to(device),
            (largest / largest.sum(1, keepdim=True)).to(device),
        )

    def __len__(self) -> int:
        return len(self.rest_vertices)

    def pose(
        self, bodies: Int[Tensor, "b"], postures: Float[Tensor, "b 20 3"]
    ) -> tuple[Float[Tensor, "b v 3"], TorchLayers | None]:
        """Skins and layers of some of the bodies (indices into the bank) in postures, in the world, metres."""
        transforms = torch_bone_transforms(self.pivots[bodies], postures)
        vertices = pose_batch(self.rest_vertices[bodies], self.model.weights, transforms)
        if self.worn is None:
            return vertices, None
        which, layers = self.worn.chosen(bodies)
        points = pose_packed(
            layers.vertices, self.indices[which], self.weights[which], layers.picture_of_vertex, transforms
        )
        return vertices, dataclasses.replace(layers, vertices=points)


@dataclasses.dataclass(frozen=True, eq=False)
class BodiesInPostures:
    """Any body of a bank in any posture of a pool (240 bytes each)."""

    bank: BodyBank
    postures: Float[Tensor, "n 20 3"]

    @classmethod
    def of(cls, bank: BodyBank, source: PostureSource, count: int, rng: np.random.Generator) -> BodiesInPostures:
        """The bank's bodies in postures drawn from a source, with the source's own variation.

        Raises:
            InputError: when ``count`` is less than 1.
        """
        if count < 1:
            raise InputError(f"a pool needs at least one posture, got {count}")
        postures = np.stack([source.sample(rng)[0] for _ in range(count)]).astype(np.float32)
        return cls(bank, torch.from_numpy(postures).to(bank.rest_vertices.device))

    @property
    def model(self) -> TorchModel:
        """What all bodies share."""
        return self.bank.model

    def draw(self, count: int, generator: torch.Generator) -> tuple[Float[Tensor, "b v 3"], TorchLayers | None]:
        """Skins and layers of random people."""
        bodies = torch.randint(len(self.bank), (count,), device=generator.device, generator=generator)
        postures = torch.randint(len(self.postures), (count,), device=generator.device, generator=generator)
        return self.bank.pose(bodies, self.postures[postures])


@dataclasses.dataclass(frozen=True, eq=False)
class PosedPeople:
    """People as posed on the CPU: 160 kB each, and 12 bytes a vertex and 25 a face of what they wear."""

    model: TorchModel
    vertices: Float[Tensor, "n v 3"]
    worn: _Worn

    @classmethod
    def of(cls, people: Sequence[PosedPerson], device: torch.device | str = "cpu") -> PosedPeople:
        """Copied to a device.

        Raises:
            InputError: when there is nobody.
        """
        if not people:
            raise InputError("there must be at least one person to draw")
        vertices = torch.from_numpy(np.stack([person.vertices for person in people])).to(device)
        worn = _Worn.of([person.layers for person in people], device)
        return cls(TorchModel.of(people[0].body.model, device), vertices, worn)

    def draw(self, count: int, generator: torch.Generator) -> tuple[Float[Tensor, "b v 3"], TorchLayers | None]:
        """Skins and layers of random people."""
        chosen = torch.randint(len(self.vertices), (count,), device=generator.device, generator=generator)
        return self.vertices[chosen], self.worn.chosen(chosen)[1]
