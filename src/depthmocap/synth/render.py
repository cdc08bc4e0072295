"""What a perfect depth camera sees: depth, region labels and materials of a person, dressed, before anything."""

from __future__ import annotations

import dataclasses
import enum

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray

from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.geometry.transforms import transform_points
from depthmocap.kernels.raster import rasterise
from depthmocap.synth.body.mesh import PosedBody

#: Nothing nearer than this is drawn, metres.
NEAR_M = 0.15
#: Where cloth or hair is farther than this before the skin, the label is 0, metres.
REACH_M = 0.25


class Material(enum.IntEnum):
    """What a pixel shows; sensors read some materials worse than others. ``person`` takes SKIN to SHOE."""

    NOTHING = 0
    SKIN = 1
    CLOTH = 2
    DARK_CLOTH = 3
    HAIR = 4
    SHOE = 5
    SCENE = 6
    OBJECT = 7
    SECOND_PERSON = 8


@dataclasses.dataclass(frozen=True, eq=False)
class Layer:
    """A posed mesh over the skin (a garment, hair, a shoe), in the world, metres; both sides are seen."""

    vertices: Float[ndarray, "v 3"]
    faces: Int[ndarray, "f 3"]
    material: Material


@dataclasses.dataclass(frozen=True, eq=False)
class PosedPerson:
    """A posed body with its clothes and hair."""

    body: PosedBody
    layers: tuple[Layer, ...] = ()

    @property
    def vertices(self) -> Float[ndarray, "v 3"]:
        """The skin's vertices."""
        return self.body.vertices

    @property
    def joints(self) -> Float[ndarray, "18 3"]:
        """The 18 joints."""
        return self.body.joints

    @property
    def lowest_m(self) -> float:
        """Height of the lowest point: that of the floor under somebody who stands."""
        return float(min(mesh[:, 2].min() for mesh in (self.vertices, *(layer.vertices for layer in self.layers))))

    def moved(self, rotation: Float[ndarray, "3 3"], offset: Float[ndarray, "3"]) -> PosedPerson:
        """The person turned about the world's origin, then shifted, with all they wear."""

        def move(points: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
            return (points @ rotation.T + offset).astype(points.dtype)

        body = dataclasses.replace(self.body, vertices=move(self.vertices), joints=move(self.joints))
        layers = tuple(dataclasses.replace(layer, vertices=move(layer.vertices)) for layer in self.layers)
        return PosedPerson(body, layers)


@dataclasses.dataclass(frozen=True, eq=False)
class Rendering:
    """One view without noise. ``labels`` are of the skin, seen through clothes and hair as in the paper (Sec. III);
    0 where there is no skin behind them or it is more than ``REACH_M`` away."""

    depth_m: Float[ndarray, "h w"]
    labels: UInt8[ndarray, "h w"]
    material: UInt8[ndarray, "h w"]

    @property
    def person(self) -> Bool[ndarray, "h w"]:
        """The person's pixels, clothes and hair included."""
        return (self.material >= Material.SKIN) & (self.material <= Material.SHOE)


def draw_mesh(
    vertices: Float[ndarray, "v 3"],
    faces: Int[ndarray, "f 3"],
    face_values: UInt8[ndarray, "f"],
    camera: DepthCamera,
    depth_m: Float[ndarray, "h w"],
    values: UInt8[ndarray, "h w"],
    two_sided: bool = False,
) -> None:
    """Draw a mesh of the world over ``depth_m`` (infinite where nothing is yet), its faces' values into ``values``."""
    points = np.ascontiguousarray(transform_points(camera.camera_from_world, vertices))
    rasterise(
        points, faces, face_values, camera.fx, camera.fy, camera.cx, camera.cy, NEAR_M, two_sided, depth_m, values
    )


def render_person(
    person: PosedPerson,
    camera: DepthCamera,
    background_m: Float[ndarray, "h w"] | None = None,
    background_material: UInt8[ndarray, "h w"] | None = None,
) -> Rendering:
    """Depth (metres along z, 0 where nothing is), labels and materials of a person, without lens distortion.

    Args:
        background_m: depth of what the person stands in and may be hidden by, 0 where there is none.
        background_material: its materials; SCENE where left out.
    """
    shape = (camera.height, camera.width)
    if background_m is None:
        depth = np.full(shape, np.inf, dtype=np.float32)
        material = np.zeros(shape, dtype=np.uint8)
    else:
        depth = np.where(background_m > 0, background_m, np.inf).astype(np.float32)
        material = (
            np.where(background_m > 0, Material.SCENE, Material.NOTHING).astype(np.uint8)
            if background_material is None
            else background_material.copy()
        )
    labels = np.zeros(shape, dtype=np.uint8)
    draw_mesh(*person.body.by_region(), camera, depth, labels)
    skin = labels > 0
    material[skin] = Material.SKIN
    if person.layers:
        bare = depth.copy()
        for layer in person.layers:
            values = np.full(len(layer.faces), layer.material, dtype=np.uint8)
            draw_mesh(layer.vertices, layer.faces, values, camera, depth, material, two_sided=True)
        labels[skin] *= bare[skin] - depth[skin] <= REACH_M
    depth[np.isinf(depth)] = 0
    return Rendering(depth, labels, material)


def render_body(
    body: PosedBody, camera: DepthCamera, background_m: Float[ndarray, "h w"] | None = None
) -> tuple[Float[ndarray, "h w"], UInt8[ndarray, "h w"]]:
    """Depth (metres along z, 0 where nothing is) and labels 0–43 of a bare body (see :func:`render_person`)."""
    rendering = render_person(PosedPerson(body), camera, background_m)
    return rendering.depth_m, rendering.labels
