"""A light model of sensor noise for training on a GPU (extra: train): much less than ``synth.sensing`` knows."""

from __future__ import annotations

import dataclasses

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import max_pool2d

#: A step in depth between neighbours from which on they are of two surfaces (metres).
JUMP_M = 0.1
#: A flying pixel before nothing floats up to so far behind the surface (metres).
BEHIND_M = 0.15


@dataclasses.dataclass(frozen=True)
class TorchNoise:
    """Ranges that every picture draws its own noise from. They are our choice: from nearly perfect sensors to worse
    than time-of-flight cameras are specified.

    Attributes:
        axial_m: deviation of a reading at 0.5 m.
        axial_per_m: what a further metre adds to it.
        lateral_px: deviation of the ray through a pixel, in the sensor's pixels.
        edge_loss: share of pixels lost beside a depth edge.
        flying: share of pixels at a depth edge that float between the two surfaces.
        quantise_m: depth steps, one of which is drawn.
    """

    axial_m: tuple[float, float] = (0.0002, 0.003)
    axial_per_m: tuple[float, float] = (0.0002, 0.004)
    lateral_px: tuple[float, float] = (0.0, 0.5)
    edge_loss: tuple[float, float] = (0.0, 0.6)
    flying: tuple[float, float] = (0.0, 0.3)
    quantise_m: tuple[float, ...] = (0.001, 0.001, 0.01, 0.03)


def add_noise(
    depth_m: Float[Tensor, "b h w"], pixel_px: Float[Tensor, "b"], noise: TorchNoise, generator: torch.Generator
) -> Float[Tensor, "b h w"]:
    """Depth pictures as sensors read them; 0 is invalid before and after.

    Args:
        pixel_px: size of the pictures' pixels in those of the sensor.
    """
    device, shape = depth_m.device, depth_m.shape
    b, h, w = shape

    def one_each(bounds: tuple[float, float]) -> Tensor:
        low, high = bounds
        return (low + (high - low) * torch.rand(b, device=device, generator=generator))[:, None, None]

    def normal(*size: int) -> Tensor:
        return torch.randn(*size, device=device, generator=generator)

    lateral = one_each(noise.lateral_px) / pixel_px.float()[:, None, None]
    y = (torch.arange(h, device=device)[:, None] + normal(b, h, w) * lateral).round().long().clamp(0, h - 1)
    x = (torch.arange(w, device=device) + normal(b, h, w) * lateral).round().long().clamp(0, w - 1)
    out = depth_m.flatten(1).gather(1, (y * w + x).flatten(1)).view(shape)

    valid = out > 0
    far = max_pool2d(out, 3, 1, 1)
    near = -max_pool2d(torch.where(valid, -out, -torch.inf), 3, 1, 1)
    beside_nothing = max_pool2d((~valid).float(), 3, 1, 1) > 0
    edge = valid & (beside_nothing | (far - near > JUMP_M))
    chance = torch.rand(shape, device=device, generator=generator)
    blend = torch.rand(shape, device=device, generator=generator)
    flies = edge & (chance < one_each(noise.flying))
    lost = edge & (chance > 1 - one_each(noise.edge_loss))
    sigma = one_each(noise.axial_m) + one_each(noise.axial_per_m) * (out - 0.5).clamp(min=0)
    behind = torch.where(far > near + JUMP_M, far, near + BEHIND_M)
    out = torch.where(flies, near + blend * (behind - near), out + normal(b, h, w) * sigma)
    steps = torch.tensor(noise.quantise_m, device=device)
    step = steps[torch.randint(len(steps), (b, 1, 1), device=device, generator=generator)]
    out = (out / step).round() * step
    return torch.where(valid & ~lost & (out > 0), out, 0.0)
