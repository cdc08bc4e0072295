"""Errors of a real depth sensor, applied to an exact depth image."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from depthmocap.errors import InputError
from depthmocap.geometry.depth_camera import DepthCamera
from depthmocap.kernels.sensor_errors import (
    EDGE_BLOCK,
    FACING_STEP,
    MARGIN,
    Pinhole,
    SensorTerms,
    blend_edges,
    cast_shadows,
    facing_share,
    mark_silhouettes,
    simulate_readings,
    smooth_noise,
)
from depthmocap.synth.render import Material


@dataclasses.dataclass(frozen=True)
class SensorModel:
    """Errors of a depth sensor. With its defaults, a model changes nothing.

    Time of flight, structured light and stereo are different settings of the same terms
    (``depthmocap.synth.sensing.sensors`` has them for sensors that exist, with their sources).

    Attributes:
        range_m: nearest and farthest reading.
        axial_m: standard deviation ``a + b z + c z²`` at z metres, of a bright surface that faces the sensor.
        grazing: the standard deviation grows by this times tan² of the angle of incidence, up to 80°.
        correlation: share of the variance that the pixels of a patch have in common.
        patch_px: size of patches (the window that structured light and stereo match); 1 for independent pixels.
        wave: standard deviation of a slowly varying error, in standard deviations of the reading; ``wave_px`` is its
            wavelength.
        lateral_px: standard deviation of the position that a pixel measures.
        fatten_px: how far foreground spreads over the background.
        lost_px: how far from a silhouette pixels are lost, on its far and on its near side.
        flying: share of flying pixels at a silhouette, between its two sides; without a background they lie within
            ``behind_m``.
        blend: share of pixels at a silhouette before nothing that are averaged with 0, as interpolation does when
            pictures with invalid pixels are undistorted or registered.
        multipath_m: error (too far) of a surface entirely surrounded by others that face it.
        reach_m: distance at which half of the readings of a bright surface that faces the sensor are lost. The signal
            falls with the distance squared, the cosine of the angle of incidence, the reflectance and the vignette.
        reflectance: by material, 1 for bright ones. The standard deviation is divided by its square root.
        hole_spread: standard deviation of the signal's logarithm; ``hole_px`` is the size of holes, ``hole_dust`` the
            share of the variance that is independent for each pixel.
        vignette: share of the signal that is missing in the corners.
        shadow_m: distance to the lamp, projector or second camera on the right (negative: on the left); pixels in its
            shadow are lost.
        baseline_m: disparity is measured over this length, in steps of ``disparity_step_px`` (0 for none).
        step_m: depth is rounded to steps of this from ``step_from_m``, 0 for none.
    """

    range_m: tuple[float, float] = (0.0, np.inf)
    axial_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    grazing: float = 0.0
    correlation: float = 0.0
    patch_px: float = 1.0
    wave: float = 0.0
    wave_px: float = 40.0
    lateral_px: float = 0.0
    fatten_px: float = 0.0
    lost_px: tuple[float, float] = (0.0, 0.0)
    flying: float = 0.0
    behind_m: float = 0.3
    blend: float = 0.0
    multipath_m: float = 0.0
    reach_m: float = np.inf
    reflectance: tuple[float, ...] = (1.0,) * len(Material)
    hole_spread: float = 0.3
    hole_px: float = 4.0
    hole_dust: float = 0.5
    vignette: float = 0.0
    shadow_m: float = 0.0
    baseline_m: float = 0.0
    disparity_step_px: float = 0.0
    step_m: float = 0.0
    step_from_m: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.range_m[0] < self.range_m[1]:
            raise InputError(f"range_m must be two growing distances from 0 on, got {self.range_m}")
        if len(self.reflectance) != len(Material) or min(self.reflectance) < 0:
            raise InputError(f"reflectance must be {len(Material)} numbers from 0 on, one a material")
        for name in ("flying", "blend", "correlation", "hole_dust", "vignette"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"{name} is a share: it must be in 0 to 1, got {getattr(self, name)}")
        if min(self.patch_px, self.wave_px, self.hole_px) < 1:
            raise InputError("patch_px, wave_px and hole_px must be at least 1")
        for name, value in dataclasses.asdict(self).items():
            if name not in ("shadow_m", "axial_m") and np.min(value) < 0:
                raise InputError(f"{name} must not be negative, got {value}")
        if self.disparity_step_px > 0 and not self.baseline_m:
            raise InputError("disparity_step_px needs a baseline_m")


def sense(
    depth_m: Float[ndarray, "h w"],
    material: UInt8[ndarray, "h w"] | None,
    camera: DepthCamera,
    model: SensorModel,
    rng: np.random.Generator,
) -> Float[ndarray, "h w"]:
    """The depth image (metres, float32) as the sensor reads it; 0 is invalid before and after.

    Only the bounding box of the valid pixels is computed. A pixel without depth stays without depth.

    Args:
        material: of each pixel (``render.Material``); without it all pixels are bright.

    Raises:
        InputError: when the image is not of the camera's size.
    """
    if depth_m.shape != (camera.height, camera.width):
        raise InputError(
            f"the depth image is {depth_m.shape[1]}×{depth_m.shape[0]} but camera {camera.name!r} is "
            f"{camera.width}×{camera.height}"
        )
    out = np.zeros(depth_m.shape, np.float32)
    seed = int(rng.integers(2**62))
    rows, columns = np.flatnonzero(depth_m.any(1)), np.flatnonzero(depth_m.any(0))
    if not len(rows):
        return out
    box = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
    depth = np.ascontiguousarray(depth_m[box], np.float32)
    materials = np.zeros(depth.shape, np.uint8) if material is None else np.ascontiguousarray(material[box])
    corner2 = (max(camera.cx, camera.width - camera.cx) ** 2) + max(camera.cy, camera.height - camera.cy) ** 2
    cx, cy = camera.cx - columns[0], camera.cy - rows[0]
    simulate_readings(
        _with_margin(depth, box, depth_m.shape),
        materials,
        np.array(model.reflectance, np.float32),
        _shadowed(depth, camera, model),
        _facing_share(depth, camera, model),
        _silhouette_blocks(depth, model),
        _smooth_noise(depth.shape, model, seed),
        Pinhole(float(camera.fx), float(camera.fy), float(cx), float(cy), float(corner2)),
        _terms(model, camera),
        seed,
        out[box],
    )
    if model.blend > 0:
        blend_edges(out.copy(), model.blend, seed + 4, out)
    return out


def _shadowed(depth: Float[ndarray, "h w"], camera: DepthCamera, model: SensorModel) -> Bool[ndarray, "_ _"]:
    """Pixels that the lamp does not reach; empty without shadows."""
    if model.shadow_m == 0:
        return np.zeros((0, 0), np.bool_)
    dark = np.zeros(depth.shape, np.bool_)
    cast_shadows(depth, camera.fx * model.shadow_m, dark)
    return dark


def _facing_share(depth: Float[ndarray, "h w"], camera: DepthCamera, model: SensorModel) -> Float[ndarray, "_ _"]:
    """How much of each pixel's surroundings faces it; empty without multipath."""
    if model.multipath_m <= 0:
        return np.zeros((0, 0), np.float32)
    coarse = np.empty((-(-depth.shape[0] // FACING_STEP), -(-depth.shape[1] // FACING_STEP)), np.float32)
    facing_share(depth, camera.fx, coarse)
    return cv2.resize(coarse, depth.shape[::-1], interpolation=cv2.INTER_LINEAR)


def _silhouette_blocks(depth: Float[ndarray, "h w"], model: SensorModel) -> Bool[ndarray, "_ _"]:
    """Blocks of pixels within reach of a silhouette; empty where silhouettes change nothing."""
    farthest_px = max(3 * model.lateral_px, 3 * model.fatten_px, *model.lost_px)
    if farthest_px <= 0 and model.flying <= 0:
        return np.zeros((0, 0), np.bool_)
    blocks = np.zeros((-(-depth.shape[0] // EDGE_BLOCK), -(-depth.shape[1] // EDGE_BLOCK)), np.bool_)
    mark_silhouettes(depth, int(min(np.ceil(farthest_px), MARGIN)) // EDGE_BLOCK + 1, blocks)
    return blocks


def _smooth_noise(shape: tuple[int, ...], model: SensorModel, seed: int) -> Float[ndarray, "fields h w"]:
    """Fields of smooth noise: displacement along u and v, error, slow error, and holes; empty if none is used."""
    cells = (model.patch_px, model.patch_px, model.patch_px, model.wave_px, model.hole_px)
    used = (
        model.patch_px > 1,
        model.patch_px > 1,
        model.correlation > 0,
        model.wave > 0,
        np.isfinite(model.reach_m) and model.hole_dust < 1,
    )
    smooth = np.empty((len(cells) if any(used) else 0, *shape), np.float32)
    for i, cell in enumerate(cells):
        if used[i]:
            smooth_noise(seed + 10 + i, cell, smooth[i])
    if used[3] and used[4]:
        # Holes of two sizes, since matching is usually poor over a wide area.
        smooth[4] = np.sqrt(0.5) * (smooth[3] + smooth[4])
    return smooth


def _with_margin(
    depth: Float[ndarray, "h w"], box: tuple[slice, slice], shape: tuple[int, ...]
) -> Float[ndarray, "h_out w_out"]:
    """A box of a picture with a margin: 0 within the picture, the border's values beyond it."""
    wide = cv2.copyMakeBorder(depth, MARGIN, MARGIN, MARGIN, MARGIN, cv2.BORDER_REPLICATE)
    rows, columns = box
    if rows.start > 0:
        wide[:MARGIN] = 0
    if rows.stop < shape[0]:
        wide[-MARGIN:] = 0
    if columns.start > 0:
        wide[:, :MARGIN] = 0
    if columns.stop < shape[1]:
        wide[:, -MARGIN:] = 0
    return wide


def _terms(model: SensorModel, camera: DepthCamera) -> SensorTerms:
    counted = model.disparity_step_px > 0
    disparity = camera.fx * model.baseline_m / model.disparity_step_px if counted else 0.0
    named = {name: float(getattr(model, name)) for name in SensorTerms._fields if hasattr(model, name)}
    return SensorTerms(
        axial_0=float(model.axial_m[0]),
        axial_1=float(model.axial_m[1]),
        axial_2=float(model.axial_m[2]),
        lost_far_px=float(model.lost_px[0]),
        lost_near_px=float(model.lost_px[1]),
        nearest_m=float(model.range_m[0]),
        farthest_m=float(model.range_m[1]),
        disparity_m=float(disparity),
        **named,
    )
