"""``render.render_person`` for batches on a GPU (extra: train), in torch alone: nothing is compiled at installation.

The pictures are the CPU's: the same faces, near plane, layers and labels; they differ where rounding decides whether
a face's border passes a pixel's centre. Memory: 5 MB a body while it is posed, 8 bytes a pixel and 0.4 MB a body while
its picture is drawn, and 600 MB on a GPU for the faces and pixels in work, however many there are (``torch_raster``).

What bounds the speed is memory traffic. Counted over the tensors that torch's separate kernels read and write, a bare
body posed, drawn and normalised into a 250×250 window moves 100 MB: at the 3.35 TB/s of an H100 that is 30 µs, 33,000
windows a second; a dressed one with sensor noise moves 210 MB, 16,000 a second. Kernels that use half of the bandwidth
give half of that. About 1,000 kernels are started for a batch (some 5 ms), so that batches should be of 512 and more.
These are estimates on paper; ``benchmarks/gpu_rows.py`` measures.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from depthmocap.geometry.cameras import DepthCamera
from depthmocap.synth.gpu.torch_raster import (
    NOTHING,
    depth_of_keys,
    draw_packed,
    draw_shared,
    faces_of_keys,
    keys_of_depth,
    project,
)
from depthmocap.synth.render import NEAR_M, REACH_M, Material, PosedPerson


@dataclasses.dataclass(frozen=True, eq=False)
class TorchCameras:
    """Pinhole cameras on a device, one a picture; an integer pixel is its centre.

    Attributes:
        intrinsics: fx, fy, cx, cy (pixels).
        camera_from_world: rotation and translation (metres).
    """

    intrinsics: Float[Tensor, "b 4"]
    camera_from_world: Float[Tensor, "b 3 4"]

    @classmethod
    def of(cls, cameras: Sequence[DepthCamera], device: torch.device | str = "cpu") -> TorchCameras:
        """Cameras of any sizes; lens distortion is left out, as on the CPU."""
        intrinsics = np.array([[c.fx, c.fy, c.cx, c.cy] for c in cameras]).reshape(-1, 4)
        poses = np.array([c.camera_from_world[:3] for c in cameras]).reshape(-1, 3, 4)
        return cls(torch.from_numpy(intrinsics).to(device), torch.from_numpy(poses).to(device))

    def cropped(self, left: Float[Tensor, "b"], top: Float[Tensor, "b"], step: Float[Tensor, "b"]) -> TorchCameras:
        """Cameras whose pixel (i, j) covers the square of side ``step`` with corner (top + i·step, left + j·step)
        of the old picture, measured from the outer corner of its first pixel."""
        fx, fy, cx, cy = self.intrinsics.unbind(-1)
        centre_x, centre_y = (cx + 0.5 - left) / step - 0.5, (cy + 0.5 - top) / step - 0.5
        return TorchCameras(torch.stack([fx / step, fy / step, centre_x, centre_y], -1), self.camera_from_world)

    def points(self, vertices: Float[Tensor, "b v 3"]) -> Float[Tensor, "b v 3"]:
        """World points, a row a camera, in the cameras' frames (float64; see ``torch_body`` for why)."""
        pose = self.camera_from_world.double()
        return vertices.double() @ pose[..., :3].mT + pose[:, None, :, 3]

    def packed_points(self, vertices: Float[Tensor, "n 3"], picture: Int[Tensor, "n"]) -> Float[Tensor, "n 3"]:
        """World points, each in the frame of its own camera (float64)."""
        pose = self.camera_from_world.double()[picture]
        return (pose[..., :3] * vertices.double()[:, None]).sum(-1) + pose[..., 3]


@dataclasses.dataclass(frozen=True, eq=False)
class TorchLayers:
    """What the people of a batch wear, of any topologies, in one list; both sides are seen.

    Attributes:
        vertices: in the world, metres.
        faces: indices into ``vertices``.
        materials: ``Material`` of every face.
        picture_of_vertex, picture_of_face: which picture of the batch they are of; faces of one picture in the order
            they are worn in.
    """

    vertices: Float[Tensor, "n 3"]
    faces: Int[Tensor, "f 3"]
    materials: UInt8[Tensor, "f"]
    picture_of_vertex: Int[Tensor, "n"]
    picture_of_face: Int[Tensor, "f"]

    @classmethod
    def of(cls, people: Sequence[PosedPerson], device: torch.device | str = "cpu") -> TorchLayers:
        """The layers of posed people, a picture each."""
        layers = [(i, layer) for i, person in enumerate(people) for layer in person.layers]
        starts = np.cumsum([0, *(len(layer.vertices) for _, layer in layers)])
        faces = [layer.faces + start for (_, layer), start in zip(layers, starts[:-1], strict=True)]

        def joined(parts: list[np.ndarray], shape: tuple[int, ...], dtype: type) -> Tensor:
            return torch.from_numpy(np.concatenate([np.zeros(shape, dtype), *parts]).astype(dtype)).to(device)

        return cls(
            joined([layer.vertices for _, layer in layers], (0, 3), np.float32),
            joined(faces, (0, 3), np.int64),
            joined([np.full(len(layer.faces), layer.material) for _, layer in layers], (0,), np.uint8),
            joined([np.full(len(layer.vertices), i) for i, layer in layers], (0,), np.int64),
            joined([np.full(len(layer.faces), i) for i, layer in layers], (0,), np.int64),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class TorchRendering:
    """Views without noise, as ``render.Rendering``."""

    depth_m: Float[Tensor, "b h w"]
    labels: UInt8[Tensor, "b h w"]
    material: UInt8[Tensor, "b h w"]

    @property
    def person(self) -> Tensor:
        """The people's pixels (b, h, w), clothes and hair included."""
        return (self.material >= Material.SKIN) & (self.material <= Material.SHOE)


def render_batch(
    vertices: Float[Tensor, "b v 3"],
    faces: Int[Tensor, "f 3"],
    face_values: UInt8[Tensor, "f"],
    cameras: TorchCameras,
    height: int,
    width: int,
) -> tuple[Float[Tensor, "b h w"], UInt8[Tensor, "b h w"]]:
    """Depth (metres along z, 0 where nothing is) and values of the nearest faces (0 where none is), a mesh each."""
    rendering = render_people(vertices, faces, face_values, cameras, height, width)
    return rendering.depth_m, rendering.labels


def render_people(
    vertices: Float[Tensor, "b v 3"],
    faces: Int[Tensor, "f 3"],
    face_regions: UInt8[Tensor, "f"],
    cameras: TorchCameras,
    height: int,
    width: int,
    layers: TorchLayers | None = None,
    background_m: Float[Tensor, "b h w"] | None = None,
) -> TorchRendering:
    """What ``render.render_person`` draws, for a batch of bodies.

    Args:
        vertices: skins in the world, metres, one a camera.
        face_regions: 1–43.
        layers: what they wear.
        background_m: depth of what they stand in, 0 where there is none; its material is SCENE.
    """
    shape, device = (len(vertices), height, width), vertices.device
    keys = torch.full(shape, NOTHING, device=device) if background_m is None else keys_of_depth(background_m)
    draw_shared(keys, project(cameras.points(vertices), cameras.intrinsics[:, None], NEAR_M), faces)
    skin_face = faces_of_keys(keys)
    labels = torch.cat([face_regions.new_zeros(1), face_regions])[skin_face]
    material = (skin_face > 0).to(torch.uint8) * Material.SKIN
    if background_m is not None:
        material = torch.where((skin_face == 0) & (background_m > 0), Material.SCENE, material).to(torch.uint8)
    depth = depth_of_keys(keys)
    if layers is not None and len(layers.faces):
        bare, first = depth, len(faces) + 1
        points = cameras.packed_points(layers.vertices, layers.picture_of_vertex)
        points = project(points, cameras.intrinsics[layers.picture_of_vertex], NEAR_M)
        draw_packed(keys, points, layers.faces, layers.picture_of_face, first, two_sided=True)
        depth, face = depth_of_keys(keys), faces_of_keys(keys)
        material = torch.where(face < first, material, layers.materials[(face - first).clamp(min=0)])
        labels = torch.where(bare - depth > REACH_M, 0, labels).to(torch.uint8)
    return TorchRendering(torch.where(depth.isinf(), 0.0, depth), labels, material)
