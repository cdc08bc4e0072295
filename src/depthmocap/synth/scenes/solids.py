"""Simple solids in the world (boxes, ellipsoids, capsules, cylinders): building them, moving them, drawing them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray

from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.kernels.cast import BOX, CAPSULE, CYLINDER, ELLIPSOID, SHELL, cast, contains_any, mark_hidden
from depthmocap.synth.render import Material

_CORNERS = np.stack(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0], indexing="ij"), -1).reshape(8, 3)
#: Pairs of corners that differ in one coordinate.
_EDGES = np.array([(a, a | bit) for bit in (1, 2, 4) for a in range(8) if not a & bit])
#: Solids are clipped this near before the camera to find where in the picture they may be (metres).
_CLIP_M = 0.01


@dataclasses.dataclass(frozen=True, eq=False)
class Solids:
    """Solids as arrays (see :mod:`depthmocap.kernels.cast`).

    Attributes:
        kinds: one of the kernel's kinds.
        halves: of a capsule half the length of its axis over its radius, else 0.
        frames: ``world_from_local``, 3×4: the half axes as columns, then the centre (metres).
        materials: what a pixel of it shows.
    """

    kinds: UInt8[ndarray, "n"]
    halves: Float[ndarray, "n"]
    frames: Float[ndarray, "n 3 4"]
    materials: UInt8[ndarray, "n"]

    def __len__(self) -> int:
        return len(self.kinds)

    def moved(self, rotation: Float[ndarray, "3 3"], offset: Float[ndarray, "3"]) -> Solids:
        """Turned about the world's origin, then shifted."""
        frames = rotation @ self.frames
        frames[:, :, 3] += offset
        return dataclasses.replace(self, frames=frames)

    def grown(self, margin_m: float) -> Solids:
        """Every solid larger by a margin on all sides."""
        lengths = np.linalg.norm(self.frames[:, :, :3], axis=1, keepdims=True)
        factors = (lengths + margin_m) / lengths
        frames = self.frames.copy()
        frames[:, :, :3] *= factors
        return dataclasses.replace(self, frames=frames, halves=self.halves / factors[:, 0, 0])

    @property
    def corners(self) -> Float[ndarray, "n 8 3"]:
        """Corners of a box around each."""
        corners = np.repeat(_CORNERS[None], len(self), 0)
        corners[:, :, 2] *= 1 + self.halves[:, None]
        return corners @ self.frames[:, :, :3].transpose(0, 2, 1) + self.frames[:, None, :, 3]

    @property
    def local_from_world(self) -> Float[ndarray, "n 3 4"]:
        """Inverse of ``frames``."""
        return _inverse(self.frames)

    def hold_any(self, points: Float[ndarray, "p 3"]) -> bool:
        """Whether any of the points is within any of the solids."""
        return bool(contains_any(self.kinds, self.halves, self.local_from_world, points))

    def hide(self, eyes: Float[ndarray, "c 3"], points: Float[ndarray, "p 3"]) -> Bool[ndarray, "c p"]:
        """Which points cannot be seen from which eyes."""
        hidden = np.zeros((len(eyes), len(points)), dtype=np.bool_)
        mark_hidden(self.kinds, self.halves, self.local_from_world, eyes.astype(float), points.astype(float), hidden)
        return hidden

    def draw(self, camera: DepthCamera, depth_m: Float[ndarray, "h w"], values: UInt8[ndarray, "h w"]) -> None:
        """Draw into ``depth_m`` (infinite where nothing is yet) and the materials into ``values``: exact depth along
        the optical axis, lens distortion included, by casting the pixels' rays."""
        if not len(self):
            return
        if any(camera.distortion):
            x, y = camera.rays[..., 0], camera.rays[..., 1]
        else:
            x = ((np.arange(camera.width) - camera.cx) / camera.fx)[None].astype(np.float32)
            y = ((np.arange(camera.height) - camera.cy) / camera.fy)[:, None].astype(np.float32)
        local_from_world = self.local_from_world
        frames = local_from_world[:, :, :3] @ camera.world_from_camera[:3]
        frames[:, :, 3] += local_from_world[:, :, 3]
        cast(x, y, self._windows(camera), self.kinds, self.halves, frames, self.materials, depth_m, values)

    def _windows(self, camera: DepthCamera) -> Int[ndarray, "n 4"]:
        """First and last row and column of the picture that each may cover."""
        whole = np.array([0, camera.height - 1, 0, camera.width - 1])
        # A shell is everywhere, and where the lens bends its edges a solid's corners do not bound it.
        if any(camera.distortion):
            return np.repeat(whole[None], len(self), 0)
        camera_from_world = camera.camera_from_world
        points = self.corners @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
        a, b = points[:, _EDGES[:, 0]], points[:, _EDGES[:, 1]]
        # An edge that passes the camera ends just before it.
        lengths = b[..., 2] - a[..., 2]
        part = (_CLIP_M - a[..., 2]) / np.where(lengths == 0, 1, lengths)
        crosses = (a[..., 2] < _CLIP_M) != (b[..., 2] < _CLIP_M)
        cuts = np.where(crosses[..., None], a + part[..., None] * (b - a), np.nan)
        points[points[..., 2] < _CLIP_M] = np.nan
        points = np.concatenate([points, cuts], 1)
        uv = points[..., :2] / points[..., 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
        low = np.clip(np.ceil(np.fmin.reduce(uv, 1)), 0, [camera.width, camera.height])
        high = np.clip(np.floor(np.fmax.reduce(uv, 1)), -1, [camera.width - 1, camera.height - 1])
        windows = np.stack([low[:, 1], high[:, 1], low[:, 0], high[:, 0]], 1)
        windows[np.isnan(windows[:, 0])] = -1  # all of it is behind the camera
        windows[self.kinds == SHELL] = whole
        return windows.astype(np.int64)


def _inverse(frames: Float[ndarray, "n 3 4"]) -> Float[ndarray, "n 3 4"]:
    turns = np.linalg.inv(frames[:, :, :3])
    return np.concatenate([turns, -turns @ frames[:, :, 3:]], 2)


def _one(kind: int, axes: ndarray, centre: ndarray, half: float, material: Material) -> Solids:
    frame = np.concatenate([axes, np.asarray(centre, dtype=float).reshape(3, 1)], 1)
    return Solids(
        np.array([kind], np.uint8), np.array([half], float), frame[None].astype(float), np.array([material], np.uint8)
    )


_Vector = Float[ndarray, "3"] | tuple[float, float, float]
_UPRIGHT = np.eye(3)


def box(
    centre: _Vector, half: _Vector, rotation: Float[ndarray, "3 3"] = _UPRIGHT, material: Material = Material.SCENE
) -> Solids:
    """A box by its centre and half sizes, turned by ``world_from_local``."""
    return _one(BOX, rotation * np.asarray(half), np.asarray(centre), 0.0, material)


def shell(low: _Vector, high: _Vector) -> Solids:
    """The inside of a box along the axes."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    return _one(SHELL, np.diag((high - low) / 2), (low + high) / 2, 0.0, Material.SCENE)


def ellipsoid(
    centre: _Vector, half: _Vector, rotation: Float[ndarray, "3 3"] = _UPRIGHT, material: Material = Material.SCENE
) -> Solids:
    """An ellipsoid by its centre and half axes, turned by ``world_from_local``."""
    return _one(ELLIPSOID, rotation * np.asarray(half), np.asarray(centre), 0.0, material)


def capsule(start: _Vector, end: _Vector, radius_m: float, material: Material = Material.SCENE) -> Solids:
    """What is within a radius of the line from ``start`` to ``end``."""
    return capsules(np.asarray(start)[None], np.asarray(end)[None], np.array([radius_m]), material)


def chain(points: Float[ndarray, "p 3"], radius_m: float, material: Material = Material.SCENE) -> Solids:
    """Capsules from point to point: a strap, a cable, a bent pipe."""
    return capsules(points[:-1], points[1:], np.full(len(points) - 1, radius_m), material)


def capsules(
    starts: Float[ndarray, "n 3"], ends: Float[ndarray, "n 3"], radii_m: Float[ndarray, "n"],
    material: Material = Material.SCENE,
) -> Solids:  # fmt: skip
    """Many capsules at once."""
    along = ends - starts
    halves = np.linalg.norm(along, axis=1) / 2
    axes = _axes_along(along) * radii_m[:, None, None]
    frames = np.concatenate([axes, ((starts + ends) / 2)[:, :, None]], 2)
    n = len(radii_m)
    return Solids(np.full(n, CAPSULE, np.uint8), halves / radii_m, frames, np.full(n, material, np.uint8))


def cylinder(start: _Vector, end: _Vector, radius_m: float, material: Material = Material.SCENE) -> Solids:
    """A cylinder with flat ends around the line from ``start`` to ``end``."""
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    half = float(np.linalg.norm(end - start)) / 2
    axes = _axes_along(end - start) * [radius_m, radius_m, half]
    return _one(CYLINDER, axes, (start + end) / 2, 0.0, material)


def above(height_m: float) -> Float[ndarray, "3"]:
    """The step straight up."""
    return np.array([0.0, 0.0, height_m])


def join(parts: Iterable[Solids]) -> Solids:
    """All solids of several."""
    parts = list(parts)
    if not parts:
        return NONE
    return Solids(
        np.concatenate([p.kinds for p in parts]),
        np.concatenate([p.halves for p in parts]),
        np.concatenate([p.frames for p in parts]),
        np.concatenate([p.materials for p in parts]),
    )


def _axes_along(directions: Float[ndarray, "*n 3"]) -> Float[ndarray, "*n 3 3"]:
    """Rotations that take the z axis to lines, either way round; any for a zero direction."""
    lengths = np.linalg.norm(directions, axis=-1, keepdims=True)
    x, y, z = np.moveaxis(np.where(lengths > 0, directions / np.where(lengths > 0, lengths, 1), [0, 0, 1]), -1, 0)
    x, y, z = (a * np.where(z < 0, -1, 1) for a in (x, y, z))
    share = 1 / (1 + z)
    rows = [1 - x * x * share, -x * y * share, x, -x * y * share, 1 - y * y * share, y, -x, -y, z]
    return np.stack(rows, -1).reshape(*directions.shape, 3)


#: Nothing.
NONE = Solids(np.zeros(0, np.uint8), np.zeros(0), np.zeros((0, 3, 4)), np.zeros(0, np.uint8))
