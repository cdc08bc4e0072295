"""Human bodies of any build: shape, then pose, then mesh, joints and region labels. Wraps Anny (extra: train).

model = BodyModel.load()
body = model.shape(Phenotype(age=0.6))
posed = body.pose(posture)
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray

from depthmocap.body.skeleton import ANNY_BONES
from depthmocap.core.caches import ensure_home, temporary_cache
from depthmocap.errors import missing_extra
from depthmocap.kernels.skin import skin
from depthmocap.synth.body.bones import POSTURE_BONES, POSTURE_OF_ANNY, world_rotations
from depthmocap.synth.body.borders import RegionMesh, cut_along_borders
from depthmocap.synth.body.region_map import face_regions


@dataclasses.dataclass(frozen=True)
class Phenotype:
    """Anny's description of a body, each 0–1. Gender 0 is male; age 1/3 is a child, 2/3 a young adult, 1 old."""

    gender: float = 0.5
    age: float = 0.65
    muscle: float = 0.5
    weight: float = 0.5
    height: float = 0.5
    proportions: float = 0.5


@dataclasses.dataclass(frozen=True, eq=False)
class BoneTransforms:
    """What carries a mesh from rest into a posture: ``point → rotations[b] @ point + offsets[b]``. Heads are joints."""

    rotations: Float[ndarray, "b 3 3"]
    offsets: Float[ndarray, "b 3"]
    heads: Float[ndarray, "b 3"]

    def skin(
        self, rest_vertices: Float[ndarray, "v 3"], indices: Int[ndarray, "v k"], weights: Float[ndarray, "v k"]
    ) -> Float[ndarray, "v 3"]:
        """Linear blend skinning of vertices (float32) by the bones ``indices``; weights sorted, largest first."""
        out = np.empty_like(rest_vertices)
        skin(rest_vertices, indices, weights, self.rotations, self.offsets, out)
        return out


@dataclasses.dataclass(frozen=True, eq=False)
class PosedBody:
    """A posed mesh in the world, metres: vertices, the 18 joints, and what belongs to the topology."""

    vertices: Float[ndarray, "v 3"]
    joints: Float[ndarray, "18 3"]
    model: BodyModel

    @property
    def faces(self) -> Int[ndarray, "f 3"]:
        """Triangles, counter-clockwise seen from outside."""
        return self.model.faces

    def by_region(self) -> tuple[Float[ndarray, "p 3"], Int[ndarray, "g 3"], UInt8[ndarray, "g"]]:
        """The same surface cut along smooth borders: points, triangles, and each triangle's region 1–43."""
        mesh = self.model.region_mesh
        return mesh.points(self.vertices), mesh.faces, mesh.regions


@dataclasses.dataclass(frozen=True, eq=False)
class Body:
    """A body of one shape in the rest pose: pelvis near the origin, facing −Y, left at +X, metres."""

    rest_vertices: Float[ndarray, "v 3"]
    rest_heads: Float[ndarray, "b 3"]
    model: BodyModel

    def with_vertices(self, rest_vertices: Float[ndarray, "v 3"]) -> Body:
        """The same skeleton in another skin, for clothes."""
        return dataclasses.replace(self, rest_vertices=rest_vertices)

    def bone_transforms(self, posture: Float[ndarray, "20 3"]) -> BoneTransforms:
        """How every bone moves from rest to a posture (see ``body.posture``), the pelvis where it was at rest."""
        model = self.model
        rotations = world_rotations(posture)[model.posture_of_bone]
        heads = np.empty_like(self.rest_heads)
        heads[0] = self.rest_heads[0]
        for bones, parents in model.levels:
            offsets = self.rest_heads[bones] - self.rest_heads[parents]
            heads[bones] = heads[parents] + np.einsum("bij,bj->bi", rotations[parents], offsets)
        offsets = heads - np.einsum("bij,bj->bi", rotations, self.rest_heads)
        return BoneTransforms(rotations.astype(np.float32), offsets.astype(np.float32), heads)

    def pose(self, posture: Float[ndarray, "20 3"]) -> PosedBody:
        """The body in a posture."""
        return self.pose_with(self.bone_transforms(posture))

    def pose_with(self, transforms: BoneTransforms) -> PosedBody:
        """The body moved by transforms of its own skeleton."""
        model = self.model
        vertices = transforms.skin(self.rest_vertices, model.skin_indices, model.skin_weights)
        return PosedBody(vertices, transforms.heads[model.joint_bones].astype(np.float64), model)


class BodyModel:
    """Anny's mesh (13,348 vertices), rig and shape space, as arrays. Use :meth:`load`."""

    def __init__(self, anny_model: Any) -> None:
        names = list(anny_model.bone_labels)
        parents = np.asarray(anny_model.bone_parents)
        self._anny = anny_model.float()
        self.bone_names: tuple[str, ...] = tuple(names)
        self.faces: Int[ndarray, "f 3"] = anny_model.faces.numpy().astype(np.int32)
        weights = anny_model.vertex_bone_weights.numpy().astype(np.float32)
        order = np.argsort(-weights, axis=1)
        self.skin_weights = np.take_along_axis(weights, order, 1)
        self.skin_indices = np.take_along_axis(anny_model.vertex_bone_indices.numpy(), order, 1).astype(np.int32)
        self.joint_bones = np.array([names.index(bone) for bone in ANNY_BONES])
        self.posture_of_bone = np.zeros(len(names), dtype=np.int64)
        depth = np.zeros(len(names), dtype=np.int64)
        for i, parent in enumerate(parents):  # parents come before their children
            if parent >= 0:
                depth[i] = depth[parent] + 1
            inherited = self.posture_of_bone[parent] if parent >= 0 else 0
            self.posture_of_bone[i] = POSTURE_OF_ANNY.get(names[i], inherited)
        #: Bones and their parents, level by level down the tree.
        self.levels = [
            (np.flatnonzero(depth == level), parents[depth == level]) for level in range(1, int(depth.max()) + 1)
        ]

    @classmethod
    @functools.cache
    def load(cls) -> BodyModel:
        """The model, built once a process. The first call on a machine takes a minute while Anny fills its cache.

        Raises:
            InputError: when anny is not installed.
        """
        ensure_home()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                import anny
                import warp
                from anny.paths import get_anny_cache_path, set_anny_cache_path

                setattr(warp.config, "quiet", True)  # noqa: B010 - the module builds its settings at import
                build = functools.partial(
                    anny.Anny, rig="makehuman", topology="anny-noeyes-notongue", skinning_method="lbs"
                )
                try:
                    return cls(build())
                except OSError as error:  # a cache that cannot be written serves as long as all is in it
                    why = f"Anny cannot write its cache {get_anny_cache_path()} ({error.strerror})"
                    set_anny_cache_path(temporary_cache("ANNY_CACHE_DIR", why))
                    return cls(build())
        except ImportError:
            raise missing_extra("anny", "train") from None

    def shape(self, phenotype: Phenotype) -> Body:
        """A body of the given phenotype."""
        import torch

        values = torch.tensor([[getattr(phenotype, label) for label in self._anny.phenotype_labels]])
        none = torch.zeros(1, 0)
        with torch.no_grad(), _one_thread():
            coefficients = self._anny._get_phenotype_blendshape_coefficients(values.float(), none, none)
            rest = self._anny.get_rest_model(coefficients)
        return Body(rest["rest_vertices"][0].numpy(), rest["rest_bone_heads"][0].numpy().astype(np.float64), self)

    @functools.cached_property
    def face_regions(self) -> UInt8[ndarray, "f"]:
        """Region 1–43 of every triangle, drawn once on the default body; shapes and postures share it."""
        body = self._default
        bones = np.array(self.bone_names)[self.skin_indices[:, 0]]
        heads = dict(zip(self.bone_names, body.rest_heads, strict=True))
        return face_regions(body.rest_vertices, self.faces, bones, heads)

    @functools.cached_property
    def region_mesh(self) -> RegionMesh:
        """The mesh cut along smooth borders of the regions, for drawing labels; shapes and postures share it."""
        return cut_along_borders(self._default.rest_vertices, self.faces, self.face_regions)

    @functools.cached_property
    def _default(self) -> Body:
        return self.shape(Phenotype())


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """The last bits of torch's sums depend on the number of threads; a body must not."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


#: The rest pose.
REST_POSTURE = np.zeros((len(POSTURE_BONES), 3))
