"""What a real depth sensor does to a perfect depth image."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray


@dataclasses.dataclass(frozen=True)
class SensorNoise:
    """Noise of a time-of-flight camera, after published measurements of Kinect 2 and Azure Kinect.

    Attributes:
        axial_m: deviation of a reading at 0.5 m.
        axial_per_m: what a further metre adds to it.
        lateral_px: deviation of the ray through a pixel.
        edge_loss: share of pixels lost beside a depth edge.
        flying: share of pixels at a depth edge that float between the two surfaces.
        holes: mean number of holes on the picture, 5–13 px wide.
        quantise_m: depth step, 0 for none.
    """

    axial_m: float = 0.0005
    axial_per_m: float = 0.001
    lateral_px: float = 0.25
    edge_loss: float = 0.25
    flying: float = 0.15
    holes: float = 0.5
    quantise_m: float = 0.001


def random_noise(rng: np.random.Generator) -> SensorNoise:
    """Sensors from nearly perfect to much worse than specified, some quantised as UBC3V's 8-bit pictures are."""
    scale = float(rng.choice([0.3, 1.0, 3.0]) * rng.uniform(0.5, 1.5))
    return SensorNoise(
        axial_m=0.001 * scale,
        axial_per_m=0.0015 * scale,
        lateral_px=float(rng.uniform(0, 0.5)),
        edge_loss=float(rng.uniform(0, 0.6)),
        flying=float(rng.uniform(0, 0.3)),
        holes=float(rng.choice([0, 1, 4])),
        quantise_m=float(rng.choice([0.001, 0.001, 0.01, 0.0303])),
    )


_EDGE_JUMP_M = 0.1


def apply_noise(depth_m: Float[ndarray, "h w"], noise: SensorNoise, rng: np.random.Generator) -> Float[ndarray, "h w"]:
    """The depth image as the sensor reads it; 0 is invalid before and after."""
    height, width = depth_m.shape
    out = depth_m
    if noise.lateral_px > 0:
        shift = rng.normal(0, noise.lateral_px, (2, height, width)).astype(np.float32)
        u, v = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
        out = cv2.remap(out, u + shift[0], v + shift[1], cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    kernel = np.ones((3, 3), np.uint8)
    far = cv2.dilate(out, kernel)
    near = -cv2.dilate(np.where(out > 0, -out, -100.0).astype(np.float32), kernel)
    edge = _edges(out, far, near)
    chance = rng.random(out.shape, dtype=np.float32)
    blend = rng.random(out.shape, dtype=np.float32)
    valid = out > 0
    flies = edge & valid & (chance < noise.flying) & (near < 50)
    sigma = noise.axial_m + noise.axial_per_m * np.maximum(out - 0.5, 0)
    out = out + rng.standard_normal(out.shape, dtype=np.float32) * sigma
    # A flying pixel floats between what is nearer and what is farther; before nothing it floats a little behind.
    behind = np.where(far > near + _EDGE_JUMP_M, far, near + 0.15)
    out = np.where(flies, near + blend * (behind - near), out)
    lost = edge & (chance > 1 - noise.edge_loss)
    for _ in range(rng.poisson(noise.holes) if noise.holes else 0):
        centre = (int(rng.integers(width)), int(rng.integers(height)))
        axes = (int(rng.integers(2, 7)), int(rng.integers(2, 7)))
        hole = cv2.ellipse(np.zeros(out.shape, np.uint8), centre, axes, float(rng.uniform(0, 180)), 0, 360, 1, -1)
        lost |= hole.astype(bool)
    if noise.quantise_m > 0:
        out = np.round(out / noise.quantise_m) * noise.quantise_m
    return np.where(valid & ~lost & (out > 0.05), out, 0).astype(np.float32)


def apply_noise_near(
    depth_m: Float[ndarray, "h w"], mask: Bool[ndarray, "h w"], noise: SensorNoise, rng: np.random.Generator
) -> Float[ndarray, "h w"]:
    """Noise on the masked pixels alone, made only around them; the rest of the result is 0."""
    out = np.zeros_like(depth_m)
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if len(rows):
        box = slice(max(rows[0] - 3, 0), rows[-1] + 4), slice(max(columns[0] - 3, 0), columns[-1] + 4)
        out[box] = np.where(mask[box], apply_noise(np.ascontiguousarray(depth_m[box]), noise, rng), 0)
    return out


def _edges(
    depth: Float[ndarray, "h w"], far: Float[ndarray, "h w"], near: Float[ndarray, "h w"]
) -> Bool[ndarray, "h w"]:
    """Pixels beside a jump in depth, or beside nothing."""
    beside_nothing = cv2.erode((depth > 0).astype(np.uint8), np.ones((3, 3), np.uint8)) == 0
    return (far - near > _EDGE_JUMP_M) | beside_nothing
